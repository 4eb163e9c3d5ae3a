"""Normal modes of a model about given positions, with and without damping."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from openmm import unit
from scipy import linalg, sparse
from scipy.sparse.linalg import LinearOperator, eigsh

from openmm_filament import _checks as check
from openmm_filament.evaluation import internal_positions
from openmm_filament.hessian import free_degrees, hessian, loose_bends, unpivoted
from openmm_filament.model import Model
from openmm_filament.timestep import highest_frequency

__all__ = ["DampedModes", "NormalModes", "damped_modes", "normal_modes"]

Array = NDArray[np.float64]

_DENSE = 1500
"""Coordinates up to which the whole matrix is diagonalised, in two seconds or less."""

_SHIFT = 1e-13
"""Distance of the shift below zero for the lowest modes, over the largest eigenvalue: that of rigid motions is zero, up to
rounding."""

_NEARLY_STRAIGHT = 0.1
"""Rest angle in rad up to which joints pass for straight ones, and are warned of where they are soft as those are not."""

_LOST = 1e3
"""Eigenvalues of less than so many roundings of the largest are warned of."""

_NEAR, _CLOSE = 2e-2, 1e-9
"""The first and the last distance of the shift above the largest eigenvalue, relative."""

_STILL = 3e-7
"""Modes slower than this part of the fastest are rounding: the eigenvalues of an undamped rigid motion, which are a double
zero, come out as large as the square root of it."""

_HERTZ_PS = 1e12
"""Picoseconds in a second."""


@dataclass(frozen=True, eq=False)
class NormalModes:
    """Undamped modes, from the lowest frequency to the highest.

    Attributes
    ----------
    frequencies : (K,) array
        Hz. Rigid motions have frequency zero up to rounding; a direction in which the energy falls has a negative one,
        standing for an imaginary frequency.
    shapes : (K, N, 3) array
        Displacements of all beads, the largest component of each mode being 1; zero at held beads. They are orthogonal
        with the masses as weights.
    """

    frequencies: Array
    shapes: Array


@dataclass(frozen=True, eq=False)
class DampedModes:
    """Modes that decay as `Re u exp((2 pi i f - d) t)`, from the lowest frequency to the highest.

    Attributes
    ----------
    frequencies, decay_rates : (K,) arrays
        f in Hz and d in 1/s, of the amplitude (that of the energy is twice as large). Overdamped motions have f = 0 and
        come first.
    shapes : (K, N, 3) complex array
        u, the largest component of each mode being 1.
    """

    frequencies: Array
    decay_rates: Array
    shapes: NDArray[np.complex128]


def normal_modes(
    model: Model, count: int | None = None, *, highest: bool = False, positions: unit.Quantity | None = None
) -> NormalModes:
    """Frequencies and shapes of small oscillations, from the mass-weighted Hessian of the model as built.

    Held beads do not move, nor does the third coordinate of a planar model. Constant forces do not add to the Hessian,
    but the positions must be in balance under them for the modes to be those of a motion.

    Joints that rest bent, by however little, and that no dihedral holds turn about their segments at no cost: of n in a row,
    n - 1 modes of bending out of the plane have frequency zero, while a joint that rests straight is as stiff out of any
    plane as in it. Add a torsion, confine the model to a `Plane`, or take `rest_angle` 0.

    Parameters
    ----------
    count : int, optional
        How many modes, the lowest unless `highest`; by default all. A few modes of a long chain (10^5 beads) are found by
        shift-inverted Lanczos iterations, short chains are diagonalised whole.
    positions : Quantity, optional
        Physical positions (N, 3); the rest positions by default.

    Raises
    ------
    ValueError
        For a count that is not from 1 to the number of free coordinates; and if all modes of a chain are asked for that
        is too long to be diagonalised whole.

    Warns
    -----
    UserWarning
        Where joints that rest bent by at most 0.1 rad have no torsion beside them; and where rounding leaves few digits.
    """
    matrix, weights, free = _weighted(model, positions)
    size = len(weights)
    wanted = size if count is None else check.integer("count", count, low=1, high=size)
    if size <= _DENSE:
        where = (size - wanted, size - 1) if highest else (0, wanted - 1)
        squared, vectors = linalg.eigh(matrix.toarray(), subset_by_index=where)
    elif wanted > size // 4:
        raise check.fail("count", f"be at most {size // 4} for a chain of {size} free coordinates", wanted)
    elif highest:
        squared, vectors = _highest(matrix, wanted, _largest(model, positions))
    else:
        squared, vectors = _lowest(matrix, wanted, _largest(model, positions))
    order = np.argsort(squared)
    squared, vectors = squared[order], vectors[:, order]
    shapes = np.zeros((wanted, *free.shape))
    shapes[:, free] = (vectors * weights[:, None]).T
    largest = np.take_along_axis(shapes.reshape(wanted, -1), np.abs(shapes).reshape(wanted, -1).argmax(1)[:, None], 1)
    frequencies = np.sign(squared) * np.sqrt(np.abs(squared)) / (2 * np.pi)
    return NormalModes(frequencies / model.scale.factor("time") * _HERTZ_PS, shapes / largest[:, :, None])


def damped_modes(model: Model, count: int | None = None, *, positions: unit.Quantity | None = None) -> DampedModes:
    """Modes of `m x'' + m gamma x' + K x = 0` with the filaments' damping rate of each bead, as `euler_cromer` runs them.

    Modes slower than 3e-7 of the fastest come out as frequency and decay zero, as undamped rigid motions do. Joints that rest
    bent without a torsion beside them: see `normal_modes`, which warns of them as this does.

    Parameters
    ----------
    count : int, optional
        How many modes, the lowest in frequency (overdamped motions first); by default all. All are computed.
    positions : Quantity, optional
        Physical positions (N, 3); the rest positions by default.

    Raises
    ------
    ValueError
        For a chain too long to be diagonalised whole (250 free beads), and for a count that is not from 1 to the number
        of free coordinates.
    """
    matrix, weights, free = _weighted(model, positions)
    size = len(weights)
    wanted = None if count is None else check.integer("count", count, low=1, high=size)
    if 2 * size > _DENSE:
        raise ValueError(
            f"Argument `model` must have at most {_DENSE // 2} free coordinates for its damped modes, but has {size}."
        )
    gamma = np.broadcast_to(model.damping[:, None], free.shape)[free]
    state = np.block([[np.zeros((size, size)), np.eye(size)], [-matrix.toarray(), -np.diag(gamma)]])
    values, vectors = linalg.eig(state)
    still = np.abs(values) < _STILL * np.abs(values).max()  # rigid motions, each a pair about zero
    values = np.where(still, 0.0, values)
    kept = np.where(still, np.cumsum(still) % 2 == 1, values.imag >= 0)
    values, vectors = values[kept], vectors[:size, kept]
    order = np.lexsort((-values.real, values.imag))[:wanted]
    values, vectors = values[order], vectors[:, order]
    shapes = np.zeros((len(values), *free.shape), dtype=complex)
    shapes[:, free] = (vectors * weights[:, None]).T
    flat = shapes.reshape(len(values), -1)
    largest = np.take_along_axis(flat, np.abs(flat).argmax(1)[:, None], 1)
    per_second = _HERTZ_PS / model.scale.factor("time")
    return DampedModes(values.imag / (2 * np.pi) * per_second, -values.real * per_second, shapes / largest[:, :, None])


def _weighted(model: Model, positions: Any) -> tuple[Any, Array, NDArray[np.bool_]]:
    """The mass-weighted Hessian of the free coordinates, 1/sqrt(m) of each, and which those are."""
    free = free_degrees(model)
    if not free.any():
        raise ValueError("Argument `model` must have a free bead to have modes, but all are held.")
    bends = loose_bends(model)
    if len(bends) > 1 and bends.max() <= _NEARLY_STRAIGHT:
        warnings.warn(
            f"{len(bends)} joints rest bent, by at most {bends.max():.3g} rad, and no torsion holds them: out of the plane of "
            "their bends they have no stiffness, as straight ones have, and those modes have frequency zero. Add a torsion, "
            "confine the model to a Plane, or take rest_angle 0.",
            stacklevel=3,
        )
    weights = (1 / np.sqrt(np.broadcast_to(model.masses[:, None], free.shape)))[free]
    chosen = np.flatnonzero(free.ravel())
    inner = hessian(model, internal_positions(model, positions))[chosen][:, chosen]
    scaling = sparse.diags_array(weights)
    return (scaling @ inner @ scaling).tocsc(), weights, free


def _start(size: int) -> Array:
    return np.random.default_rng(0).normal(size=size)


def _largest(model: Model, positions: Any) -> float:
    """The largest eigenvalue, to a per cent."""
    return highest_frequency(model, internal_positions(model, positions)) ** 2


def _lowest(matrix: Any, count: int, top: float) -> tuple[Array, Array]:
    """The lowest eigenvalues by inverse iteration: about zero, or just below where rigid motions make that singular."""
    start = _start(matrix.shape[0])
    factors = unpivoted(matrix)
    shift = 0.0
    if factors is None or factors.U.diagonal().min() <= 1e-15 * top:
        shift = -_SHIFT * top
        factors = unpivoted(matrix - shift * sparse.eye_array(matrix.shape[0]))
        if factors is None:
            raise ValueError(
                "Argument `positions` must be near a minimum of the energy for so long a chain, but are not."
            )
    inverse = LinearOperator(matrix.shape, factors.solve)
    _, vectors = eigsh(matrix, count, sigma=shift, which="LM", v0=start, OPinv=inverse)
    squared = np.einsum("ik,ik->k", vectors, matrix @ vectors)
    lost = np.finfo(float).eps * top
    if (np.abs(squared[squared > 0]) < _LOST * lost).any() and shift == 0.0:
        warnings.warn(
            f"The lowest modes of this chain stand {squared[squared > 0].min() / top:.1e} of the highest apart from zero (in "
            "omega^2), where rounding leaves few digits: take fewer, longer segments.",
            stacklevel=4,
        )
    return squared, vectors


def _highest(matrix: Any, count: int, top: float) -> tuple[Array, Array]:
    """The largest eigenvalues, from the largest to a per cent: a long chain crowds its modes there.

    A shift closes in on the largest from above by inverse iteration. That it is above is seen from the pivots: all are
    negative where the shifted matrix is negative definite.
    """
    size = matrix.shape[0]
    vector, gap = _start(size), _NEAR
    while True:
        shift = top * (1 + gap)
        factors = unpivoted(matrix - shift * sparse.eye_array(size))
        if factors is None or (factors.U.diagonal() > 0).any():
            gap *= 2
            continue
        if gap < _CLOSE:
            inverse = LinearOperator((size, size), factors.solve)
            squared, vectors = eigsh(matrix, count, sigma=shift, which="LM", v0=vector, OPinv=inverse)
            return squared, vectors
        for _ in range(8):
            vector = factors.solve(vector)
            vector /= np.linalg.norm(vector)
        top = float(vector @ (matrix @ vector))
        gap *= 0.1
