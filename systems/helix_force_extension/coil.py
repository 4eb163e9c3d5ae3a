"""The helix of the thesis (3.2.2) pulled without temperature: its model, its curve, and the helix formulas."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from openmm import unit
from scipy.optimize import brentq

import openmm_filament as of
from systems import stage

__all__ = [
    "CONTOUR",
    "HEIGHT",
    "RADIUS",
    "SEGMENTS",
    "SHEAR",
    "WIRE",
    "YOUNG",
    "Curve",
    "Point",
    "end_stiffness",
    "end_stiffness_found",
    "free_helix_extension",
    "helix",
    "pulled",
]

Array = NDArray[np.float64]

RADIUS, HEIGHT, TURNS, WIRE = 5.97e-3, 0.1, 2, 0.5e-3
"""Radius of the helix, its height, its turns and the radius of the wire, in m."""

YOUNG = 1e9
SHEAR = (1e7, 1e8, 1e9, 1e10, 1e11)
"""E and the values of G in Pa: 1, 10 and 100 GPa are the thesis's, the softer two are added."""

SEGMENTS = 55
_STEPS = 400
"""Newton steps for a point; 60 are usual."""

DENSITY = 1e3  # kg/m^3; a static scene needs none, a filament has masses

CONTOUR = math.hypot(2 * math.pi * RADIUS * TURNS, HEIGHT)
BENDING = YOUNG * math.pi * WIRE**4 / 4
"""E I in N m^2; the torsional rigidity is G pi r^4/2."""
STRETCHING = YOUNG * math.pi * WIRE**2
"""E S in N."""


def twisting(shear: float) -> float:
    """G J in N m^2."""
    return shear * math.pi * WIRE**4 / 2


@dataclass(frozen=True, eq=False)
class Point:
    """One equilibrium: the force in N, the extension in m, the residual and its floor over the force.

    `bend` is the smallest bending angle in rad, `step` the stable time step over that of the shape at rest.
    """

    force: float
    extension: float
    residual: float
    floor: float
    converged: bool
    bend: float
    step: float
    positions: Array


@dataclass(frozen=True, eq=False)
class Curve:
    """The points of one G and one form of the torsion."""

    form: str
    shear: float
    model: of.Model
    points: Sequence[Point]

    @property
    def converged(self) -> list[Point]:
        """The points that count."""
        return [point for point in self.points if point.converged]


def helix(shear: float, force: float, *, segments: int = SEGMENTS, form: Any = of.torsion.Harmonic) -> of.Model:
    """The helix held at its first bead, its last pulled along the axis.

    The weighted torsion has the stiffness `K sin^2(beta_0) = C` of the harmonic one at rest.
    """
    rest = of.shapes.helix(segments, radius=RADIUS * unit.meter, pitch=HEIGHT / TURNS * unit.meter, turns=TURNS)
    step = float(np.linalg.norm(np.diff(rest.value_in_unit(unit.meter)[:2], axis=0)))
    stiffness = twisting(shear) / step
    if form is of.torsion.Weighted:
        first, second = np.diff(rest.value_in_unit(unit.meter)[:3], axis=0)
        stiffness /= float(np.linalg.norm(np.cross(first, second)) / step**2) ** 2
    terms = (
        of.stretching.Harmonic(STRETCHING / step * unit.newton / unit.meter),
        of.bending.Harmonic(BENDING / step * unit.joule),
        form(stiffness * unit.joule),
    )
    mass = DENSITY * math.pi * WIRE**2 * step
    filament = of.Filament(rest, mass * unit.kilogram, terms)
    return of.build(filament, loads=[of.loads.Hold(0), of.loads.Pull(-1, (0.0, 0.0, force) * unit.newton)])


def pulled(
    shear: float,
    forces: Array,
    *,
    form: Any = of.torsion.Harmonic,
    progress: Callable[[float], None] | None = None,
) -> Curve:
    """Equilibria at rising forces in N, each begun at the last."""
    points: list[Point] = []
    positions, before = None, 0.0
    at_rest = of.stable_timestep(helix(shear, float(forces[0]), form=form))
    for force in forces:
        model = helix(shear, float(force), form=form)
        found = of.equilibrium(model, positions=positions, begin_at=before / float(force), most_steps=_STEPS)
        x = found.positions.value_in_unit(unit.meter)
        if found.converged and found.is_minimum:
            positions, before = found.positions, float(force)
        step = of.stable_timestep(model, found.positions) / at_rest
        load = float(force) * stage.NEWTON
        points.append(
            Point(
                float(force),
                float(x[-1, 2] - x[0, 2]),
                found.residual / load,
                found.floor / load,
                found.converged and found.is_minimum,
                _smallest_bend(x),
                float(step),
                found.positions.value_in_unit(unit.nanometer),
            )
        )
        if progress is not None:
            progress(len(points) / len(forces))
    return Curve(form.__name__.lower(), shear, model, points)


def _smallest_bend(x: Array) -> float:
    s = np.diff(x, axis=0)
    sine = np.linalg.norm(np.cross(s[:-1], s[1:]), axis=1)
    return float(np.arctan2(sine, (s[:-1] * s[1:]).sum(axis=1)).min())


def end_stiffness(shear: float) -> float:
    """Small-load stiffness in N/m between the end beads.

    Two thirds of `B C/(R^2 L (B cos^2 a + C sin^2 a))`, that of a helix of whole turns pulled on its axis with ends free
    to turn (the force on a bead acts one radius off it), in series with the stretching of the wire, `E S/(L sin^2 a)`.
    """
    b, c, sine = BENDING, twisting(shear), HEIGHT / CONTOUR
    on_axis = b * c / (RADIUS**2 * CONTOUR * (b * (1 - sine**2) + c * sine**2))
    return 1 / (1 / (2 / 3 * on_axis) + CONTOUR * sine**2 / STRETCHING)


def end_stiffness_found(shear: float, segments: int, force: float) -> float:
    """The same in N/m from the equilibria under a small force and twice that, what goes as its square taken out."""
    longer = []
    for pull in (force, 2 * force):
        found = of.equilibrium(helix(shear, pull, segments=segments))
        if not found.converged:
            raise RuntimeError(found.message)
        x = found.positions.value_in_unit(unit.meter)
        longer.append(float(x[-1, 2] - x[0, 2]) - HEIGHT)
    return 2 * force / (4 * longer[0] - longer[1])


def free_helix_extension(shear: float, force: float) -> float:
    """Extension in m of a uniform helix under a force in N on its axis, ends free to turn, at any deformation.

    With `kappa = w cos a` and `tau = w sin a` the axial torque `B (kappa - kappa0) cos a + C (tau - tau0) sin a` vanishes,
    which gives w of a, and the axial force is `w [C (tau - tau0) - B (kappa - kappa0) tan a]`. Of a wire that stretches by
    `F sin(a)/E S`.
    """
    b, c = BENDING, twisting(shear)
    w0, a0 = 2 * math.pi * TURNS / CONTOUR, math.asin(HEIGHT / CONTOUR)
    kappa0, tau0 = w0 * math.cos(a0), w0 * math.sin(a0)

    def excess(a: float) -> float:
        cosine, sine = math.cos(a), math.sin(a)
        w = (b * kappa0 * cosine + c * tau0 * sine) / (b * cosine**2 + c * sine**2)
        pull = w * (c * (w * sine - tau0) - b * (w * cosine - kappa0) * math.tan(a))
        return pull - force

    a = brentq(excess, a0, math.pi / 2 - 1e-12, xtol=1e-15)
    return CONTOUR * math.sin(a) * (1 + force * math.sin(a) / STRETCHING)
