"""The Pareto front of error against wall time, the time to an error on it, and orders of convergence."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from systems.error_vs_runtime.settings import Order, Outcome

__all__ = ["Fit", "fitted", "pareto", "power_law", "thermal_time_to", "time_to"]

Array = NDArray[np.float64]


def pareto(seconds: Array, errors: Array) -> NDArray[np.intp]:
    """Indices of the points that no other beats in both time and error, by rising time; NaN and infinities never count."""
    usable = np.flatnonzero(np.isfinite(seconds) & np.isfinite(errors))
    order = usable[np.lexsort((errors[usable], seconds[usable]))]
    front, best = [], math.inf
    for i in order:
        if errors[i] < best:
            front.append(i)
            best = float(errors[i])
    return np.array(front, dtype=np.intp)


def time_to(seconds: Array, errors: Array, wanted: float) -> float:
    """Wall time of the cheapest setting whose error is as wanted, a point of the front; NaN where no setting is as good.

    Nothing is read off between two points of the front: they may be of unlike methods.
    """
    return next((float(seconds[i]) for i in pareto(seconds, errors) if errors[i] <= wanted), math.nan)


def thermal_time_to(seconds: float, scatter: float, bias: float, wanted: float) -> float:
    """Wall time after which bias and two standard deviations are as wanted: scatter falls as one over the root of time.

    Infinite where the bias alone is larger. It reaches beyond the runs made, whose scatter need not be as small, and below
    them, where building and warming up would not leave so little.
    """
    left = wanted - abs(bias)
    return seconds * (2 * scatter / left) ** 2 if left > 0 else math.inf


@dataclass(frozen=True)
class Fit:
    """An order of convergence: exponent and its standard error from the scatter of the points, or from their own errors."""

    order: float
    error: float
    points: int


def power_law(x: Array, y: Array, y_errors: Array | None = None) -> Fit:
    """Exponent of `y = c x^p` by least squares in logarithms, weighted where y has errors; NaN with fewer than two points."""
    if len(x) < 2:
        return Fit(math.nan, math.nan, len(x))
    u, v = np.log(x), np.log(y)
    weights = np.ones_like(u) if y_errors is None else (y / y_errors) ** 2
    centre = np.average(u, weights=weights)
    curvature = float(weights @ (u - centre) ** 2)
    order = float(weights @ ((u - centre) * (v - np.average(v, weights=weights)))) / curvature
    if y_errors is not None:
        return Fit(order, 1 / math.sqrt(curvature), len(x))
    rest = v - np.average(v) - order * (u - centre)
    error = math.sqrt(float(rest @ rest) / (len(x) - 2) / curvature) if len(x) > 2 else math.nan
    return Fit(order, error, len(x))


def fitted(order: Order, outcomes: Sequence[Outcome]) -> Fit:
    """The measured order of a study: of the scatter against the length of a run, else of the (absolute) error or bias."""
    chosen = [o for o in outcomes if order.chosen(o.setting) and o.results]
    x = np.array([float(getattr(o.setting, order.variable)) for o in chosen])
    if order.variable == "effort":
        scatter = np.array([o.scatter for o in chosen])
        # of n normal deviates the standard deviation has a relative error of 1/sqrt(2 (n - 1))
        return power_law(x, scatter, np.array([o.scatter / math.sqrt(2 * (len(o.deviations) - 1)) for o in chosen]))
    if any(o.bias_error for o in chosen):
        bias, error = (np.array([getattr(o, name) for o in chosen]) for name in ("bias", "bias_error"))
        clear = np.abs(bias) > 2 * error
        return power_law(x[clear], np.abs(bias[clear]), error[clear])
    y = np.array([o.error for o in chosen])
    clear = y > order.floor
    return power_law(x[clear], y[clear])
