"""What the systems that move share: a stretched wire, a running Context, progress, trajectories and the closing report."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

import numpy as np
import openmm as mm
from numpy.typing import NDArray
from openmm import unit
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

import openmm_filament as of
from openmm_filament.integrators import internal_langevin
from openmm_filament.motion import Motion
from openmm_filament.trajectory import TrajectoryWriter
from systems.scene import Check, Summary

__all__ = [
    "JOULE",
    "NEWTON",
    "NO_PICTURES",
    "alike",
    "close",
    "context",
    "metres",
    "progress",
    "seconds",
    "wire",
    "write_trajectory",
]

Array = NDArray[np.float64]

NEWTON = 1e-12 * unit.AVOGADRO_CONSTANT_NA.value_in_unit(unit.mole**-1)
"""One newton in kJ/mol/nm."""

NO_PICTURES = 'No 3D pictures: `pip install "openmm-filament[render]"` installs what draws them.'
"""The finding of a system where PyVista is missing."""

JOULE = 1e-3 * unit.AVOGADRO_CONSTANT_NA.value_in_unit(unit.mole**-1)
"""One joule in kJ/mol."""


def wire(
    segments: int,
    *,
    length: float,
    radius: float,
    youngs_modulus: float,
    line_density: float,
    damping: float | Array | None = None,
    masses: Array | None = None,
    softer: float = 1.0,
    form: Literal["arccosine", "arctangent"] = "arccosine",
) -> of.Filament:
    """A straight wire of circular section along z, in SI units: stretching and bending, no torsion.

    Parameters
    ----------
    damping : float or (segments + 1,) array, optional
        1/s.
    masses : (segments + 1,) array, optional
        kg; by default `line_density` times the segment length for every bead.
    softer : float
        What the stretching stiffness is divided by. Small transverse motion does not feel it, as long as the tension is
        the same, and the time step is longer by its square root.
    form : "arccosine" or "arctangent"
        Of `of.bending.Harmonic`: with the second a nearly straight wire keeps its energy.
    """
    step = length / segments
    section = math.pi * radius**2
    stretching = youngs_modulus * section / step / softer
    bending = youngs_modulus * math.pi * radius**4 / 4 / step
    return of.Filament(
        of.shapes.line(segments, step * unit.meter),
        (line_density * step if masses is None else masses) * unit.kilogram,
        (
            of.stretching.Harmonic(stretching * unit.newton / unit.meter),
            of.bending.Harmonic(bending * unit.joule, form=form),
        ),
        damping=None if damping is None else damping / unit.second,
    )


def context(model: of.Model, integrator: mm.Integrator, platform: str | None = None) -> mm.Context:
    """A Context at the rest positions, checked by preflight, on the platform named or else the fastest.

    Name "Reference" where positions are read every few steps: other platforms may step faster but hand over a State slowly.
    """
    chosen = of.fastest_platform(model) if platform is None else mm.Platform.getPlatformByName(platform)
    made = mm.Context(model.system, integrator, chosen, of.platform_properties(model, chosen))
    made.setPositions(model.positions)
    of.preflight(model, made)
    return made


def alike(model: of.Model, timestep: float, damping: float) -> mm.Integrator:
    """What takes the steps, of `timestep` s, of Euler-Cromer in half the time where all beads are damped alike, at `damping` 1/s.

    LangevinMiddle at zero temperature: with the friction that keeps `1 - gamma dt` of a velocity its positions are those of
    Euler-Cromer under forces `1 - gamma dt/2` times as large. Raises ValueError for a step above the stability limit.
    """
    step = of.euler_cromer(model, timestep=timestep * unit.second).getStepSize().value_in_unit(unit.picosecond)
    return internal_langevin(model, 0.0, -math.log1p(-damping * timestep) / step, step, None)


def seconds(motion: Motion) -> Array:
    """The times (T,) of a motion in s."""
    return np.asarray(motion.times.value_in_unit(unit.second))


def metres(values: Array) -> Array:
    """Lengths in nm, as `record` gives them, in m."""
    return values * 1e-9


@contextmanager
def progress(text: str) -> Iterator[Callable[[float], None]]:
    """A progress bar with the time left; yields the function that takes the fraction done."""
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        console=Console(),
        transient=True,
    )
    with bar:
        task = bar.add_task(text, total=1.0)
        yield lambda fraction: bar.update(task, completed=fraction)


def write_trajectory(path: Path, model: of.Model, times: Array, positions: Array) -> None:
    """Frames, physical positions (T, N, 3) in nm at times (T,) in s, as DCD, PDB and sidecar; `of.load` reads them."""
    writer = TrajectoryWriter(model, path)
    to_internal = 1e12 / model.scale.factor("time")
    for i, (time, frame) in enumerate(zip(times, positions, strict=True)):
        writer.write(frame / model.scale.length, i, time * to_internal)
    writer.close()


def close(folder: Path, summary: Summary, console: Console | None = None) -> int:
    """Write the summary, print checks (failures first), their count, and findings; 1 if an exact check failed, else 0."""
    console = console or Console()
    summary.write(folder)
    for check in sorted(summary.checks, key=_rank):
        verdict = ("[red]FAILED[/]", "differs from the thesis", "[green]passed[/]")[_rank(check)]
        console.print(
            f"{verdict} {escape(check.name)}: {check.value:.8g} for {check.expected:.8g}, error {check.error:.3g} "
            f"(at most {check.tolerance:.3g})",
            soft_wrap=True,
        )
    failed, differing, passed = ([_rank(check) for check in summary.checks].count(rank) for rank in range(3))
    text = f"{passed} checks passed, {differing} of the thesis's statements differ"
    console.print(f"[red]{failed} FAILED[/], {text}" if failed else text, soft_wrap=True)
    for finding in summary.findings:
        console.print(f"- {escape(finding)}", soft_wrap=True)
    return 0 if summary.passed else 1


def _rank(check: Check) -> int:
    """0 for an exact check that failed, 1 for a statement of the thesis that does not hold, 2 for what passed."""
    return 2 if check.passed else 0 if check.kind == "exact" else 1
