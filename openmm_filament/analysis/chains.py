"""Chains out of arrays and trajectories: positions in nm, checked, one axis for frames and one for chains."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from openmm_filament import _checks as check
from openmm_filament.geometry import segments

__all__ = ["chain_positions", "chain_segments", "common_frames", "curve_points", "split_chains"]

Array = NDArray[np.float64]


def chain_positions(positions: Any, atoms: ArrayLike | None = None) -> Array:
    """Positions (T, M, N, 3) in nm: T frames of M chains of N beads.

    Parameters
    ----------
    positions : (T, N, 3) array in nm, or mdtraj.Trajectory
        Frames in the order of time. Of a trajectory, such as `of.load` returns, each chain of its topology is a chain;
        they must have equally many atoms. Chains must be whole, not wrapped into a periodic box.
    atoms : (N,) or (M, N) array of int, optional
        Indices of the beads along each chain, for part of the atoms or for chains within an array.

    Raises
    ------
    ValueError
        If the shapes do not fit, a coordinate is not finite, or chains of a trajectory differ in length.
    """
    trajectory = hasattr(positions, "xyz")
    values = check.finite("positions", positions.xyz if trajectory else positions)
    if values.ndim != 3 or values.shape[2] != 3 or not len(values):
        raise ValueError(f"Argument `positions` must have shape (frames, beads, 3), but has shape {values.shape}.")
    if atoms is None:
        chosen = _chains_of(positions) if trajectory else np.arange(values.shape[1])[None]
    else:
        chosen = np.atleast_2d(np.asarray(atoms))
        if chosen.ndim != 2 or chosen.dtype.kind not in "iu":
            raise ValueError(f"Argument `atoms` must hold indices of shape (n,) or (m, n), but is {atoms!r}.")
        if chosen.size and (chosen.min() < 0 or chosen.max() >= values.shape[1]):
            raise check.fail(
                "atoms", f"hold indices from 0 to {values.shape[1] - 1}", f"{chosen.min()} ... {chosen.max()}"
            )
    if chosen.shape[1] < 2 or not len(chosen):
        raise ValueError(f"Argument `positions` must have chains of at least 2 beads, but has {chosen.shape[1]}.")
    return values[:, chosen]


def _chains_of(trajectory: Any) -> NDArray[np.int64]:
    """Indices (M, N) of the atoms of each chain of a trajectory's topology."""
    if getattr(trajectory, "topology", None) is None:
        return np.arange(trajectory.xyz.shape[1])[None]
    chains = _atoms_by_chain(trajectory)
    lengths = sorted({len(chain) for chain in chains})
    if len(lengths) != 1:
        raise ValueError(
            f"Argument `positions` must hold chains of one length, but holds chains of {lengths} atoms: choose with `atoms`."
        )
    return np.array(chains, dtype=np.int64)


def _atoms_by_chain(trajectory: Any) -> list[list[int]]:
    return [[atom.index for atom in chain.atoms] for chain in trajectory.topology.chains]


def split_chains(trajectory: Any) -> tuple[Array, ...]:
    """Positions (T, N, 3) in nm of each chain of an `mdtraj.Trajectory`, in the order of its topology, of any lengths.

    For functions of two curves: `linking(*split_chains(frames))`.

    Raises
    ------
    TypeError
        If `trajectory` has no topology to split it by.
    ValueError
        If a coordinate is not finite.
    """
    if getattr(trajectory, "topology", None) is None or not hasattr(trajectory, "xyz"):
        raise TypeError(f"Argument `trajectory` must be an mdtraj.Trajectory, but is a {type(trajectory).__name__}.")
    values = check.finite("trajectory", trajectory.xyz)
    return tuple(values[:, atoms] for atoms in _atoms_by_chain(trajectory))


def curve_points(name: str, curve: Any, least: int) -> tuple[Array, bool]:
    """One curve a frame, (T, N, 3), and whether there was an axis for frames; a single curve (N, 3) gets T = 1.

    Raises
    ------
    ValueError
        If the shape does not fit, a curve has fewer than `least` points, a coordinate is not finite, or a trajectory holds
        several chains.
    """
    if getattr(curve, "topology", None) is not None and (chains := len(_atoms_by_chain(curve))) != 1:
        raise ValueError(
            f"Argument `{name}` must hold one chain, but holds {chains}: take them apart with `analysis.split_chains`."
        )
    values = check.finite(name, getattr(curve, "xyz", curve))
    if values.ndim not in {2, 3} or values.shape[-1] != 3 or not len(values):
        raise ValueError(
            f"Argument `{name}` must have shape (points, 3) or (frames, points, 3), but has shape {values.shape}."
        )
    if values.shape[-2] < least:
        raise ValueError(f"Argument `{name}` must have at least {least} points, but has {values.shape[-2]}.")
    return (values, True) if values.ndim == 3 else (values[None], False)


def common_frames(first: Array, second: Array) -> int:
    """How many frames two curves (T, N, 3) have together, one of them being allowed one that stands for all.

    Raises ValueError for `second` where they do not fit.
    """
    if len(first) != len(second) and 1 not in {len(first), len(second)}:
        raise ValueError(f"Argument `second` must have {len(first)} frames or one, but has {len(second)}.")
    return max(len(first), len(second))


def chain_segments(positions: Array) -> tuple[Array, Array]:
    """Lengths (T, M, N - 1) and unit tangents (T, M, N - 1, 3) of the segments of positions (T, M, N, 3).

    Raises
    ------
    ValueError
        If two successive beads coincide.
    """
    steps = segments(positions)
    lengths = np.sqrt(np.einsum("...i,...i->...", steps, steps))
    if not lengths.all():
        frame, chain, bead = (int(i) for i in np.argwhere(lengths == 0)[0])
        raise ValueError(
            f"Argument `positions` must keep successive beads apart, but beads {bead} and {bead + 1} of chain {chain} "
            f"coincide in frame {frame}."
        )
    return lengths, steps / lengths[..., None]
