"""What breaks it: a map made by running. Each cell is right, with its error, told of, refused with a message, or wrong.

Time step limits and energy drift, stiffness and mass ratios, sizes, numbers of beads, amplitudes, bending angles from straight
to folded back, coincident beads, dihedrals across +-pi, temperatures, forces, and single, mixed and double precision.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from pathlib import Path

import openmm_filament as of
from systems import stage
from systems.scene import Check, Summary
from systems.stability import cells, figures, limits, precision, pulls, scales, shapes, thermal

__all__ = ["Map", "options", "run"]


class Map:
    """All cells, and the series behind two of their axes."""

    def __init__(self) -> None:
        self.cells: list[cells.Cell] = []
        self.limits: list[limits.Limit] = []
        self.drifts: list[tuple[float, float, float]] = []

    def make(self, *, quick: bool) -> None:
        """Run everything, one axis after the other."""
        axes = (
            limits.limits(quick=quick, into=self.limits),
            limits.drifts(quick=quick, into=self.drifts),
            scales.ratios(quick=quick),
            scales.masses(quick=quick),
            scales.sizes(quick=quick),
            scales.counts(quick=quick),
            scales.amplitudes(quick=quick),
            shapes.angles(),
            shapes.coincident(),
            shapes.dihedrals(),
            thermal.temperatures(quick=quick),
            pulls.forces(quick=quick),
            precision.precisions(quick=quick),
        )
        with stage.progress("cells of the map") as show:
            for i, axis in enumerate(axes):
                self.cells += axis
                show((i + 1) / len(axes))


def options(parser: argparse._ArgumentGroup) -> None:
    """Add the system's own command-line options: there are none."""
    del parser


def run(folder: Path, *, quick: bool, seed: int, options: argparse.Namespace) -> int:
    """Make the map and write it into `folder`; 1 if a cell is wrong or a limit off by more than 5 %, else 0."""
    del seed, options  # what is random here is seeded where it stands, so that the map is the same map every time
    begun = time.perf_counter()
    made = Map()
    made.make(quick=quick)
    cells.write(folder / "stability.csv", made.cells)
    figures.draw(folder / "stability.png", made.cells, made.limits, made.drifts)
    counted = Counter(cell.outcome for cell in made.cells)
    shown = of.build(next(iter(limits.chains(quick=True)))[3]().filaments[0])
    return stage.close(
        folder,
        Summary(
            system="stability",
            models=[shown],
            platform="Reference; CPU and OpenCL for precision",
            wall_seconds=time.perf_counter() - begun,
            filament={"cells": len(made.cells), **{name.replace(" ", "_"): counted[name] for name in cells.OUTCOMES}},
            checks=checks(made),
            findings=findings(made.cells),
        ),
    )


def checks(made: Map) -> list[Check]:
    """No cell wrong, on each axis; every limit within 5 %; the spread of the energy of second order in the time step."""
    out = []
    for axis in dict.fromkeys(cell.axis for cell in made.cells):
        wrong = sum(cell.outcome == "wrong" for cell in made.cells if cell.axis == axis)
        out.append(Check(f"{axis}: wrong cells", "exact", float(wrong), 0.0, float(wrong), 0.0))
    for limit in made.limits:
        ratio = limit.predicted / limit.found if limit.found else float("inf")
        name = f"time step limit, {limit.case}, {limit.label}: predicted over found"
        out.append(Check(name, "exact", ratio, 1.0, abs(ratio - 1), limits.LIMIT))
    spread = {part: kept for part, _, kept in made.drifts}
    order = figures.slope([(part, spread[part]) for part in (0.03, 0.1, 0.2)])
    out.append(Check("order of the energy's spread in the time step", "exact", order, 2.0, abs(order - 2), 0.2))
    return out


def findings(made: list[cells.Cell]) -> list[str]:
    """Counts by axis, and the largest error that counts as right."""
    out = []
    for axis in dict.fromkeys(cell.axis for cell in made):
        own = [cell for cell in made if cell.axis == axis]
        counted = Counter(cell.outcome for cell in own)
        said = ", ".join(f"{counted[name]} {name}" for name in cells.OUTCOMES if counted[name])
        worst = max((cell for cell in own if cell.outcome == "right"), key=lambda cell: cell.error, default=None)
        largest = f"; largest error {worst.error:.2g} ({worst.case}, {worst.label})" if worst else ""
        out.append(f"{axis[0].upper()}{axis[1:]}: {said}{largest}.")
    out += [
        f"WRONG: {c.axis}, {c.case}, {c.label}: error {c.error:.3g}. {c.message}"[:300]
        for c in made
        if c.outcome == "wrong"
    ]
    return out
