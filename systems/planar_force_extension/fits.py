"""How well worm-like chains fit a curve: (3.10), (3.12) and the exact chain in a plane, one number free in each."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import curve_fit

from openmm_filament import wlc

__all__ = ["FORMS", "RANGES", "Fit", "fitted"]

Array = NDArray[np.float64]

RANGES = ("low", "middle", "high")


def _large_force(force: Array, scale: float | Array) -> Array:
    return 1 - 0.25 * np.sqrt(scale / force)


def _marko_siggia(force: Array, scale: float | Array) -> Array:
    return np.asarray(wlc.extension_marko_siggia(force / scale, 1.0, 1.0, 1.0))


@lru_cache(maxsize=1)
def _tabulated() -> CubicSpline:
    logarithm = np.linspace(-6.0, 6.0, 241)
    return CubicSpline(logarithm, wlc.extension_exact(10**logarithm, 1.0, 1.0, 1.0, dimension=2))


def _exact(force: Array, scale: float | Array) -> Array:
    """The infinite chain in a plane, from a table good to 1e-6 between its two limits."""
    f = force / scale
    between = _tabulated()(np.log10(np.clip(f, 1e-6, 1e6)))
    return np.asarray(np.where(f < 1e-6, 2 * f, np.where(f > 1e6, 1 - 0.25 / np.sqrt(f), between)))


FORMS: dict[str, Callable[[Array, float | Array], Array]] = {
    "(3.10) in 2D": _large_force,
    "(3.12) Marko-Siggia": _marko_siggia,
    "exact worm-like chain in 2D": _exact,
}
"""Extension over contour at a force, by the force `k_B T/l_p` in the same unit. The contour is known, not fitted."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A form, the force `k_B T/l_p` that fits best, its standard error, and what is left: curve less form over contour.

    `misses` are the largest such differences in the low, middle and high third of the forces on a logarithmic scale.
    """

    form: str
    scale: float
    scale_error: float
    left: Array

    @property
    def rms(self) -> float:
        """Root mean square of what is left."""
        return float(np.sqrt((self.left**2).mean()))

    @property
    def misses(self) -> tuple[float, ...]:
        """The largest difference, with its sign, in each third of the points."""
        return tuple(float(part[np.argmax(np.abs(part))]) for part in np.array_split(self.left, 3))


def fitted(force: Array, extension: Array, form: str) -> Fit:
    """Least squares over all points, from the best of some starts; extensions over the contour."""
    function = FORMS[form]
    guesses = np.geomspace(force[0] / 100, force[-1] * 100, 25)
    left = function(force[:, None], guesses) - extension[:, None]
    guess = float(guesses[np.argmin((left**2).sum(axis=0))])

    def of_logarithm(f: Array, logarithm: float) -> Array:
        return function(f, math.exp(logarithm))

    (best,), covariance = curve_fit(of_logarithm, force, extension, p0=[math.log(guess)])
    scale = math.exp(best)
    return Fit(form, scale, scale * math.sqrt(covariance[0, 0]), extension - function(force, scale))
