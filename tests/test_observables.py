"""Sizes of chains and means of correlated samples, against closed forms, double sums and sampling."""

from __future__ import annotations

import math
from pathlib import Path

import mdtraj
import numpy as np
import openmm as mm
import pytest
import tolerances as tol
from arviz_stats.base import array_stats
from conftest import KJ, NM
from openmm import app, unit
from scipy import integrate, stats

import openmm_filament as of
from openmm_filament import analysis, wlc
from openmm_filament.starts import equilibrium_starts

# --- closed forms -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("contour", [1e-3, 0.4, 1.9, 2.1, 19.0, 1e4])
def test_the_continuous_radius_of_gyration_is_an_integral_of_distances(contour: float, dimension: int) -> None:
    """`<R_g^2> = int_0^L (L - s) <R^2(s)> ds/L^2`; continuous across the switch from series to closed form at x = 2."""
    wanted, _ = integrate.quad(
        lambda s: (contour - s) * wlc.mean_squared_end_to_end(1.0, s, dimension=dimension),
        0,
        contour,
        epsabs=0,
        epsrel=1e-11,
        limit=500,
        points=[p for p in (1.0, 10.0, 100.0) if p < contour],  # what decays near one end
    )
    found = wlc.mean_squared_radius_of_gyration(1.0, contour, dimension=dimension)
    assert found == pytest.approx(wanted / contour**2, rel=tol.QUADRATURE)


def test_limits_of_the_radius_of_gyration() -> None:
    assert wlc.mean_squared_radius_of_gyration(1e9, 12.0) == pytest.approx(12.0, rel=1e-7)  # a rod, L^2/12
    assert wlc.mean_squared_radius_of_gyration(1e-6, 12.0) == pytest.approx(2e-6 * 12 / 6, rel=1e-5)  # a coil
    fine = wlc.mean_squared_radius_of_gyration_discrete(4000, 0.005, math.exp(-0.005))
    assert fine == pytest.approx(wlc.mean_squared_radius_of_gyration(1.0, 20.0), rel=1e-3)


def test_the_closed_form_that_is_documented_holds_far_from_a_rod() -> None:
    lp, length = 53.0, 1000.0
    formula = lp * length / 3 - lp**2 + 2 * lp**3 / length - 2 * lp**4 / length**2 * (1 - math.exp(-length / lp))
    assert wlc.mean_squared_radius_of_gyration(lp, length) == pytest.approx(formula, rel=1e-13)


@pytest.mark.parametrize(("cosine", "variance"), [(0.9, 0.0), (-0.3, 0.2), (1.0, 0.0), (0.0, 0.5)])
def test_discrete_sizes_by_double_sums(cosine: float, variance: float) -> None:
    """Over all pairs of beads, and of bonds between them: `<s_i.s_j> = b^2 c^|i-j| + var delta_ij`."""
    bonds, b = 7, 1.7
    products = np.array(
        [[b**2 * cosine ** abs(i - j) + variance * (i == j) for j in range(bonds)] for i in range(bonds)]
    )
    squared = np.array(
        [[products[min(i, j) : max(i, j), min(i, j) : max(i, j)].sum() for j in range(8)] for i in range(8)]
    )
    end = wlc.mean_squared_end_to_end_discrete(bonds, b, cosine, bond_variance=variance)
    gyration = wlc.mean_squared_radius_of_gyration_discrete(bonds, b, cosine, bond_variance=variance)
    assert end == pytest.approx(squared[0, -1], rel=1e-13)
    assert gyration == pytest.approx(squared.sum() / (2 * 8**2), rel=1e-13)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize(("length", "stretching"), [(1.0, 200.0), (1.0, 5.0), (0.0, 5.0)])
def test_the_variance_of_a_bond_by_quadrature(length: float, stretching: float, dimension: int) -> None:
    def moment(n: int) -> float:
        weight = lambda s: s ** (n + dimension - 1) * math.exp(-stretching * (s - length) ** 2 / (2 * 4.0))  # noqa: E731
        return float(integrate.quad(weight, 0, length + 15, points=[length], limit=300, epsrel=1e-12)[0])

    mean, square = moment(1) / moment(0), moment(2) / moment(0)
    found = wlc.bond_length_variance(length, stretching, 4.0, dimension=dimension)
    assert found == pytest.approx(square - mean**2, rel=1e-8)


def test_wrong_sizes_are_refused() -> None:
    with pytest.raises(ValueError, match="`mean_cosine` must lie in"):
        wlc.mean_squared_radius_of_gyration_discrete(3, 1.0, 1.1)
    with pytest.raises(ValueError, match="`bond_variance` must not be negative"):
        wlc.mean_squared_end_to_end_discrete(3, 1.0, 0.5, bond_variance=-1.0)
    with pytest.raises(ValueError, match="`correlation` must begin with 1"):
        wlc.mean_squared_sizes([0.9, 0.8], 1.0)
    with pytest.raises(ValueError, match="`contour_length` must be positive"):
        wlc.mean_squared_radius_of_gyration(1.0, 0.0)


# --- sampling -----------------------------------------------------------------------------------------------------


def test_sampled_helices_have_the_exact_sizes(rng: np.random.Generator) -> None:
    """Beads with soft bonds, bends and torsion, drawn from equilibrium; theory from the product of rotations."""
    terms = (
        of.stretching.Harmonic(60 * KJ / NM**2, rest_length=2 * NM),
        of.bending.Harmonic(30 * KJ, rest_angle=0.5 * unit.radian),
        of.torsion.Harmonic(10 * KJ, rest_angle=0.6 * unit.radian),
    )
    filament = of.Filament(of.shapes.helix(13, radius=3 * NM, pitch=6 * NM, turns=2), 300 * unit.dalton, terms)
    kT = of.units.BOLTZMANN * 300
    correlation = wlc.tangent_correlation_discrete(12, bending=30, kT=kT, rest_angle=0.5, torsion=10, rest_torsion=0.6)
    mean, variance = (f(2.0, 60.0, kT) for f in (wlc.mean_bond_length, wlc.bond_length_variance))
    end, gyration = wlc.mean_squared_sizes(correlation, float(mean), bond_variance=float(variance))
    x = equilibrium_starts(filament, 0.0, 300.0, 1500, rng)
    for found, exact in (
        (analysis.mean_squared_end_to_end(x), end),
        (analysis.mean_squared_radius_of_gyration(x), gyration),
    ):
        assert abs(found.value - exact) < tol.SIGMAS * found.error
        assert found.error < 0.02 * exact
        assert found.effective_samples > 700


def test_a_run_in_openmm_from_its_trajectory(tmp_path: Path) -> None:
    """Two chains under a Langevin thermostat, in scaled units: written, loaded by `load`, and held against the theory."""
    kelvin = 300 * unit.kelvin
    small = 0.02 * NM  # an Angstrom chain: the model is scaled
    terms = (
        of.stretching.Harmonic(5e5 * KJ / NM**2),
        of.bending.Harmonic(12 * KJ),
    )
    filament = of.Filament(of.shapes.line(8, small), 300 * unit.dalton, terms)
    model = of.build([filament, filament])
    assert not model.scale.is_identity
    integrator = of.langevin(model, kelvin, seed=3)
    simulation = app.Simulation(model.topology, model.system, integrator, mm.Platform.getPlatformByName("Reference"))
    simulation.context.setPositions(model.positions)
    simulation.step(500)
    simulation.reporters.append(of.trajectory_reporter(model, tmp_path / "run.dcd", 20))
    simulation.step(24_000)
    frames = of.load(tmp_path / "run.dcd")
    assert isinstance(frames, mdtraj.Trajectory)

    kT = of.units.BOLTZMANN * 300
    cosine, mean = float(wlc.mean_cosine(12 / kT)), float(wlc.mean_bond_length(0.02, 5e5, kT))
    variance = float(wlc.bond_length_variance(0.02, 5e5, kT))
    end = analysis.mean_squared_end_to_end(frames)
    gyration = analysis.mean_squared_radius_of_gyration(frames)
    lp = analysis.persistence_length(frames)
    arguments = (8, mean, cosine)
    for found, exact in (
        (end, wlc.mean_squared_end_to_end_discrete(*arguments, bond_variance=variance)),
        (gyration, wlc.mean_squared_radius_of_gyration_discrete(*arguments, bond_variance=variance)),
        (lp, -mean / math.log(cosine)),
    ):
        assert found.error < 0.1 * exact
        assert abs(found.value - exact) < tol.SIGMAS * found.error
    both = [mdtraj.compute_rg(frames.atom_slice(range(9 * i, 9 * i + 9))) for i in range(2)]
    assert gyration.value == pytest.approx(float(np.mean(np.square(both))), rel=1e-5)


# --- means of correlated samples ----------------------------------------------------------------------------------


def test_independent_samples_have_the_usual_error(rng: np.random.Generator) -> None:
    x = rng.normal(3.0, 2.0, (500, 4))
    found = analysis.average(x)
    assert found.value == pytest.approx(x.mean(), rel=1e-14)
    assert found.error == pytest.approx(x.std() / math.sqrt(2000), rel=tol.ERROR_OF_ERROR)


def test_errors_of_correlated_samples_cover_as_often_as_they_say() -> None:
    """An autoregressive series, `x' = a x + noise`, of integrated time `(1 + a)/(2 (1 - a))`."""
    rng, series, a = np.random.default_rng(2), 300, 0.8
    noise = rng.normal(size=(800, series, 2)) * math.sqrt(1 - a**2)
    x = np.empty_like(noise)
    x[0] = rng.normal(size=(series, 2))
    for i in range(1, len(x)):
        x[i] = a * x[i - 1] + noise[i]
    found = [analysis.average(x[:, s]) for s in range(series)]
    z = np.array([each.value / each.error for each in found])
    for width, share in ((1.0, 0.6827), (1.96, 0.95)):
        assert stats.binomtest(int((np.abs(z) < width).sum()), series, share).pvalue > tol.COVERAGE
    assert np.mean([each.autocorrelation_time for each in found]) == pytest.approx(4.5, rel=tol.ERROR_OF_ERROR)
    naive = np.array([each.value / (x[:, s].std() / 40) for s, each in enumerate(found)])
    assert stats.binomtest(int((np.abs(naive) < 1.96).sum()), series, 0.95).pvalue < tol.COVERAGE


def test_the_error_agrees_with_arviz(rng: np.random.Generator) -> None:
    """Geyer's rule there, Wolff's here, on relaxation without oscillation, where both hold."""
    x = rng.normal(size=(6000, 4))
    for i in range(1, len(x)):
        x[i] += 0.8 * x[i - 1]
    other = array_stats.mcse(x[1000:].T, chain_axis=0, draw_axis=1, method="mean")
    assert analysis.average(x[1000:]).error == pytest.approx(float(other), rel=tol.ERROR_OF_ERROR)


def test_the_error_of_a_damped_oscillation() -> None:
    """`x'' = 1.6 x' - 0.8 x + noise`, like chains under little friction: the exact variance of its mean is 25/n."""
    rng, series = np.random.default_rng(3), 40
    x = rng.normal(size=(2500, series, 4))
    for i in range(2, len(x)):
        x[i] += 1.6 * x[i - 1] - 0.8 * x[i - 2]
    errors = [analysis.average(x[500:, s]).error for s in range(series)]
    assert np.mean(errors) == pytest.approx(5 / math.sqrt(8000), rel=0.05)


def test_runs_that_stay_apart_have_the_error_of_their_scatter(rng: np.random.Generator) -> None:
    """Eight runs, each stuck at its own value: little more is known than from eight numbers."""
    stuck = rng.normal(size=8)
    found = analysis.average(np.tile(stuck, (200, 1)) + 0.01 * rng.normal(size=(200, 8)))
    assert 0.4 < found.error / (stuck.std() / math.sqrt(8)) < 2.5
    assert found.effective_samples < 40


def test_degenerate_samples() -> None:
    assert analysis.average([2.0, 2.0, 2.0, 2.0]).error == 0.0
    assert math.isnan(analysis.average([1.0, 2.0]).error)
    with pytest.raises(ValueError, match="`samples` must have shape"):
        analysis.average(np.zeros((2, 2, 2)))
    with pytest.raises(ValueError, match="`samples` must be finite"):
        analysis.average([1.0, math.nan])
