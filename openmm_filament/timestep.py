"""How fast a model moves: its stiffest mode, which limits the time step, and its slowest, which sets the friction."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from openmm import unit
from scipy.linalg import eigvalsh_tridiagonal

from openmm_filament import _checks as check
from openmm_filament import units
from openmm_filament._term import Interaction
from openmm_filament.contact import crowd_of
from openmm_filament.evaluation import internal_positions
from openmm_filament.geometry import bending_angles
from openmm_filament.hessian import free_degrees, product
from openmm_filament.model import Model

__all__ = ["highest_frequency", "slow_frequency", "stable_timestep"]

Array = NDArray[np.float64]

_STRAIGHT = 1e-7
"""Bending angle in rad taken for straight beside a bent rest angle."""

_DENSE = 24
"""Degrees of freedom up to which the Hessian is formed whole."""

_ITERATIONS, _SETTLED, _TOLERANCE = 200, 4, 5e-3
"""At most so many Lanczos iterations, ended when the last four have raised omega_max^2 by less than 0.5 %."""


def stable_timestep(model: Model, positions: unit.Quantity | None = None) -> unit.Quantity:
    """The longest stable time step of Verlet, leapfrog and Langevin integration, 2/omega_max, as a physical time.

    omega_max is the stiffest mode of the mass-weighted Hessian at `positions` (physical, (N, 3); by default the
    model's own), found by Lanczos iterations with exact products of it; contact counts, even where there is none yet, with
    4 k/m, that of beads pressed from both sides. Motion far from these positions can be stiffer, and joints that rest bent
    without a torsion, which are soft out of their plane (see `bending.Harmonic`), do not lower it: use a fraction of the
    limit. For a scaled model pass `model.to_internal(...)` of it to an OpenMM integrator.

    Raises
    ------
    ValueError
        If nothing in the model resists a displacement, so that there is no limit.
    """
    frequency = highest_frequency(model, internal_positions(model, positions))
    return model.to_physical(2.0 / frequency, "time")


def highest_frequency(model: Model, positions: Array, *, apart: bool = False) -> float:
    """omega_max in internal units at internal positions (N, 3); `apart` where beads that overlap there will not in a run."""
    if not free_degrees(model).any() or not any(len(interaction.beads) for interaction in model.interactions):
        raise ValueError(
            "Argument `model` must have a free bead and a term that acts on it to have a stable time step."
        )
    shape = _off_the_cones(model, positions)
    crowd = crowd_of(model.interactions)
    bonded = [interaction for interaction in model.interactions if interaction is not crowd]
    squared = _highest_squared(model, shape, bonded) if bonded else 0.0
    if crowd is not None:
        squared += _pressed(model, crowd)
        if not apart and len((touching := crowd.at(shape)).beads):
            squared = max(squared, _highest_squared(model, shape, [*bonded, touching]))
    if not squared > 0:
        raise ValueError("Argument `model` must resist some displacement to have a stable time step, but does not.")
    return math.sqrt(squared)


def _pressed(model: Model, crowd: Interaction) -> float:
    """omega^2 that contact may add, whether or not there is any yet: beads pressed from both sides, 4 k/m."""
    return float((4 * crowd.parameters["k"] / model.masses[crowd.beads[:, 0]]).max())


def _highest_squared(model: Model, positions: Array, acting: Sequence[Interaction]) -> float:
    """omega_max^2 of these terms at these positions."""
    masses = model.masses
    free = free_degrees(model)
    if model.planar and np.ptp(positions[:, 2]) > 1e-9 * np.ptp(positions):
        free[:, 2] = free[:, 0]  # a shape out of the plane may turn into it: then what is stiff in z will count
    weights = (1 / np.sqrt(np.broadcast_to(masses[:, None], positions.shape)))[free]

    def apply(vector: Array) -> Array:
        moved = np.zeros_like(positions)
        moved[free] = weights * vector
        return np.asarray(weights * product(acting, positions, moved)[free])

    return _largest_eigenvalue(apply, int(free.sum()))


def _off_the_cones(model: Model, positions: Array) -> Array:
    """Positions moved by a hundredth of a segment where a joint is straight but would rest bent.

    There the energy has a cone, and no second derivative; beside it the stiffest mode is as anywhere near.
    """
    for interaction in model.interactions:
        bent = interaction.parameters.get("beta0")
        if bent is None or not (bent > _STRAIGHT).any():
            continue
        triples = positions[interaction.beads[bent > _STRAIGHT]]
        if bending_angles(triples).min() < _STRAIGHT:
            length = np.linalg.norm(np.diff(triples, axis=1), axis=-1).min()
            aside: Array = np.random.default_rng(0).normal(size=positions.shape)
            return positions + 0.01 * float(length) * aside
    return positions


def _largest_eigenvalue(apply: Callable[[Array], Array], size: int) -> float:
    """By Lanczos iterations, which find the edge of a spectrum first; without reorthogonalisation, which it can spare."""
    if size <= _DENSE:
        matrix = np.stack([apply(column) for column in np.eye(size)])
        return float(np.linalg.eigvalsh((matrix + matrix.T) / 2)[-1])
    vector = np.random.default_rng(0).normal(size=size)
    vector /= np.linalg.norm(vector)
    previous = np.zeros(size)
    diagonal: list[float] = []
    beside: list[float] = []
    found: list[float] = []
    for _ in range(_ITERATIONS):
        image = apply(vector)
        diagonal.append(float(vector @ image))
        found.append(float(eigvalsh_tridiagonal(diagonal, beside)[-1]))
        if len(found) > _SETTLED and found[-1] - found[-1 - _SETTLED] < _TOLERANCE * found[-1]:
            break
        image -= diagonal[-1] * vector + (beside[-1] * previous if beside else 0.0)
        norm = float(np.linalg.norm(image))
        if norm <= 1e-12 * abs(found[-1]):
            break
        beside.append(norm)
        previous, vector = vector, image / norm
    return found[-1]


def slow_frequency(model: Model, temperature: float) -> float:
    """Estimate of the slowest frequency (internal units) at an internal temperature, to tune the friction to.

    The lowest mode of a chain held at one end that resists a transverse displacement of the other with
    `3 k_B T/<R^2> + F/L`: the entropic spring of the free chain and the tension (exact for a string under tension,
    `omega = pi/2 sqrt(F/(L M))`). The slowest filament of the model counts.
    """
    kt = units.BOLTZMANN * temperature
    slowest = math.inf
    rest = model.split(internal_positions(model))
    masses = model.split(model.masses)
    pulls = model.split(model.pulls)
    for filament, x, mass, pull in zip(model.filaments, rest, masses, pulls, strict=True):
        length = float(np.linalg.norm(np.diff(x, axis=0), axis=-1).sum())
        if not length:
            continue
        bond = length / (len(x) - 1)
        cosine = _mean_cosine(model, filament, kt)
        squared = min(length * bond * (1 + cosine) / max(1 - cosine, 1e-12), length**2)
        stiffness = 3 * kt / squared + float(np.linalg.norm(pull.sum(axis=0))) / length
        slowest = min(slowest, math.pi / 2 * math.sqrt(stiffness / float(mass.sum())))
    if math.isinf(slowest):
        raise ValueError("Argument `model` must have a filament of two beads or more to have a slow mode.")
    return check.positive("slow frequency", slowest).item()


def _mean_cosine(model: Model, filament: Any, kt: float) -> float:
    """A rough `<cos beta>` of one joint: the bending of its median stiffness about its rest angle."""
    factor = 1.0
    for interaction in filament.interactions():
        if interaction.term.family == "bending" and len(interaction.beads):
            ratio = float(np.median(interaction.parameters["alpha"])) / model.scale.energy / kt if kt else math.inf
            thermal = 1 / math.tanh(ratio) - 1 / ratio if ratio < 300 else 1 - 1 / ratio
            rest = float(np.median(interaction.parameters.get("beta0", np.zeros(1))))
            return min(thermal, 1.0) * math.cos(rest)
        factor = 0.0
    return factor
