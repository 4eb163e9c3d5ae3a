"""Blocks as they end: into the checkpoint, the trajectories and the estimates; and out of the checkpoint again."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from openmm_filament import units
from openmm_filament.blocks import BlockResult
from openmm_filament.checkpoints import Checkpoint
from openmm_filament.divergence import DivergedError
from openmm_filament.points import Point, Run

__all__ = ["intact", "keep", "restored", "take_all", "tell_of"]


def restored(points: Sequence[Point], store: Checkpoint | None) -> tuple[list[tuple[Point, Run]], Point | None]:
    """The runs that need a block, the heaviest points first, once all that the checkpoint has is taken; its last point.

    Taking blocks in the order in which they ended makes the same rounds as when they ended.
    """
    due = {id(run): (point, run) for point in sorted(points, key=lambda p: -p.weight) for run in point.runs}
    last = None
    if store is None:
        return list(due.values()), None
    for i, j, result in store.stored():
        point, run = points[i], points[i].runs[j]
        if due.pop(id(run), None) is None:
            raise ValueError(f"Argument `checkpoint` must hold the blocks of one call, but {store.path} does not.")
        _take(point, run, result, store)
        due |= {id(again): (point, again) for again in point.due_after(run)}
        last = point
    return sorted(due.values(), key=lambda pair: -pair[0].weight), last


def keep(points: Sequence[Point], point: Point, run: Run, result: BlockResult, store: Checkpoint | None) -> None:
    """Into the checkpoint first: what a trajectory holds can then be made again."""
    if store is not None:
        store.add(points.index(point), point.runs.index(run), result)
    _take(point, run, result, store)


def _take(point: Point, run: Run, result: BlockResult, store: Checkpoint | None) -> None:
    try:
        point.take(run, result)
    except OSError as error:
        assert point.writer is not None
        raise OSError(
            error.errno,
            f"The run has stopped: its trajectory {point.writer.path} cannot be written ({error.strerror}).{intact(store)}",
        ) from error


def take_all(
    points: Sequence[Point],
    results: Sequence[BlockResult],
    store: Checkpoint | None,
    failures: Mapping[int, DivergedError] | None = None,
) -> None:
    """What the points of one Context have sampled; those that are finished, or given up, take no more.

    Extensions that are NaN are of a point that is given up now, for one of the `failures`, by the number of the point.
    """
    for i, (point, result) in enumerate(zip(points, results, strict=True)):
        run = point.runs[0]
        if point.finished or point.failure is not None:
            continue
        if np.isnan(result.extensions).any():
            point.fail((failures or {}).get(i) or _diverged_before(point))
            continue
        _take(point, run, replace(result, checkpoint=b""), store)
        point.due_after(run)


def _diverged_before(point: Point) -> DivergedError:
    """What is left to say where the checkpoint tells that a point was given up."""
    nowhere = units.quantity(np.full((len(point.runs[0].block.filament), 3), np.nan), "length")
    return DivergedError("By its checkpoint the run has diverged.", 0, "unknown", 0, nowhere)


def intact(store: Checkpoint | None) -> str:
    """What an error says of the checkpoint, if there is one; without a block it is removed."""
    if store is None:
        return ""
    if not store.holds_blocks:
        return f" The checkpoint {store.path} has no block yet: the same call begins anew."
    return f" The checkpoint {store.path} is intact: the same call goes on from it."


def tell_of(apart: Sequence[Point], consequence: str) -> None:
    """Warn of forces whose chains stay in separate shapes."""
    named = ", ".join(f"{point.force:.6g} pN (R-hat {point.r_hat:.3f})" for point in apart)
    warnings.warn(f"Chains stay in shapes of their own at {named}: {consequence}.", stacklevel=3)
    for point in apart:
        point.told = True
