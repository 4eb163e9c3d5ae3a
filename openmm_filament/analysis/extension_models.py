"""The worm-like chain as a function of what is fitted: which model, which parameters, and where to begin."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from openmm_filament import _checks as check
from openmm_filament import wlc
from openmm_filament.analysis.curves import Curve
from openmm_filament.analysis.least_squares import Minimum, Problem, minimise

__all__ = ["PARAMETERS", "FittedChain", "extension_of"]

Array = NDArray[np.float64]

PARAMETERS = ("persistence_length", "contour_length", "stretch_modulus")
"""nm, nm and pN; an infinite modulus is that of a chain that does not stretch."""

_SOFT = 1e-3
"""Unit of the compliance 1/S, in 1/pN, that is fitted in place of S: where nothing stretches it is 0, not infinite."""

_BOUNDS = 14.0
"""Powers of e by which a length may go from its start."""


def extension_of(model: str, force: Array, values: Mapping[str, float], kT: float, dimension: int) -> Array:
    """The model's extension; an infinite modulus is that of a chain that does not stretch."""
    lp, length, modulus = (values[name] for name in PARAMETERS)
    stretch = None if math.isinf(modulus) else modulus
    if model == "bouchiat":
        return np.asarray(wlc.extension_bouchiat(force, lp, length, kT))
    if model == "marko_siggia":
        return np.asarray(wlc.extension_marko_siggia(force, lp, length, kT))
    if model == "odijk":
        if stretch is None:
            return np.asarray(wlc.extension_high_force(force, lp, length, kT, dimension=dimension))
        return np.asarray(wlc.extension_odijk(force, lp, length, kT, stretch, dimension=dimension))
    finite = model == "exact"
    return np.asarray(
        wlc.extension_exact(force, lp, length, kT, stretch_modulus=stretch, finite=finite, dimension=dimension)
    )


@functools.cache
def _table() -> tuple[Array, Array]:
    """Logarithms of reduced forces and the extension over the contour length there, for starting values."""
    f = np.geomspace(1e-4, 1e6, 400)
    return np.log(f), np.asarray(wlc.extension_bouchiat(f, 1.0, 1.0, 1.0))


class FittedChain:
    """The fitted parameters as numbers without bounds that matter: ln l_p, ln L, and 1/S in units of `_SOFT`."""

    def __init__(self, model: str, curve: Curve, kT: float, given: dict[str, Any], start: Mapping[str, float]) -> None:
        self.model, self.curve, self.kT = model, curve, kT
        self.fitted = tuple(name for name in PARAMETERS if isinstance(given[name], str))
        for name in self.fitted:
            check.one_of(name, given[name], ("fit",))
        if not self.fitted:
            raise ValueError("Argument `persistence_length` or another must be 'fit', but all are fixed.")
        for name in start:
            check.one_of("start", name, self.fitted)
        self.fixed = {
            name: math.inf if value is None else float(check.shape(name, check.positive(name, value), ()))
            for name, value in given.items()
            if name not in self.fitted
        }
        self.begin = self._starting({name: float(check.positive(name, value)) for name, value in start.items()})

    def values(self, at: Array) -> dict[str, float]:
        """All three parameters, in nm and pN."""
        free = {name: self.physical(name, x) for name, x in zip(self.fitted, at.tolist(), strict=True)}
        return {name: free[name] if name in free else self.fixed[name] for name in PARAMETERS}

    @staticmethod
    def physical(name: str, x: float) -> float:
        """A parameter in nm or pN from its number."""
        if name == "stretch_modulus":
            return math.inf if x <= 0 else 1 / (x * _SOFT)
        return math.exp(min(x, 700.0)) if x < math.inf else math.inf

    @staticmethod
    def slope(name: str, value: float) -> float:
        """Derivative of a parameter by its number."""
        return -(value**2) * _SOFT if name == "stretch_modulus" else value

    def extension(self, at: Array, model: str | None = None) -> Array:
        """Extensions (M,) in nm, of this model or of another."""
        return extension_of(model or self.model, self.curve.force, self.values(at), self.kT, self.curve.dimension)

    def solve(self) -> tuple[Problem, Minimum]:
        """The best fit; errors of forces enter by the slope of the last one, until that settles."""
        low = np.where([name == "stretch_modulus" for name in self.fitted], 0.0, self.begin - _BOUNDS)
        high = np.where([name == "stretch_modulus" for name in self.fitted], 1e4, self.begin + _BOUNDS)
        at = self.begin
        for _ in range(1 if self.curve.force_error is None else 12):
            sigma = self.errors(at)
            problem = Problem(lambda x, s=sigma: (self.curve.extension - self.extension(x)) / s, low, high)  # type: ignore[misc]
            best = minimise(problem, at)
            settled = bool(np.all(np.abs(best.at - at) < 1e-6))
            at = best.at
            if settled:
                break
        return problem, best

    def errors(self, at: Array) -> Array:
        """Standard errors (M,) of the residuals in nm; 1 where none are known."""
        curve = self.curve
        if curve.force_error is None:
            return np.ones(len(curve)) if curve.extension_error is None else curve.extension_error
        ends = [
            extension_of(self.model, curve.force * factor, self.values(at), self.kT, curve.dimension)
            for factor in (0.99, 1.01)
        ]
        variance = ((ends[1] - ends[0]) / (0.02 * curve.force) * curve.force_error) ** 2
        if curve.extension_error is not None:
            variance = variance + curve.extension_error**2
        return np.asarray(np.sqrt(variance))

    def _starting(self, start: dict[str, float]) -> Array:
        """Numbers to begin at: the best on a grid of l_p and S, L being linear, by an interpolation."""
        curve, fixed = self.curve, self.fixed | start
        unit = self.kT / float(np.sqrt(curve.force.min() * curve.force.max()))
        lengths = [fixed["persistence_length"]] if "persistence_length" in fixed else unit * np.geomspace(0.02, 500, 40)
        moduli = [fixed["stretch_modulus"]] if "stretch_modulus" in fixed else [math.inf, 3000.0, 1000.0, 300.0, 100.0]
        weights = np.ones(len(curve)) if curve.extension_error is None else curve.extension_error**-2.0
        best: tuple[float, dict[str, float]] = (math.inf, {})
        for lp in lengths:
            straight = np.interp(np.log(curve.force * lp / self.kT), *_table())
            for modulus in moduli:
                shape = straight + curve.force / modulus
                length = fixed.get("contour_length", float(weights @ (shape * curve.extension) / (weights @ shape**2)))
                chi = float(weights @ (curve.extension - length * shape) ** 2)
                if length > 0 and chi < best[0]:
                    values = {"persistence_length": lp, "contour_length": length, "stretch_modulus": modulus}
                    best = (chi, values)
        if not best[1]:
            raise ValueError("Argument `data` must have extensions along the force, but they point against it.")
        values = best[1]
        return np.array(
            [1 / (values[n] * _SOFT) if n == "stretch_modulus" else math.log(values[n]) for n in self.fitted]
        )
