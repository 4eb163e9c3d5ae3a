"""Tangent correlations and persistence lengths: exact products of rotations, quadrature, and what errors are worth."""

from __future__ import annotations

import math
import warnings
from typing import Any

import mdtraj
import numpy as np
import pytest
import tolerances as tol
from conftest import KJ, NM, Array, chain_from_angles
from openmm import unit
from scipy import integrate, special, stats

import openmm_filament as of
from openmm_filament import analysis, wlc
from openmm_filament.geometry import dihedrals
from openmm_filament.starts import equilibrium_starts

KT = 2.5
HELIX: dict[str, Any] = {
    "bending": 150.0, "kT": KT, "rest_angle": 0.7, "torsion": 20.0, "rest_torsion": 0.4,
}  # fmt: skip


# --- the exact product --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", ["harmonic", "cosine"])
def test_a_chain_without_torsion_is_a_power_of_the_mean_cosine(form: Any) -> None:
    found = wlc.tangent_correlation_discrete(30, bending=20.0, kT=KT, bending_form=form)
    np.testing.assert_allclose(found, wlc.mean_cosine(8.0, bending_form=form) ** np.arange(31.0), rtol=tol.ROUNDING)
    bent = wlc.tangent_correlation_discrete(30, bending=20.0, kT=KT, rest_angle=0.8)
    np.testing.assert_allclose(bent, wlc.mean_cosine(8.0, rest_angle=0.8) ** np.arange(31.0), rtol=tol.ROUNDING)


def averages(torsion: float, form: str, rest: float, multiplicity: int) -> complex:
    """`<exp(i tau)>` by adaptive quadrature over a turn."""

    def weight(tau: float) -> float:
        d = math.remainder(tau - rest, 2 * math.pi)
        energy = torsion * d**2 / 2 if form == "harmonic" else torsion * (1 - math.cos(multiplicity * d))
        return math.exp(-energy / KT)

    def over(f: Any) -> float:
        return float(integrate.quad(f, rest - math.pi, rest + math.pi, limit=400, epsabs=1e-13, points=[rest])[0])

    norm = over(weight)
    return complex(over(lambda t: weight(t) * math.cos(t)), over(lambda t: weight(t) * math.sin(t))) / norm


@pytest.mark.parametrize(
    ("torsion", "form", "rest", "multiplicity"),
    [
        (0.3, "harmonic", 2.9, 1),
        (20.0, "harmonic", -0.4, 1),
        (900.0, "harmonic", 0.4, 1),
        (3.0, "periodic", 0.4, 1),
        (300.0, "periodic", -2.0, 1),
        (20.0, "periodic", 1.0, 3),
    ],
)
def test_three_tangents_apart_by_quadrature_and_spherical_trigonometry(
    torsion: float, form: Any, rest: float, multiplicity: int
) -> None:
    """`t_2.t_0 = cos^2 beta - sin^2 beta cos tau`, and t_3 by vectors: no matrix is multiplied."""
    density = lambda b: math.exp(-150.0 / KT * (b - 0.7) ** 2 / 2) * math.sin(b)  # noqa: E731
    over = lambda f: integrate.quad(lambda b: f(b) * density(b), 0, math.pi, points=[0.7], epsabs=1e-14)[0]  # noqa: E731
    c, s = over(math.cos) / over(lambda b: 1.0), over(math.sin) / over(lambda b: 1.0)
    turn = averages(torsion, form, rest, multiplicity)
    # a frame is carried along: t' = c t + s n', n' = n cos tau + m sin tau, m' = m cos tau - n sin tau, n'' = c n' - s t
    tangent, normal, binormal = np.eye(3)
    tangents = [tangent]
    for i in range(4):
        angle = 1.0 if i == 0 else turn
        towards = angle.real * normal + angle.imag * binormal if i else normal
        binormal = angle.real * binormal - angle.imag * normal if i else binormal
        tangent, normal = c * tangent + s * towards, c * towards - s * tangent
        tangents.append(tangent)
    wanted = [float(t @ tangents[0]) for t in tangents]
    assert wanted[2] == pytest.approx(c * c - s * s * turn.real, rel=1e-14)
    found = wlc.tangent_correlation_discrete(
        4, bending=150.0, kT=KT, rest_angle=0.7, torsion=torsion, torsion_form=form, rest_torsion=rest, multiplicity=multiplicity
    )  # fmt: skip
    np.testing.assert_allclose(found, wanted, atol=tol.QUADRATURE)


def test_a_periodic_torsion_averages_to_bessel_functions() -> None:
    found = wlc.tangent_correlation_discrete(
        2, bending=150.0, kT=KT, rest_angle=0.7, torsion=5.0, torsion_form="periodic"
    )
    cosine = float(wlc.mean_cosine(60.0, rest_angle=0.7))
    rest = wlc.tangent_correlation_discrete(2, bending=150.0, kT=KT, rest_angle=0.7, torsion=1e9)[2]
    sine_squared = cosine**2 - rest
    order = special.ive(1, 2.0) / special.ive(0, 2.0)
    assert found[2] == pytest.approx(cosine**2 - sine_squared * order, abs=1e-8)


def test_a_cold_chain_has_the_tangents_of_its_helix() -> None:
    """The sign and the zero of the torsion are those of the package's own geometry."""
    x = of.shapes.helix(30, radius=3 * NM, pitch=6 * NM, turns=4).value_in_unit(NM)
    t = np.diff(x, axis=0)
    t /= np.linalg.norm(t, axis=1)[:, None]
    bend = float(np.arccos(t[0] @ t[1]))
    torsion = float(dihedrals(x[None, :4])[0])
    cold = wlc.tangent_correlation_discrete(29, bending=1e9, kT=1.0, rest_angle=bend, torsion=1e9, rest_torsion=torsion)
    np.testing.assert_allclose(cold, t @ t[0], atol=1e-6)
    mirrored = wlc.tangent_correlation_discrete(
        29, bending=1e9, kT=1.0, rest_angle=bend, torsion=1e9, rest_torsion=-torsion
    )
    np.testing.assert_allclose(cold, mirrored, atol=1e-12)


def helices(rng: np.random.Generator, frames: int, segments: int, *, stiffer: float = 1.0) -> Array:
    """Chains of `HELIX` whose angles are drawn by rejection, built by the tests' own frames."""

    def bend() -> float:
        while True:
            b = rng.normal(0.7, math.sqrt(KT / 150.0))
            if 0 < b < math.pi and rng.random() < math.sin(b):
                return float(b)

    def turn() -> float:
        while True:
            d = rng.normal(0, math.sqrt(KT / 20.0 / stiffer))
            if abs(d) < math.pi:
                return float(0.4 + d)

    return np.array(
        [
            chain_from_angles(
                np.ones(segments),
                np.array([bend() for _ in range(segments - 1)]),
                np.array([turn() for _ in range(segments - 2)]),
            )
            for _ in range(frames)
        ]
    )


def test_sampled_helices_have_the_exact_correlation(rng: np.random.Generator) -> None:
    exact = wlc.tangent_correlation_discrete(9, **HELIX)
    found = analysis.tangent_correlation(helices(rng, 1200, 10))
    z = (found.values[1:] - exact[1:]) / found.errors[1:]
    assert np.abs(z).max() < tol.SIGMAS
    other = analysis.tangent_correlation(helices(rng, 1200, 10, stiffer=0.5))
    assert np.abs((other.values[1:] - exact[1:]) / other.errors[1:]).max() > tol.SIGMAS


def test_the_engine_s_starts_have_the_exact_correlation(rng: np.random.Generator) -> None:
    """The very terms that OpenMM runs, drawn from equilibrium."""
    terms = (
        of.stretching.Harmonic(500 * KJ / NM**2),
        of.bending.Harmonic(20 * KJ, rest_angle=0.5 * unit.radian),
        of.torsion.Periodic(6 * KJ, rest_angle=1.2 * unit.radian),
    )
    filament = of.Filament(of.shapes.helix(12, radius=3 * NM, pitch=6 * NM, turns=2), 300 * unit.dalton, terms)
    x = equilibrium_starts(filament, 0.0, 300.0, 1500, rng)
    kT = of.units.BOLTZMANN * 300
    exact = wlc.tangent_correlation_discrete(
        11, bending=20.0, kT=kT, rest_angle=0.5, torsion=6.0, torsion_form="periodic", rest_torsion=1.2
    )
    found = analysis.tangent_correlation(x)
    assert np.abs((found.values[1:] - exact[1:]) / found.errors[1:]).max() < tol.SIGMAS


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"torsion": -1.0}, "`torsion` must not be negative"),
        ({"rest_torsion": 4.0}, r"`rest_torsion` must lie in \[-3"),
        ({"rest_angle": -0.1}, r"`rest_angle` must lie in \[0"),
        ({"bending_form": "cosine"}, "`rest_angle` must be 0 for the cosine form"),
        ({"torsion_form": "weighted"}, "`torsion_form` must be one of"),
        ({"multiplicity": 2}, "`multiplicity` must be 1 for the harmonic form"),
        ({"kT": 0.0}, "`kT` must be positive"),
    ],
)
def test_wrong_chains_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        wlc.tangent_correlation_discrete(3, **{**HELIX, **options})


# --- the persistence length ---------------------------------------------------------------------------------------


def walks(rng: np.random.Generator, frames: int, segments: int, stiffness: float, dimension: int = 3) -> Array:
    """Freely rotating chains of unit bonds with harmonic joints (K = alpha/kT), all frames at once."""
    beta = np.linspace(0, math.pi, 20_001)
    density = np.exp(-stiffness * beta**2 / 2) * np.sin(beta) ** (dimension - 2)
    bends = np.interp(rng.random((frames, segments - 1)), np.cumsum(density) / density.sum(), beta)
    if dimension == 2:
        turned = np.cumsum(bends * rng.choice([-1, 1], bends.shape), axis=1)
        angles = np.concatenate([np.zeros((frames, 1)), turned], axis=1)
        tangents = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=-1)
        return np.concatenate([np.zeros((frames, 1, 3)), np.cumsum(tangents, axis=1)], axis=1)
    tangent = np.tile([0.0, 0.0, 1.0], (frames, 1))
    steps = [tangent]
    for i in range(segments - 1):
        across = np.cross(tangent, rng.normal(size=(frames, 3)))
        across /= np.linalg.norm(across, axis=1)[:, None]
        tangent = np.cos(bends[:, i, None]) * tangent + np.sin(bends[:, i, None]) * across
        steps.append(tangent)
    return np.concatenate([np.zeros((frames, 1, 3)), np.cumsum(np.stack(steps, axis=1), axis=1)], axis=1)


def exact_length(stiffness: float, dimension: int = 3) -> float:
    decay = -1 / math.log(float(wlc.mean_cosine(stiffness, dimension=dimension)))
    return decay if dimension == 3 else decay / 2


def test_rest_bends_without_torsion_count_as_random_ones(rng: np.random.Generator) -> None:
    """An arc of stiff joints, drawn from equilibrium: its length is that of its bends, not of its stiffness, 400 segments."""
    kT, bend = of.units.BOLTZMANN * 300, 0.3
    terms = (of.stretching.Harmonic(500 * KJ / NM**2), of.bending.Harmonic(400 * kT * KJ, bend * unit.radian))
    arc = of.Filament(of.shapes.line(20, 1 * NM), 300 * unit.dalton, terms)
    found = analysis.persistence_length(equilibrium_starts(arc, 0.0, 300.0, 1500, rng))
    exact = -1 / math.log(float(wlc.mean_cosine(400.0, rest_angle=bend)))
    assert abs(found.value - exact) < tol.SIGMAS * found.error
    assert exact == pytest.approx(-1 / math.log(math.cos(bend)), rel=0.1)


@pytest.mark.parametrize(
    ("stiffness", "segments", "dimension"), [(8.0, 30, 3), (8.0, 30, 2), (50.0, 10, 3), (1.0, 20, 3)]
)
def test_the_error_bar_covers_the_exact_value_as_often_as_it_says(
    stiffness: float, segments: int, dimension: int
) -> None:
    """Many independent sets: the pulls are normal, so one and two standard errors hold what they should."""
    rng, sets, frames = np.random.default_rng(11), 150, 100
    x = walks(rng, sets * frames, segments, stiffness, dimension).reshape(sets, frames, segments + 1, 3)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "The persistence length rests on")
        found = [analysis.persistence_length(part, dimension=dimension) for part in x]
    z = np.array([(each.value - exact_length(stiffness, dimension)) / each.error for each in found])
    for width, share in ((1.0, 0.6827), (1.96, 0.95)):
        assert stats.binomtest(int((np.abs(z) < width).sum()), sets, share).pvalue > tol.COVERAGE, width
    assert stats.binomtest(int((np.abs(z) < 1.96 / 1.6).sum()), sets, 0.95).pvalue < tol.COVERAGE


def test_correlated_frames_do_not_make_the_error_smaller(rng: np.random.Generator) -> None:
    """Every frame repeated five times: as many effective samples as before."""
    x = walks(rng, 400, 20, 8.0)
    alone, repeated = analysis.persistence_length(x), analysis.persistence_length(np.repeat(x, 5, axis=0))
    assert repeated.value == pytest.approx(alone.value, rel=1e-9)
    assert repeated.error == pytest.approx(alone.error, rel=tol.ERROR_OF_ERROR)
    assert repeated.autocorrelation_time == pytest.approx(5 * alone.autocorrelation_time, rel=2 * tol.ERROR_OF_ERROR)


def test_the_error_agrees_with_a_jackknife(rng: np.random.Generator) -> None:
    x = walks(rng, 500, 20, 8.0)
    found = analysis.persistence_length(x)
    left_out = [analysis.persistence_length(np.delete(x, np.s_[i::50], axis=0)).value for i in range(50)]
    jackknife = math.sqrt(49 * np.var(left_out))
    assert found.error == pytest.approx(jackknife, rel=tol.ERROR_OF_ERROR)


def test_products_of_tangents_by_a_plain_loop(rng: np.random.Generator) -> None:
    x = walks(rng, 3, 6, 4.0) * 2.0
    found = analysis.tangent_correlation(x)
    t = np.diff(x, axis=1) / 2.0
    for n in range(6):
        pairs = [t[f, i] @ t[f, i + n] for f in range(3) for i in range(6 - n)]
        assert found.values[n] == pytest.approx(np.mean(pairs), abs=1e-12)
    assert found.separations == pytest.approx(2.0 * np.arange(6))


def test_chains_are_found_in_trajectories_and_by_their_atoms(rng: np.random.Generator) -> None:
    x = walks(rng, 60, 12, 8.0)
    both = np.concatenate([x, np.roll(x, 7, axis=0)[:, ::-1]], axis=1)
    topology = mdtraj.Topology()
    for _ in range(2):
        chain = topology.add_chain()
        for _ in range(13):
            topology.add_atom("B", None, topology.add_residue("BEA", chain))
    trajectory = mdtraj.Trajectory(both, topology)
    first = analysis.tangent_correlation(x)
    by_chain = analysis.tangent_correlation(trajectory)
    np.testing.assert_allclose(by_chain.values, first.values, atol=1e-6)
    one = analysis.tangent_correlation(trajectory, atoms=range(13))
    np.testing.assert_allclose(one.errors, first.errors, rtol=1e-4, atol=1e-9)
    halves = analysis.tangent_correlation(both, atoms=np.arange(26).reshape(2, 13))
    np.testing.assert_allclose(halves.values, by_chain.values, atol=1e-6)
    uneven = trajectory.atom_slice(range(20))
    with pytest.raises(ValueError, match=r"chains of \[7, 13\] atoms: choose with `atoms`"):
        analysis.persistence_length(uneven)
    with pytest.raises(ValueError, match="`atoms` must hold indices from 0 to 25"):
        analysis.persistence_length(trajectory, atoms=[24, 25, 26])


def test_the_fitted_range_and_what_is_refused(rng: np.random.Generator) -> None:
    x = walks(rng, 300, 20, 8.0)
    found = analysis.persistence_length(x)
    values = found.correlation.values
    assert found.fitted[0] == 1
    assert values[found.fitted[1]] >= math.exp(-1) > values[found.fitted[1] + 1]
    assert analysis.persistence_length(x, fit=(2, 5)).fitted == (2, 5)
    with pytest.raises(ValueError, match="`fit` must be at most 19"):
        analysis.persistence_length(x, fit=(1, 20))
    with pytest.raises(ValueError, match="`fit` must be at least 3"):
        analysis.persistence_length(x, fit=(3, 2))
    with pytest.raises(ValueError, match=r"shape \(frames, beads, 3\)"):
        analysis.persistence_length(x[0])
    with pytest.raises(ValueError, match="at least 3 beads"):
        analysis.persistence_length(x[:, :2])
    with pytest.raises(ValueError, match="`positions` must be finite"):
        analysis.persistence_length(np.where(x == x.max(), np.nan, x))
    with pytest.raises(ValueError, match="beads 3 and 4 of chain 0 coincide in frame 5"):
        still = x.copy()
        still[5, 4] = still[5, 3]
        analysis.persistence_length(still)
    with pytest.raises(ValueError, match="lies between 0 and 1 at separation 1"):
        analysis.persistence_length(np.arange(4.0)[None, :, None] * [1.0, 0, 0])
    with pytest.raises(ValueError, match="`dimension` must be one of"):
        analysis.persistence_length(x, dimension=1)


def test_too_few_samples_and_helices_are_told(rng: np.random.Generator) -> None:
    with pytest.warns(UserWarning, match="rests on .* effective samples"):
        analysis.persistence_length(walks(rng, 8, 20, 8.0))
    with pytest.warns(UserWarning, match="is not an exponential"):
        analysis.persistence_length(helices(rng, 300, 10), fit=(1, 4))
