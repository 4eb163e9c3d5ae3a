"""The pluck of 12 N as printed: lift, tension and pitch of a string far from small motion, with its true bonds."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import openmm_filament as of
from openmm_filament import analysis
from systems import stage, strings
from systems.strings import Pluck

__all__ = ["BEAD", "FORCE", "HardPluck", "run"]

Array = NDArray[np.float64]

SEGMENTS, BEAD, FORCE = 201, 50, 12.0  # N
RATE, EVERY = 24_000, 72
"""The time step is 0.80 of the stability limit; half of it changes the largest lift by 1e-4. The pluck ends on a sample."""

WINDOW = 0.02
"""Seconds in which a pitch is told."""


@dataclass(frozen=True, eq=False)
class HardPluck:
    """The motion in time.

    Attributes
    ----------
    times : (T,) array
        s.
    positions : (T, 202, 3) array
        m.
    tensions : (T, 201) array
        N, from the lengths of the bonds.
    energies : dict of str to (T,) array
        J, by term, with "kinetic".
    imbalance : float
        Largest `E + energy lost to damping - work of the pluck`, less its first value, over the work.
    pitch : Pitch
        Of the summed motion after the pluck; times count from its end.
    """

    model: of.Model
    times: Array
    positions: Array
    tensions: Array
    energies: dict[str, Array]
    imbalance: float
    pitch: analysis.Pitch

    @property
    def lift(self) -> Array:
        """Largest distance of a bead from the axis in m, (T,)."""
        return np.asarray(np.hypot(self.positions[..., 0], self.positions[..., 1]).max(axis=1))

    @property
    def mean(self) -> Array:
        """Mean of the moving beads' displacements in m, (T,)."""
        return np.asarray(self.positions[:, 1:-1, 0].mean(axis=1))


def run(seconds: float, progress: Callable[[float], None] | None = None) -> HardPluck:
    """Pluck and run for so many seconds."""
    model = strings.string(SEGMENTS, [Pluck(BEAD, FORCE)], softer=1.0)
    context = strings.start(model, RATE, EVERY, alike=True)
    motion = of.record(
        model,
        context,
        round(seconds * RATE),
        EVERY,
        observe=lambda x: x,
        energies=True,
        progress=progress,
    )
    positions = stage.metres(motion.values)
    after = strings.released(motion)
    mean = positions[:, 1:-1, 0].mean(axis=1)
    energies = {name: values / stage.JOULE for name, values in motion.energies.items()}
    return HardPluck(
        model,
        stage.seconds(motion),
        positions,
        tensions(positions),
        energies,
        _imbalance(energies, positions[:, BEAD, 0], after),
        analysis.instantaneous_pitch(mean[after], 1 / RATE, WINDOW),
    )


def tensions(positions: Array) -> Array:
    """`k (s - (b - T/k))` in N for positions (T, N, 3) in m, T the tension at rest: (T, N - 1)."""
    b = strings.LENGTH / SEGMENTS
    stiffness = strings.YOUNG * math.pi * strings.RADIUS**2 / b
    lengths = np.linalg.norm(np.diff(positions, axis=1), axis=-1)
    return np.asarray(strings.TENSION + stiffness * (lengths - b))


def _imbalance(energies: dict[str, Array], lift: Array, after: NDArray[np.bool_]) -> float:
    """What is missing in the balance of energy, by the trapezium rule for what the damping takes, over the work done.

    The pluck does the work `F x`, which stops when it lets go.
    """
    total = sum(values for name, values in energies.items() if name != "pluck")
    kinetic = energies["kinetic"]
    lost = 2 * strings.DAMPING / RATE * np.append(0.0, np.cumsum((kinetic[1:] + kinetic[:-1]) / 2))
    work = FORCE * np.where(after, lift[np.argmax(after) - 1], lift)
    balance = np.asarray(total + lost - work)
    return float(np.abs(balance - balance[0])[after].max() / work[-1])
