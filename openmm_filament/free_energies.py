"""Free energies from the work of ramps there and back: Jarzynski each way, and both together by BAR, through pymbar."""

from __future__ import annotations

import logging
import math
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from openmm import unit
from scipy.special import expit

from openmm_filament import _checks as check
from openmm_filament import units

if TYPE_CHECKING:
    import xarray

__all__ = ["FreeEnergy", "free_energy", "free_energy_of_works"]

Array = NDArray[np.float64]

_OVERLAP = 0.03
"""Overlap below which BAR and its error are not to be trusted (Klimovich, Shirts and Mobley, J. Comput. Aided Mol. Des.
29, 397 (2015))."""


@dataclass(frozen=True)
class FreeEnergy:
    """The free energy of the last state minus that of the first, in kJ/mol.

    Attributes
    ----------
    difference, error : float
        By Bennett's acceptance ratio from both directions, with one standard error: infinite where all works there are
        above, or below, those gained back.
    forward, forward_error : float
        By Jarzynski's equality from the ramps there, with one standard error. Too high, by a bias that the error does not
        hold, where few replicas see little work.
    reverse, reverse_error : float
        The same from the ramps back: too low where biased.
    dissipated_forward, dissipated_reverse : float
        Mean work beyond the difference, each way.
    overlap : float
        Of the two distributions of the work: 1 where they are one, 0 where they are apart.
    """

    difference: float
    error: float
    forward: float
    forward_error: float
    reverse: float
    reverse_error: float
    dissipated_forward: float
    dissipated_reverse: float
    overlap: float


def free_energy(ramp: xarray.Dataset) -> FreeEnergy:
    """The free energy difference between the ends of a `ramp`: of the filament, with its trap or under its force.

    For a force ramp it is that of the ensemble of constant force, `-integral <z> dF`.

    Arguments of other kinds, warnings and the package that is needed: see `free_energy_of_works`.
    """
    if not hasattr(ramp, "data_vars"):
        raise TypeError(f"Argument `ramp` must be a dataset of `ramp`, but is {ramp!r}.")
    if "work" not in ramp:
        raise ValueError(
            f"Argument `ramp` must be a dataset of `ramp`, with its work, but has {[str(name) for name in ramp.data_vars]}."
        )
    works = ramp["work"].isel(point=-1).transpose("direction", "replica").values
    kelvin = float(ramp.attrs["temperature_K"]) * unit.kelvin
    there, back = (units.quantity(work, "energy") for work in works)
    return free_energy_of_works(there, back, kelvin)


def free_energy_of_works(forward: unit.Quantity, reverse: unit.Quantity, temperature: unit.Quantity) -> FreeEnergy:
    """The free energy difference from works measured there and back, each run having begun in equilibrium.

    Parameters
    ----------
    forward, reverse : Quantity
        Energy, (M,) and (K,), at least 2 each: the work done on the system on the way there, and on the way back (so that
        their means add up to the dissipation, which is positive).
    temperature : Quantity

    Raises
    ------
    ValueError
        For works that are none, and for those so far apart that Bennett's equation has no solution in double precision.
    ImportError
        Without pymbar, which the extra `free-energy` installs.

    Warns
    -----
    UserWarning
        Where the two distributions of the work overlap too little.
    """
    kelvin = check.positive("temperature", units.number("temperature", temperature, "temperature")).item()
    thermal = units.BOLTZMANN * kelvin
    there, back = (
        check.finite(name, check.shape(name, units.numbers(name, value, "energy"), (None,))) / thermal
        for name, value in (("forward", forward), ("reverse", reverse))
    )
    for name, values in (("forward", there), ("reverse", back)):
        if len(values) < 2:
            raise check.fail(name, "hold at least two works", len(values))
    both, up, down = _estimates(there, back)
    overlap = _overlap(there, back, both[0])
    apart = there.min() > (-back).max() or there.max() < (-back).min()
    if apart or math.isnan(both[1]):
        both = both[0], math.inf
    if apart or not overlap >= _OVERLAP:
        doubt = (
            "no work there is within those gained back, so that its error is infinite"
            if apart
            else "the free energy and its error are not to be trusted"
        )
        warnings.warn(
            f"The works there and back overlap by {overlap:.2g} only, with {there.mean() - both[0]:.3g} and "
            f"{back.mean() + both[0]:.3g} k_B T dissipated: {doubt}. Take slower ramps, or shorter ones.",
            stacklevel=2,
        )
    return FreeEnergy(
        difference=both[0] * thermal,
        error=both[1] * thermal,
        forward=up[0] * thermal,
        forward_error=up[1] * thermal,
        reverse=-down[0] * thermal,
        reverse_error=down[1] * thermal,
        dissipated_forward=float(there.mean() - both[0]) * thermal,
        dissipated_reverse=float(back.mean() + both[0]) * thermal,
        overlap=overlap,
    )


def _pymbar() -> Any:
    logger = logging.getLogger("pymbar")
    level = logger.level
    logger.setLevel(logging.ERROR)  # it tells of an optional package whenever it is first imported
    try:
        from pymbar import other_estimators
    except ImportError as error:
        raise ImportError(
            'Free energies need pymbar 4 or later: pip install "openmm-filament[free-energy]", or pip install "pymbar>=4".'
        ) from error
    finally:
        logger.setLevel(level)
    return other_estimators


def _estimates(there: Array, back: Array) -> tuple[tuple[float, float], tuple[float, float], tuple[float, float]]:
    """Difference and error in k_B T from both ways, from the one there, and from the one back."""
    estimators = _pymbar()
    from pymbar.utils import BoundsError, ConvergenceError

    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore", RuntimeWarning
        )  # works far apart over- and underflow, and come out with no error
        try:
            both = _estimate(estimators.bar(there, back))
        except (BoundsError, ConvergenceError) as error:
            raise ValueError(
                "Arguments `forward` and `reverse` must hold works from which Bennett's equation can be solved, but they "
                f"are, with {there.mean():.3g} and {back.mean():.3g} k_B T on average, too far apart: take slower ramps, or "
                "shorter ones."
            ) from error
        return both, _estimate(estimators.exp(there)), _estimate(estimators.exp(back))


def _estimate(result: dict[str, Any]) -> tuple[float, float]:
    return float(result["Delta_f"]), float(result["dDelta_f"])


def _overlap(there: Array, back: Array, difference: float) -> float:
    """One minus the second eigenvalue of the overlap matrix of the two states, works and difference in k_B T."""
    work = np.concatenate([there, -back])
    last = expit(difference - work + math.log(len(back) / len(there)))  # weight of the last state in each sample
    return float((last * (1 - last)).sum() * (1 / len(there) + 1 / len(back)))
