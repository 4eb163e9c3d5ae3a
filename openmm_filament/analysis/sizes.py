"""Sizes of chains in thermal motion: `<R^2>` and `<R_g^2>` with their standard errors."""

from __future__ import annotations

from typing import Any

from numpy.typing import ArrayLike

from openmm_filament.analysis.averages import Average, average
from openmm_filament.analysis.chains import chain_positions

__all__ = ["mean_squared_end_to_end", "mean_squared_radius_of_gyration"]


def mean_squared_end_to_end(positions: Any, *, atoms: ArrayLike | None = None) -> Average:
    """`<R^2>` in nm^2, R being the vector from the first bead to the last, with its standard error.

    Its exact values: `wlc.mean_squared_end_to_end` and `wlc.mean_squared_end_to_end_discrete`.

    Parameters
    ----------
    positions : (T, N, 3) array in nm, or mdtraj.Trajectory
        Frames in the order of time, evenly spaced; chains are whole and independent of one another.
    atoms : (N,) or (M, N) array of int, optional
        The beads of each chain; by default all of an array, and each chain of a trajectory's topology.

    Raises
    ------
    ValueError
        As `analysis.tangent_correlation` does.

    Examples
    --------
    >>> mean_squared_end_to_end([[[0.0, 0, 0], [3, 0, 0], [3, 4, 0]]]).value
    25.0
    """
    x = chain_positions(positions, atoms)
    return average(((x[:, :, -1] - x[:, :, 0]) ** 2).sum(axis=-1))


def mean_squared_radius_of_gyration(positions: Any, *, atoms: ArrayLike | None = None) -> Average:
    """`<R_g^2>` in nm^2, `R_g^2` the mean squared distance of the beads, all of one weight, from their mean.

    Its exact values: `wlc.mean_squared_radius_of_gyration` and, of beads, `wlc.mean_squared_radius_of_gyration_discrete`.
    Arguments and errors are those of `mean_squared_end_to_end`.

    Examples
    --------
    >>> mean_squared_radius_of_gyration([[[0.0, 0, 0], [2, 0, 0]]]).value
    1.0
    """
    x = chain_positions(positions, atoms)
    return average(((x - x.mean(axis=2, keepdims=True)) ** 2).sum(axis=-1).mean(axis=-1))
