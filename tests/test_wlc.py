"""Theory of the worm-like chain: every number by two routes that share no code."""

from __future__ import annotations

import doctest
import itertools
import math
import subprocess
import sys

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy import integrate, linalg, special

from openmm_filament import wlc
from openmm_filament.wlc import bonds, continuous, discrete, flexible, interpolations, joints, limits, moments
from openmm_filament.wlc.chain import DiscreteChain

KT = 4.114  # pN nm, 298 K
TABLE = 1e-9  # the tabulated fractions have ten decimals
TABLE_SHORT = 1.1e-5  # five decimals, in the last of which the value may be rounded
SERIES = 1e-11  # power series at 34 digits against double precision: measured 1e-14, in 1 - z/L 1e-12
DIRECT = 2e-9  # product quadrature against the transfer operator: measured 5e-10 or better
PROPAGATOR = 1e-10  # matrix exponential by scaling and squaring: measured 1e-12
DOUBLING = 1e-10  # twice the nodes: measured below 1e-11
RESPONSE = 1e-7  # z = F <R^2>/(d kT) at x = F b/kT = 1e-5; the next order is (F R/kT)^2, below 1e-8
CONTINUUM = 1e-5  # what a twofold Richardson extrapolation in 1/N leaves at N = 400: measured 4e-6
ROUND_TRIP = 1e-8  # the promise of the module; near full extension times the rounding amplification 1/(1 - z)
SIGMAS = 4.0  # seeded Monte Carlo
EPS = float(np.finfo(float).eps)

DNA = (53.0, 1000.0, KT)
FORCES = np.geomspace(0.05, 50, 12)
REDUCED = np.array([0.01, 0.1, 0.3, 1, 3, 10, 100, 1000])
FRACTIONS = [0.0066663408, 0.0663433692, 0.1917955995, 0.4811931582]
FRACTIONS += [0.7083739028, 0.8415581501, 0.9499915480, 0.9841883586]
PULLS = [0.05, 0.2, 1, 5, 10, 50]  # pN
FINITE = [0.34886, 0.67555, 0.85851, 0.93728, 0.95574, 0.98026]

PAIRS = {  # name: (extension, inverse, extra arguments, in two dimensions as well)
    "marko_siggia": (wlc.extension_marko_siggia, wlc.force_marko_siggia, {}, False),
    "bouchiat": (wlc.extension_bouchiat, wlc.force_bouchiat, {}, False),
    "high_force": (wlc.extension_high_force, wlc.force_high_force, {}, True),
    "hookean": (wlc.extension_hookean, wlc.force_hookean, {}, True),
    "odijk": (wlc.extension_odijk, wlc.force_odijk, {"stretch_modulus": 1000.0}, True),
    "fjc": (wlc.extension_fjc, wlc.force_fjc, {}, True),
    "gaussian": (wlc.extension_gaussian, wlc.force_gaussian, {}, True),
    "exact": (wlc.extension_exact, wlc.force_exact, {}, True),
    "exact_extensible_finite": (
        wlc.extension_exact, wlc.force_exact, {"stretch_modulus": 1000.0, "finite": True}, True,
    ),
}  # fmt: skip
BOUNDED = {"marko_siggia", "bouchiat", "high_force", "fjc", "exact"}  # models that do not reach the contour length
MODELS = [
    pytest.param(name, {**extra, **({"dimension": d} if planar else {})}, id=f"{name}-{d}d")
    for name, (_, _, extra, planar) in PAIRS.items()
    for d in ((2, 3) if planar else (3,))
]


# --- the continuous chain -----------------------------------------------------------------------------------------


def series_energy(f, softness):
    """Ground state of H in three dimensions from power series about both poles, matched at the equator."""
    g = softness * f**2 / 2

    def at_equator(sign, energy):
        a = [mpmath.mpf(0), mpmath.mpf(0), mpmath.mpf(1)]  # a_(-2), a_(-1), a_0
        for n in range(130):
            own = mpmath.mpf(n * (n + 1)) / 2 - (sign * f + g + energy)
            a.append((own * a[-1] + (sign * f + 2 * g) * a[-2] - g * a[-3]) / (n + 1) ** 2)
        return mpmath.fsum(a), mpmath.fsum(n * c for n, c in enumerate(a[2:]))

    def mismatch(energy):
        (north, north_slope), (south, south_slope) = at_equator(1, energy), at_equator(-1, energy)
        return north_slope * south + south_slope * north

    guess = -(f**2) / 3 if f < 1.5 else -f - g + mpmath.sqrt(f + 2 * g) - 0.3
    return mpmath.findroot(mismatch, (guess, guess * 1.01))


@pytest.mark.parametrize(
    ("f", "softness"), [(0.01, 0), (0.3, 0), (1, 0), (10, 0), (100, 0), (1, 0.1), (10, 0.02), (60, 1e-3)]
)
def test_ground_state_matches_power_series(f, softness):
    with mpmath.workdps(34):
        h = mpmath.mpf(10) ** -8 * f
        z = float((series_energy(f - h, softness) - series_energy(f + h, softness)) / (2 * h))
    modulus = 1 / softness if softness else None
    assert_allclose(wlc.extension_exact(float(f), 1.0, 1.0, 1.0, stretch_modulus=modulus), z, rtol=SERIES)


def test_reference_fractions():
    assert_allclose(wlc.extension_exact(REDUCED, 1.0, 1.0, 1.0), FRACTIONS, atol=TABLE, rtol=0)
    assert_allclose(wlc.extension_exact(PULLS, *DNA, finite=True) / 1000, FINITE, atol=TABLE_SHORT, rtol=0)


def test_perturbed_persistence_length_fails_the_reference():
    """The comparison above can fail."""
    with pytest.raises(AssertionError):
        assert_allclose(wlc.extension_exact(REDUCED, 1.01, 1.0, 1.0), FRACTIONS, atol=TABLE, rtol=0)
    perturbed = wlc.extension_exact(PULLS, 53 * 1.01, 1000.0, KT, finite=True) / 1000
    with pytest.raises(AssertionError):
        assert_allclose(perturbed, FINITE, atol=TABLE_SHORT, rtol=0)


@pytest.mark.parametrize("f", [0.01, 0.5, 3.0, 30.0])
def test_planar_ground_state_is_a_mathieu_function(f):
    """In two dimensions `-1/2 psi'' - f cos(theta) psi` is Mathieu's equation with q = 4 f, theta = 2 v + pi."""
    degrees = np.arange(720) / 4
    psi = special.mathieu_cem(0, 4 * f, degrees)[0]
    z = -np.sum(np.cos(2 * np.radians(degrees)) * psi**2) / np.sum(psi**2)
    assert_allclose(wlc.extension_exact(f, 1.0, 1.0, 1.0, dimension=2), z, rtol=1e-9)  # scipy's Mathieu functions


@pytest.mark.parametrize(("dimension", "softness", "length"), [*itertools.product((2, 3), (0.0, 0.01), (0.3, 19.0))])
@pytest.mark.parametrize("f", [0.02, 2.0, 40.0])
def test_finite_chain_matches_propagator(f, dimension, softness, length):
    """Matrix elements by quadrature, the derivative of the propagator by scaling and squaring."""
    size, levels = 120, np.arange(60)
    if dimension == 3:
        cosines, weights = special.roots_legendre(size)
        basis = np.array([special.eval_legendre(n, cosines) * math.sqrt(n + 0.5) for n in levels])
        kinetic = np.diag(levels * (levels + 1) / 2)
    else:
        angles = 2 * math.pi * np.arange(2 * size) / (2 * size)
        cosines, weights = np.cos(angles), np.full(2 * size, math.pi / size)
        basis = np.cos(np.multiply.outer(levels, angles)) / np.sqrt(math.pi * np.where(levels, 1, 2))[:, None]
        kinetic = np.diag(levels**2 / 2)
    depth = f * (cosines - 1) + softness * f**2 / 2 * (cosines**2 - 1)  # the constant keeps the exponential in range
    potential = (basis * weights * depth) @ basis.T
    slope = (basis * weights * (cosines + softness * f * cosines**2)) @ basis.T
    weight, derivative = linalg.expm_frechet(-length * (kinetic - potential), length * slope)
    modulus = 1 / softness if softness else None
    z = wlc.extension_exact(f, 1.0, length, 1.0, stretch_modulus=modulus, finite=True, dimension=dimension)
    assert_allclose(z, derivative[0, 0] / weight[0, 0], rtol=PROPAGATOR)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("contour", [1e-3, 0.5, 2.0, 19.0, 500.0])
def test_linear_response_of_the_finite_chain(dimension, contour):
    force = 1e-4 / contour
    squared = wlc.mean_squared_end_to_end(1.0, contour, dimension=dimension)
    z = wlc.extension_exact(force, 1.0, contour, 1.0, finite=True, dimension=dimension)
    assert_allclose(z, force * squared / dimension, rtol=RESPONSE)
    decay = dimension - 1
    double, _ = integrate.quad(
        lambda s: 2 * (contour - s) * math.exp(-s * decay / 2), 0, contour, epsabs=0, epsrel=1e-12
    )
    assert_allclose(squared, double, rtol=1e-11)


@pytest.mark.parametrize("dimension", [2, 3])
def test_limits_of_the_infinite_chain(dimension):
    arguments = (1.0, 1.0, 1.0)
    weak, strong = np.array([1e-6, 1e-4]), np.array([1e3, 1e4, 1e5])
    low = wlc.extension_exact(weak, *arguments, dimension=dimension)
    assert_allclose(low, wlc.extension_hookean(weak, *arguments, dimension=dimension), rtol=1e-6)  # next order 4 f^2
    shortfall = 1 - wlc.extension_exact(strong, *arguments, dimension=dimension)
    assert_allclose(shortfall, (dimension - 1) / (4 * np.sqrt(strong)), rtol=1e-4)  # next order 1/(64 f)
    stretched = wlc.extension_exact(strong, *arguments, dimension=dimension, stretch_modulus=1e9)
    assert_allclose(stretched - (1 - shortfall), strong / 1e9, rtol=0.2)
    assert wlc.extension_exact(0.0, *arguments, finite=True, dimension=dimension) == 0
    long = wlc.extension_exact(1.0, 1.0, 1e7, 1.0, finite=True, dimension=dimension) / 1e7
    assert_allclose(long, wlc.extension_exact(1.0, *arguments, dimension=dimension), rtol=1e-6)  # ends: l_p/L


@pytest.mark.parametrize("dimension", [2, 3])
def test_discrete_chain_converges_to_the_continuum(dimension):
    lp, contour, forces = 1.0, 5.0, np.array([0.05, 1.0, 8.0])
    z = []
    for segments in (100, 200, 400):
        b = contour / segments
        chain = {"segments": segments, "bond_length": b, "bending": lp / b, "kT": 1.0, "bending_form": "cosine"}
        z.append(wlc.extension_discrete(forces, **chain, dimension=dimension))
    once = [2 * fine - coarse for coarse, fine in itertools.pairwise(z)]
    exact = wlc.extension_exact(forces, lp, contour, 1.0, finite=True, dimension=dimension)
    assert_allclose((4 * once[1] - once[0]) / 3, exact, rtol=CONTINUUM)
    assert np.all(np.abs(z[2] - exact) < 0.6 * np.abs(z[1] - exact))


# --- formulas -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "extra"), MODELS)
@settings(max_examples=8, deadline=None)
@given(exponent=st.floats(-3, 3.5))
def test_inverse_round_trip(name, extra, exponent):
    extension, inverse, _, _ = PAIRS[name]
    force = 10.0**exponent
    z = extension(force, *DNA, **extra)
    if z == 0:  # the large-force formulas at small force
        assert name in {"high_force", "odijk"}
        return
    amplification = 4 * EPS / max(1 - z / DNA[1], EPS) if name in BOUNDED else 0
    assert_allclose(inverse(z, *DNA, **extra), force, rtol=ROUND_TRIP + amplification)


@pytest.mark.parametrize(("name", "extra"), MODELS)
def test_scalar_array_and_refusals(name, extra):
    extension, inverse, _, _ = PAIRS[name]
    forces = np.array([[0.5, 1.0, 7.0], [2.0, 30.0, 4.0]])
    forces.setflags(write=False)
    z = extension(forces, *DNA, **extra)
    assert z.shape == forces.shape
    single = extension(7.0, *DNA, **extra)
    assert isinstance(single, float)
    assert single == z[0, 2]
    assert isinstance(inverse(single, *DNA, **extra), float)
    assert inverse(z, *DNA, **extra).shape == forces.shape
    assert extension(0.0, *DNA, **extra) == 0
    assert extension(np.array([]), *DNA, **extra).shape == (0,)
    with pytest.raises(ValueError, match="`force` must not be negative, but is -1"):
        extension(-1.0, *DNA, **extra)
    with pytest.raises(ValueError, match="`kT` must be positive"):
        extension(1.0, 53.0, 1000.0, 0.0, **extra)
    with pytest.raises(ValueError, match="`extension`"):
        inverse(-1.0, *DNA, **extra)
    if name in {"high_force", "odijk"}:
        with pytest.raises(ValueError, match="`extension` must be positive"):
            inverse(0.0, *DNA, **extra)
    else:
        assert inverse(0.0, *DNA, **extra) == 0
    if name in BOUNDED:
        with pytest.raises(ValueError, match="`extension` must lie below the contour length 1000 nm, but is 1001"):
            inverse(1001.0, *DNA, **extra)
    else:
        assert inverse(1001.0, *DNA, **extra) > 0
    if "dimension" in extra:
        with pytest.raises(ValueError, match="`dimension` must be one of 2, 3"):
            extension(1.0, *DNA, **{**extra, "dimension": 4})


def test_interpolations_against_their_printed_form():
    z = np.linspace(0, 0.99, 34)
    unit = KT / 53
    marko_siggia = unit * (0.25 / (1 - z) ** 2 - 0.25 + z)
    assert_allclose(wlc.force_marko_siggia(1000 * z, *DNA), marko_siggia, rtol=1e-12)
    a = [-0.5164228, -2.737418, 16.07497, -38.87607, 39.49944, -14.17718]
    bouchiat = marko_siggia + unit * sum(c * z ** (i + 2) for i, c in enumerate(a))
    assert_allclose(wlc.force_bouchiat(1000 * z, *DNA), bouchiat, rtol=1e-12)


def test_errors_of_the_interpolations():
    """What the docstrings state."""
    f = np.geomspace(1e-3, 1e3, 150)
    z = wlc.extension_exact(f, 1.0, 1.0, 1.0)
    marko_siggia = wlc.force_marko_siggia(z, 1.0, 1.0, 1.0) / f - 1
    assert marko_siggia.max() == pytest.approx(0.1664, abs=5e-4)
    assert f[marko_siggia.argmax()] == pytest.approx(1.44, rel=0.1)
    bouchiat = np.abs(wlc.force_bouchiat(z, 1.0, 1.0, 1.0) / f - 1)
    assert bouchiat.max() == pytest.approx(0.0034, abs=5e-5)
    assert f[bouchiat.argmax()] == pytest.approx(0.08, rel=0.15)
    assert (wlc.extension_marko_siggia(f, 1.0, 1.0, 1.0) / z - 1).min() == pytest.approx(-0.0853, abs=2e-4)
    assert np.abs(wlc.extension_bouchiat(f, 1.0, 1.0, 1.0) / z - 1).max() == pytest.approx(0.0034, abs=5e-5)
    exact = wlc.extension_exact([0.4, 5.0, 50.0], *DNA, stretch_modulus=1000.0)
    assert_allclose(
        wlc.extension_odijk([0.4, 5.0, 50.0], *DNA, 1000.0) / exact - 1, [0.00148, 0.00049, 0.00139], atol=1e-5
    )


@pytest.mark.parametrize("dimension", [2, 3])
def test_freely_jointed_chain_against_mpmath(dimension):
    kuhn = {2: 4, 3: 2}[dimension]
    for x in [1e-12, 1e-5, 0.1, 1.0, 30.0, 1e4, 1e7, 1e10]:
        with mpmath.workdps(40):
            y = mpmath.mpf(x)
            value = mpmath.coth(y) - 1 / y if dimension == 3 else 1 - 1 / (2 * y) - 1 / (8 * y**2)
            if dimension == 2 and x < 1e5:
                value = mpmath.besseli(1, y) / mpmath.besseli(0, y)
        assert_allclose(wlc.extension_fjc(x / kuhn, 1.0, 1.0, 1.0, dimension=dimension), float(value), rtol=1e-13)
    weak = 1e-6
    assert_allclose(
        wlc.extension_fjc(weak, 1.0, 1.0, 1.0, dimension=dimension),
        wlc.extension_gaussian(weak, 1.0, 1.0, 1.0, dimension=dimension), rtol=1e-10,
    )  # fmt: skip
    assert_allclose(
        wlc.extension_gaussian(0.3, *DNA, dimension=dimension),
        wlc.extension_hookean(0.3, *DNA, dimension=dimension),
        rtol=1e-14,
    )


# --- one joint, one bond ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize(("form", "rest"), [("harmonic", 0.0), ("harmonic", 0.7), ("cosine", 0.0)])
@pytest.mark.parametrize("stiffness", [0.0, 0.3, 10.0, 1e4])
def test_mean_cosine_by_adaptive_quadrature(stiffness, form, rest, dimension):
    def weight(beta):
        energy = (beta - rest) ** 2 / 2 if form == "harmonic" else 2 * math.sin(beta / 2) ** 2
        return math.exp(-stiffness * energy) * math.sin(beta) ** (dimension - 2)

    reach = min(math.pi, rest + 12 / math.sqrt(max(stiffness, 1e-9)))
    start = max(0.0, rest - 12 / math.sqrt(max(stiffness, 1e-9)))
    options = {"epsabs": 0, "epsrel": 1e-12, "limit": 200}
    norm, _ = integrate.quad(weight, start, reach, **options)
    less, _ = integrate.quad(lambda b: weight(b) * 2 * math.sin(b / 2) ** 2, start, reach, **options)
    value = wlc.mean_cosine(stiffness, bending_form=form, rest_angle=rest, dimension=dimension)
    assert_allclose(1 - value, less / norm, rtol=1e-11, atol=2e-16)


def test_mean_cosine_closed_forms_and_reference():
    K = np.array([0.5, 10.0, 50.0])
    assert_allclose(wlc.mean_cosine(K, bending_form="cosine"), 1 / np.tanh(K) - 1 / K, rtol=1e-12)
    assert_allclose(
        wlc.mean_cosine(K, bending_form="cosine", dimension=2), special.ive(1, K) / special.ive(0, K), rtol=1e-12
    )
    assert_allclose(-1 / np.log(wlc.mean_cosine(K[1:], bending_form="cosine")), [9.49122, 49.49832], atol=5e-6)
    assert_allclose(-1 / np.log(wlc.mean_cosine(K[1:])), [10.17174, 50.16767], atol=5e-6)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("form", ["harmonic", "cosine"])
@settings(max_examples=25, deadline=None)
@given(exponent=st.floats(-6, math.log10(0.99)))
def test_bending_from_cosine_round_trip(dimension, form, exponent):
    cosine = 1 - 10**exponent
    stiffness = wlc.bending_from_cosine(cosine, bending_form=form, dimension=dimension)
    back = wlc.mean_cosine(stiffness, bending_form=form, dimension=dimension)
    assert_allclose(1 - back, 1 - cosine, rtol=1e-10, atol=4 * EPS)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("stiffness", [0.01, 1.0, 40.0, 1e6])
def test_mean_bond_length(stiffness, dimension):
    b0 = 2.0
    sigma = math.sqrt(KT / stiffness)
    edges = np.linspace(max(0.0, b0 - 12 * sigma), b0 + 12 * sigma, 9)

    def moment(n):
        def integrand(s):
            return s**n * math.exp(-stiffness * (s - b0) ** 2 / (2 * KT))

        return sum(integrate.quad(integrand, *ends, epsabs=0, epsrel=1e-12)[0] for ends in itertools.pairwise(edges))

    mean = wlc.mean_bond_length(b0, stiffness, KT, dimension=dimension)
    assert_allclose(mean, moment(dimension) / moment(dimension - 1), rtol=1e-11)
    assert_allclose(wlc.rest_length(mean, stiffness, KT, dimension=dimension), b0, rtol=1e-10)
    if stiffness > 1e5:
        assert_allclose(mean - b0, (dimension - 1) * KT / (stiffness * b0), rtol=1e-5)


def test_rest_length_refuses_what_no_bond_gives():
    with pytest.raises(ValueError, match="`mean_length` must be at least"):
        wlc.rest_length(1.0, 1.0, KT)


# --- the discrete chain: direct integration -----------------------------------------------------------------------


def bond_weights(tension, b0, stretching, kT, dimension):
    """Weight and weighted length of a bond by quadrature over its length."""
    if stretching is None:
        weight = np.exp(tension * b0 / kT)
        return weight, weight * b0
    sigma = math.sqrt(kT / stretching)
    low, high = max(0.0, b0 - 12 * sigma), b0 + 14 * sigma + abs(tension).max() / stretching
    x, w = special.roots_legendre(160)
    s = low + (high - low) * (x + 1) / 2
    weight, length = np.zeros_like(tension), np.zeros_like(tension)
    for value, measure in zip(s, w * (high - low) / 2, strict=True):
        term = (
            measure
            * value ** (dimension - 1)
            * np.exp(-stretching * (value - b0) ** 2 / (2 * kT) + tension * value / kT)
        )
        weight += term
        length += term * value
    return weight, length


def panel(low, high, count):
    x, w = special.roots_legendre(count)
    return low + (high - low) * (x + 1) / 2, w * (high - low) / 2


def direct_extension(case, b0, kT):
    """The configuration integral on a product grid: one direction, then joint angles."""
    _, dimension, force, stretching, form, flip, joints, count = case
    if dimension == 3:
        cosines, measure = panel(-1, 1, count)
    else:
        theta = 2 * math.pi * np.arange(2 * count) / (2 * count)
        cosines, measure = np.cos(theta), np.ones(2 * count)
    weight, length = bond_weights(force * cosines, b0, stretching, kT, dimension)
    total, moment = measure * weight, measure * length * cosines
    state = cosines if dimension == 3 else theta
    for stiffness, rest in joints:
        if dimension == 3:
            beta, wb = panel(0, math.pi, count)
            psi = math.pi * (np.arange(count) + 0.5) / count
            angles = wb * np.sin(beta)
            c = state[:, None, None]
            state = c * np.cos(beta)[:, None] + np.sqrt(1 - c**2) * np.sin(beta)[:, None] * np.cos(psi)
        else:
            ends = [-math.pi, 0, math.pi] if flip else [rest - math.pi, rest, rest + math.pi]
            halves = [panel(*pair, count) for pair in itertools.pairwise(ends)]
            beta, angles = np.concatenate([h[0] for h in halves]), np.concatenate([h[1] for h in halves])
            state = state[:, None] + beta
        angle = np.abs(beta) if flip else beta
        energy = (angle - rest) ** 2 / 2 if form == "harmonic" else -np.cos(beta)
        kernel = angles * np.exp(-stiffness * energy)
        kernel = np.repeat(kernel, count) if dimension == 3 else kernel
        state = np.clip(state, -1, 1).ravel() if dimension == 3 else state.ravel()
        cosines = state if dimension == 3 else np.cos(state)
        weight, length = bond_weights(force * cosines, b0, stretching, kT, dimension)
        before, total_before = np.outer(moment, kernel).ravel(), np.outer(total, kernel).ravel()
        total, moment = total_before * weight, before * weight + total_before * length * cosines
    return moment.sum() / total.sum()


SMALL = [
    # segments, dimension, force, stretching, form, flip, joints (alpha/kT, rest), nodes
    (1, 3, 1.3, None, "harmonic", True, [], 40),
    (1, 3, 1.3, 3.0, "harmonic", True, [], 40),
    (1, 2, 40.0, 50.0, "harmonic", True, [], 200),
    (2, 3, 2.0, None, "harmonic", True, [(1.5, 0.0)], 40),
    (2, 3, 2.0, 6.0, "cosine", True, [(4.0, 0.0)], 40),
    (2, 3, 3.0, 20.0, "harmonic", True, [(12.0, 1.1)], 48),
    (3, 3, 0.8, None, "harmonic", True, [(2.0, 0.4), (1.0, 2.0)], 14),
    (2, 2, 3.0, 2.0, "harmonic", True, [(2.0, 0.0)], 60),
    (2, 2, 30.0, None, "harmonic", True, [(9.0, 0.8)], 120),
    (2, 2, 300.0, None, "harmonic", False, [(200.0, -1.8)], 500),
    (2, 2, 300.0, None, "harmonic", True, [(200.0, 1.8)], 500),
    (3, 2, 2.0, 8.0, "harmonic", True, [(3.0, 0.9), (5.0, 0.2)], 36),
    (3, 2, 2.0, 8.0, "harmonic", False, [(3.0, 0.9), (1.0, -2.4)], 36),
    (3, 2, 4.0, None, "harmonic", False, [(20.0, 0.9), (20.0, -2.4)], 50),
    (3, 2, 2.0, None, "cosine", True, [(3.0, 0.0), (7.0, 0.0)], 40),
]


@pytest.mark.parametrize("case", SMALL)
def test_short_chain_by_direct_integration(case):
    kT, b0 = 0.9, 1.2
    segments, dimension, force, stretching, form, flip, joints, _ = case
    stiffness, rest = np.array(joints).reshape(-1, 2).T
    z = wlc.extension_discrete(
        force, segments=segments, bond_length=b0, bending=stiffness * kT, kT=kT, stretching=stretching,
        bending_form=form, rest_angles=rest, flip=flip, dimension=dimension,
    )  # fmt: skip
    assert_allclose(z, direct_extension(case, b0, kT), rtol=DIRECT)


@pytest.mark.parametrize(
    ("dimension", "flip", "bent"), [(2, True, 0.0), (3, True, 0.0), (2, False, 1.0), (2, True, 0.6), (3, True, 0.2)]
)
@pytest.mark.parametrize("stretching", [None, 3000.0])
@pytest.mark.parametrize("stiffness", [0.2, 20.0, 700.0])
def test_twice_the_nodes_change_nothing(dimension, flip, bent, stretching, stiffness):
    rest = bent * np.random.default_rng(3).uniform(0.1, 1, 11) * (1 if flip else np.resize([1, -1], 11))
    chain = DiscreteChain(
        segments=12, bond_length=1.0, bending=stiffness, kT=1.0, stretching=stretching, bending_form="harmonic",
        rest_angles=rest, flip=flip, dimension=dimension,
    )  # fmt: skip
    forces = np.array([1e-4, 0.3, 60.0])
    once, twice = (discrete._extension(forces, chain, refine) for refine in (1.0, 2.0))
    assert_allclose(once, twice, rtol=DOUBLING)


def test_strong_force_on_cold_bent_chain():
    """K = 1e4, F b/kT = 1e3: the mean is the mechanical equilibrium, to the order of 1/K."""
    K, pull = 1e4, 1e3
    rest = np.array([0.9, -1.3, 0.5, 0.8])
    theta = np.cumsum(np.concatenate([[0.0], rest]))
    theta -= np.angle(np.exp(1j * theta).sum())
    for _ in range(50):  # Newton from the rest shape laid along the force
        joints = np.diff(theta) - rest
        gradient = pull * np.sin(theta) + K * (np.append(0, joints) - np.append(joints, 0))
        stiffness = np.diag(pull * np.cos(theta))
        for i in range(4):
            stiffness[i : i + 2, i : i + 2] += K * np.array([[1, -1], [-1, 1]])
        theta -= np.linalg.solve(stiffness, gradient)
    assert np.abs(gradient).max() < 1e-6 * pull
    z = wlc.extension_discrete(
        pull, segments=5, bond_length=1.0, bending=K, kT=1.0, rest_angles=rest, flip=False, dimension=2
    )
    assert_allclose(z, np.cos(theta).sum(), rtol=2e-3)
    with pytest.raises(ValueError, match="`force` must be weaker"):
        wlc.extension_discrete(pull, segments=5, bond_length=1.0, bending=K, kT=1.0, rest_angles=np.abs(rest))


# --- the discrete chain: long chains ------------------------------------------------------------------------------


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("stretching", [None, 30.0])
@pytest.mark.parametrize("stiffness", [0.5, 12.0, 900.0])
def test_linear_response_of_the_discrete_chain(dimension, stretching, stiffness):
    """`z = F <R^2>/(d kT)`; a stretching bond adds its variance to each bond."""
    segments, b0, kT = 60, 1.5, 0.7
    force = 1e-5 * kT / b0 / segments
    cosine = wlc.mean_cosine(stiffness, dimension=dimension)
    mean = b0 if stretching is None else wlc.mean_bond_length(b0, stretching, kT, dimension=dimension)
    squared = wlc.mean_squared_end_to_end_discrete(segments, mean, cosine)
    if stretching is not None:
        sigma = math.sqrt(kT / stretching)
        s, w = panel(max(0.0, b0 - 12 * sigma), b0 + 12 * sigma, 200)
        weight = w * s ** (dimension - 1) * np.exp(-((s - b0) ** 2) / (2 * sigma**2))
        squared += segments * (np.sum(weight * s**2) / weight.sum() - mean**2)
    z = wlc.extension_discrete(
        force,
        segments=segments,
        bond_length=b0,
        bending=stiffness * kT,
        kT=kT,
        stretching=stretching,
        dimension=dimension,
    )
    assert_allclose(z, force * squared / (dimension * kT), rtol=RESPONSE)


@pytest.mark.parametrize("flip", [True, False, np.arange(19) % 3 == 0])
def test_linear_response_of_a_bent_planar_chain(flip):
    """`<t_i.t_j>` is the real part of the product of `<exp(i phi)>` over the joints between."""
    stiffness, rest = 8.0, np.random.default_rng(5).uniform(0.2, 1.5, 19)
    rest = np.where(np.broadcast_to(flip, 19), rest, rest * np.resize([1, -1, -1], 19))
    factors = []
    for angle, free in zip(rest, np.broadcast_to(flip, 19), strict=True):
        ends = [0.0, math.pi] if free else [angle - math.pi, angle + math.pi]
        phi, w = panel(*ends, 120)
        weight = w * np.exp(-stiffness * (phi - angle) ** 2 / 2)
        value = np.sum(weight * np.exp(1j * phi)) / weight.sum()
        factors.append(value.real if free else value)
    squared = 20.0
    for i in range(19):
        squared += 2 * np.cumprod(factors[i:]).real.sum()
    force = 1e-6
    z = wlc.extension_discrete(
        force, segments=20, bond_length=1.0, bending=stiffness, kT=1.0, rest_angles=rest, flip=flip, dimension=2
    )
    assert_allclose(z, force * squared / 2, rtol=RESPONSE)


def test_reference_curve_of_the_discrete_chain():
    """Per segment of a long chain: the difference of two lengths removes the ends."""
    lp = -1 / math.log(wlc.mean_cosine(10.0))
    forces = np.array([0.1, 1, 10, 100]) / lp
    long, short = (
        wlc.extension_discrete(forces, segments=n, bond_length=1.0, bending=10.0, kT=1.0) for n in (1200, 800)
    )
    assert_allclose((long - short) / 400, [0.066397, 0.481611, 0.843242, 0.954985], atol=6e-7)


def test_discretisation_error_of_dna():
    """Rigid links with `<cos beta> = exp(-b/l_p)` against the continuous finite chain, per cent."""
    table = {40: [2.1, 3.7, 3.6, 1.7], 80: [0.5, 1.2, 1.8, 1.4], 160: [0.1, 0.3, 0.6, 0.9]}
    forces = [0.05, 1.0, 5.0, 50.0]
    exact = wlc.extension_exact(forces, *DNA, finite=True)
    for segments, expected in table.items():
        b = 1000 / segments
        bending = KT * wlc.bending_from_cosine(math.exp(-b / 53))
        z = wlc.extension_discrete(forces, segments=segments, bond_length=b, bending=bending, kT=KT)
        assert_allclose(100 * (z / exact - 1), expected, atol=0.06)


@pytest.mark.parametrize(("dimension", "flip"), [(3, True), (2, True), (2, False)])
def test_monte_carlo_of_free_chains(dimension, flip):
    """Chains drawn exactly without force, weighted with exp(F z/kT): a coarse check of the whole construction."""
    rng, count, segments, stiffness, force = np.random.default_rng(11), 200_000, 8, 6.0, 0.15
    rest = np.linspace(0.2, 0.9, segments - 1)
    grid = np.linspace(0, math.pi, 4001)[1:] if flip else np.linspace(-math.pi, math.pi, 8001)[1:]
    along = rng.uniform(-1, 1, count) if dimension == 3 else rng.uniform(-math.pi, math.pi, count)
    z = along.copy() if dimension == 3 else np.cos(along)
    for angle in rest:
        weight = np.exp(-stiffness * (grid - angle) ** 2 / 2) * (np.sin(grid) if dimension == 3 else 1)
        cumulative = np.cumsum(weight)
        beta = np.interp(rng.random(count), cumulative / cumulative[-1], grid)
        if dimension == 3:
            turn = np.cos(rng.uniform(0, math.pi, count))
            along = np.clip(along * np.cos(beta) + np.sqrt(1 - along**2) * np.sin(beta) * turn, -1, 1)
            z += along
        else:
            along = along + (rng.choice([-1, 1], count) if flip else 1) * beta
            z += np.cos(along)
    weights = np.exp(force * z)
    mean = np.sum(weights * z) / weights.sum()
    error = math.sqrt(np.sum((weights * (z - mean)) ** 2)) / weights.sum()
    exact = wlc.extension_discrete(
        force,
        segments=segments,
        bond_length=1.0,
        bending=stiffness,
        kT=1.0,
        rest_angles=rest,
        flip=flip,
        dimension=dimension,
    )
    assert abs(mean - exact) < SIGMAS * error
    assert error < 0.02 * exact


def test_mirror_and_reversal_symmetry():
    rng = np.random.default_rng(2)
    rest, stiffness = rng.uniform(-2, 2, 9), rng.uniform(1, 40, 9)
    chain = {"segments": 10, "bond_length": 1.0, "kT": 1.0, "stretching": 50.0, "flip": False, "dimension": 2}
    z = wlc.extension_discrete(FORCES, bending=stiffness, rest_angles=rest, **chain)
    assert_allclose(wlc.extension_discrete(FORCES, bending=stiffness, rest_angles=-rest, **chain), z, rtol=1e-11)
    assert_allclose(
        wlc.extension_discrete(FORCES, bending=stiffness[::-1], rest_angles=rest[::-1], **chain), z, rtol=1e-11
    )


@pytest.mark.parametrize(("dimension", "stretching"), [*itertools.product((2, 3), (None, 80.0))])
def test_force_discrete_round_trip(dimension, stretching):
    chain = {
        "segments": 30,
        "bond_length": 10.0,
        "bending": 20.0,
        "kT": KT,
        "stretching": stretching,
        "dimension": dimension,
    }
    forces = np.array([0.0, 0.02, 1.0, 40.0])
    assert_allclose(wlc.force_discrete(wlc.extension_discrete(forces, **chain), **chain), forces, rtol=ROUND_TRIP)


def test_mean_squared_end_to_end_discrete_closed_form():
    for n, c in [(1, 0.3), (2, -0.4), (50, 0.9), (300, 0.0)]:
        closed = n * 4.0 * ((1 + c) / (1 - c) - 2 * c * (1 - c**n) / (n * (1 - c) ** 2))
        assert_allclose(wlc.mean_squared_end_to_end_discrete(n, 2.0, c), closed, rtol=1e-12)
    assert wlc.mean_squared_end_to_end_discrete(7, 2.0, 1.0) == 196
    fine = wlc.mean_squared_end_to_end_discrete(100_000, 0.01, math.exp(-0.01 / 53))
    assert_allclose(fine, wlc.mean_squared_end_to_end(53.0, 1000.0), rtol=1e-8)


# --- arguments ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"force": -1.0}, "`force` must not be negative"),
        ({"segments": 0}, "`segments` must be at least 1"),
        ({"bond_length": 0.0}, "`bond_length` must be positive"),
        ({"bending": -1.0}, "`bending` must not be negative"),
        ({"bending": [1.0, 2.0]}, r"`bending` must have shape \(9,\), but has shape \(2,\)"),
        ({"stretching": 0.0}, "`stretching` must be positive"),
        ({"bending_form": "linear"}, "`bending_form` must be one of"),
        ({"rest_angles": -0.1}, r"`rest_angles` must lie in \[0.0, 3.14"),
        ({"rest_angles": 0.1, "bending_form": "cosine"}, "`rest_angles` must be 0 for the cosine form"),
        ({"flip": False}, "`flip` must be True in three dimensions"),
        ({"flip": [True, False], "dimension": 2}, r"`flip` must have shape \(9,\)"),
        (
            {"flip": np.arange(9) > 3, "rest_angles": -0.1, "dimension": 2},
            "`rest_angles` must not be negative where a joint",
        ),
        # 1000 kT per rad^2 bent by 2 rad: straightened to weights of 1e-870
        ({"force": 500.0, "bending": 1000.0, "rest_angles": 2.0, "flip": False, "dimension": 2}, "weights underflow"),
        ({"dimension": 1}, "`dimension` must be one of 2, 3"),
        ({"force": 1e6, "dimension": 2, "rest_angles": 0.1}, "`force` must be weaker"),
    ],
)
def test_refused_chains(change, message):
    chain = {"force": 1.0, "segments": 10, "bond_length": 1.0, "bending": 5.0, "kT": 1.0}
    with pytest.raises(ValueError, match=message):
        wlc.extension_discrete(**{**chain, **change})


@pytest.mark.parametrize("cosine", [0.0, 1.0, -0.2])
def test_bending_from_cosine_refuses(cosine):
    with pytest.raises(ValueError, match="`mean_cosine` must lie in"):
        wlc.bending_from_cosine(cosine)


@pytest.mark.parametrize("module", [bonds, continuous, discrete, flexible, interpolations, joints, limits, moments])
def test_docstring_examples(module):
    result = doctest.testmod(module)
    assert result.attempted
    assert not result.failed


def test_loads_no_heavy_package():
    code = "import sys, openmm_filament.wlc; print(*{'openmm', 'mdtraj', 'matplotlib'} & set(sys.modules))"
    assert not subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()


def test_no_extension_takes_no_force() -> None:
    chain = {"segments": 5, "bond_length": 1.0, "bending": 10.0, "kT": 4.0}
    assert wlc.force_discrete(0.0, **chain) == 0.0
    np.testing.assert_array_equal(wlc.force_discrete([0.0, 0.0], **chain), [0.0, 0.0])


def test_an_extension_that_asks_for_too_strong_a_force_is_refused() -> None:
    with pytest.raises(
        ValueError, match="`force`, or the one that the extension asks for, must keep F l_p/kT below 1e"
    ):
        wlc.force_exact(1000 - 1e-7, 53.0, 1000.0, 4.114)


def test_the_force_on_a_chain_of_soft_bonds_is_found_beyond_its_contour() -> None:
    chain = {
        "segments": 2,
        "bond_length": 1.0,
        "bending": 0.283,
        "kT": 1.0,
        "stretching": 3.16,
        "bending_form": "cosine",
    }
    z = wlc.extension_discrete(9.7, **chain)
    assert wlc.force_discrete(z, **chain) == pytest.approx(9.7, rel=1e-8)
