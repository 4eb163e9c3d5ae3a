"""A double-stranded DNA pulled in thermal motion: extension against force, held against the worm-like chain.

Contour 1 um, persistence length 53 nm (lambda phage DNA in 10 mM Na+, thesis 2.8), stretch modulus 1000 pN, 298 K; one
end held, 12 forces from 0.05 to 50 pN. Every point is sampled by Langevin dynamics and compared with the exact discrete
chain that was run and with the exact continuous one of the same finite length.
"""

from __future__ import annotations

import argparse
import time
from contextlib import ExitStack
from pathlib import Path

from openmm import unit
from rich.console import Console

import openmm_filament as of
from systems.cluster import dask_executor
from systems.dna_force_extension import figures, judgement
from systems.dna_force_extension.curve import (
    CONTOUR,
    FORCES,
    MODULUS,
    PERSISTENCE,
    SHOWN,
    TEMPERATURE,
    chain,
    error_parts,
    model_shown,
    rows_of,
    wanted_errors,
    write_csv,
)
from systems.dna_force_extension.display import Display, table
from systems.scene import Summary, prepared_checkpoint, what_goes_on

__all__ = ["options", "run"]


def options(parser: argparse._ArgumentGroup) -> None:
    """Add the system's own command-line options."""
    parser.add_argument(
        "--relative-error",
        type=float,
        metavar="E",
        help="bound on bias plus two standard errors at every force; default 0.009 from 0.3 pN up, 0.027 below, so that a "
        "point seldom misses 1 and 3 %% by chance (0.06 with --quick)",
    )
    parser.add_argument("--processes", type=int, help="worker processes; by default one a core")
    parser.add_argument(
        "--platform",
        default="Reference",
        help="of OpenMM; on CUDA, HIP and OpenCL the whole curve is one Context (default Reference)",
    )
    parser.add_argument(
        "--resume",
        action="store_true",
        help="go on with a run that was ended, from the checkpoint beside its folder, with the same options",
    )
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="of a Dask scheduler, whose workers of one thread each do the work; `local` starts one here",
    )
    parser.add_argument("--all-trajectories", action="store_true", help="keep a trajectory at every force")


def run(folder: Path, *, quick: bool, seed: int, options: argparse.Namespace) -> int:
    """Sample the curve, write the results into `folder`; 1 if an exact check fails, else 0."""
    begun = time.perf_counter()
    console = Console()
    wanted = wanted_errors(options.relative_error, quick=quick)
    paths = {SHOWN: folder / "trajectory.dcd"}
    if options.all_trajectories:
        paths |= {i: folder / f"trajectory_{force:.3g}pN.dcd" for i, force in enumerate(FORCES) if i != SHOWN}
    kept = prepared_checkpoint(options.output, resume=options.resume, overwrite=options.overwrite)
    with ExitStack() as opened:
        executor, processes = None, options.processes
        if options.scheduler is not None:
            executor = opened.enter_context(dask_executor(options.scheduler, processes))
            processes = None if options.scheduler == "local" else processes
        display = opened.enter_context(Display(console))
        curve = of.force_extension(
            chain(),
            FORCES * unit.piconewton,
            TEMPERATURE * unit.kelvin,
            wanted,
            seed=seed,
            processes=processes,
            executor=executor,
            platform=options.platform,
            checkpoint=kept,
            trajectories=paths,
            progress=display.show,
        )
    interrupted = bool(curve.attrs["interrupted"])
    rows, parts = rows_of(curve), error_parts(curve)
    console.print(table(rows))
    write_csv(folder / "force_extension.csv", rows)
    write_csv(folder / "error_parts.csv", parts)
    curve.to_netcdf(folder / "force_extension.nc", engine="scipy")
    figures.draw_curve(folder / "force_extension.png", rows)
    figures.draw_budget(folder / "error_parts.png", parts, wanted)
    checks = [] if interrupted else judgement.checks(folder, rows, parts, wanted)
    summary = Summary(
        system="dna_force_extension",
        models=[model_shown(curve)],
        platform=curve.attrs["platform"],
        wall_seconds=time.perf_counter() - begun,
        filament={
            "contour_length_nm": CONTOUR,
            "persistence_length_nm": PERSISTENCE,
            "stretch_modulus_pN": MODULUS,
            "temperature_K": TEMPERATURE,
            "bending_form": "harmonic",
            "seed": seed,
            "held_bead": 0,
            "pulled_bead": -1,
        },
        checks=checks,
        findings=judgement.findings(rows, parts, interrupted=interrupted),
    )
    summary.write(folder)
    for check in checks:
        verdict = "[green]passed[/]" if check.passed else "[red]FAILED[/]"
        console.print(f"{verdict} {check.name}: {check.error:.3g} (at most {check.tolerance:.3g})", soft_wrap=True)
    if interrupted:
        console.print(f"interrupted: {what_goes_on(kept)}", soft_wrap=True)
        return 130
    return 0 if summary.passed else 1
