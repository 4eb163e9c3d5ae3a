"""Fits of the worm-like chain to force-extension curves.

Forces in pN, lengths in nm, stretch moduli in pN, temperatures in K.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from openmm_filament import _checks as check
from openmm_filament.analysis.curves import Curve, as_curve
from openmm_filament.analysis.extension_models import PARAMETERS, FittedChain, extension_of
from openmm_filament.analysis.least_squares import Minimum, profile

__all__ = ["ForceExtensionFit", "ForceExtensionModel", "fit_force_extension"]

Array = NDArray[np.float64]

ForceExtensionModel = Literal["exact", "exact_infinite", "bouchiat", "marko_siggia", "odijk"]

_BOLTZMANN = 0.01380649
"""pN nm/K."""

_UNKNOWN = 0.5
"""Standard error over the value above which a parameter counts as not determined by the data."""

_IMPROBABLE = 1e-3
"""Probability of so large a chi-squared below which the model is said not to describe the data."""


@dataclass(frozen=True, eq=False)
class ForceExtensionFit:
    """The result of `fit_force_extension`.

    Attributes
    ----------
    model : str
    temperature : float
        K.
    values : dict of str to float
        persistence_length and contour_length in nm, stretch_modulus in pN (infinite for an inextensible chain), fitted or
        given.
    errors : dict of str to float
        One standard error of each fitted parameter, from the curvature at the best values; infinite for one that the data do
        not determine, alone or beside the others.
    intervals : dict of str to (low, high)
        Of confidence `level`, by profile likelihood; an infinite end is one that the data do not bound.
    level : float
    fitted : tuple of str
        The fitted parameters, in the order of the covariance.
    covariance : (P, P) array
        In nm and pN; infinite and NaN for parameters that are not determined.
    chi_squared : float
        Sum of the squared residuals over their standard errors; of curves without errors, over 1 nm^2.
    degrees_of_freedom : int
    probability : float
        Of a chi-squared as large as this if the model holds; NaN for curves without errors.
    residuals : (M,) array
        Extension less the fitted one, nm.
    curve : Curve
        What was fitted.
    """

    model: str
    temperature: float
    values: dict[str, float]
    errors: dict[str, float]
    intervals: dict[str, tuple[float, float]]
    level: float
    fitted: tuple[str, ...]
    covariance: Array
    chi_squared: float
    degrees_of_freedom: int
    probability: float
    residuals: Array
    curve: Curve

    def extension(self, force: ArrayLike) -> Array:
        """The fitted extension in nm at a force, or an array of them, in pN."""
        forces = np.asarray(force, dtype=np.float64)
        return extension_of(self.model, forces, self.values, _BOLTZMANN * self.temperature, self.curve.dimension)


def fit_force_extension(
    data: Any,
    *,
    model: ForceExtensionModel = "exact",
    temperature: float | None = None,
    persistence_length: float | Literal["fit"] = "fit",
    contour_length: float | Literal["fit"] = "fit",
    stretch_modulus: float | Literal["fit"] | None = None,
    start: Mapping[str, float] | None = None,
    level: float = 0.95,
) -> ForceExtensionFit:
    """Fit a worm-like chain to a force-extension curve by weighted least squares.

    Extensions are fitted against forces: `sum ((z - z(F))/sigma)^2` is made smallest, `sigma^2` being the square of the
    extension's error plus, where forces have errors, that of the force's error times the slope of the fitted curve (which
    asks for force errors over which the slope changes little). Without any errors all points count alike, and the scatter
    about the fit gives their error.

    Parameters
    ----------
    data : Curve, path or xarray.Dataset
        A `Curve` of arrays, a CSV file with the columns of the systems (others through `read_curve`), or what
        `force_extension` returns. Of the dataset of a `WormlikeChain` the exactly known bias of the discrete chains is
        taken off first; the dataset of a `Filament` is that of a discrete chain, which differs from every model here.
    model : str
        - "exact": the continuous chain of length L with free ends (`wlc.extension_exact`, finite);
        - "exact_infinite": the same for L far above l_p;
        - "bouchiat": an interpolation within 0.34 % of the infinite chain, inextensible;
        - "marko_siggia": an interpolation, up to 8.5 % in extension and 16.7 % in force off, inextensible;
        - "odijk": a limit for large forces, within 0.2 % from `F l_p/kT = 5` up.
    temperature : float, optional
        K; by default that of the dataset.
    persistence_length, contour_length : float or "fit"
        Fixed at a number of nm, or fitted.
    stretch_modulus : float, "fit" or None
        In pN; None for an inextensible chain. "bouchiat" and "marko_siggia" have none.
    start : mapping of str to float, optional
        Values of fitted parameters to begin at; by default found on a grid.
    level : float
        Of the confidence intervals.

    Raises
    ------
    ValueError
        If an argument is out of its range or has no effect, or there are fewer points than parameters (without errors,
        not more).
    RuntimeError
        If the fit does not settle.

    Warns
    -----
    UserWarning
        If a parameter is not determined by the data, the model does not describe them, or the model's own error, against
        the exact infinite chain at the fitted parameters, exceeds a standard error of a point.

    Examples
    --------
    >>> forces = np.geomspace(0.05, 50, 12)
    >>> from openmm_filament import wlc
    >>> exact = wlc.extension_exact(forces, 53.0, 1000.0, 4.114, stretch_modulus=1000.0, finite=True)
    >>> found = fit_force_extension(Curve(forces, exact, 0.005 * exact), temperature=297.98, stretch_modulus="fit")
    >>> {name: round(value, 1) for name, value in found.values.items()}
    {'persistence_length': 53.0, 'contour_length': 1000.0, 'stretch_modulus': 1000.0}
    """
    curve = as_curve(data)
    check.one_of("model", model, ("exact", "exact_infinite", "bouchiat", "marko_siggia", "odijk"))
    level = float(check.within("level", level, 0, 1, open_ends=True))
    kelvin = temperature if temperature is not None else curve.temperature
    if kelvin is None:
        raise ValueError("Argument `temperature` must be given for data without one, but is None.")
    kelvin = float(check.shape("temperature", check.positive("temperature", kelvin), ()))
    if model in ("bouchiat", "marko_siggia"):
        if stretch_modulus is not None:
            raise check.fail("stretch_modulus", f"be None for {model!r}, which does not stretch", repr(stretch_modulus))
        if curve.dimension != 3:
            raise check.fail("model", "hold in two dimensions for this curve", repr(model))
    given = dict(zip(PARAMETERS, (persistence_length, contour_length, stretch_modulus), strict=True))
    chain = FittedChain(model, curve, _BOLTZMANN * kelvin, given, start or {})
    known = curve.extension_error is not None or curve.force_error is not None
    freedom = len(curve) - len(chain.fitted)
    if freedom < (0 if known else 1):
        raise ValueError(
            f"Argument `data` must hold {'at least' if known else 'more than'} {len(chain.fitted)} points to fit so many "
            f"parameters, but holds {len(curve)}."
        )
    problem, best = chain.solve()
    spread = None if known else best.chi_squared / freedom
    intervals = {}
    for i, name in enumerate(chain.fitted):
        low, high = (chain.physical(name, end) for end in profile(problem, best, i, level, spread))
        intervals[name] = (min(low, high), max(low, high))
    values = chain.values(best.at)
    scales = np.array([chain.slope(name, values[name]) for name in chain.fitted])
    with np.errstate(invalid="ignore"):
        covariance = best.covariance * np.outer(scales, scales) * (1.0 if spread is None else spread)
    lost = best.undetermined
    covariance[lost] = covariance[:, lost] = math.nan
    covariance[lost, lost] = math.inf
    found = ForceExtensionFit(
        model,
        kelvin,
        values,
        dict(zip(chain.fitted, np.sqrt(np.diag(covariance)).tolist(), strict=True)),
        intervals,
        level,
        chain.fitted,
        covariance,
        best.chi_squared,
        freedom,
        float(special.chdtrc(freedom, best.chi_squared)) if known and freedom else math.nan,
        curve.extension - chain.extension(best.at),
        curve,
    )
    _tell(found, chain, best, spread)
    return found


def _tell(found: ForceExtensionFit, chain: FittedChain, best: Minimum, spread: float | None) -> None:
    """Warn of what the fit cannot say."""
    for name in found.fitted:
        low, high = found.intervals[name]
        if not (found.errors[name] < _UNKNOWN * found.values[name] and high < math.inf and low > 0):
            warnings.warn(
                f"The data do not determine {name}: {found.values[name]:.4g}, {100 * found.level:g} % interval from "
                f"{low:.4g} to {high:.4g}. Fix it, or measure where it matters.",
                stacklevel=3,
            )
    if found.probability < _IMPROBABLE:
        warnings.warn(
            f"The model {found.model!r} does not describe the data within their errors: chi-squared is "
            f"{found.chi_squared:.4g} for {found.degrees_of_freedom} degrees of freedom.",
            stacklevel=3,
        )
    if found.model in ("exact", "exact_infinite"):
        return
    error = chain.errors(best.at) * (1.0 if spread is None else math.sqrt(spread))
    off = chain.extension(best.at) - chain.extension(best.at, "exact_infinite")
    worst = int(np.argmax(np.abs(off) / error))
    if abs(off[worst]) > error[worst]:
        # the residuals fall by J p: this moves the parameters until the model lies where the exact chain does
        moved = best.covariance @ (best.jacobian.T @ (off / chain.errors(best.at)))
        shifts = ", ".join(
            f"{name} by about {chain.slope(name, found.values[name]) * by:+.3g}"
            for name, by, lost in zip(found.fitted, moved, best.undetermined, strict=True)
            if not lost
        )
        warnings.warn(
            f"The model {found.model!r} is off the exact chain by {off[worst]:.3g} nm at {found.curve.force[worst]:.4g} pN, "
            f"{abs(off[worst]) / error[worst]:.1f} standard errors of that point{shifts and f', which shifts {shifts}'}.",
            stacklevel=3,
        )
