"""The pseudoknot (thesis 2.9): two elastic helices that intertwine and hold each other with no bond between them.

One helix is held at its foot. A hand brings another, at its end, screws it in, lets go, and after a rest in thermal motion
pulls it straight out. Work is counted from the traps that are the hand, over starts of any phase with the axes offset and
tilted, at several speeds; controls, other ways to make and break it, and its numbers varied stand beside it. Contact has no
friction. Springs of millimetres feel no temperature; the thermostat's is scaled, a part of E I/R.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from openmm import unit

import openmm_filament as of
from openmm_filament.executors import available_workers
from openmm_filament.parallel import run_all
from systems import stage
from systems.cluster import dask_executor
from systems.pseudoknot import figures, findings, judgement, plan
from systems.pseudoknot.hands import PLATFORM, TRAP, Task, model_of
from systems.pseudoknot.rows import Row, rows_of, write_csv
from systems.pseudoknot.runs import Result, attempt
from systems.scene import Check, Summary

__all__ = ["options", "run"]


def options(parser: argparse._ArgumentGroup) -> None:
    """Add the system's own command-line options."""
    parser.add_argument("--processes", type=int, help="worker processes; by default one a core")
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="of a Dask scheduler, whose workers of one thread each do the work; `local` starts one here",
    )


def run(folder: Path, *, quick: bool, seed: int, options: argparse.Namespace) -> int:
    """Run the ensembles and write the results into `folder`; 1 if an exact check fails, 130 after Ctrl-C, else 0."""
    begun = time.perf_counter()
    cases = plan.cases(quick=quick)
    planned = plan.tasks(cases, seed)
    crews = sorted(plan.crews([task for _, _, task in planned]), key=lambda crew: -_cost([planned[i][2] for i in crew]))
    together = [tuple(planned[i][2] for i in crew) for crew in crews]
    with ExitStack() as opened:
        executor = None
        if options.scheduler is not None:
            executor = opened.enter_context(dask_executor(options.scheduler, options.processes))
        show = opened.enter_context(stage.progress("pairs of chains"))
        show(0.0)
        found = run_all(
            attempt,
            together,
            available_workers(options.processes),
            show,
            executor=executor,
            costs=[_cost(tasks) for tasks in together],
        )
    came = [
        (planned[i], result)
        for crew, each in zip(crews, found, strict=True)
        if each
        for i, result in zip(crew, each, strict=True)
    ]
    results = [(case, pace, result) for (case, pace, _), result in came if isinstance(result, Result)]
    failures = [result for _, result in came if isinstance(result, str)]
    interrupted = None in found
    order = [case.label for case in cases]
    results.sort(key=lambda entry: (order.index(entry[0].label), entry[1], entry[2].task.seed))
    rows = _rows(results)
    table = judgement.settings(rows, cases)
    write_csv(folder / "pseudoknot.csv", rows)
    judgement.write_settings(folder / "parameters.csv", table)
    said, checks = _judged(
        folder, results, rows, table, failed=len(failures), interrupted=interrupted, frames=FRAMES[quick]
    )
    code = stage.close(
        folder,
        Summary(
            system="pseudoknot",
            models=[model_of([result.task], [result.task.start()]) for _, _, result in results[:1]],
            platform=PLATFORM,
            wall_seconds=time.perf_counter() - begun,
            filament=_numbers(seed),
            checks=checks,
            findings=[*said, *failures],
        ),
    )
    return 130 if interrupted else code


def _cost(tasks: Sequence[Task]) -> float:
    """Of a Context, in some unit: its steps times what one costs, by itself and for each bead."""
    beads = sum(len(task.poses) * (task.lower.segments + task.upper.segments + 2) for task in tasks)
    return max(plan.steps(task) for task in tasks) * (beads + 400)


def _rows(results: list[tuple[plan.Case, float, Result]]) -> list[Row]:
    """All pairs, those of a case and speed numbered through."""
    rows: list[Row] = []
    for case, pace, result in results:
        before = sum(row.label == case.label and row.slowness == pace for row in rows)
        rows += rows_of(case, pace, result, before)
    return rows


def _judged(
    folder: Path,
    results: list[tuple[plan.Case, float, Result]],
    rows: list[Row],
    table: list[judgement.Setting],
    *,
    failed: int,
    interrupted: bool,
    frames: int,
) -> tuple[list[str], list[Check]]:
    """Findings and checks, with the figures drawn; what is left of them after Ctrl-C."""
    said = []
    shown = next((result for _, _, result in results if result.task.film), None)
    if shown is not None:
        said = _pictures(folder, shown, frames)
        figures.energies(folder / "energy.png", shown)
        figures.course(folder / "making_and_breaking.png", shown)
    if interrupted:
        return [f"Interrupted: {len(rows)} pairs were done and stand in the tables.", *said], []
    try:
        slow = judgement.outcome(rows)
    except ValueError as error:
        return [str(error), *said], judgement.checks(results, rows, None, failed)
    figures.summary(folder / "pseudoknot.png", table, slow)
    figures.parameters(folder / "parameters.png", table)
    return [*findings.sentences(rows, table, slow), *said], judgement.checks(results, rows, slow, failed)


FRAMES = {False: 60, True: 24}
"""Frames of the trajectory and of the film, at most, of a full and of a quick run."""


def _pictures(folder: Path, shown: Result, most: int) -> list[str]:
    """The trajectory of one pair from apart to apart, and its film; a finding where it cannot be drawn."""
    phases = (shown.making, shown.resting, shown.breaking)
    ends = np.cumsum([0.0, *(phase.times[-1] for phase in phases)])
    times = np.concatenate([phase.times + end for phase, end in zip(phases, ends, strict=False)])
    frames = np.concatenate([phase.frames for phase in phases]) * 1e9
    chosen = np.unique(np.linspace(0, len(times) - 1, most).astype(int))
    task = shown.task
    model = model_of([task], [task.start()[:1]])
    stage.write_trajectory(folder / "trajectory.dcd", model, times[chosen], frames[chosen])
    if not of.rendering.available():
        return [stage.NO_PICTURES]
    first, radius = task.lower.segments + 1, task.lower.thickness / 2 * unit.meter
    held = len(phases[0].times) + len(phases[1].times) - 1
    pair = [frames[held][:first] * unit.nanometer, frames[held][first:] * unit.nanometer]
    of.rendering.still(
        pair, folder / "still.png", radius=radius, title="Two helices hold each other, nothing else does"
    )
    moving = [frames[chosen][:, :first] * unit.nanometer, frames[chosen][:, first:] * unit.nanometer]
    of.rendering.animate(
        moving,
        folder / "animation.mp4",
        times=times[chosen] * unit.second,
        radius=radius,
        title="Screwed in, left alone, pulled straight out",
    )
    return []


def _numbers(seed: int) -> dict[str, object]:
    wire = plan.BASE
    return {
        "thickness_m": wire.thickness,
        "helix_radius_m": wire.radius,
        "pitch_m": wire.pitch,
        "turns": wire.turns,
        "segments": wire.segments,
        "youngs_modulus_Pa": wire.youngs_modulus,
        "shear_modulus_Pa": wire.shear_modulus,
        "density_kg_per_m3": wire.density,
        "contact_stiffness_N_per_m": wire.stretching(),
        "trap_stiffness_N_per_m": TRAP * wire.stretching(),
        "damping_per_s": plan.DAMPING / wire.period(),
        "overlap_turns": plan.OVERLAP,
        "largest_shift_m": plan.SHIFT * wire.thickness,
        "largest_tilt_rad": plan.TILT,
        "bending_over_radius_J": wire.energy,
        "thermal_energy_J": plan.WARMTH * wire.energy,
        "bending_form": "harmonic",
        "temperature_K": plan.WARMTH * wire.energy / 1.380649e-23,
        "seed": seed,
    }
