"""Clamps and ramps against exact answers: quadrature of short chains, transforms of free joints, the exact discrete chain."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
import tolerances as tol
from conftest import KJ, NM, Array
from openmm import unit
from scipy import integrate, optimize
from scipy.special import logsumexp

import openmm_filament as of
from openmm_filament import parallel, protocols

PN = unit.piconewton
STIFF = KJ / NM**2
KELVIN = 300.0
WARM = KELVIN * unit.kelvin
KT = of.units.BOLTZMANN * KELVIN
FORCE = 0.602214076  # kJ/mol/nm in a pN
LENGTH, BOND, JOINT = 2.0, 60.0, 5.0  # nm, kJ/mol/nm^2, kJ/mol


@pytest.fixture(autouse=True)
def in_process(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    """Tasks one after another in this process, where a test does not ask for workers."""
    if "workers" not in request.fixturenames:
        monkeypatch.setattr(protocols, "run_all", one_by_one)


def one_by_one(function: Callable[[Any], Any], tasks: Any, workers: int, progress: Any) -> list[Any]:
    return [function(task) for task in tasks]


@pytest.fixture
def workers() -> None:
    """Worker processes as in use."""


def chain(bonds: int, joint: float = 0.0, bond: float = BOND) -> of.Filament:
    terms: tuple[Any, ...] = (of.stretching.Harmonic(bond * KJ / NM**2),)
    if joint:
        terms += (of.bending.Harmonic(joint * KJ),)
    return of.Filament(of.shapes.line(bonds, LENGTH * NM), 100 * unit.dalton, terms)


# Exact answers ------------------------------------------------------------------------------------------------------


def force_of_two_bonds(distance: float) -> float:
    """-k_B T d ln Z/dR in pN of two bonds with a joint, by quadrature over the middle bead (along z, and off the axis)."""
    z, rho = np.meshgrid(np.linspace(-3, distance + 3, 801), np.linspace(1e-6, 4, 801), indexing="ij")

    def log_z(end: float) -> float:
        first, second = np.hypot(z, rho), np.hypot(end - z, rho)
        cosine = (z * (end - z) - rho**2) / (first * second)
        energy = BOND / 2 * ((first - LENGTH) ** 2 + (second - LENGTH) ** 2)
        energy += JOINT / 2 * np.arccos(np.clip(cosine, -1, 1)) ** 2
        return float(logsumexp(np.log(rho) - energy / KT))

    return -KT * (log_z(distance + 1e-3) - log_z(distance - 1e-3)) / 2e-3 / FORCE


@cache
def free_joints(bonds: int) -> tuple[Array, Array]:
    """Distances and density of the end-to-end vector of freely jointed springs, by the transform of one bond."""
    s = np.linspace(1e-4, 2 * LENGTH, 2001)
    weight = s**2 * np.exp(-BOND / 2 * (s - LENGTH) ** 2 / KT)
    q = np.linspace(1e-6, 30, 3001)
    one = integrate.simpson(weight * np.sinc(np.outer(q, s) / np.pi), x=s) / integrate.simpson(weight, x=s)
    r = np.linspace(1e-3, 1.6 * bonds * LENGTH, 1201)
    kernel = q**2 * np.sinc(np.outer(r, q) / np.pi)
    return r, integrate.simpson(kernel * one**bonds, x=q) / (2 * np.pi**2)


def force_of_free_joints(bonds: int, distance: float) -> float:
    """-k_B T d ln P/dR in pN."""
    r, density = free_joints(bonds)
    here = np.abs(r - distance) < 0.5
    slope = np.polyder(np.polyfit(r[here] - distance, np.log(density[here]), 6))
    return -KT * float(np.polyval(slope, 0.0)) / FORCE


def in_trap(bonds: int, position: float, k: float) -> float:
    """ln of the partition function of freely jointed springs in an isotropic trap, k in kJ/mol/nm^2."""
    r, density = free_joints(bonds)
    x = k * r * position / KT  # the mean over directions of exp(x cos) is sinh(x)/x
    log = np.log(r**2 * np.maximum(density, 0) + 1e-300) - k * (r - position) ** 2 / (2 * KT)
    log += np.log(-np.expm1(-2 * x) / (2 * x))
    return float(logsumexp(log))


# Clamps -------------------------------------------------------------------------------------------------------------


def test_an_extension_clamp_reads_the_force_of_two_bonds_by_quadrature() -> None:
    places = np.array([2.5, 4.4])
    held = of.clamp(chain(2, JOINT), WARM, extension=places * NM, replicas=48, duration=1 * unit.nanosecond)
    exact = np.array([force_of_two_bonds(r) for r in places])
    assert held.force.dims == ("extension",)
    assert held.force_of_replica.shape == (2, 48)
    assert (np.abs(held.force - exact) < tol.SIGMAS * held.force_error).all()
    assert held.force_error[1] < 0.01 * exact[1]


def test_an_extension_clamp_of_free_joints_reads_the_slope_of_their_distribution() -> None:
    held = of.clamp(chain(5), WARM, extension=[5.0, 8.5] * NM, replicas=24)
    exact = [force_of_free_joints(5, r) for r in held.extension.values]
    assert (np.abs(held.force - exact) < tol.SIGMAS * held.force_error).all()
    assert held.force_error[1] < 0.02 * exact[1]


def test_a_trap_at_rest_reads_force_and_extension_of_the_exact_chain_in_it() -> None:
    k, places = 4.0, np.array([6.0, 10.0])
    held = of.clamp(chain(5), WARM, trap=places * NM, stiffness=k * KJ / NM**2, replicas=48)
    for i, place in enumerate(places):
        force = -KT * (in_trap(5, place + 1e-3, k) - in_trap(5, place - 1e-3, k)) / 2e-3
        assert abs(held.force[i] - force / FORCE) < tol.SIGMAS * held.force_error[i]
        assert abs(held.extension[i] - (place - force / k)) < tol.SIGMAS * held.extension_error[i]
        assert held.extension_error[i] < 0.01 * held.extension[i]
    np.testing.assert_allclose(held.force, k * (places - held.extension) / FORCE, rtol=1e-9)
    assert held.attrs["stiffness_pN_per_nm"] == pytest.approx([k / FORCE] * 3)
    assert held.force.attrs["units"] == "pN"


# Ramps --------------------------------------------------------------------------------------------------------------


@cache
def pulled() -> tuple[Any, float]:
    """A worm-like chain of 6 bonds from 2 to 12 pN and back, and its exact free energy in kJ/mol."""
    filament = chain(6, JOINT)
    way = of.ramp(filament, WARM, 200 * unit.picosecond, force=[2, 12] * PN, points=20, replicas=160)
    forces = np.linspace(2, 12, 81)
    exact = of.exact_extension(filament, forces * PN, WARM).value_in_unit(NM)
    return way, -float(integrate.simpson(exact, x=forces)) * FORCE


def test_the_free_energy_between_two_forces_is_that_of_the_exact_chain() -> None:
    way, exact = pulled()
    found = of.free_energy(way)
    assert abs(found.difference - exact) < tol.SIGMAS * found.error
    assert found.error < 0.005 * abs(exact)
    assert abs(found.forward - exact) < tol.SIGMAS * found.forward_error
    assert abs(found.reverse - exact) < tol.SIGMAS * found.reverse_error
    assert found.overlap > 0.1
    assert found.dissipated_forward + found.dissipated_reverse == pytest.approx(float(way.hysteresis))
    assert way.hysteresis > 3 * way.hysteresis_error


def test_both_ways_begin_in_equilibrium() -> None:
    way, _ = pulled()
    first = way.extension.isel(point=0)
    exact = of.exact_extension(chain(6, JOINT), [2, 12] * PN, WARM).value_in_unit(NM)
    assert (np.abs(first.mean("replica") - exact) < tol.SIGMAS * first.std("replica") / np.sqrt(160)).all()


def test_a_helix_with_torsion_is_led_in_a_trap() -> None:
    helix = of.shapes.helix(12, radius=3 * NM, pitch=5 * NM, turns=1.5)
    terms = (of.stretching.Harmonic(500 * STIFF), of.bending.Harmonic(200 * KJ), of.torsion.Harmonic(40 * KJ))
    filament = of.Filament(helix, 300 * unit.dalton, terms)
    way = of.ramp(
        filament,
        WARM,
        20 * unit.picosecond,
        trap=[8, 10] * NM,
        stiffness=[0, 0, 50] * STIFF,
        points=2,
        replicas=8,
        equilibration=400 * unit.picosecond,
    )
    assert np.isfinite(way.work).all()
    assert way.extension[0, :, -1].mean() > way.extension[0, :, 0].mean()


def test_the_dataset_of_a_ramp_names_what_it_holds() -> None:
    way, _ = pulled()
    assert way.extension.dims == way.work.dims == ("direction", "replica", "point")
    assert way.extension.shape == (2, 160, 21)
    assert way.force.dims == ("direction", "point")
    assert way.force.sel(direction="forward").values == pytest.approx(np.linspace(2, 12, 21))
    assert way.force.sel(direction="reverse").values == pytest.approx(np.linspace(12, 2, 21))
    assert way.time.values == pytest.approx(np.linspace(0, 200, 21))
    assert [way[name].attrs["units"] for name in ("force", "extension", "work", "time")] == ["pN", "nm", "kJ/mol", "ps"]
    assert way.attrs["control"] == "force"
    assert way.attrs["interrupted"] == 0
    assert not way.work[:, :, 0].any()


def test_a_trap_pulled_through_has_the_free_energy_of_the_exact_chain_in_it() -> None:
    k = 4.0
    way = of.ramp(
        chain(5),
        WARM,
        60 * unit.picosecond,
        trap=[5.0, 11.0] * NM,
        stiffness=k * KJ / NM**2,
        points=10,
        replicas=160,
    )
    exact = -KT * (in_trap(5, 11.0, k) - in_trap(5, 5.0, k))
    found = of.free_energy(way)
    assert abs(found.difference - exact) < tol.SIGMAS * found.error
    assert found.error < 0.02 * exact
    read = k * (way.trap - way.extension) / FORCE
    np.testing.assert_allclose(read.transpose(*way.force.dims), way.force, rtol=0, atol=1e-9)


def test_a_clamp_pulled_apart_has_the_free_energy_of_its_distribution() -> None:
    way = of.ramp(chain(5), WARM, 60 * unit.picosecond, extension=[5.0, 8.5] * NM, points=10, replicas=160)
    r, density = free_joints(5)
    exact = -KT * float(np.diff(np.interp([5.0, 8.5], r, np.log(density)))[0])
    found = of.free_energy(way)
    assert abs(found.difference - exact) < tol.SIGMAS * found.error
    assert found.error < 0.03 * exact


def test_slower_ramps_have_less_hysteresis_and_follow_the_exact_curve() -> None:
    filament = chain(6, JOINT)
    fast, slow = (
        of.ramp(filament, WARM, time * unit.picosecond, force=[2, 12] * PN, points=4, replicas=48)
        for time in (10, 1000)
    )
    assert fast.hysteresis - 4 * fast.hysteresis_error > slow.hysteresis + 4 * slow.hysteresis_error
    middle = slow.extension.isel(point=2)
    exact = of.exact_extension(filament, 7 * PN, WARM).value_in_unit(NM)
    error = float(middle.std()) / np.sqrt(middle.size)
    assert abs(float(middle.mean()) - exact) < tol.SIGMAS * error
    assert error < 0.015 * exact


# Free energies ------------------------------------------------------------------------------------------------------


def works(rng: np.random.Generator, change: float, spread: float, count: int = 400) -> tuple[Array, Array]:
    """Works (k_B T) there and back that are normal and obey Crooks's theorem."""
    there, back = rng.normal(size=(2, count)) * spread
    return there + change + spread**2 / 2, back - change + spread**2 / 2


def test_bar_and_jarzynski_are_those_of_their_equations(rng: np.random.Generator) -> None:
    there, back = works(rng, 3.0, 1.2)
    found = of.free_energy_of_works(there * KT * KJ, back * KT * KJ, WARM)

    def imbalance(change: float) -> float:  # Bennett's equation for equal numbers of works
        return float((1 / (1 + np.exp(there - change))).sum() - (1 / (1 + np.exp(back + change))).sum())

    assert found.difference == pytest.approx(KT * optimize.brentq(imbalance, -10, 20), rel=1e-9)
    assert found.forward == pytest.approx(-KT * (logsumexp(-there) - np.log(len(there))))
    assert found.reverse == pytest.approx(KT * (logsumexp(-back) - np.log(len(back))))
    assert abs(found.difference - 3 * KT) < tol.SIGMAS * found.error
    assert found.dissipated_forward == pytest.approx(there.mean() * KT - found.difference)
    assert 0.3 < found.overlap < 0.9


def test_the_overlap_is_one_for_one_distribution_and_warned_of_where_there_is_none(rng: np.random.Generator) -> None:
    same = of.free_energy_of_works(np.full(5, 2.0) * KJ, np.full(5, -2.0) * KJ, WARM)
    assert same.overlap == pytest.approx(1)
    assert same.difference == pytest.approx(2)
    there, back = works(rng, 3.0, 8.0)
    with pytest.warns(UserWarning, match=r"works there and back overlap by .* only, .* k_B T dissipated"):
        of.free_energy_of_works(there * KT * KJ, back * KT * KJ, WARM)


@pytest.mark.parametrize("far", [20.0, 400.0, 4e4, -150.0])
def test_works_that_are_apart_have_an_infinite_error(rng: np.random.Generator, far: float) -> None:
    """And no warnings but the package's own, which pytest would take for errors."""
    there, back = far + rng.normal(size=(2, 40))
    with pytest.warns(
        UserWarning, match=r"overlap by .* only.*: no work there .*, so that its error is infinite"
    ) as told:
        found = of.free_energy_of_works(there * KT * KJ, back * KT * KJ, WARM)
    assert len(told) == 1
    assert found.error == math.inf
    assert abs(found.difference) < abs(far) * KT
    assert found.forward == pytest.approx(-KT * (logsumexp(-there) - np.log(len(there))))


def test_works_without_any_solution_are_refused() -> None:
    with pytest.raises(ValueError, match=r"`forward` and `reverse` must hold works from which .* too far apart"):
        of.free_energy_of_works([1.0, 2.0] * KJ, [1e300, 1e308] * KJ, WARM)


def test_without_pymbar_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pymbar", None)
    with pytest.raises(ImportError, match=r"need pymbar 4 or later: pip install \"openmm-filament\[free-energy\]\""):
        of.free_energy_of_works([1, 2] * KJ, [1, 2] * KJ, WARM)


@pytest.mark.parametrize(
    ("there", "back", "error", "message"),
    [
        ([1.0] * KJ, [1.0, 2.0] * KJ, ValueError, "`forward` must hold at least two works, but is 1"),
        ([1.0, np.nan] * KJ, [1.0, 2.0] * KJ, ValueError, "`forward` must be finite, but is nan at index 1"),
        ([1.0, 2.0] * KJ, [[1.0, 2.0]] * KJ, ValueError, r"`reverse` must have shape \(n,\)"),
        ([1.0, 2.0], [1.0, 2.0] * KJ, TypeError, "`forward` must be a Quantity of energy"),
    ],
)
def test_works_that_are_none_are_refused(there: Any, back: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        of.free_energy_of_works(there, back, WARM)


# Processes ----------------------------------------------------------------------------------------------------------


def brief(**changes: Any) -> Any:
    settings: dict[str, Any] = {"force": [2, 12] * PN, "points": 2, "replicas": 17, "seed": 3}
    return of.ramp(chain(2, JOINT), WARM, 3 * unit.picosecond, **(settings | changes))


def test_a_seed_gives_the_same_numbers_whatever_the_number_of_processes(
    workers: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[float] = []
    two = brief(processes=2, progress=seen.append)
    monkeypatch.setattr(protocols, "run_all", one_by_one)
    one = brief()
    np.testing.assert_array_equal(two.work, one.work)
    np.testing.assert_array_equal(two.extension, one.extension)
    assert seen == pytest.approx([1 / 3, 2 / 3, 1])
    assert len(np.unique(two.work[0, :, -1])) == 17


def test_another_seed_gives_others() -> None:
    assert not (brief(seed=4).work[0, :, -1] == brief().work[0, :, -1]).any()


def stop(fraction: float) -> None:
    raise KeyboardInterrupt


def test_ctrl_c_returns_the_replicas_that_are_done(workers: None) -> None:
    way = brief(processes=1, progress=stop, replicas=64)
    assert way.attrs["interrupted"] == 1
    assert way.sizes["replica"] in range(8, 64, 8)
    assert np.isfinite(way.work).all()


def test_ctrl_c_leaves_nan_in_a_clamp_and_is_passed_on_where_nothing_is_done(monkeypatch: pytest.MonkeyPatch) -> None:
    def first_alone(function: Any, tasks: Any, workers: int, progress: Any) -> list[Any]:
        return [function(tasks[0]), *[None] * (len(tasks) - 1)]

    monkeypatch.setattr(protocols, "run_all", first_alone)
    held = of.clamp(chain(2), WARM, extension=[2.0, 3.0] * NM, duration=2 * unit.picosecond)
    assert held.attrs["interrupted"] == 1
    assert np.isfinite(held.force_of_replica[0, :8]).all()
    assert np.isnan(held.force_of_replica[0, 8:]).all()
    assert np.isfinite(held.force[0])
    assert np.isnan(held.force[1])
    monkeypatch.setattr(protocols, "run_all", lambda function, tasks, workers, progress: [None] * len(tasks))
    with pytest.raises(KeyboardInterrupt):
        brief()


def test_what_a_worker_raises_is_raised(workers: None) -> None:
    with pytest.raises(ValueError, match="math domain error|nonnegative"):
        parallel.run_all(math.sqrt, [4.0, -1.0, 9.0], 1, None)


# Refused ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"force": None}, TypeError, "Exactly one control must be given .* but none is"),
        ({"extension": [1, 2] * NM}, TypeError, "Exactly one control must be given .* but force, extension is"),
        ({"force": [2, 12]}, TypeError, "`force` must be a Quantity of force"),
        ({"force": [2, 12] * NM}, TypeError, "`force` must have a unit of force"),
        ({"force": [-2, 12] * PN}, ValueError, "`force` must not be negative, but is -2.0 at index 0 pN"),
        ({"force": [2, 4, 12] * PN}, ValueError, r"`force` must have shape \(2,\)"),
        ({"force": [2, 2] * PN}, ValueError, "`force` must hold two different values, but is 2 pN twice"),
        ({"force": None, "extension": [2, 2] * NM}, ValueError, "hold two different values, but is 2 nm twice"),
        ({"force": None, "trap": [1, 2] * NM}, TypeError, "`stiffness` must be given with a trap, and only then"),
        ({"stiffness": 1 * KJ / NM**2}, TypeError, "`stiffness` must be given with a trap, and only then"),
        (
            {"force": None, "trap": [1, 2] * NM, "stiffness": -1 * KJ / NM**2},
            ValueError,
            "`stiffness` must not be negative",
        ),
        (
            {"force": None, "trap": [1, 2] * NM, "stiffness": [1, 1, 0] * KJ / NM**2},
            ValueError,
            "`stiffness` must be positive",
        ),
        ({"points": 1}, ValueError, "`points` must be at least 2, but is 1"),
        ({"replicas": 0}, ValueError, "`replicas` must be at least 1, but is 0"),
        ({"seed": -1}, ValueError, "`seed` must be at least 0"),
        ({"friction": 0 / unit.picosecond}, ValueError, "`friction` must be positive"),
        ({"equilibration": 1.0}, TypeError, "`equilibration` must be a Quantity of time"),
        ({"timestep": 1 * unit.nanosecond}, ValueError, "`timestep` must be at most the stability limit"),
        ({"processes": 0}, ValueError, "`processes` must be at least 1"),
    ],
)
def test_what_is_wrong_is_refused(changes: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        brief(**changes)


PS = unit.picosecond


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"duration": 1e30 * PS}, r"`duration` must take at most 2147483647 steps, but is 1e\+30 ps, .* steps of"),
        ({"equilibration": 1 * unit.second}, r"`equilibration` must take at most 2147483647 steps, but is 1e\+12 ps"),
        ({"friction": 1e-30 / PS}, r"`duration` must be given, .* that relax in 1e\+30 ps, but is left out"),
        ({"friction": 1e300 / PS, "duration": 1 * PS}, r"`equilibration` must be given, .* that relax in .*e\+30"),
        (
            {"extension": [2.0, 3.0, 2.0] * NM},
            "`extension` must hold no value twice, but holds 2 nm at index 0 and at index 2",
        ),
    ],
)
def test_clamps_that_would_never_end_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        of.clamp(chain(2), WARM, **({"extension": [2.0] * NM} | changes))


def test_a_ramp_that_would_never_end_is_refused() -> None:
    with pytest.raises(ValueError, match="`duration` must take at most 2147483647 steps"):
        of.ramp(chain(2), WARM, 1 * unit.second, force=[1, 2] * PN)


def tasks_of(monkeypatch: pytest.MonkeyPatch, run: Callable[..., Any], *arguments: Any, **options: Any) -> list[Any]:
    """What would run, and nothing of it."""
    seen: list[Any] = []

    def none(function: Any, tasks: Any, workers: int, progress: Any) -> list[Any]:
        seen.extend(tasks)
        return [None] * len(tasks)

    monkeypatch.setattr(protocols, "run_all", none)
    with pytest.raises(KeyboardInterrupt):
        run(*arguments, **options)
    return seen


def test_the_longest_runs_are_planned_in_little_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    time = 5 * unit.microsecond
    options: dict[str, Any] = {"extension": [2.0] * NM, "duration": time}
    clamped = tasks_of(monkeypatch, of.clamp, chain(2), WARM, **options)[0]
    led = tasks_of(monkeypatch, of.ramp, chain(2), WARM, time, force=[1, 2] * PN, points=7)[0]
    assert clamped.values.nbytes < 1e5
    assert led.values.nbytes < 1e7
    readings = (len(clamped.values) - 1) * clamped.reads
    assert readings * clamped.stride * clamped.timestep == pytest.approx(5e6)
    assert clamped.stride == 10
    assert (len(led.values) - 1) * led.stride * led.timestep == pytest.approx(5e6)
    assert (len(led.values) - 1) == 7 * led.every


def test_the_mean_of_readings_is_that_of_all_of_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """A clamp whose records are means of ten readings, against one that keeps every reading; and a trap's extension."""
    options: dict[str, Any] = {"trap": [3.0] * NM, "stiffness": 4.0 * STIFF, "replicas": 2, "duration": 20 * PS}
    every = of.clamp(chain(2), WARM, **options)
    steps = int(every.steps[0])
    assert steps % 10 == 0
    monkeypatch.setattr(protocols, "_RECORDS", 7)
    few = of.clamp(chain(2), WARM, **options, timestep=float(every.time_step[0]) * PS)
    assert few.steps[0] >= steps
    monkeypatch.setattr(protocols, "_RECORDS", int(few.steps[0]) // 10)
    same = of.clamp(chain(2), WARM, **options, timestep=float(few.time_step[0]) * PS)
    for name in ("force_of_replica", "extension_of_replica", "steps"):
        np.testing.assert_allclose(few[name], same[name], rtol=1e-9)


def test_a_clamp_says_of_each_value_what_was_run() -> None:
    places, options = [2.0, 4.4] * NM, {"replicas": 2, "duration": 1 * PS}
    held = of.clamp(chain(2, JOINT), WARM, extension=places, **options)
    for i, place in enumerate(places):
        alone = of.clamp(chain(2, JOINT), WARM, extension=place, **options)
        for name in ("time_step", "friction", "equilibration_steps", "steps"):
            assert held[name].dims == ("extension",)
            assert float(held[name][i]) == float(alone[name][0])
    assert held.friction[0] < held.friction[1]  # which follows the tension
    assert (held.steps * held.time_step).values == pytest.approx([1.0, 1.0])
    assert not {"time_step_ps", "friction_per_ps", "equilibration_steps"} & set(held.attrs)
    way = brief()
    assert way.attrs["friction_per_ps"] > 0
    assert way.attrs["time_step_ps"] * way.attrs["equilibration_steps"] > 0


def test_no_temperature_no_time_and_no_filament_are_refused() -> None:
    two = {"force": [2, 12] * PN}
    with pytest.raises(ValueError, match="`temperature` must be positive, but is 0"):
        of.ramp(chain(2), 0 * unit.kelvin, 1 * unit.picosecond, **two)
    with pytest.raises(TypeError, match="`temperature` must be a Quantity of temperature"):
        of.ramp(chain(2), 300, 1 * unit.picosecond, **two)
    with pytest.raises(ValueError, match="`duration` must be positive"):
        of.ramp(chain(2), WARM, 0 * unit.picosecond, **two)
    with pytest.raises(TypeError, match="`filament` must be a Filament"):
        of.ramp("DNA", WARM, 1 * unit.picosecond, **two)
    ring = of.Filament(of.shapes.ring(6, 1 * NM), 1 * unit.dalton, (), closed=True)
    with pytest.raises(ValueError, match="`filament` must be an open filament"):
        of.clamp(ring, WARM, extension=[1.0] * NM)
    with pytest.raises(ValueError, match="`extension` must hold at least one value"):
        of.clamp(chain(2), WARM, extension=[] * NM)
    with pytest.raises(ValueError, match="`replicas` must be at least 2, but is 1"):
        of.clamp(chain(2), WARM, extension=[1.0] * NM, replicas=1)
