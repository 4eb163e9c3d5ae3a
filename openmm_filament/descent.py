"""The energy of a model's free coordinates under its constant forces, and its damped Newton descent."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse
from scipy.sparse.linalg import eigsh

from openmm_filament.articulated import relaxed
from openmm_filament.evaluation import internal_positions
from openmm_filament.filament import COLLINEAR, sines
from openmm_filament.geometry import dot
from openmm_filament.hessian import free_degrees, hessian, unpivoted
from openmm_filament.model import Model

__all__ = ["COARSE", "Descent"]

Array = NDArray[np.float64]

_RESIDUAL = 1e-8
"""Largest force left on a free bead, over the largest load."""

_ABOVE_FLOOR = 10.0
"""The same, over the rounding floor of the forces."""

_TOO_ROUGH = 1e-3
"""Residual over the load above which nothing is at rest, whatever rounding leaves."""

COARSE = 1e-4
"""Residual over the load at which a stage of the continuation is left."""

_HALF = 0.5
"""The part of the load from which the last leap of an arm is made."""

_CREEP = 15
"""Damped Newton steps in a row after which a descent is taken to creep along a ridge."""

_NUDGE = 0.05
"""Largest displacement, over the shortest segment, of the push off a saddle."""

_NEGATIVE = 1e-13
"""An eigenvalue of the Hessian counts as negative below minus this part of the largest, where rounding cannot make it."""

_DENSE = 1500
"""Degrees of freedom up to which all eigenvalues are computed."""


class Descent:
    """The energy of the free coordinates of a model in internal units, and its damped Newton descent."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self.free = free_degrees(model)
        if not self.free.any():
            raise ValueError("Argument `model` must have a free bead to come to rest, but all are held.")
        if not any(len(interaction.beads) for interaction in model.interactions):
            raise ValueError(
                "Argument `model` must have a term or a trap that acts on it to come to rest, but has none."
            )
        self.chosen = np.flatnonzero(self.free.ravel())
        for load in model.loads:
            net = sum(load.pulls.values(), np.zeros(3))
            if load.held or len(load.traps.beads):
                continue
            if np.abs(net).max() > 1e-9 * max(np.abs(f).max() for f in [*load.pulls.values(), net]):
                raise ValueError("Argument `model` must hold a bead of a filament that is pulled away to come to rest.")
        self.fixed = internal_positions(model)
        self.load = float(np.abs(model.pulls).max())
        self._damping = 0.0
        self.fell = False
        self._seen: tuple[Array, Any] | None = None

    def is_arm(self, x: Array) -> bool:
        """Whether this is one open filament, pulled, held at bead 0 or at beads 0 and 1 alone, and bent everywhere."""
        model = self.model
        filament, load = model.filaments[0], model.loads[0]
        if (
            len(model.filaments) > 1
            or filament.closed
            or model.planar
            or sorted(load.held) not in ([0], [0, 1])
            or not self.load
        ):
            return False
        if any(interaction.term.span == 1 for interaction in model.interactions):  # traps and contact
            return False
        return len(filament) > 3 and bool(sines(self.whole(x)).min() > COLLINEAR)

    def led_on(self, x: Array, share: float, most: int) -> tuple[Array, int]:
        """An arm at rest under a part of the load, led on to half of the full one by doubling: positions, steps left."""
        left = most
        while 0 < share < _HALF and left > 0:
            share *= 2
            found, steps = self.as_arm(x, share, left, COARSE)
            x, left = found[self.free], left - steps
        return x, left

    def as_arm(self, x: Array, share: float, most: int, tolerance: float) -> tuple[Array, int]:
        """Positions (N, 3) of least energy under a part of the load, in the coordinates of an arm, and the steps taken."""
        model = self.model
        clamped = len(model.loads[0].held) == 2
        return relaxed(
            self.whole(x), model.interactions, share * model.pulls, most=most, tolerance=tolerance, clamped=clamped
        )

    def settle(self, x: Array, most: int) -> tuple[Array, int, bool]:
        """At rest under the full load: the positions, the steps left, and whether they converged."""
        left = most
        if self.is_arm(x):
            positions, steps = self.as_arm(x, 1.0, left, _RESIDUAL / 10)
            x, left = positions[self.free], left - steps
        x, steps, converged = self.relax(x, 1.0, _RESIDUAL, max(left, 1))
        return x, max(left - steps, 0), converged

    def reduced(self, positions: Array) -> Array:
        self.fixed = np.where(self.free, self.fixed, positions)
        return positions[self.free]

    def whole(self, x: Array) -> Array:
        out = self.fixed.copy()
        out[self.free] = x
        return out

    def energy(self, x: Array, share: float) -> float:
        positions = self.whole(x)
        inner = sum(interaction.energy(positions) for interaction in self.model.interactions)
        return inner - share * float((self.model.pulls * positions).sum())

    def force(self, x: Array, share: float) -> Array:
        positions = self.whole(x)
        total = share * self.model.pulls
        for interaction in self.model.interactions:
            total = total + interaction.forces(positions)
        return total[self.free]

    def hessian(self, x: Array) -> Any:
        """The sparse Hessian of the free coordinates; that of the last x is kept."""
        if self._seen is None or self._seen[0] is not x:
            self._seen = x, hessian(self.model, self.whole(x))[self.chosen][:, self.chosen].tocsc()
        return self._seen[1]

    def floor(self, x: Array) -> float:
        """The force that a rounding of every coordinate, and of the forces of the elements, may leave on a bead."""
        positions = self.whole(x)
        rounded = np.spacing(np.abs(x)) / np.sqrt(12)  # standard deviation of the rounding of each coordinate
        by_coordinates = np.sqrt(self.hessian(x).power(2) @ rounded**2)
        elements = max(float(np.abs(i.forces(positions)).max()) for i in self.model.interactions)
        return self.residual(by_coordinates) + float(np.finfo(float).eps) * elements

    def residual(self, force: Array) -> float:
        spread = np.zeros(self.free.shape)
        spread[self.free] = force
        return float(np.sqrt(dot(spread, spread)).max())

    def relax(self, x: Array, share: float, relative: float, most: int) -> tuple[Array, int, bool]:
        """Newton steps from x until the residual is small; the last x, the steps taken, and whether it is."""
        energy, force = self.energy(x, share), self.force(x, share)
        best = self.residual(force)
        self.fell = False
        uphill = 0  # successive steps where the Hessian was not positive definite
        for step in range(most):
            if best <= self.goal(x, share, relative):
                return x, step, True
            moved = self._step(x, energy, force, share)
            if moved is None:
                return x, step + 1, False
            x, energy, force = moved
            uphill = uphill + 1 if self._damping else 0
            if uphill == _CREEP:  # along a ridge, off which the force does not point
                lowest, direction = self.lowest(x)
                if self.falls(x, lowest):
                    x, self.fell = self.nudged(x, direction), True
                    energy, force = self.energy(x, share), self.force(x, share)
                uphill = 0
            best = self.residual(force)
        return x, most, best <= self.goal(x, share, relative)

    def goal(self, x: Array, share: float, relative: float) -> float:
        """The residual at which x counts as in equilibrium."""
        load, floor = share * self.load, _ABOVE_FLOOR * self.floor(x)
        if not load or share < 1:  # on the way any rest will do that rounding allows
            return max(relative * load, floor)
        return max(relative * load, min(floor, _TOO_ROUGH * load))

    def _step(self, x: Array, energy: float, force: Array, share: float) -> tuple[Array, float, Array] | None:
        """One step that lowers the energy, or, where rounding hides that, the residual; None where none does."""
        matrix = self.hessian(x)
        largest = float(np.abs(matrix.diagonal()).max())
        shortest = self._shortest(x)
        damping = self._damping
        rounding = self._rounding(x)
        for _ in range(60):
            step = _solve(matrix, damping * largest, force)
            if step is not None:
                reach = float(np.abs(step).max())
                if reach <= 0.5 * shortest:
                    tried = self._along(x, step)
                    with np.errstate(all="ignore"):
                        lower, pushed = self.energy(tried, share), self.force(tried, share)
                    gain = float(step @ force) / 2
                    falls = lower < energy - 1e-4 * max(gain, 0.0) if gain > rounding else lower < energy + rounding
                    if falls and (gain > rounding or np.linalg.norm(pushed) < np.linalg.norm(force)):
                        self._damping = damping / 10 if damping > 1e-15 else 0.0
                        return tried, lower, pushed
            damping = max(4 * damping, 1e-16)
            if damping > 1e6:
                return None
        return None

    def _along(self, x: Array, step: Array) -> Array:
        """The positions at the end of a step, taken along a curve that starts in its direction.

        Each segment becomes as long as the step says to first order, and is turned for the rest: a straight step would
        stretch what it turns, by the square of the turn, and stiff bonds would allow only tiny ones.
        """
        before, after = self.whole(x), self.whole(x + step)
        curved = after.copy()
        for filament, load, first in zip(self.model.filaments, self.model.loads, self.model.starts, strict=False):
            beads = slice(int(first), int(first) + len(filament))
            curved[beads] = _turned(before[beads], after[beads], sorted(load.held))
        return curved[self.free]

    def _rounding(self, x: Array) -> float:
        """Differences of the energy that mean nothing."""
        positions = self.whole(x)
        parts = [abs(i.energy(positions)) for i in self.model.interactions]
        return float(64 * np.finfo(float).eps * (sum(parts) + np.abs(self.model.pulls * positions).sum()))

    def _shortest(self, x: Array) -> float:
        return self.shortest(self.whole(x))

    def shortest(self, positions: Array) -> float:
        """The shortest segment of positions (N, 3)."""
        chained = [i.beads for i in self.model.interactions if i.term.span > 1]
        pairs = [positions[beads[:, 1]] - positions[beads[:, 0]] for beads in chained]
        return min((float(np.sqrt(dot(s, s)).min()) for s in pairs), default=np.inf)

    def lowest(self, x: Array) -> tuple[float, Array]:
        """The lowest eigenvalue of the Hessian over the largest, and its direction."""
        matrix = self.hessian(x)
        size = matrix.shape[0]
        if size <= _DENSE:
            values, vectors = linalg.eigh(matrix.toarray())
            return float(values[0] / np.abs(values).max()), vectors[:, 0]
        top = float(np.abs(matrix).sum(axis=1).max())
        start = np.random.default_rng(0).normal(size=size)
        values, vectors = eigsh(matrix, 1, sigma=-1e-6 * top, which="LM", v0=start)
        if values[0] > -1e-6 * top:
            values, vectors = eigsh(matrix, 1, sigma=-1e-12 * top, which="LM", v0=start)
        return float(values[0] / top), vectors[:, 0]

    def falls(self, x: Array, lowest: float) -> bool:
        """Whether a negative eigenvalue is more than rounding, of the Hessian and of the energy of a nudge along it."""
        largest = float(np.abs(self.hessian(x)).sum(axis=1).max())
        gain = -lowest * largest * (_NUDGE * self._shortest(x)) ** 2 / 2
        return lowest < -_NEGATIVE and gain > self._rounding(x)

    def nudged(self, x: Array, direction: Array) -> Array:
        """Positions moved a little along a direction."""
        push: Array = _NUDGE * self._shortest(x) / np.abs(direction).max() * direction
        return x + push


def _turned(before: Array, after: Array, held: list[int]) -> Array:
    """A chain (N, 3) with the directions of `after` and the lengths that it has to first order in the move.

    Held beads stay; where there are several, what a stretch between two of them is off by is spread over its segments.
    """
    if len(before) < 2:
        return after
    old, new = np.diff(before, axis=0), np.diff(after, axis=0)
    length = np.sqrt(dot(old, old))
    wanted = dot(old, new) / length  # l + x.d(s)
    found = np.sqrt(dot(new, new))
    steps = new * (np.where(wanted > 0.2 * length, wanted, found) / found)[:, None]
    chain = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    if not held:
        return np.asarray(chain + (after - chain).mean(axis=0))
    gaps = after[held] - chain[held]
    beads = np.arange(len(chain))
    return np.asarray(chain + np.stack([np.interp(beads, held, gaps[:, k]) for k in range(3)], axis=-1))


def _solve(matrix: Any, shift: float, force: Array) -> Array | None:
    """(H + shift)^-1 f, or None where the shifted Hessian is not positive definite."""
    factors = unpivoted(matrix + shift * sparse.eye_array(matrix.shape[0]) if shift else matrix)
    if factors is None or (factors.U.diagonal() <= 0).any() or (factors.perm_r != np.arange(len(force))).any():
        return None
    step: Array = factors.solve(force)
    return step if np.isfinite(step).all() else None
