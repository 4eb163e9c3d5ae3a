"""Error against wall time for every system, and what growth costs.

Each system's model is run with many settings - time step, segments, integrator, bending form, platform, precision, way to an
equilibrium, length of a thermal run - and held against its exact answer. The Pareto front tells what an error costs, the fits
tell the order of convergence, and the cheapest setting that meets what a system states of itself is set beside its default.
Wall times exclude imports and include building and stepping; every setting is run several times, in turns, as often as the
time allows.
"""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path

import openmm as mm
from rich.console import Console

from systems import stage
from systems.error_vs_runtime import figures, judgement, tables, turns
from systems.error_vs_runtime.integrators import available
from systems.error_vs_runtime.sweeps import bars, knots, loaded, masses, statics, strung, thermal
from systems.error_vs_runtime.sweeps import growth as growing
from systems.mass_spring.chain import Chain
from systems.scene import Summary

__all__ = ["STUDIES", "options", "run"]

REPEATS, QUICK_REPEATS = 5, 2
"""Most runs of each setting: fewer, but two, where the time is short."""

MINUTES, QUICK_MINUTES = 20.0, 2.0
"""What a run may take on an idle machine."""

DRAWING = 15.0
"""Seconds that figures and tables are expected to take."""


def options(parser: argparse._ArgumentGroup) -> None:
    """Add the system's own command-line options."""
    parser.add_argument(
        "--only", metavar="SYSTEM", action="append", help="one system, or `growth`; may be given several times"
    )
    parser.add_argument(
        "--repeats",
        type=int,
        help=f"runs of each setting, whatever they take; by default up to {REPEATS} that end in {MINUTES:g} minutes, "
        f"{QUICK_REPEATS} with --quick",
    )


STUDIES = {
    "mass_spring": (masses.mass_spring_studies,),
    "guitar_string": (strung.guitar_studies,),
    "xylophone_bar": (bars.bar_studies,),
    "weighted_string": (loaded.weighted_studies,),
    "open_ring": (statics.ring_studies,),
    "planar_force_extension": (statics.planar_studies, thermal.planar_studies),
    "helix_force_extension": (statics.helix_studies, thermal.helix_studies),
    "dna_force_extension": (thermal.dna_studies,),
    "pseudoknot": (knots.pseudoknot_studies,),
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
    studies = [study for name in STUDIES if name in wanted for make in STUDIES[name] for study in make(quick=quick)]
    growth_seconds = growing.expected(quick=quick) if "growth" in wanted else 0.0
    whole = turns.expected(studies, repeats) + growth_seconds + DRAWING
    allowed = 60 * (QUICK_MINUTES if quick else MINUTES)
    console = Console()
    console.print(_announced(turns.expected(studies, 1), repeats, growth_seconds, whole, allowed))
    growth = None
    with stage.progress("error against run time") as show:
        part = 1 - growth_seconds / (whole - DRAWING)
        left = allowed - growth_seconds - DRAWING - (time.perf_counter() - begun)
        studies = turns.measured(
            studies, repeats, seed, lambda f: show(part * f), seconds=left if options.repeats is None else math.inf
        )
        if "growth" in wanted:
            growth = growing.grown(quick=quick, progress=lambda f: show(part + f * (1 - part)))
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
                "repeats": max((len(o.results) for s in studies for o in s.outcomes), default=0),
                "repeats_asked_for": repeats,
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


def _announced(one: float, repeats: int, growth: float, whole: float, allowed: float) -> str:
    """What a run is expected to take, before it begins."""
    text = (
        f"{repeats} runs of every setting, about {one:.0f} s each time on an idle core, and {growth:.0f} s of growth: "
    )
    text += f"{whole / 60:.1f} minutes with figures"
    return text + (f"; fewer runs, but {turns.FEWEST}, if they take more than {allowed / 60:g}.")
