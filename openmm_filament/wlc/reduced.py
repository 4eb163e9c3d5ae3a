"""The checked arguments of the continuous chains in the chain's own units: `f = F l_p/kT`, `z/L` and `kT/(S l_p)`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from openmm_filament import _checks as check
from openmm_filament.wlc.numerics import Floats, positive_scalar

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = ["check_below_contour", "fractions", "reduced_forces", "stretch_softness"]


def reduced_forces(
    force: ArrayLike, persistence_length: float, contour_length: float, kT: float, dimension: int = 3
) -> tuple[Floats, float]:
    """The reduced forces `F l_p/kT` and the contour length, all arguments checked."""
    check.one_of("dimension", dimension, (2, 3))
    scale = positive_scalar("persistence_length", persistence_length) / positive_scalar("kT", kT)
    return check.non_negative("force", force) * scale, positive_scalar("contour_length", contour_length)


def fractions(
    extension: ArrayLike,
    persistence_length: float,
    contour_length: float,
    kT: float,
    dimension: int = 3,
    *,
    bounded: bool = True,
) -> tuple[Floats, float]:
    """The fractions `z/L` and the unit of force `kT/l_p`, all arguments checked; `bounded` refuses `z >= L`."""
    check.one_of("dimension", dimension, (2, 3))
    unit = positive_scalar("kT", kT) / positive_scalar("persistence_length", persistence_length)
    contour = positive_scalar("contour_length", contour_length)
    values = check.non_negative("extension", extension)
    if bounded:
        check_below_contour(values, contour)
    return values / contour, unit


def check_below_contour(extension: Floats, contour: float) -> None:
    """Refuse an extension that a chain without stretch does not reach."""
    if (extension >= contour).any():
        raise check.fail("extension", f"lie below the contour length {contour:.6g} nm", f"{extension.max():.6g}")


def stretch_softness(persistence_length: float, kT: float, stretch_modulus: float) -> float:
    """`kT/(S l_p)`: the strain by the unit of force, for a persistence length and a kT already checked."""
    return kT / (persistence_length * positive_scalar("stretch_modulus", stretch_modulus))
