"""Second derivatives of a model's energy, exact to rounding, as a sparse matrix."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from openmm_filament._term import Interaction
from openmm_filament.model import Model

__all__ = ["free_degrees", "hessian", "loose_bends", "product", "unpivoted"]

Array = NDArray[np.float64]

_STEP = 1e-30
"""The imaginary displacement: its square is lost beside one, so that the derivative is that of the formula."""


def hessian(model: Model, positions: Array) -> Any:
    """d^2E/dr_i dr_j of the terms, (3N, 3N) as a symmetric `scipy.sparse.csr_array`, coordinates bead by bead.

    `positions` (N, 3) and the result are in internal units. Constant forces do not add to it, held beads are not left
    out. The gradients of the terms are differentiated by a complex step (Squire and Trapp, SIAM Review 1998), which has
    no difference to lose digits in.
    """
    size = positions.size
    total = sparse.csr_array((size, size))
    for interaction in model.interactions:
        if len((here := interaction.at(positions)).beads):
            total = total + _assembled(here, positions, size)
    return (total + total.T) / 2


def loose_bends(model: Model) -> Array:
    """Rest angles (K,) in rad of the joints that rest bent, of a model in space, with neither torsion nor cosine bending.

    Such a joint turns about its first segment at no cost: of n in a row, n - 1 bending modes out of the plane have no
    stiffness, where a straight joint is as stiff out of any plane as in it.
    """
    if model.planar:
        return np.empty(0)
    held = np.zeros(len(model.masses), dtype=bool)  # middle beads
    for interaction in model.interactions:
        if interaction.term.span == 4:
            held[interaction.beads[:, 1:3]] = True
        elif interaction.term.span == 3 and "beta0" not in interaction.parameters:
            held[interaction.beads[:, 1]] = True
    loose = [np.empty(0)]
    for interaction in model.interactions:
        if interaction.term.span == 3 and "beta0" in interaction.parameters:
            rest = interaction.parameters["beta0"]
            loose.append(rest[(rest > 0) & ~held[interaction.beads[:, 1]]])
    return np.concatenate(loose)


def product(interactions: Sequence[Interaction], positions: Array, direction: Array) -> Array:
    """The Hessian of these terms times a displacement (N, 3), exact to rounding, without the matrix; internal units.

    Contact is given as the pairs in reach at these positions (`Interaction.at`), found once for many products.
    """
    total: Array = np.zeros_like(positions)
    moved = positions + 1j * _STEP * direction
    for interaction in interactions:
        slopes = np.imag(interaction.term.gradient(moved[interaction.beads], interaction.parameters)) / _STEP
        total += interaction.summed(slopes, len(positions))
    return total


def _assembled(interaction: Interaction, positions: Array, size: int) -> Any:
    x = positions[interaction.beads].astype(complex)
    count, span, _ = x.shape
    blocks = np.empty((count, span, 3, span, 3))
    for bead in range(span):
        for axis in range(3):
            moved: Any = x.copy()
            moved[:, bead, axis] += 1j * _STEP
            blocks[..., bead, axis] = interaction.term.gradient(moved, interaction.parameters).imag / _STEP
    index = (3 * interaction.beads[:, :, None] + np.arange(3)).reshape(count, 3 * span)
    rows = np.repeat(index, 3 * span, axis=1).ravel()
    columns = np.tile(index, (1, 3 * span)).ravel()
    return sparse.coo_array((blocks.ravel(), (rows, columns)), shape=(size, size)).tocsr()


def free_degrees(model: Model) -> NDArray[np.bool_]:
    """Which of the coordinates (N, 3) may move: not those of held beads, nor the third one of a planar model."""
    free = np.ones((int(model.starts[-1]), 3), dtype=bool)
    free[model.held] = False
    if model.planar:
        free[:, 2] = False
    return free


def unpivoted(matrix: Any) -> Any:
    """LU factors (`scipy.sparse.linalg.SuperLU`) of a banded symmetric matrix without pivoting, None where it is singular.

    All pivots are positive just where the matrix is positive definite.
    """
    try:
        return splu(matrix.tocsc(), permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    except RuntimeError:
        return None
