"""Weighted least squares in a few parameters, with intervals by profile likelihood.

Plain SciPy. lmfit's `conf_interval` scales every fit by its own chi-squared; here standard errors that are known are taken
at their word, and only unknown ones are estimated from the residuals, where both give the same intervals.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, special

__all__ = ["Minimum", "Problem", "minimise", "profile"]

Array = NDArray[np.float64]

_DIFFERENCE = 1e-4
"""Step of central differences; parameters are scaled to be of order 1 where it matters."""

_PRECISE = 1e-9
"""Relative change of parameters and chi-squared at which a fit has settled."""

_CLOSE = 0.03
"""Length of a step, in standard errors, after which a minimum along a profile has been reached: chi-squared, with what the
step takes off it, is then within about 1e-4."""

_DEGENERATE = 1e-7
"""Singular value of the Jacobian, its columns scaled to one, over the largest, below which its differences only make noise: no
change of the residuals tells of a step along that direction, and the parameters that take part in it are not determined."""

_TAKES_PART = 1e-3
"""Component of such a direction from which a parameter takes part in it."""

_FAR = 60.0
"""Standard errors from the best value at which an interval counts as open."""


@dataclass(frozen=True)
class Problem:
    """Residuals over their errors as a function of P parameters, each in [low, high]."""

    residuals: Callable[[Array], Array]
    low: Array
    high: Array

    def jacobian(self, at: Array) -> Array:
        """(M, P), by central differences, one-sided of second order at a bound."""
        columns = []
        for i in range(len(at)):
            h = np.zeros(len(at))
            h[i] = _DIFFERENCE
            if at[i] - _DIFFERENCE < self.low[i]:
                near, far = self.residuals(at + h), self.residuals(at + 2 * h)
                columns.append((4 * near - far - 3 * self.residuals(at)) / (2 * _DIFFERENCE))
            else:
                columns.append((self.residuals(at + h) - self.residuals(at - h)) / (2 * _DIFFERENCE))
        return np.stack(columns, axis=1)


@dataclass(frozen=True, eq=False)
class Minimum:
    """Best parameters (P,), residuals (M,), Jacobian (M, P), chi-squared, and the inverse of `J^T J` (P, P).

    Where the data leave directions undetermined, the inverse is that on the others, and `undetermined` (P,) tells which
    parameters take part in them: their errors are infinite.
    """

    at: Array
    residuals: Array
    jacobian: Array
    chi_squared: float
    covariance: Array
    undetermined: NDArray[np.bool_]


def minimise(problem: Problem, start: Array) -> Minimum:
    """The minimum of the sum of squared residuals near `start`.

    Raises
    ------
    RuntimeError
        If it is not found.
    """
    found = optimize.least_squares(
        problem.residuals,
        np.clip(start, problem.low, problem.high),
        problem.jacobian,
        bounds=(problem.low, problem.high),
        xtol=_PRECISE,
        ftol=_PRECISE,
        gtol=_PRECISE,
        max_nfev=300,
    )
    if not found.success:
        raise RuntimeError(f"The fit did not settle: {found.message}")
    at = np.asarray(found.x)
    jacobian = problem.jacobian(at)
    residuals = problem.residuals(at)
    return Minimum(at, residuals, jacobian, float(residuals @ residuals), *_inverse(jacobian))


def _inverse(jacobian: Array) -> tuple[Array, NDArray[np.bool_]]:
    """The inverse of `J^T J` (P, P) on the directions that the data determine, and which parameters take part in others."""
    size = np.linalg.norm(jacobian, axis=0)
    scale = np.where(size > 0, size, 1.0)
    _, values, rows = np.linalg.svd(jacobian / scale, full_matrices=True)
    found = np.zeros(len(size))
    found[: len(values)] = values
    known = found > _DEGENERATE * found.max(initial=0.0)
    half = rows[known] / found[known, None] / scale
    return half.T @ half, (np.abs(rows[~known]) > _TAKES_PART).any(axis=0)


def profile(problem: Problem, best: Minimum, parameter: int, level: float, spread: float | None) -> tuple[float, float]:
    """The interval of one parameter outside which the best of the others leaves too large a chi-squared.

    Parameters
    ----------
    level : float
        Of confidence, in (0, 1).
    spread : float, optional
        Variance of a residual, where it was estimated from `best` itself (chi-squared over the degrees of freedom): the
        rise of chi-squared is then held against F's distribution. None where errors are known: that of chi-squared.

    Returns
    -------
    tuple of float
        A bound of the parameter, or an infinity, where the interval is open; both infinite for one that is not determined.
    """
    if best.undetermined[parameter]:
        return -math.inf, math.inf
    if spread == 0:  # the fit goes through every point
        return float(best.at[parameter]), float(best.at[parameter])
    rise = float(special.chdtri(1, 1 - level))
    if spread is not None:
        rise = float(special.fdtri(1, len(best.residuals) - len(best.at), level))
        problem, best = _scaled(problem, best, math.sqrt(spread))
    sigma = math.sqrt(best.covariance[parameter, parameter]) or 1.0
    return _end(problem, best, parameter, rise, -sigma), _end(problem, best, parameter, rise, sigma)


def _scaled(problem: Problem, best: Minimum, unit: float) -> tuple[Problem, Minimum]:
    """The same with residuals counted in this unit."""
    minimum = Minimum(
        best.at,
        best.residuals / unit,
        best.jacobian / unit,
        best.chi_squared / unit**2,
        best.covariance * unit**2,
        best.undetermined,
    )
    return Problem(lambda at: problem.residuals(at) / unit, problem.low, problem.high), minimum


def _end(problem: Problem, best: Minimum, parameter: int, rise: float, sigma: float) -> float:
    """Where the profile crosses `best.chi_squared + rise`, going by the signed step `sigma`."""
    rest = np.arange(len(best.at)) != parameter
    centre = float(best.at[parameter])
    limit = float((problem.low if sigma < 0 else problem.high)[parameter])
    # the others follow along the valley of the quadratic approximation, and then from the nearest minimum
    column = best.covariance[:, parameter]
    valley = column[rest] / column[parameter] if column[parameter] else np.zeros(int(rest.sum()))
    known: dict[float, Array] = {centre: best.at[rest]}

    def excess(value: float) -> float:
        """The root of the rise of chi-squared, nearly linear, less the one that is looked for."""
        nearest = min(known, key=lambda other: abs(other - value))

        def full(others: Array) -> Array:
            at = np.empty(len(best.at))
            at[rest], at[parameter] = others, value
            return at

        inner = Problem(lambda others: problem.residuals(full(others)), problem.low[rest], problem.high[rest])
        known[value], chi = _descend(inner, known[nearest] + valley * (value - nearest))
        return math.sqrt(max(chi - best.chi_squared, 0.0)) - math.sqrt(rise)

    inside, step = centre, 2 * sigma
    while True:
        outside = inside + step
        beyond = outside <= limit if sigma < 0 else outside >= limit
        if beyond:
            outside = limit
        if outside == inside:
            return limit
        if excess(outside) > 0:
            if inside != centre and excess(inside) >= 0:  # a curve without noise: rounding is all that rises
                return inside
            return float(optimize.brentq(excess, inside, outside, xtol=1e-3 * abs(sigma), rtol=1e-10))
        if beyond:
            return limit
        if abs(outside - centre) > _FAR * abs(sigma):
            return math.copysign(math.inf, sigma)
        inside, step = outside, 1.2 * step


def _descend(problem: Problem, start: Array) -> tuple[Array, float]:
    """The minimum near `start` and its chi-squared, by a few Gauss-Newton steps; by `minimise` where they do not settle."""
    at = start
    for _ in range(6):
        if (at <= problem.low).any() or (at + _DIFFERENCE >= problem.high).any():
            break
        residuals = problem.residuals(at)
        if not len(at):
            return at, float(residuals @ residuals)
        jacobian = np.stack([problem.residuals(at + h) - residuals for h in _DIFFERENCE * np.eye(len(at))], axis=1)
        jacobian /= _DIFFERENCE
        step = np.linalg.lstsq(jacobian, -residuals)[0]
        gain = float(np.sum((jacobian @ step) ** 2))
        at = at + step
        if gain < _CLOSE**2:
            return at, float(residuals @ residuals) - gain
    found = minimise(problem, start)
    return found.at, found.chi_squared
