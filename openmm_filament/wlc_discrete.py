"""The discrete chain at thermal equilibrium: the very potentials that are simulated, solved exactly.

Units: forces in pN, lengths in nm, energies and `kT` in pN nm, stretching stiffness in pN/nm, bending stiffness in
pN nm (per rad^2), angles in rad. `bending_over_kT` and cosines are pure numbers.

Conventions: a chain of `segments` bonds has `segments - 1` joints. The bending angle `beta` is unsigned, 0 when
straight, in [0, pi]; `phi` is its signed version in a plane. A bond of length s and direction t has the weight
`s^(d-1) ds dt` in `dimension` d (2 or 3). Ends are free: neither the first nor the last bond has a preferred direction.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, special
from scipy.optimize import elementwise

from openmm_filament import _checks as check

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike

__all__ = [
    "bending_from_cosine",
    "extension_discrete",
    "force_discrete",
    "mean_bond_length",
    "mean_cosine",
    "mean_squared_end_to_end_discrete",
    "rest_length",
]

Floats = NDArray[np.float64]
BendingForm = Literal["harmonic", "cosine"]

_CUT = 40.0  # kernels are cut where they fall below exp(-40), a few 1e-18 of their peak
_TAIL = 1e-10  # largest admitted last coefficients of a message, relative to its largest one (rounding: 1e-16 F b/kT)
_NOISE = 1e-15  # rounding of a message after a Legendre transform, relative to its largest value
_TOLERANCE = 1e-8  # what is promised of an extension
_TINY = 1e-300
_LARGEST = 8000  # nodes of a planar message: a matrix of half a gigabyte
_BATCH = 48  # forces that travel along the chain together
_MOST_HARMONICS = 2400  # of a spatial message: three matrices of 46 megabytes


# --- helpers shared with wlc.py -----------------------------------------------------------------------------------


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
def _gauss(order: int) -> tuple[Floats, Floats]:
    """Nodes and weights of the Gauss-Legendre rule on [-1, 1]; not to be written to."""
    nodes, weights = special.roots_legendre(order)
    return nodes, weights


# --- one bond -----------------------------------------------------------------------------------------------------


def _bond(
    tension: Floats, length: float | Floats, stretching: float | None, kT: float, dimension: int
) -> tuple[Floats, Floats]:
    """Log of the weight, and mean length, of a bond pulled along itself by `tension` (negative when pushed).

    The weight is `int_0^inf s^(d-1) exp(-k (s - b0)^2/(2 kT) + tension s/kT) ds` up to a constant factor: with
    `sigma^2 = kT/k` and `y = (b0 + tension/k)/sigma` a Gaussian moment `J_(d-1)(y)`, from `J_(n+1) = y J_n + n J_(n-1)`
    and the error function, times `exp(tension (b0 + tension/(2 k))/kT)`. Far on the pushed side (y < -20) the recursion
    cancels and the asymptotic series takes its place.
    """
    if stretching is None:
        return tension * length / kT, np.broadcast_to(np.asarray(length, dtype=np.float64), tension.shape)
    sigma = math.sqrt(kT / stretching)
    y = (length + tension / stretching) / sigma
    pushed = y < 0  # there the common factor exp(-y^2/2) is taken out
    gauss = np.exp(-(y**2) / 2)
    erfc = np.where(pushed, special.erfcx(np.maximum(-y, 0) / math.sqrt(2)), special.erfc(-y / math.sqrt(2)))
    moments = [math.sqrt(math.pi / 2) * erfc]
    moments.append(y * moments[0] + np.where(pushed, 1.0, gauss))
    for n in range(1, dimension):
        moments.append(y * moments[n] + n * moments[n - 1])
    far = y < -20
    if far.any():
        x = -y[far]
        for n in (dimension - 1, dimension):
            series = [(-0.5) ** k * math.factorial(n + 2 * k) / math.factorial(k) for k in range(9)]
            moments[n][far] = np.polynomial.polynomial.polyval(x**-2, series) / x ** (n + 1)
    log_weight = tension * (length + tension / (2 * stretching)) / kT - np.where(pushed, y**2 / 2, 0.0)
    return log_weight + np.log(moments[dimension - 1]), sigma * moments[dimension] / moments[dimension - 1]


def mean_bond_length(bond_length: ArrayLike, stretching: float, kT: float, *, dimension: int = 3) -> float | Floats:
    """Mean length of a free harmonic bond, `<s>` with the weight `s^(d-1) exp(-k (s - b0)^2/(2 kT))`, s > 0.

    To first order `b0 + (d-1) kT/(k b0)`; here to rounding (relative 1e-13), for any stiffness.

    Args:
        bond_length: rest length b0 in nm, scalar or array, not negative.
        stretching: stiffness k in pN/nm.
        kT: thermal energy in pN nm.
        dimension: 2 or 3.

    Returns:
        The mean length in nm, shaped like `bond_length`.

    Raises:
        ValueError: if an argument is out of its range.

    Examples:
        >>> round(mean_bond_length(10.0, 5.0, 4.114), 4)
        10.1632
    """
    length = check.non_negative("bond_length", bond_length)
    stretching, kT = positive_scalar("stretching", stretching), positive_scalar("kT", kT)
    check.one_of("dimension", dimension, (2, 3))
    return scalar_or_array(np.asarray(_bond(np.zeros(length.shape), length, stretching, kT, dimension)[1]))


def rest_length(mean_length: ArrayLike, stretching: float, kT: float, *, dimension: int = 3) -> float | Floats:
    """Rest length b0 whose bond has the mean length `mean_length`: the inverse of `mean_bond_length`.

    Args:
        mean_length: wanted mean length in nm, scalar or array; it must exceed that of a bond with b0 = 0.
        stretching: stiffness k in pN/nm.
        kT: thermal energy in pN nm.
        dimension: 2 or 3.

    Returns:
        b0 in nm, shaped like `mean_length`.

    Raises:
        ValueError: if the bond is so soft, or so short, that no b0 >= 0 gives this mean length.

    Examples:
        >>> round(rest_length(10.163241, 5.0, 4.114), 4)
        10.0
    """
    mean = check.positive("mean_length", mean_length)
    shortest = float(mean_bond_length(0.0, stretching, kT, dimension=dimension))
    if (mean < shortest).any():
        raise check.fail("mean_length", f"be at least {shortest:.6g} nm for this stiffness", f"{mean.min():.6g}")

    def difference(length: Floats, target: Floats) -> Floats:
        return _bond(np.zeros(length.shape), length, stretching, kT, dimension)[1] - target

    return scalar_or_array(root(difference, mean, 0.0, mean))


# --- one joint ----------------------------------------------------------------------------------------------------


def _joint_rule(stiffness: Floats, rest: Floats, form: str, dimension: int, order: int) -> tuple[Floats, Floats]:
    """Gauss-Legendre rule in beta for each joint: angles and normalised Boltzmann weights, both (joints, order).

    `stiffness` is alpha/kT. Where the Boltzmann factor is below exp(-40) there are no nodes.
    """
    with np.errstate(divide="ignore"):
        reach = np.sqrt(2 * _CUT / stiffness) if form == "harmonic" else np.arccos(np.maximum(1 - _CUT / stiffness, -1))
    low, high = np.maximum(rest - reach, 0), np.minimum(rest + reach, math.pi)
    nodes, weights = _gauss(order)
    beta = low[:, None] + (high - low)[:, None] * (nodes + 1) / 2
    shape = (beta - rest[:, None]) ** 2 / 2 if form == "harmonic" else 2 * np.sin(beta / 2) ** 2
    boltzmann = weights * np.exp(-stiffness[:, None] * shape) * np.sin(beta) ** (dimension - 2)
    return beta, boltzmann / boltzmann.sum(axis=1, keepdims=True)


def _one_minus_cosine(stiffness: Floats, rest: float, form: str, dimension: int) -> Floats:
    """`1 - <cos beta>` without cancellation, shaped like `stiffness`."""
    flat = stiffness.ravel()
    beta, weights = _joint_rule(flat, np.full(flat.shape, rest), form, dimension, 96)
    average: Floats = (weights * 2 * np.sin(beta / 2) ** 2).sum(axis=1)
    return average.reshape(stiffness.shape)


def _check_joint(form: str, dimension: int) -> None:
    check.one_of("bending_form", form, ("harmonic", "cosine"))
    check.one_of("dimension", dimension, (2, 3))


def mean_cosine(
    bending_over_kT: ArrayLike, *, bending_form: BendingForm = "harmonic", rest_angle: float = 0.0, dimension: int = 3
) -> float | Floats:
    """Mean cosine `<cos beta>` of a free joint, weight `sin(beta)^(d-2) exp(-E(beta)/kT)` over [0, pi].

    `E = 1/2 alpha (beta - beta0)^2` (harmonic) or `-alpha cos(beta)` (cosine; in three dimensions
    `<cos beta> = coth K - 1/K`, in two `I1(K)/I0(K)`). The persistence length of a chain of rigid links b follows as
    `-b/ln<cos beta>` (the decay length of the tangent correlation).

    Args:
        bending_over_kT: K = alpha/kT, scalar or array, not negative.
        bending_form: "harmonic" or "cosine".
        rest_angle: beta0 in [0, pi]; must be 0 for the cosine form.
        dimension: 2 or 3.

    Returns:
        The mean cosine, shaped like `bending_over_kT`, with an absolute error of about 1e-15.

    Raises:
        ValueError: if an argument is out of its range.

    Examples:
        >>> [round(-1 / math.log(mean_cosine(10.0, bending_form=form)), 5) for form in ("harmonic", "cosine")]
        [10.17174, 9.49122]
    """
    _check_joint(bending_form, dimension)
    stiffness = check.non_negative("bending_over_kT", bending_over_kT)
    rest = float(check.within("rest_angle", rest_angle, 0, math.pi))
    if bending_form == "cosine" and rest != 0:
        raise check.fail("rest_angle", "be 0 for the cosine form", rest)
    return scalar_or_array(1 - _one_minus_cosine(stiffness, rest, bending_form, dimension))


def bending_from_cosine(
    mean_cosine: ArrayLike, *, bending_form: BendingForm = "harmonic", dimension: int = 3
) -> float | Floats:
    """K = alpha/kT of the straight joint with this mean cosine: the inverse of `mean_cosine`.

    Args:
        mean_cosine: `<cos beta>`, scalar or array, in (0, 1).
        bending_form: "harmonic" or "cosine".
        dimension: 2 or 3.

    Returns:
        K, shaped like `mean_cosine`; its relative error is that of `1 - mean_cosine` as a float (1e-10 at 1 - 1e-6).

    Raises:
        ValueError: if an argument is out of its range.

    Examples:
        >>> round(bending_from_cosine(mean_cosine(12.5)), 9)
        12.5
    """
    _check_joint(bending_form, dimension)
    cosine = check.within("mean_cosine", mean_cosine, 0, 1, open_ends=True)

    def difference(stiffness: Floats, target: Floats) -> Floats:
        return (1 - target) - _one_minus_cosine(stiffness, 0.0, bending_form, dimension)

    return scalar_or_array(root(difference, cosine, cosine / 2, 4 / (1 - cosine)))


def mean_squared_end_to_end_discrete(segments: int, bond_length: float, mean_cosine: float) -> float:
    """`<R^2>` of the freely rotating chain: `N b^2 [(1 + c)/(1 - c) - 2 c (1 - c^N)/(N (1 - c)^2)]`, c = `<cos beta>`.

    Flory, *Statistical Mechanics of Chain Molecules* (1969), chapter 1. Summed term by term, so it holds its relative
    accuracy (1e-13) up to c = 1, a rod.

    Args:
        segments: number N of rigid bonds, at least 1.
        bond_length: b in nm.
        mean_cosine: c in [-1, 1].

    Returns:
        `<R^2>` in nm^2.

    Raises:
        ValueError: if an argument is out of its range.

    Examples:
        >>> mean_squared_end_to_end_discrete(10, 2.0, 0.0), mean_squared_end_to_end_discrete(10, 2.0, 1.0)
        (40.0, 400.0)
    """
    segments = check.integer("segments", segments, low=1)
    length, cosine = positive_scalar("bond_length", bond_length), float(check.within("mean_cosine", mean_cosine, -1, 1))
    apart = np.arange(1, segments)
    return length**2 * (segments + 2 * float(np.sum((segments - apart) * cosine**apart)))


# --- the chain: transfer operators --------------------------------------------------------------------------------


@functools.lru_cache(maxsize=4)
def _legendre_basis(size: int) -> tuple[Floats, Floats, Floats]:
    """Nodes and weights in cos(theta), and the orthonormal Legendre polynomials on them, (nodes, modes)."""
    nodes, weights = _gauss(size)
    values = np.empty((size, size))
    values[:, 0], values[:, 1] = 1.0, nodes
    for n in range(1, size - 1):
        values[:, n + 1] = ((2 * n + 1) * nodes * values[:, n] - n * values[:, n - 1]) / (n + 1)
    return nodes, weights, values * np.sqrt(np.arange(size) + 0.5)


def _legendre_coefficients(stiffness: Floats, rest: Floats, form: str, size: int) -> Floats:
    """`<P_l(cos beta)>` of each joint, (joints, size): what the bending kernel does to the harmonics of a message."""
    span = math.pi if stiffness.min() <= 0 else min(math.pi, 3 * math.sqrt(2 * _CUT / stiffness.min()))
    beta, weights = _joint_rule(stiffness, rest, form, 3, 64 + int(0.7 * size * span))
    x, previous, current = np.cos(beta), np.ones_like(beta), np.cos(beta)
    result = np.empty((len(stiffness), size))
    result[:, 0] = 1.0
    for n in range(1, size):
        result[:, n] = np.einsum("jm,jm->j", weights, current)
        previous, current = current, ((2 * n + 1) * x * current - n * previous) / (n + 1)
    return result


_STEP_WIDTH = 0.17  # of the rounded edge of the low-pass filter, in units of 1/(grid spacing); the filter passes 0.6 pi
_STEP_REACH = 46.0  # grid spacings after which the filtered step is flat to 1e-14


def _filtered_step(x: Floats) -> Floats:
    """Unit step after a low-pass filter, x in grid spacings.

    On a uniform grid the sum of `step(x) g(x)` is spectrally accurate for a smooth g, although the step is sharp: the
    filter leaves every frequency of g (below 0.6 pi) alone and removes those that would alias onto them.
    """
    result = np.where(x > 0, 1.0, 0.0)
    near = np.abs(x) < _STEP_REACH
    nodes, weights = _gauss(160)
    q = (nodes + 1) / 2 * (math.pi + 9 * _STEP_WIDTH)
    passed = special.erfc((q - math.pi) / (math.sqrt(2) * _STEP_WIDTH)) / 2 * weights * (math.pi + 9 * _STEP_WIDTH) / 2
    result[near] = 0.5 + np.sin(np.multiply.outer(x[near], q)) @ (passed / q) / math.pi
    return result


@functools.lru_cache(maxsize=16)
def _window(size: int, low: float, high: float) -> Floats:
    """The filtered indicator of low < phi < high at the angles `2 pi m/size`, m from -2 size to 3 size."""
    spacing = 2 * math.pi / size
    m = np.arange(-2.0 * size, 3.0 * size)
    window: Floats = _filtered_step(m - low / spacing) - _filtered_step(m - high / spacing)
    return window


def _planar_kernel(stiffness: float, rest: float, form: str, flip: bool, size: int) -> Floats:
    """The bending weight at the signed angles `phi_m = 2 pi m/size`, m < size.

    The harmonic form has a kink opposite its minimum and, where it is even in phi, at phi = 0; see `_filtered_step`.
    """
    phi = 2 * math.pi / size * np.arange(-2 * size, 3 * size)
    if form == "cosine":
        return np.exp(-2 * stiffness * np.sin(phi[2 * size : 3 * size] / 2) ** 2)
    pieces = [(rest - math.pi, rest + math.pi, rest)]
    if flip and rest != 0:
        pieces = [(0.0, math.pi, rest), (-math.pi, 0.0, -rest)]
    elif stiffness * math.pi**2 / 2 > _CUT:  # the kink is too small to matter
        pieces = [(-math.inf, math.inf, rest)]
    images = np.zeros(phi.shape)
    for low, high, centre in pieces:
        window = 1.0 if math.isinf(low) else _window(size, low, high)
        images += window * np.exp(-stiffness * (phi - centre) ** 2 / 2)
    kernel: Floats = images.reshape(5, size).sum(axis=0)
    return kernel


class _Planar:
    """Messages at uniform angles.

    The kernel is summed as it stands, all terms positive, so that no digit is lost even where a strong force picks out
    the far tail of a stiff bent joint.
    """

    def __init__(self, joints: Floats, form: str, flip: bool, curvature: float, refine: float) -> None:
        self.joints, self.form, self.flip = joints, form, flip
        stiffest = joints[:, 0].max(initial=0.0)
        kinked = form == "harmonic" and (
            (flip and bool(joints[:, 1].any())) or joints[:, 0].min(initial=np.inf) * math.pi**2 / 2 < _CUT
        )
        # An integrand exp(-c theta^2/2) has frequencies up to 7.7 sqrt(c), which the sampling rate must exceed; beside
        # a kink they must stay below 0.3 of it.
        band = 7.7 * math.sqrt(2 * stiffest + (2 if kinked else 1) * curvature)
        size = 4 * math.ceil(refine * (band / 0.3 if kinked else band + 16) / 4)
        self.size = max(size, 128)
        self.even = flip or not joints[:, 1].any()  # its mirror image weighs the same: half the circle
        self.nodes = 2 * math.pi * (np.arange(self.size // 2 if self.even else self.size) + 0.5) / self.size
        self.cosines, self.weights = np.cos(self.nodes), np.full(self.nodes.shape, 2 * math.pi / self.size)
        if len(self.nodes) > _LARGEST:
            raise check.fail("force", f"be weaker: this chain would need {len(self.nodes)} angles, at most", _LARGEST)
        self.built = -1

    def __call__(self, joint: int, messages: Floats) -> Floats:
        if self.built < 0 or (self.joints[joint] != self.joints[self.built]).any():
            stiffness, rest = self.joints[joint].tolist()
            kernel = _planar_kernel(stiffness, rest, self.form, self.flip, self.size)
            kernel /= kernel.sum()
            size = len(self.nodes)
            self.matrix = linalg.toeplitz(kernel[:size], np.roll(kernel[::-1], 1)[:size])  # kernel[i - j]
            if self.even:
                self.matrix += linalg.hankel(kernel[1 : size + 1], kernel[size : 2 * size])  # kernel[i + j + 1]
        self.built = joint
        result: Floats = self.matrix @ messages
        return result


class _Spatial:
    """Messages at Gauss-Legendre nodes in cos(theta); the bending kernel acts on their Legendre coefficients."""

    def __init__(self, joints: Floats, form: str, curvature: float, refine: float) -> None:
        stiffest = joints[:, 0].max(initial=0.0)
        # exp(-g theta^2/2) has harmonics up to 8.3 sqrt(g); g of a message in a straight chain from
        # 1/g' = 1/(g + curvature) + 1/stiffness, or the bound g' = stiffness where joints are bent.
        g = stiffest if joints[:, 1].any() else curvature * (math.sqrt(0.25 + stiffest / max(curvature, 1e-12)) - 0.5)
        self.size = 16 * math.ceil(refine * (24 + 8.3 * math.sqrt(min(g, stiffest) + curvature)) / 16)
        if self.size > _MOST_HARMONICS:
            raise check.fail(
                "force", f"be weaker: this chain would need {self.size} harmonics, at most", _MOST_HARMONICS
            )
        self.cosines, self.weights, self.polynomials = _legendre_basis(self.size)
        self.projection = np.ascontiguousarray((self.polynomials * self.weights[:, None]).T)
        distinct, self.which = np.unique(joints, axis=0, return_inverse=True)
        self.which = self.which.reshape(-1)
        self.coefficients = np.empty((0, 0))
        if len(joints):
            self.coefficients = _legendre_coefficients(distinct[:, 0], distinct[:, 1], form, self.size)
        kept = np.abs(self.coefficients).max(axis=0, initial=0.0) > 1e-18
        self.kept = int(np.flatnonzero(kept).max(initial=0)) + 1
        self.tail = 0.0

    def __call__(self, joint: int, messages: Floats) -> Floats:
        coefficients = self.projection @ messages
        self.tail = max(self.tail, float((np.abs(coefficients[-4:]) / np.abs(coefficients).max(axis=0)).max()))
        damped = self.coefficients[self.which[joint], : self.kept, None] * coefficients[: self.kept]
        result: Floats = self.polynomials[:, : self.kept] @ damped
        return result


def _propagate(
    operator: _Planar | _Spatial, segments: int, log_weight: Floats, pull: Floats, kT: float
) -> tuple[Floats, float]:
    """Extensions `kT d(ln Z)/dF`, one per force, and the largest log factor by which a bond amplified a small message.

    `log_weight` and `pull` = d(log_weight)/dF are (nodes, forces). The message of the bonds so far and its logarithmic
    derivative with respect to the force travel together along the chain.
    """
    forces = log_weight.shape[1]
    top = log_weight.max(axis=0)
    log_message, slope = np.zeros_like(log_weight), np.zeros_like(log_weight)
    amplified = 0.0
    for bond in range(segments):
        log_joint = log_weight + log_message
        peak = log_joint.max(axis=0)
        amplified = max(amplified, float((top + log_message.max(axis=0) - peak).max()))
        joint = np.exp(log_joint - peak)
        derivative = joint * (pull + slope)
        if bond < segments - 1:
            messages = operator(bond, np.hstack([joint, derivative]))
            message = np.maximum(messages[:, :forces], _TINY)
            log_message, slope = np.log(message), np.where(message > _TINY, messages[:, forces:] / message, 0.0)
    weights: Floats = operator.weights
    return kT * (weights @ derivative) / (weights @ joint), amplified


@dataclasses.dataclass(frozen=True)
class _Chain:
    """The checked arguments of `extension_discrete`; `joints` is (segments - 1, 2): alpha/kT and rest angle."""

    segments: int
    bond_length: float
    joints: Floats
    kT: float
    stretching: float | None
    form: str
    flip: bool
    dimension: int


def _extension(force: Floats, chain: _Chain, refine: float = 1.0) -> Floats:
    """`extension_discrete` for checked arguments; `refine` multiplies the number of nodes (the tests double it)."""
    kT, joints = chain.kT, chain.joints
    bond = (chain.bond_length, chain.stretching, kT, chain.dimension)
    flat = force.ravel()
    strongest = np.array([flat.max()])
    longest = float(_bond(strongest, *bond)[1][0])
    curvature = float(strongest[0]) * longest / kT  # of log_weight in the angle, from above
    if chain.stretching is not None:
        curvature += float(strongest[0]) ** 2 / (chain.stretching * kT)
    for _ in range(12):
        operator: _Planar | _Spatial
        if chain.dimension == 2:
            operator = _Planar(joints, chain.form, chain.flip, curvature, refine)
        else:
            operator = _Spatial(joints, chain.form, curvature, refine)
        tension = operator.cosines[:, None] * flat
        log_weight, length = _bond(tension, *bond)
        pull = operator.cosines[:, None] * length / kT
        extension, amplified = _propagate(operator, chain.segments, log_weight, pull, kT)
        if isinstance(operator, _Planar):
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


def _check_chain(
    *,
    segments: int,
    bond_length: float,
    bending: ArrayLike,
    kT: float,
    stretching: float | None,
    bending_form: BendingForm,
    rest_angles: ArrayLike,
    flip: bool,
    dimension: int,
) -> _Chain:
    _check_joint(bending_form, dimension)
    segments, kT = check.integer("segments", segments, low=1), positive_scalar("kT", kT)
    joints = np.empty((segments - 1, 2))
    low = 0.0 if flip else -math.pi
    columns = (
        ("bending", check.non_negative("bending", bending) / kT),
        ("rest_angles", check.within("rest_angles", rest_angles, low, math.pi, unit="rad")),
    )
    for column, (name, values) in enumerate(columns):
        joints[:, column] = values if values.ndim == 0 else check.shape(name, values, (segments - 1,))
    if bending_form == "cosine" and columns[1][1].any():
        raise check.fail("rest_angles", "be 0 for the cosine form", rest_angles)
    if dimension == 3 and not flip:
        raise check.fail("flip", "be True in three dimensions, where an angle has no sign", flip)
    length = positive_scalar("bond_length", bond_length)
    stretching = None if stretching is None else positive_scalar("stretching", stretching)
    return _Chain(segments, length, joints, kT, stretching, bending_form, flip, dimension)


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
    flip: bool = True,
    dimension: int = 3,
) -> float | Floats:
    """Mean extension of the finite discrete chain with free ends, exact, for the potentials that are simulated.

    `Z = int prod_i [s_i^(d-1) ds_i dt_i exp(-k (s_i - b0)^2/(2 kT) + F s_i t_i.z/kT)] prod_j exp(-E_j(beta_j)/kT)`,
    `E_j = 1/2 alpha_j (beta_j - beta0_j)^2` or `-alpha_j cos(beta_j)`; the extension is `kT d(ln Z)/dF`. Each stretch
    is integrated out in closed form, the directions by a transfer operator (for chains e.g. Livadaru, Netz and Kreuzer,
    Macromolecules 36, 3732 (2003)).

    Args:
        force: F >= 0 in pN, scalar or array.
        segments: number N of bonds, at least 1.
        bond_length: length of rigid bonds, or rest length b0 of harmonic ones, in nm.
        bending: alpha in pN nm, scalar or one per joint, (N-1,).
        kT: thermal energy in pN nm.
        stretching: stiffness k of a bond in pN/nm; None for rigid bonds.
        bending_form: "harmonic" or "cosine".
        rest_angles: beta0 in [0, pi], scalar or one per joint, (N-1,); 0 for the cosine form. In three dimensions a
            bent joint turns freely about the bond before it (no torsion).
        flip: in two dimensions, whether a bent joint may bend either way: True takes the unsigned angle, a double well;
            False freezes each sign, `E_j = 1/2 alpha_j (phi_j - phi0_j)^2` with the difference wrapped into (-pi, pi]
            and `rest_angles` signed, in [-pi, pi]. The chain as a whole turns freely in both cases.
        dimension: 2 or 3.

    Returns:
        The mean end-to-end vector along the force in nm, shaped like `force`. The relative error is below 1e-8 for
        alpha/kT up to 1e4 and F b/kT from 1e-6 to 1e3.

    Raises:
        ValueError: if an argument is out of its range, or (in three dimensions, bent joints) if the force straightens
            joints so stiff that the result would be lost to rounding: `alpha beta0^2/2` beyond about 16 kT.

    Examples:
        >>> chain = dict(segments=80, bond_length=12.5, bending=17.0, kT=4.114)
        >>> extension_discrete([0.0, 0.1, 10.0], **chain).round(2)
        array([  0.  , 537.59, 973.48])
    """
    chain = _check_chain(
        segments=segments,
        bond_length=bond_length,
        bending=bending,
        kT=kT,
        stretching=stretching,
        bending_form=bending_form,
        rest_angles=rest_angles,
        flip=flip,
        dimension=dimension,
    )
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
    flip: bool = True,
    dimension: int = 3,
) -> float | Floats:
    """Force at which the discrete chain has this mean extension: the inverse of `extension_discrete`.

    Args:
        extension: in nm, scalar or array, not negative; below `segments * bond_length` for rigid bonds.
        segments: see `extension_discrete`, like all the others.
        bond_length: in nm.
        bending: in pN nm.
        kT: in pN nm.
        stretching: in pN/nm, or None.
        bending_form: "harmonic" or "cosine".
        rest_angles: in rad.
        flip: see `extension_discrete`.
        dimension: 2 or 3.

    Returns:
        The force in pN, shaped like `extension`.

    Raises:
        ValueError: if the extension is out of the chain's reach, or as `extension_discrete`.

    Examples:
        >>> chain = dict(segments=80, bond_length=12.5, bending=17.0, kT=4.114)
        >>> round(force_discrete(extension_discrete(1.0, **chain), **chain), 9)
        1.0
    """
    chain = _check_chain(
        segments=segments,
        bond_length=bond_length,
        bending=bending,
        kT=kT,
        stretching=stretching,
        bending_form=bending_form,
        rest_angles=rest_angles,
        flip=flip,
        dimension=dimension,
    )
    values = check.non_negative("extension", extension)
    contour = chain.segments * chain.bond_length
    if stretching is None and (values >= contour).any():
        raise check.fail("extension", f"lie below the contour length {contour:.6g} nm", f"{values.max():.6g}")
    fraction = np.minimum(values / contour, 0.999)
    guess = chain.kT / chain.bond_length * fraction / (1 - fraction)  # that of free joints, within a factor
    return scalar_or_array(invert(lambda f: _extension(f, chain), values, guess))
