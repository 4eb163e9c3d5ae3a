"""The chain pulled without temperature: its static equilibria, and what they must be by three other routes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from openmm import unit
from scipy import linalg, optimize

import openmm_filament as of
from systems import stage
from systems.planar_force_extension import chain

__all__ = [
    "Curve",
    "Point",
    "by_headings",
    "compliance",
    "let_go",
    "nearly_straight",
    "pulled",
    "reduced_force",
    "shapes_at",
]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Point:
    """One equilibrium: force in N, extension along it and end-to-end distance in m, residual and its floor over the force."""

    force: float
    extension: float
    distance: float
    residual: float
    floor: float
    converged: bool
    positions: Array

    @property
    def over(self) -> int:
        """Joints that bend the other way than at rest."""
        return int((np.sign(chain.signed_bends(self.positions)) != np.sign(chain.BENDS)).sum())


@dataclass(frozen=True, eq=False)
class Curve:
    """The points of one Young's modulus in Pa; `positions` of points are in m."""

    young: float
    model: of.Model
    points: list[Point]

    @property
    def converged(self) -> list[Point]:
        """The points that count."""
        return [point for point in self.points if point.converged]


def reduced_force(young: float, force: float) -> float:
    """`F l0/alpha` of a force in N."""
    return force * chain.STEP / chain.rigidities(young)[1]


def pulled(young: float, forces: Array, progress: Callable[[float], None] | None = None) -> Curve:
    """Equilibria at rising forces in N, each begun at the last."""
    points: list[Point] = []
    positions, before = None, 0.0
    for force in forces.tolist():
        model = chain.cold_model(young, force)
        found = of.equilibrium(model, positions=positions, begin_at=before / force)
        points.append(_point(found, force))
        if points[-1].converged:
            positions, before = found.positions, force
        if progress is not None:
            progress(len(points) / len(forces))
    return Curve(young, model, points)


def _point(found: of.Equilibrium, force: float) -> Point:
    x = np.asarray(found.positions.value_in_unit(unit.meter))
    load, span = force * stage.NEWTON, x[-1] - x[0]
    return Point(
        force,
        float(span[0]),
        float(np.hypot(span[0], span[1])),
        found.residual / load,
        found.floor / load,
        found.converged and found.is_minimum,
        x,
    )


def let_go(curve: Curve) -> list[Point]:
    """The way back: equilibria at the forces of a curve from the largest down, each begun at the last."""
    x, points = curve.points[-1].positions, []
    for point in curve.points[::-1]:
        found = of.equilibrium(chain.cold_model(curve.young, point.force), positions=x * unit.meter, begin_at=1.0)
        x = found.positions.value_in_unit(unit.meter)
        points.append(_point(found, point.force))
    return points


def shapes_at(reduced: Sequence[float]) -> list[Array]:
    """The equilibria (31, 3) in segments l0 under rising forces in alpha/l0, led on from rest by a factor 2 at most."""
    unit_force = chain.rigidities(chain.YOUNG[0])[1] / chain.STEP
    path = [reduced[0] / 8]
    for force in reduced:
        path += np.geomspace(path[-1], force, 2 + int(np.log2(force / path[-1])))[1:].tolist()
    points = pulled(chain.YOUNG[0], np.array(path) * unit_force).points
    return [points[path.index(force)].positions / chain.STEP for force in reduced]


def compliance(young: float) -> float:
    """d(extension)/dF at rest in m/N by Castigliano: every joint turns by `F y/alpha`, every bond gives `F cos/k`.

    y is the distance of a joint from the line between the ends.
    """
    bond, joint = chain.rigidities(young)
    y = chain.REST[1:-1, 1]
    cosines = np.diff(chain.REST[:, 0]) / chain.STEP
    return float((y**2).sum() / joint + (cosines**2).sum() / bond)


def nearly_straight(reduced: float, signs: Array) -> float:
    """Extension over contour under a large force in alpha/l0, to second order in the headings of the segments.

    Bonds are as long as the force along them makes them, `s = l0 + F cos/k`; the headings then solve a linear system with
    the rest bends, whose `signs` (29,) are those of the equilibrium.
    """
    n, ratio = chain.SEGMENTS, chain.STIFFNESS_RATIO
    turn = np.diff(np.eye(n), axis=0)  # headings to bends
    rest = signs * np.abs(chain.BENDS)
    stretch = reduced / ratio
    headings = linalg.solve(turn.T @ turn + reduced * (1 + stretch) * np.eye(n), turn.T @ rest)
    return float(1 + stretch - (0.5 + stretch) * (headings**2).mean())


def by_headings(reduced: float, shape: Array) -> tuple[float, float]:
    """Extension over contour of the equilibrium in the 30 headings by SciPy alone, and its energy in alpha.

    Every bond is given the length that its tension asks for. The search begins at the headings of `shape` (31, 3), each
    turned by up to 1e-4 rad, which no joint is to cross zero for.
    """
    s = np.diff(shape, axis=0)
    start = np.arctan2(s[0, 1], s[0, 0]) + np.concatenate([[0.0], np.cumsum(chain.signed_bends(shape))])
    start += np.random.default_rng(0).uniform(-1e-4, 1e-4, len(start))
    found = optimize.root(lambda h: _energy(h, reduced)[1], start, tol=1e-13).x
    c = np.cos(found)
    return float((c * (1 + reduced * c / chain.STIFFNESS_RATIO)).mean()), _energy(found, reduced)[0]


def _energy(headings: Array, force: float) -> tuple[float, Array]:
    """Energy in alpha and its gradient, lengths of bonds minimised out."""
    ratio = chain.STIFFNESS_RATIO
    cosine, turns = np.cos(headings), np.diff(headings)
    wrapped = (turns + np.pi) % (2 * np.pi) - np.pi
    off = np.abs(wrapped) - np.abs(chain.BENDS)
    moment = off * np.sign(wrapped)
    energy = (off**2).sum() / 2 - force * (cosine + force * cosine**2 / (2 * ratio)).sum()
    gradient = force * np.sin(headings) * (1 + force * cosine / ratio)
    gradient[1:] += moment
    gradient[:-1] -= moment
    return float(energy), gradient
