"""Error against wall time for every system, and what growth costs.

Each system's model is run with many settings - time step, segments, integrator, bending form, platform, precision, way to an
equilibrium, length of a thermal run - and held against its exact answer. The Pareto front tells what an error costs, the fits
tell the order of convergence, and the cheapest setting that meets what a system states of itself is set beside its default.
Wall times exclude imports and include building and stepping; every setting is run several times, in turns.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import openmm as mm
from rich.console import Console

from systems import stage
from systems.error_vs_runtime import figures, judgement, tables
from systems.error_vs_runtime.integrators import available
from systems.error_vs_runtime.settings import Study, measured
from systems.error_vs_runtime.sweeps import growth as growing
from systems.error_vs_runtime.sweeps import statics, swinging, thermal
from systems.mass_spring.chain import Chain
from systems.scene import Summary

__all__ = ["STUDIES", "options", "run"]

REPEATS, QUICK_REPEATS = 3, 2

GROWTH_SHARE = 6.0
"""Part of the time that growth takes, in the units of `Study.share`."""


def options(parser: argparse._ArgumentGroup) -> None:
    """Add the system's own command-line options."""
    parser.add_argument(
        "--only", metavar="SYSTEM", action="append", help="one system, or `growth`; may be given several times"
    )
    parser.add_argument(
        "--repeats", type=int, help=f"runs of each setting; default {REPEATS} ({QUICK_REPEATS} with --quick)"
    )


STUDIES = {
    "mass_spring": (swinging.mass_spring_studies,),
    "guitar_string": (swinging.guitar_studies,),
    "xylophone_bar": (swinging.bar_studies,),
    "weighted_string": (swinging.weighted_studies,),
    "open_ring": (statics.ring_studies,),
    "planar_force_extension": (statics.planar_studies, thermal.planar_studies),
    "helix_force_extension": (statics.helix_studies, thermal.helix_studies),
    "dna_force_extension": (thermal.dna_studies,),
}
"""What makes the questions of each system."""


def run(folder: Path, *, quick: bool, seed: int, options: argparse.Namespace) -> int:
    """Run all sweeps and write the results into `folder`; 1 if an exact check fails, else 0."""
    begun = time.perf_counter()
    repeats = (QUICK_REPEATS if quick else REPEATS) if options.repeats is None else options.repeats
    if repeats < 1:
        raise ValueError(f"Argument `--repeats` must be at least 1, but is {repeats}.")
    wanted = options.only or [*STUDIES, "growth"]
    if unknown := sorted(set(wanted) - {*STUDIES, "growth"}):
        raise ValueError(f"Argument `--only` must be one of {', '.join([*STUDIES, 'growth'])}, but is {unknown[0]}.")
    asked = [study for name in STUDIES if name in wanted for make in STUDIES[name] for study in make(quick=quick)]
    studies, growth = _measured(asked, repeats, seed, growth="growth" in wanted, quick=quick)
    checks, findings = judgement.checks(studies), judgement.findings(studies)
    if studies:
        tables.write_runs(folder / "runs.csv", studies)
        tables.write_table(folder / "table.csv", studies)
    for name in dict.fromkeys(s.system for s in studies):
        figures.draw_system(folder / f"{name}.png", [s for s in studies if s.system == name])
    if growth is not None:
        tables.write_growth(folder / "growth.csv", growth)
        figures.draw_growth(folder / "growth.png", growth)
        checks += judgement.growth_checks(growth)
        findings += judgement.growth_findings(growth)
    console = Console()
    if studies:
        console.print(tables.printed(studies))
    return stage.close(
        folder,
        Summary(
            system="error_vs_runtime",
            models=[Chain(9).model],
            platform=", ".join(available()),
            wall_seconds=time.perf_counter() - begun,
            filament={
                "repeats": repeats,
                "settings": sum(len(s.outcomes) for s in studies),
                "runs": sum(len(o.results) for s in studies for o in s.outcomes),
                "recommended": {
                    f"{s.system}, {s.question}": best.setting.label
                    for s in studies
                    if (best := judgement.recommended(s)) is not None
                },
                "openmm": mm.__version__,
            },
            checks=checks,
            findings=findings,
        ),
        console,
    )


def _measured(
    studies: Sequence[Study], repeats: int, seed: int, *, growth: bool, quick: bool
) -> tuple[list[Study], growing.Growth | None]:
    """Run what was asked for, with a progress bar over all of it."""
    whole = sum(s.share for s in studies) + (GROWTH_SHARE if growth else 0.0)
    out: list[Study] = []
    grown = None
    with stage.progress("error against run time") as show:
        done = 0.0
        for study in studies:
            outcomes = measured(study, repeats, seed, lambda f, d=done, s=study.share: show((d + f * s) / whole))  # type: ignore[misc]
            out.append(replace(study, outcomes=tuple(outcomes)))
            done += study.share
        if growth:
            grown = growing.grown(quick=quick, progress=lambda f: show((done + f * GROWTH_SHARE) / whole))
    return out, grown
