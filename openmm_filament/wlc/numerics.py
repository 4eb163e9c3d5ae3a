"""Elementwise roots, a cached quadrature rule, and how a function of `wlc` takes and returns its numbers."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import special
from scipy.optimize import elementwise

from openmm_filament import _checks as check

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike

__all__ = ["Floats", "gauss", "invert", "positive_scalar", "root", "scalar_or_array"]

Floats = NDArray[np.float64]


def scalar_or_array(values: Floats) -> float | Floats:
    """A float for a zero-dimensional array, the array itself otherwise."""
    return float(values) if values.ndim == 0 else values


def positive_scalar(name: str, value: float) -> float:
    """A single positive number."""
    return float(check.shape(name, check.positive(name, value), ()))


def root(function: Callable[[Floats, Floats], Floats], target: Floats, low: ArrayLike, high: ArrayLike) -> Floats:
    """Elementwise x in [low, high] with function(x, target) = 0, to rounding (Chandrupatla's method)."""
    bracket = tuple(np.broadcast_to(np.asarray(b, dtype=np.float64), target.shape) for b in (low, high))
    result = elementwise.find_root(function, bracket, args=(target,))
    if not np.all(result.success):
        raise RuntimeError(f"No root found for {np.extract(~np.asarray(result.success), target)}.")
    return np.asarray(result.x, dtype=np.float64)


def invert(function: Callable[[Floats], Floats], target: Floats, guess: Floats) -> Floats:
    """Elementwise x > 0 where the increasing `function` reaches `target`; 0 where the target is 0.

    The bracket grows from `guess` by factors of two, so a guess within a few factors is enough.
    """
    solution = np.zeros_like(target)
    wanted = target > 0
    goal, bounds = target[wanted], []
    for sign, factor in ((1.0, 0.5), (-1.0, 2.0)):
        bound = guess[wanted].copy()
        outside = np.ones(bound.shape, dtype=bool)
        for _ in range(200):
            outside[outside] = sign * (function(bound[outside]) - goal[outside]) > 0
            if not outside.any():
                break
            bound[outside] *= factor
        bounds.append(bound)
    if goal.size:
        solution[wanted] = root(lambda x, y: function(x) - y, goal, *bounds)
    return solution


@functools.lru_cache(maxsize=32)
def gauss(order: int) -> tuple[Floats, Floats]:
    """Nodes and weights of the Gauss-Legendre rule on [-1, 1]; not to be written to."""
    nodes, weights = special.roots_legendre(order)
    return nodes, weights
