"""What is run: the knot itself at three speeds, its controls, other ways to make and break it, and its numbers varied."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

import openmm_filament as of
from systems.pseudoknot.chains import Wire, start_gap
from systems.pseudoknot.hands import Task
from systems.pseudoknot.poses import Pose, drawn
from systems.pseudoknot.ways import Way

__all__ = ["BASE", "OVERLAP", "Case", "cases", "crews", "linked", "steps", "task", "tasks"]

BASE = Wire()
OVERLAP = 1.5
"""Turns of the upper helix that are brought into the lower one."""

SLOWNESS = (2.5, 5.0, 10.0)
"""Times of making over the period of the slowest swing of the lower helix."""

BESIDE = 2.5
"""The same of what stands beside the knot itself: one speed."""

PULL = 0.5
"""Time of a pull, straight or sideways, over that of making: its work depends little on its speed."""

REST = 0.5
"""Time in which the knot is left alone, over that period."""

DAMPING = 0.3
"""Rate over that of the slowest swing: it decays to 1/e in some seven periods."""

CHILL, WARMTH = 1e-6, 1e-4
"""k_B T over E I/R of the first velocities, and, over that of the knot itself, of the thermostat while the hand is away."""

SHIFT, TILT = 1.0, 0.1
"""Largest offset of the axes over the thickness of the wire, and largest angle between them in rad."""

DRAWN_OUT = 0.65
"""Way of the pull over the contour length of the chain."""

FAR = 0.02
"""Shift in m of one pair more, whose lower chain is out of reach: the hand moves its upper chain alone."""


@dataclass(frozen=True)
class Case:
    """One setting of the scene.

    Attributes
    ----------
    group : str
        "main", "base" (the same as the others run), "control", "way", or the name of what is varied.
    value : float
        Of what is varied, in the unit of its name; NaN for the others.
    making : "screw", "push" or "side"
    breaking : "straight", "unscrew" or "side"
    crossing : float
        Angle of the axes in rad; they meet in the middle of what parallel chains have in common.
    held : bool
        Whether the hand keeps its hold in between, so that it can go back the way it came.
    """

    label: str
    group: str
    lower: Wire = BASE
    upper: Wire = BASE
    value: float = math.nan
    making: Literal["screw", "push", "side"] = "screw"
    breaking: Literal["straight", "unscrew", "side"] = "straight"
    crossing: float = 0.0
    clumsiness: float = 1.0
    warmth: float = WARMTH
    rest: float = REST
    slowness: tuple[float, ...] = field(default=(BESIDE,))
    starts: int = 5
    held: bool = False


def _varied(group: str, value: float, *, crossing: float = 0.0, clumsiness: float = 1.0, **wire: float) -> Case:
    """With other numbers of the wire, as dense as makes its period that of the others: they share Contexts."""
    changed = replace(BASE, **wire)  # type: ignore[arg-type]
    if group != "E_GPa":
        changed = replace(changed, density=BASE.density * (BASE.period() / changed.period()) ** 2)
    return Case(f"{group} {value:g}", group, changed, changed, value, crossing=crossing, clumsiness=clumsiness)


def cases(*, quick: bool) -> list[Case]:
    """All that is run; with `quick` less of it."""
    rod, mirrored = replace(BASE, hand=0), replace(BASE, hand=-1)
    e, g = BASE.youngs_modulus, BASE.shear_modulus
    main = Case("two helices", "main", slowness=SLOWNESS, starts=16)
    base = Case("screwed in, pulled out", "base")
    controls = [
        Case("two rods", "control", rod, rod),
        Case("rod in a helix", "control", BASE, rod),
        Case("opposite hands", "control", BASE, mirrored),
    ]
    ways = [
        Case("pushed without turning", "way", making="push"),
        Case("pushed from the side", "way", making="side"),
        Case("pulled sideways", "way", breaking="side"),
        Case("unscrewed", "way", breaking="unscrew", held=True),
        Case("ten times warmer and four times longer", "way", warmth=10 * WARMTH, rest=4 * REST),
    ]
    scaled = _varied("E_GPa", 10, youngs_modulus=10 * e, shear_modulus=10 * g)
    varied = [
        *(_varied("G_over_E", ratio, shear_modulus=ratio * e) for ratio in (0.1, 1.0)),
        *(_varied("helix_radius_mm", r, radius=r * 1e-3) for r in (1.25, 1.75)),
        *(_varied("pitch_mm", p, pitch=p * 1e-3) for p in (2.2, 3.0, 5.0)),
        *(_varied("thickness_mm", d, thickness=d * 1e-3) for d in (0.9, 1.25)),
        *(_varied("clumsiness", c, clumsiness=c) for c in (0.1, 2.0)),
        *(_varied("crossing_deg", angle, crossing=math.radians(angle)) for angle in (30, 60, 90)),
    ]
    if not quick:
        return [main, base, *controls, *ways, scaled, *varied]
    few = [replace(case, starts=1, slowness=(0.8,), rest=0.3) for case in (base, controls[0], controls[2])]
    return [replace(main, slowness=(0.8, 1.3), starts=4, rest=0.3), *few]


def linked(wire: Wire) -> float:
    """The linking integral of two such helices, the upper one screwed `OVERLAP` turns into the lower, half a pitch apart."""
    coil = replace(wire, hand=1)
    shape, up = coil.shape(), coil.height + start_gap(coil, coil)
    lower = Pose(math.pi - 2 * math.pi * up / coil.pitch).placed(shape)
    way = _screw(coil, coil, start_gap(coil, coil))
    upper = shape + np.array([0.0, 0.0, up])
    return float(of.analysis.linking(lower, upper + way.displacements(shape, 1.0)))


def _screw(lower: Wire, upper: Wire, gap: float) -> Way:
    down = gap + OVERLAP * lower.pitch
    return Way("screw", (0.0, 0.0, -down), -(upper.hand or 1) * down / lower.pitch)


def task(case: Case, slowness: float, poses: tuple[Pose, ...], seed: int, *, film: bool = False) -> Task:
    """A case at one slowness: pairs in these poses, and one pair more out of reach of each other."""
    lower, upper = case.lower, case.upper
    period, energy = lower.period(), lower.energy
    gap = start_gap(lower, upper) + (2 * lower.thickness if case.crossing else 0.0)  # a coil across reaches higher
    screw = _screw(lower, upper, gap)
    middle = lower.height - OVERLAP * lower.pitch / 2
    poses = tuple(replace(pose, crossing=case.crossing, crossed_at=middle) for pose in poses)
    beside = 2 * lower.radius + 4 * lower.thickness  # clear of a lower chain that is shifted and tilted
    aside = 1.2 * lower.thickness if not lower.hand else 0.0  # rods side by side
    place = (aside, 0.0, lower.height + gap)
    if case.making == "side":
        place = (beside, 0.0, 0.0)
    making = {
        "screw": screw,
        "push": replace(screw, name="push", turns=0.0),
        "side": Way("side", (-beside, 0.0, 0.0)),
    }[case.making]
    far = DRAWN_OUT * lower.contour
    breaking = {
        "straight": Way("straight", (0.0, 0.0, far)),
        "unscrew": Way("unscrew", (0.0, 0.0, -screw.along[2]), -screw.turns),
        "side": Way("side", (far, 0.0, 0.0)),
    }[case.breaking]
    return Task(
        case.label,
        lower,
        upper,
        (*poses, Pose(shift=(0.0, FAR))),
        place,
        making,
        Way("held", (0.0, 0.0, 0.0)) if case.held else None,
        breaking,
        (slowness * period, case.rest * period, slowness * period * (1.0 if case.breaking == "unscrew" else PULL)),
        DAMPING / period,
        CHILL * energy,
        case.warmth * BASE.energy,
        seed,
        film,
    )


def tasks(chosen: list[Case], seed: int) -> list[tuple[Case, float, Task]]:
    """The tasks of the cases, one a speed; cases and speeds share their starts."""
    out = []
    for case in chosen:
        size = case.lower.thickness * SHIFT * case.clumsiness
        poses = drawn(case.starts, seed, shift=size, tilt=TILT * case.clumsiness)
        for slowness in case.slowness:
            film = case.group == "main" and slowness == case.slowness[-1]
            out.append((case, slowness, task(case, slowness, poses, 1000 * seed, film=film)))
    return out


def crews(planned: Sequence[Task]) -> list[list[int]]:
    """Which tasks, by their place, share a Context: those that may, with about the same limit of the time step.

    A step costs a Context 0.3 ms and each of its beads less than a microsecond: many pairs together are cheap.
    """
    out: list[list[int]] = []
    for i in sorted(range(len(planned)), key=lambda i: steps(planned[i])):
        task = planned[i]
        for crew in out:
            first, pairs = planned[crew[0]], sum(len(planned[j].poses) for j in crew)
            alike = first.shared == task.shared and steps(task) <= _ALIKE * steps(first)
            if alike and pairs + len(task.poses) <= _MOST:
                crew.append(i)
                break
        else:
            out.append([i])
    return out


_ALIKE, _MOST = 1.5, 60
"""Largest ratio of numbers of steps, and pairs, of a Context."""


def steps(task: Task) -> float:
    """About the number of steps of a task, in some unit: its time over the period of its stiffest mode."""
    return sum(task.times) * max(_stiffest(wire) for wire in (task.lower, task.upper))


def _stiffest(wire: Wire) -> float:
    """Frequency of a wire's stiffest mode, rad/s: of stretching, or of torsion.

    The lever of the latter is the distance of a bead from the line through its neighbours; 2.4 is what the knot has.
    """
    length, rise = wire.spacing * wire.thickness, wire.pitch / (2 * math.pi)
    stretching = 2 * math.sqrt(wire.youngs_modulus / wire.density) / length
    if not wire.hand:
        return stretching
    curvature = wire.radius / (wire.radius**2 + rise**2)
    twisting = 2.4 * math.sqrt(wire.shear_modulus / wire.density) * wire.thickness / (length**3 * curvature)
    return max(stretching, twisting)
