"""The discrete chain at thermal equilibrium: the very potentials that are simulated, solved exactly.

Conventions: a chain of `segments` bonds has `segments - 1` joints. The bending angle `beta` is unsigned, 0 when
straight, in [0, pi]; `phi` is its signed version in a plane. A bond of length s and direction t has the weight
`s^(d-1) ds dt` in `dimension` d (2 or 3). Ends are free: neither the first nor the last bond has a preferred direction.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from openmm_filament import _checks as check
from openmm_filament.wlc.chain import DiscreteChain
from openmm_filament.wlc.joints import BendingForm
from openmm_filament.wlc.numerics import Floats, invert, scalar_or_array
from openmm_filament.wlc.planar import Planar
from openmm_filament.wlc.reduced import check_below_contour
from openmm_filament.wlc.spatial import Spatial

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = ["extension_discrete", "force_discrete"]

_TAIL = 1e-10  # largest admitted last coefficients of a message, relative to its largest one (rounding: 1e-16 F b/kT)
_NOISE = 1e-15  # rounding of a message after a Legendre transform, relative to its largest value
_TOLERANCE = 1e-8  # what is promised of an extension
_TINY = 1e-300
_LOST = math.log(1e-285)  # logarithm of the values of a message below which rounding to _TINY may be felt
_NEGLIGIBLE = 45.0  # logarithm of the largest over the smallest weight that counts in a sum
_BATCH = 48  # forces that travel along the chain together


def _propagate(operator: Planar | Spatial, chain: DiscreteChain, force: Floats) -> tuple[Floats, float]:
    """Extensions `kT d(ln Z)/dF`, one per force, and the largest log factor by which a bond amplified a small message.

    The message of the bonds so far and its logarithmic derivative with respect to the force, both (nodes, forces),
    travel together along the chain.
    """
    log_weight, length = chain.bond(operator.cosines[:, None] * force)
    pull = operator.cosines[:, None] * length / chain.kT  # d(log_weight)/dF
    top = log_weight.max(axis=0)
    log_message, slope = np.zeros_like(log_weight), np.zeros_like(log_weight)
    noise = np.zeros_like(log_weight)  # what rounding up to _TINY may have put into the message
    lost = np.zeros(len(force), dtype=bool)
    amplified, forces = 0.0, len(force)
    for bond in range(chain.segments):
        log_joint = log_weight + log_message
        peak = log_joint.max(axis=0)
        amplified = max(amplified, float((top + log_message.max(axis=0) - peak).max()))
        joint = np.exp(log_joint - peak)
        derivative = joint * (pull + slope)
        spoilt = np.exp(log_weight - peak) * noise
        lost |= ((log_message < _LOST) & (log_joint > peak - _NEGLIGIBLE)).any(axis=0)
        if bond < chain.segments - 1:
            columns = [joint, derivative, spoilt] if noise.any() else [joint, derivative]
            messages = operator(bond, np.hstack(columns))
            message = np.maximum(messages[:, :forces], _TINY)
            log_message = np.log(message)
            slope = np.where(message > _TINY, messages[:, forces : 2 * forces] / message, 0.0)
            if operator.positive:  # otherwise small messages are differences, whose rounding `amplified` tells
                noise = np.where(message > _TINY, 0.0, _TINY)
                if len(columns) == 3:
                    noise = noise + messages[:, 2 * forces :]
    weights: Floats = operator.weights
    lost |= weights @ spoilt > _TOLERANCE * (weights @ joint)
    if lost.any():
        raise check.fail("force", "be weaker for joints this stiff and bent (weights underflow)", force[lost].min())
    return chain.kT * (weights @ derivative) / (weights @ joint), amplified


def _extension(force: Floats, chain: DiscreteChain, refine: float = 1.0) -> Floats:
    """`extension_discrete` for checked arguments; `refine` multiplies the number of nodes (the tests double it)."""
    flat = force.ravel()
    strongest = float(flat.max())
    longest = float(chain.bond(np.array([strongest]))[1][0])
    curvature = strongest * longest / chain.kT  # of a bond's log weight in the angle, from above
    if chain.stretching is not None:
        curvature += strongest**2 / (chain.stretching * chain.kT)
    for _ in range(12):
        operator = (Planar if chain.dimension == 2 else Spatial)(chain, curvature, refine)
        extension, amplified = _propagate(operator, chain, flat)
        if isinstance(operator, Planar):
            break
        if _NOISE * math.exp(min(amplified, 700)) > _TOLERANCE:
            raise check.fail("force", "be weaker for joints this stiff and bent (rounding spoils it)", flat.max())
        if operator.tail < _TAIL:
            break
        refine *= 1.4
    else:
        raise RuntimeError(f"The chain did not converge with {operator.size} harmonics.")
    if not np.isfinite(extension).all():
        raise check.fail("force", "be weaker for joints this stiff and bent (weights underflow)", flat.max())
    return np.where(flat == 0, 0.0, extension).reshape(force.shape)


def extension_discrete(
    force: ArrayLike,
    *,
    segments: int,
    bond_length: float,
    bending: ArrayLike,
    kT: float,
    stretching: float | None = None,
    bending_form: BendingForm = "harmonic",
    rest_angles: ArrayLike = 0.0,
    flip: ArrayLike = True,
    dimension: int = 3,
) -> float | Floats:
    """Mean extension of the finite discrete chain with free ends, exact, for the potentials that are simulated.

    `Z = int prod_i [s_i^(d-1) ds_i dt_i exp(-k (s_i - b0)^2/(2 kT) + F s_i t_i.z/kT)] prod_j exp(-E_j(beta_j)/kT)`,
    `E_j = 1/2 alpha_j (beta_j - beta0_j)^2` or `-alpha_j cos(beta_j)`; the extension is `kT d(ln Z)/dF`. Each stretch
    is integrated out in closed form, the directions by a transfer operator (for chains e.g. Livadaru, Netz and Kreuzer,
    Macromolecules 36, 3732 (2003)).

    Parameters
    ----------
    force : array_like
        F >= 0 in pN, scalar or array.
    segments : int
        Number N of bonds, at least 1.
    bond_length : float
        Length of rigid bonds, or rest length b0 of harmonic ones, in nm.
    bending : array_like
        alpha in pN nm, scalar or one per joint, (N-1,).
    kT : float
        Thermal energy in pN nm.
    stretching : float, optional
        Stiffness k of a bond in pN/nm; None for rigid bonds.
    bending_form : str
        "harmonic" or "cosine".
    rest_angles : array_like
        beta0 in [0, pi], scalar or one per joint, (N-1,); 0 for the cosine form. In three dimensions a bent joint turns
        freely about the bond before it (no torsion).
    flip : array_like of bool
        In two dimensions, whether a bent joint may bend either way, for all joints or one each, (N-1,): True takes the
        unsigned angle, a double well; False freezes the sign, `E_j = 1/2 alpha_j (phi_j - phi0_j)^2` with the difference
        wrapped into (-pi, pi] and its rest angle signed, in [-pi, pi]. The chain as a whole turns freely in every case.
    dimension : int
        2 or 3.

    Returns
    -------
    float or ndarray
        The mean end-to-end vector along the force in nm, shaped like `force`. The relative error is below 1e-8 for
        alpha/kT up to 1e4 and F b/kT from 1e-6 to 1e3.

    Raises
    ------
    ValueError
        If an argument is out of its range, or if the force straightens bent joints so stiff that the result would be lost
        to rounding: `alpha beta0^2/2` beyond about 16 kT in three dimensions, to underflow beyond about 650 kT in two.

    Examples
    --------
    >>> chain = dict(segments=80, bond_length=12.5, bending=17.0, kT=4.114)
    >>> extension_discrete([0.0, 0.1, 10.0], **chain).round(2)
    array([  0.  , 537.59, 973.48])
    """
    chain = DiscreteChain(segments, bond_length, bending, kT, stretching, bending_form, rest_angles, flip, dimension)
    values = check.non_negative("force", force)
    flat = values.ravel()
    result = np.empty_like(flat)
    order = np.argsort(flat)  # forces of a kind together: the strongest of a batch sets the number of nodes for all
    for start in range(0, len(flat), _BATCH):
        batch = order[start : start + _BATCH]
        result[batch] = _extension(flat[batch], chain)
    return scalar_or_array(result.reshape(values.shape))


def force_discrete(
    extension: ArrayLike,
    *,
    segments: int,
    bond_length: float,
    bending: ArrayLike,
    kT: float,
    stretching: float | None = None,
    bending_form: BendingForm = "harmonic",
    rest_angles: ArrayLike = 0.0,
    flip: ArrayLike = True,
    dimension: int = 3,
) -> float | Floats:
    """Force at which the discrete chain has this mean extension: the inverse of `extension_discrete`.

    The chain is described as there. Takes any extension >= 0 in nm, scalar or array, of a chain with harmonic bonds, and
    one below `segments * bond_length` of rigid bonds. Returns the force in pN, shaped like `extension`.

    Raises
    ------
    ValueError
        If the extension is out of the chain's reach, or as `extension_discrete`.

    Examples
    --------
    >>> chain = dict(segments=80, bond_length=12.5, bending=17.0, kT=4.114)
    >>> round(force_discrete(extension_discrete(1.0, **chain), **chain), 9)
    1.0
    """
    chain = DiscreteChain(segments, bond_length, bending, kT, stretching, bending_form, rest_angles, flip, dimension)
    values = check.non_negative("extension", extension)
    if not values.any():
        return scalar_or_array(np.zeros_like(values))
    if chain.stretching is None:
        check_below_contour(values, chain.contour_length)
    fraction = np.minimum(values / chain.contour_length, 0.9)
    guess = chain.kT / chain.bond_length * fraction / (1 - fraction)  # that of free joints, within a factor
    return scalar_or_array(invert(lambda f: _extension(f, chain), values, guess))
