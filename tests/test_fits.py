"""Fits of force-extension curves: what they recover, what their intervals are worth, and what they refuse."""

from __future__ import annotations

import math
import os
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tolerances as tol
from conftest import Array
from openmm import unit
from scipy import optimize, stats

import openmm_filament as of
from openmm_filament import analysis, wlc
from openmm_filament.analysis import Curve, fit_force_extension, read_curve
from openmm_filament.analysis.extension_models import extension_of
from openmm_filament.analysis.least_squares import Problem, minimise, profile

KELVIN = 298.0
KT = 0.01380649 * KELVIN
FORCES = np.geomspace(0.05, 50, 12)
STRONG = np.geomspace(0.6, 60, 12)  # F l_p/kT from 8 up, where Odijk holds
DNA = {"persistence_length": 53.0, "contour_length": 1000.0, "stretch_modulus": 1000.0}
SEEDS = 120


def exact(forces: Array, *, finite: bool = True, stretch_modulus: float | None = 1000.0) -> Array:
    return np.asarray(wlc.extension_exact(forces, 53.0, 1000.0, KT, stretch_modulus=stretch_modulus, finite=finite))


@pytest.mark.parametrize(
    ("model", "extensible"),
    [("exact", True), ("exact", False), ("exact_infinite", True), ("odijk", True), ("bouchiat", False), ("marko_siggia", False)],
)  # fmt: skip
def test_curves_without_noise_give_their_parameters_back(model: Any, extensible: bool) -> None:
    forces = STRONG if model == "odijk" else FORCES
    extension = extension_of(model, forces, DNA | ({} if extensible else {"stretch_modulus": math.inf}), KT, 3)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "The model 'marko_siggia' is off the exact chain")
        found = fit_force_extension(
            Curve(forces, extension, 0.005 * extension),
            model=model,
            temperature=KELVIN,
            stretch_modulus="fit" if extensible else None,
        )
    for name, value in found.values.items():
        wanted = DNA[name] if extensible or name != "stretch_modulus" else math.inf
        assert value == pytest.approx(wanted, rel=tol.FITTED), name
    assert found.chi_squared < 1e-6
    assert found.degrees_of_freedom == 12 - (3 if extensible else 2)
    np.testing.assert_allclose(found.extension(forces), extension, rtol=1e-6)


def test_two_dimensions() -> None:
    forces = np.geomspace(0.05, 5, 8)
    extension = np.asarray(wlc.extension_exact(forces, 53.0, 300.0, KT, finite=True, dimension=2))
    found = fit_force_extension(Curve(forces, extension, 0.01 * extension, dimension=2), temperature=KELVIN)
    assert found.values["persistence_length"] == pytest.approx(53.0, rel=tol.FITTED)


def noisy(rng: np.random.Generator, relative: float = 0.005) -> Curve:
    """A curve by Odijk's formula, whose fits are quick."""
    extension = np.asarray(wlc.extension_odijk(STRONG, 53.0, 1000.0, KT, 1000.0))
    error = relative * extension
    return Curve(STRONG, extension + error * rng.normal(size=len(error)), error)


@pytest.fixture(scope="module")
def fits() -> list[analysis.ForceExtensionFit]:
    rng = np.random.default_rng(5)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "The model 'odijk' does not describe")  # one curve in a thousand
        return [
            fit_force_extension(noisy(rng), model="odijk", temperature=KELVIN, stretch_modulus="fit")
            for _ in range(SEEDS)
        ]


def test_fitted_parameters_are_unbiased(fits: list[analysis.ForceExtensionFit]) -> None:
    for name, value in DNA.items():
        # 1/S is what is nearly linear in the data
        power = -1 if name == "stretch_modulus" else 1
        values = np.array([fit.values[name] ** power for fit in fits])
        z = (values.mean() - value**power) / (values.std(ddof=1) / math.sqrt(SEEDS))
        assert abs(z) < tol.SIGMAS, (name, z)


def test_intervals_cover_as_often_as_they_say(fits: list[analysis.ForceExtensionFit]) -> None:
    for name, value in DNA.items():
        inside = sum(fit.intervals[name][0] <= value <= fit.intervals[name][1] for fit in fits)
        assert stats.binomtest(inside, SEEDS, 0.95).pvalue > tol.COVERAGE, (name, inside)


def test_chi_squared_is_distributed_as_one(fits: list[analysis.ForceExtensionFit]) -> None:
    assert stats.kstest([fit.probability for fit in fits], "uniform").pvalue > tol.COVERAGE


def test_intervals_too_narrow_by_a_third_fail_the_test_of_coverage(fits: list[analysis.ForceExtensionFit]) -> None:
    inside = sum(abs(fit.values["contour_length"] - 1000) <= 1.96 / 1.5 * fit.errors["contour_length"] for fit in fits)
    assert stats.binomtest(inside, SEEDS, 0.95).pvalue < tol.COVERAGE


@pytest.mark.slow
def test_intervals_of_the_exact_model_cover_as_often_as_they_say() -> None:
    rng, inside, seeds = np.random.default_rng(6), np.zeros(3), 30 if os.environ.get("OPENMM_FILAMENT_SHORT") else 60
    extension = exact(FORCES)
    for _ in range(seeds):
        data = Curve(FORCES, extension * (1 + 0.005 * rng.normal(size=12)), 0.005 * extension)
        found = fit_force_extension(data, temperature=KELVIN, stretch_modulus="fit")
        inside += [found.intervals[name][0] <= DNA[name] <= found.intervals[name][1] for name in DNA]
    assert all(stats.binomtest(int(n), seeds, 0.95).pvalue > tol.COVERAGE for n in inside)


def test_values_and_covariance_agree_with_scipy_and_with_gauss_newton(rng: np.random.Generator) -> None:
    extension = exact(FORCES)
    data = Curve(FORCES, extension * (1 + 0.005 * rng.normal(size=12)), 0.005 * extension)
    found = fit_force_extension(data, temperature=KELVIN, stretch_modulus="fit")

    def model(force: Array, lp: float, length: float, modulus: float) -> Array:
        return np.asarray(wlc.extension_exact(force, lp, length, KT, stretch_modulus=modulus, finite=True))

    values, covariance = optimize.curve_fit(
        model, FORCES, data.extension, (50.0, 1020.0, 800.0), data.extension_error, absolute_sigma=True
    )
    np.testing.assert_allclose(list(found.values.values()), values, rtol=tol.OTHER_FIT)
    np.testing.assert_allclose(found.covariance, covariance, rtol=tol.OTHER_COVARIANCE)

    at = np.array([50.0, 1020.0, 1000.0])
    for _ in range(12):  # by hand, from differences of the theory
        steps = 1e-5 * at
        jacobian = np.stack(
            [(model(FORCES, *(at + h)) - model(FORCES, *(at - h))) / (2 * h.sum()) for h in np.diag(steps)]
        )
        jacobian /= data.extension_error
        residual = (data.extension - model(FORCES, *at)) / data.extension_error
        at = at + np.linalg.solve(jacobian @ jacobian.T, jacobian @ residual)
    np.testing.assert_allclose(list(found.values.values()), at, rtol=tol.OTHER_FIT)


def test_intervals_without_errors_agree_with_lmfit(rng: np.random.Generator) -> None:
    lmfit = pytest.importorskip("lmfit")
    curve = noisy(rng)
    data = Curve(curve.force, curve.extension)
    found = fit_force_extension(data, model="odijk", temperature=KELVIN, stretch_modulus=1000.0)
    assert math.isnan(found.probability)

    def residual(parameters: Any) -> Array:
        lp, length = parameters["lp"].value, parameters["length"].value
        return data.extension - np.asarray(wlc.extension_odijk(data.force, lp, length, KT, 1000.0))

    parameters = lmfit.create_params(lp=50.0, length=990.0)
    fitter = lmfit.Minimizer(residual, parameters)
    best = fitter.minimize()
    intervals = lmfit.conf_interval(fitter, best, sigmas=[0.95])
    for name, ours in (("lp", "persistence_length"), ("length", "contour_length")):
        assert found.values[ours] == pytest.approx(best.params[name].value, rel=tol.OTHER_FIT)
        assert found.errors[ours] == pytest.approx(best.params[name].stderr, rel=tol.OTHER_COVARIANCE)
        ends = [end for _, end in intervals[name]]
        width = ends[2] - ends[0]
        np.testing.assert_allclose(found.intervals[ours], (ends[0], ends[2]), atol=tol.INTERVAL * width)


@pytest.mark.filterwarnings("ignore:The model 'odijk' is off the exact chain")  # for so little noise it is
def test_intervals_without_errors_go_with_the_noise() -> None:
    """A thousandth of the noise leaves a thousandth of the interval, though no error is given."""
    widths = []
    for relative in (5e-3, 5e-6):
        curve = noisy(np.random.default_rng(7), relative)
        data = Curve(curve.force, curve.extension)
        found = fit_force_extension(
            data, model="odijk", temperature=KELVIN, contour_length=1000.0, stretch_modulus=1000.0
        )
        low, high = found.intervals["persistence_length"]
        assert low < 53 < high
        widths.append(high - low)
    assert widths[0] / widths[1] == pytest.approx(1000, rel=0.05)


def test_a_profile_agrees_with_a_grid() -> None:
    """`y = a exp(b x)` with large errors: the interval of b is not symmetric."""
    x = np.linspace(0, 1, 6)
    y = np.array([1.0, 0.9, 0.5, 0.6, 0.2, 0.3])
    problem = Problem(lambda p: (y - p[0] * np.exp(p[1] * x)) / 0.2, np.full(2, -20.0), np.full(2, 20.0))
    best = minimise(problem, np.array([1.0, -1.0]))
    low, high = profile(problem, best, 1, 0.95, None)
    b = np.linspace(-6, 1, 70_001)
    shape = np.exp(b[:, None] * x)
    a = shape @ y / (shape**2).sum(axis=1)  # the best amplitude is linear
    chi = ((y - a[:, None] * shape) ** 2).sum(axis=1) / 0.04
    inside = b[chi < chi.min() + stats.chi2.ppf(0.95, 1)]
    width = high - low
    np.testing.assert_allclose((low, high), (inside[0], inside[-1]), atol=tol.INTERVAL * width)
    assert (best.at[1] - low) / (high - best.at[1]) > 1.2


def test_errors_of_forces_count_by_the_slope(rng: np.random.Generator) -> None:
    """An extension clamp: forces scatter by 5 % about those of the exact extensions."""
    pulls, found = [], []
    extension = np.asarray(wlc.extension_odijk(STRONG, 53.0, 1000.0, KT, 1000.0))
    for _ in range(60):
        error = 0.05 * STRONG
        data = Curve(STRONG + error * rng.normal(size=12), extension, force_error=error)
        fit = fit_force_extension(data, model="odijk", temperature=KELVIN, stretch_modulus=1000.0)
        found.append(fit.values["persistence_length"])
        pulls.append([(fit.values[name] - DNA[name]) / fit.errors[name] for name in fit.fitted])
    assert np.mean(found) == pytest.approx(53.0, rel=tol.FORCE_ERRORS)
    assert stats.kstest(np.ravel(pulls), "norm").pvalue > tol.COVERAGE


def test_a_simulated_curve_gives_the_chain_back() -> None:
    """Real sampling with coarse segments, whose bias is known and taken off; the raw curve is fitted worse."""
    dna = of.WormlikeChain(300 * unit.nanometer, 53 * unit.nanometer, 1000 * unit.piconewton)
    curve = of.force_extension(dna, [0.2, 0.8, 4, 20] * unit.piconewton, KELVIN * unit.kelvin, 0.05, processes=2)
    found = fit_force_extension(curve, stretch_modulus=1000.0)
    assert found.temperature == KELVIN
    for name, value in (("persistence_length", 53.0), ("contour_length", 300.0)):
        assert abs(found.values[name] - value) < tol.SIGMAS * found.errors[name], name
    assert found.errors["persistence_length"] < 0.2 * 53
    np.testing.assert_allclose(found.curve.extension, curve.extension - curve.bias - curve.time_step_bias, rtol=1e-12)


# --- what is told -------------------------------------------------------------------------------------------------


def test_a_parameter_without_effect_is_told() -> None:
    weak = FORCES[FORCES < 2]
    extension = exact(weak)
    with pytest.warns(UserWarning, match="do not determine stretch_modulus: .* to inf"):
        found = fit_force_extension(Curve(weak, extension, 0.01 * extension), temperature=KELVIN, stretch_modulus="fit")
    assert found.intervals["stretch_modulus"][1] == math.inf
    assert found.intervals["stretch_modulus"][0] < 1000


@pytest.mark.parametrize("errors", [None, 1.0])
@pytest.mark.parametrize("model", ["exact", "exact_infinite"])
def test_one_force_alone_does_not_tell_two_lengths_apart(errors: float | None, model: Any) -> None:
    """Any persistence length has its contour length: errors are infinite, though the sum of squares has a least value."""
    one = Curve([1.0] * 4, [780.0, 781.0, 779.0, 780.5], errors)
    with pytest.warns(UserWarning, match="do not determine") as told:
        found = fit_force_extension(one, model=model, temperature=KELVIN)
    for name in found.fitted:
        assert found.errors[name] == math.inf
        assert found.intervals[name] == (0, math.inf)
        assert any(f"do not determine {name}" in str(w.message) for w in told)
    assert np.isinf(np.diag(found.covariance)).all()
    assert np.isnan(found.covariance[0, 1])
    alone = fit_force_extension(one, model=model, temperature=KELVIN, contour_length=1000.0)
    assert alone.errors["persistence_length"] < 0.02 * alone.values["persistence_length"]


def test_a_modulus_from_low_forces_alone_is_told_though_lengths_are_given() -> None:
    """The extension grows by F/S beside 2 F l_p/(3 kT): 1e-5 of it here, against errors of a per cent."""
    low = np.geomspace(1e-3, 1e-2, 6)
    extension = exact(low, finite=False)
    with pytest.warns(UserWarning, match="do not determine stretch_modulus: .* to inf"):
        found = fit_force_extension(
            Curve(low, extension, 0.01 * extension),
            model="exact_infinite", temperature=KELVIN, persistence_length=53.0, contour_length=1000.0, stretch_modulus="fit",
        )  # fmt: skip
    assert found.errors["stretch_modulus"] > found.values["stretch_modulus"]


@pytest.mark.filterwarnings("ignore:The model 'odijk'")  # which does not hold there
def test_a_parameter_that_changes_nothing_is_told() -> None:
    """Below its range Odijk's chain is as short as it gets, whatever its lengths: its error was 0."""
    low = np.geomspace(1e-4, 1e-3, 6)
    with pytest.warns(UserWarning, match="do not determine") as told:
        found = fit_force_extension(
            Curve(low, exact(low, finite=False), 1.0), model="odijk", temperature=KELVIN, stretch_modulus="fit"
        )
    for name in DNA:
        assert found.errors[name] == math.inf
        assert any(f"do not determine {name}" in str(w.message) for w in told)


@pytest.mark.parametrize(("points", "errors"), [(2, 1.0), (3, None), (1, 1.0)])
def test_fewer_points_than_parameters_are_refused(points: int, errors: float | None) -> None:
    forces = FORCES[:points]
    with pytest.raises(
        ValueError, match=rf"`data` must hold .* 3 points to fit so many parameters, but holds {points}"
    ):
        fit_force_extension(Curve(forces, exact(forces), errors), temperature=KELVIN, stretch_modulus="fit")


def test_errors_of_what_hardly_differs_are_those_of_more_digits() -> None:
    """A Jacobian whose columns agree to 1e-6: `J^T J` has lost what the singular values still tell."""
    x = np.linspace(0, 1, 30)
    columns = np.stack([1 + 0 * x, 1 + 1e-6 * x], axis=1)
    problem = Problem(lambda at: columns @ (at - 0.5), np.full(2, -1e9), np.full(2, 1e9))
    best = minimise(problem, np.zeros(2))
    slope = np.stack([1 + 0 * x, x], axis=1)  # the same line, its slope being 1e-6 of the second parameter
    wanted = 1e12 * np.linalg.inv(slope.T @ slope)[1, 1]
    assert not best.undetermined.any()
    assert best.covariance[1, 1] == pytest.approx(wanted, rel=1e-3)
    twin = Problem(lambda at: np.stack([1 + 0 * x, x, 2 * x], axis=1) @ at - x, np.full(3, -1e9), np.full(3, 1e9))
    best = minimise(twin, np.zeros(3))
    assert best.undetermined.tolist() == [False, True, True]
    assert best.covariance[0, 0] == pytest.approx(np.linalg.inv(slope.T @ slope)[0, 0], rel=1e-3)
    assert profile(twin, best, 1, 0.95, None) == (-math.inf, math.inf)


def test_a_chain_that_seems_to_shrink_has_an_infinite_modulus() -> None:
    extension = np.asarray(wlc.extension_odijk(STRONG, 53.0, 1000.0, KT, 1000.0)) - STRONG * 1.1
    with pytest.warns(UserWarning, match="do not determine stretch_modulus: .* to inf"):
        found = fit_force_extension(
            Curve(STRONG, extension, 0.005 * extension), model="odijk", temperature=KELVIN, stretch_modulus="fit"
        )
    assert found.values["stretch_modulus"] > 1e12  # its inverse is at its bound, 0
    assert found.intervals["stretch_modulus"][1] == math.inf
    assert 0 < found.intervals["stretch_modulus"][0] < math.inf


@pytest.mark.parametrize(("model", "forces"), [("marko_siggia", FORCES), ("odijk", FORCES)])
def test_a_model_outside_its_range_is_told_with_the_shift_it_brings(model: Any, forces: Array) -> None:
    extension = exact(forces, finite=False, stretch_modulus=None)
    with pytest.warns(UserWarning, match=f"'{model}' is off the exact chain") as told:
        found = fit_force_extension(Curve(forces, extension, 0.005 * extension), model=model, temperature=KELVIN)
    message = next(str(w.message) for w in told if "off the exact" in str(w.message))
    shift = float(message.split("persistence_length by about ")[1].split(",")[0])
    assert shift == pytest.approx(found.values["persistence_length"] - 53.0, rel=tol.SHIFT)


def test_bouchiat_is_good_enough_for_half_a_per_cent() -> None:
    extension = exact(FORCES, finite=False, stretch_modulus=None)
    found = fit_force_extension(Curve(FORCES, extension, 0.005 * extension), model="bouchiat", temperature=KELVIN)
    assert found.values["persistence_length"] == pytest.approx(53.0, rel=0.005)


def test_a_model_that_does_not_describe_the_data_is_told() -> None:
    extension = exact(FORCES)
    with pytest.warns(UserWarning, match="does not describe the data"):
        fit_force_extension(Curve(FORCES, extension, 0.002 * extension), temperature=KELVIN)


# --- files and datasets -------------------------------------------------------------------------------------------


def test_files_are_read_by_their_columns(tmp_path: Path) -> None:
    extension = exact(FORCES)
    own, other = tmp_path / "own.csv", tmp_path / "other.csv"
    rows = [f"{f!r},{z!r},{0.005 * z!r}" for f, z in zip(FORCES.tolist(), extension.tolist(), strict=True)]
    own.write_text("\n".join(["force_pN,extension_nm,extension_error_nm", *rows]) + "\n")
    rows = [f"a,{f / 1000!r},{z / 1000!r}\nb,1,1" for f, z in zip(FORCES.tolist(), extension.tolist(), strict=True)]
    other.write_text("\n".join(["which,F (nN),z (um)", *rows]) + "\n")
    found = fit_force_extension(own, temperature=KELVIN, stretch_modulus=1000.0)
    assert found.values["persistence_length"] == pytest.approx(53.0, rel=tol.FITTED)
    np.testing.assert_array_equal(found.curve.extension_error, [0.005 * z for z in extension])
    curve = read_curve(other, force="F (nN)", extension="z (um)", pN=1000, nm=1000, where={"which": "a"})
    np.testing.assert_allclose(curve.force, FORCES)
    np.testing.assert_allclose(curve.extension, extension)
    assert curve.extension_error is None
    with pytest.raises(ValueError, match="a column 'force_pN', but"):
        read_curve(other)
    with pytest.raises(ValueError, match="rows where"):
        read_curve(other, force="F (nN)", extension="z (um)", where={"which": "c"})
    own.write_text("force_pN,extension_nm\n1,two\n")
    with pytest.raises(ValueError, match="'two' under 'extension_nm'"):
        read_curve(own)


def test_a_dataset_loses_the_forces_that_were_given_up() -> None:
    import xarray

    extension = exact(FORCES)
    extension[3] = math.nan
    data = xarray.Dataset(
        {"extension": ("force", extension), "extension_error": ("force", 0.005 * extension)},
        coords={"force": FORCES},
        attrs={"temperature_K": KELVIN},
    )
    found = fit_force_extension(data, stretch_modulus=1000.0)
    assert len(found.curve) == 11
    assert found.values["persistence_length"] == pytest.approx(53.0, rel=tol.FITTED)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"model": "wlc"}, "`model` must be one of 'exact'"),
        ({"temperature": None}, "`temperature` must be given"),
        ({"temperature": -1.0}, "`temperature` must be positive"),
        ({"model": "bouchiat", "stretch_modulus": 1000.0}, "`stretch_modulus` must be None for 'bouchiat'"),
        ({"persistence_length": "vary"}, "`persistence_length` must be one of 'fit'"),
        ({"persistence_length": 53.0, "contour_length": 1000.0}, "all are fixed"),
        ({"contour_length": -1.0}, "`contour_length` must be positive"),
        ({"start": {"stretch_modulus": 3.0}}, "`start` must be one of"),
        ({"level": 1.0}, r"`level` must lie in \(0, 1\)"),
    ],
)
def test_wrong_arguments_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        fit_force_extension(Curve(FORCES, exact(FORCES)), **{"temperature": KELVIN, **options})


def test_wrong_data_are_refused() -> None:
    with pytest.raises(TypeError, match="must be a Curve, the path"):
        fit_force_extension(3.0, temperature=KELVIN)
    with pytest.raises(ValueError, match="`force` must be positive"):
        Curve([0.0, 1.0], [1.0, 2.0])
    with pytest.raises(ValueError, match="`extension` must have shape"):
        Curve([1.0, 2.0], [1.0])
    with pytest.raises(ValueError, match="`extension_error` must be positive"):
        Curve([1.0], [1.0], 0.0)
    with pytest.raises(ValueError, match="more than 2 points"):
        fit_force_extension(Curve([1.0, 2.0], [100.0, 150.0]), temperature=KELVIN)
    with pytest.raises(ValueError, match="at least 3 points"):
        fit_force_extension(Curve([1.0, 2.0], [100.0, 150.0], 1.0), temperature=KELVIN, stretch_modulus="fit")
    with pytest.raises(ValueError, match="point against it"):
        fit_force_extension(Curve(FORCES, -exact(FORCES)), temperature=KELVIN)
    with pytest.raises(ValueError, match="hold in two dimensions"):
        fit_force_extension(Curve(FORCES, exact(FORCES), dimension=2), model="bouchiat", temperature=KELVIN)


def test_the_known_bias_of_a_file_is_taken_off(tmp_path: Path) -> None:
    """As the systems write them: where the exact extensions of both chains stand beside those sampled."""
    path = tmp_path / "curve.csv"
    path.write_text(
        "\ufeffforce_pN,extension_nm,extension_error_nm,exact_discrete_nm,exact_continuous_nm\n1,105,1,104,100\n2,210,1,202,200\n",
        encoding="utf-8",
    )
    assert read_curve(path).extension.tolist() == [101.0, 208.0]
    assert read_curve(path, extension="exact_discrete_nm").extension[0] == 104.0
