"""A run that diverges is stopped, and the error says where, by which term and at which step; nothing good is lost."""

from __future__ import annotations

import copy
import pickle
import re
from pathlib import Path
from typing import Any

import numpy as np
import openmm as mm
import pytest
import tolerances as tol
from conftest import KJ, NM, Array
from openmm import app, unit

import openmm_filament as of
from openmm_filament import bending, stretching, torsion
from openmm_filament.divergence import DivergedError, check_heat
from openmm_filament.evaluation import kinetic_temperature
from openmm_filament.integrators import temperature_of
from openmm_filament.loads import Hold, Plane

PS = unit.picosecond
REFERENCE = mm.Platform.getPlatformByName("Reference")
TERMS = (stretching.Harmonic(200 * KJ / NM**2), bending.Harmonic(200 * KJ), torsion.Harmonic(3 * KJ))
NUMBER = r"[0-9.e+-]+"


def helix(terms: Any = TERMS) -> of.Filament:
    return of.Filament(of.shapes.helix(11, radius=2 * NM, pitch=3 * NM, turns=1.3), 10 * unit.dalton, terms)


def wire() -> of.Filament:
    terms = of.rod_terms(2e11 * unit.pascal, None, 0.5 * unit.millimeter, 5 * unit.centimeter)
    return of.Filament(of.shapes.line(20, 5 * unit.centimeter), 0.3 * unit.gram, terms)


def simulation(model: of.Model, over_limit: float) -> app.Simulation:
    """From the rest shape, pushed a little, with a time step so many times the limit."""
    dt = over_limit * model.to_internal(of.stable_timestep(model)).value_in_unit(PS)
    made = app.Simulation(model.topology, model.system, mm.VerletIntegrator(dt), REFERENCE)
    x = model.positions.value_in_unit(NM)
    push = 1e-4 * np.random.default_rng(2).normal(size=x.shape)
    push[model.held] = 0
    made.context.setPositions((x + push) * NM)
    return made


def diverged(
    model: of.Model, reporter: Any, over_limit: float = 1.5, steps: int = 20_000
) -> tuple[DivergedError, app.Simulation]:
    run = simulation(model, over_limit)
    run.reporters.append(reporter)
    with pytest.raises(DivergedError) as caught:
        run.step(steps)
    return caught.value, run


def lengths(x: Array) -> Array:
    return np.linalg.norm(np.diff(x, axis=0), axis=-1)


@pytest.fixture(params=["watch", "trajectory_reporter"])
def reporter(request: pytest.FixtureRequest, tmp_path: Path) -> Any:
    """Makes the reporter of a model with an interval."""
    if request.param == "watch":
        return of.watch
    return lambda model, interval: of.trajectory_reporter(model, tmp_path / "run.dcd", interval)


@pytest.mark.parametrize("interval", [1, 50, 1000])
def test_a_time_step_above_the_limit_stops_the_run(reporter: Any, interval: int) -> None:
    error, run = diverged(of.build(helix(), [Hold(0)]), reporter(of.build(helix(), [Hold(0)]), interval))
    assert isinstance(error, RuntimeError)
    assert error.term in {"stretching", "bending", "torsion"}
    assert 0 <= error.bead < 12
    assert 1 <= error.step <= run.currentStep <= 20_000
    last_good = error.last_good.value_in_unit(NM)
    assert last_good.shape == (12, 3)
    assert np.isfinite(last_good).all()


def test_the_message_names_bead_term_lengths_angles_and_step(reporter: Any) -> None:
    model = of.build(helix(), [Hold(0)])
    error, _ = diverged(model, reporter(model, 100))
    message = str(error)
    limit = of.stable_timestep(model).value_in_unit(PS)
    for part in (
        rf"diverged at step {error.step} \(last good frame: step \d+\)",
        rf"(is not finite|of the rest shape), by the force of {error.term} on bead {error.bead}\.",
        rf"from bead \d+ to \d+ the segment lengths were {NUMBER}(, {NUMBER})* nm",
        rf"the bending angles {NUMBER}(, {NUMBER})* rad",
        r"the torsions [0-9.e+,\s-]+ rad",
        re.escape(f"The time step is {1.5 * limit:.6g} ps"),
    ):
        assert re.search(part, message), f"{part} not in {message}"
    assert "nan" not in message.lower().replace("finite", "")


def test_the_step_lies_between_the_last_good_frame_and_the_look_that_found_it() -> None:
    model = of.build(helix())
    every, _ = diverged(model, of.watch(model, 1))
    late, run = diverged(model, of.watch(model, 500))
    good = int(re.search(r"last good frame: step (\d+)", str(late)).group(1))
    assert good % 500 == 0
    assert good < late.step <= good + 500 == run.currentStep
    assert late.step <= every.step + 1  # it is replayed step by step: as exact as looking at each


def test_the_last_good_frame_is_that_of_the_last_look() -> None:
    """As a run without the reporter has it at that step."""
    model = of.build(helix())
    error, _ = diverged(model, of.watch(model, 20))
    good = int(re.search(r"last good frame: step (\d+)", str(error)).group(1))
    again = simulation(model, 1.5)
    again.step(good)
    x = again.context.getState(positions=True).getPositions(asNumpy=True).value_in_unit(NM)
    np.testing.assert_array_equal(error.last_good.value_in_unit(NM), x)


def test_the_term_that_did_it_is_named() -> None:
    """The stiff one of two. (Bending alone does not carry coordinates to infinity: its angles end at pi.)"""
    model = of.build(helix((bending.Harmonic(1 * KJ), stretching.Harmonic(2000 * KJ / NM**2))))
    error, _ = diverged(model, of.watch(model, 10))
    assert error.term == "stretching"


@pytest.mark.parametrize("make", [helix, wire], ids=["nm", "scaled"])
@pytest.mark.parametrize("interval", [1, 5, 1000])
def test_the_last_good_frame_has_not_blown_up_already(make: Any, interval: int) -> None:
    """Finite is not good: a chain a thousand times its length is lost, and does not fit the floats of a DCD."""
    model = of.build(make(), [Hold(0)])
    error, _ = diverged(model, of.watch(model, interval))
    rest = model.to_physical(model.positions, "length").value_in_unit(NM)
    assert np.ptp(error.last_good.value_in_unit(NM)) < 1e3 * np.ptp(rest)


def test_a_term_that_is_not_finite_is_named() -> None:
    """Three beads on a line under a dihedral: NaN from that term alone, about the middle of the three."""
    model = of.build(helix())
    run = simulation(model, 0.01)
    x = model.positions.value_in_unit(NM).copy()
    x[5] = [0.0, 0.0, 5.0]
    x[4], x[6] = [0.0, 0.0, 4.0], [0.0, 0.0, 6.0]
    run.context.setPositions(x * NM)
    run.reporters.append(of.watch(model, 5))
    with pytest.raises(DivergedError) as caught:
        run.step(10)
    assert caught.value.term == "torsion"
    assert caught.value.step == 1
    assert 3 <= caught.value.bead <= 7
    np.testing.assert_array_equal(caught.value.last_good.value_in_unit(NM), x)


def test_a_start_that_is_not_finite_is_refused_at_step_0() -> None:
    model = of.build(helix())
    run = simulation(model, 0.1)
    x = model.positions.value_in_unit(NM).copy()
    x[3] = np.nan
    run.context.setPositions(x * NM)
    run.reporters.append(of.watch(model, 5))
    with pytest.raises(DivergedError, match="Bead 3 is not finite at step 0"):
        run.step(10)


def test_beads_are_named_within_their_filament() -> None:
    chains = [helix(), helix((stretching.Harmonic(5000 * KJ / NM**2),))]
    model = of.build(chains)
    error, _ = diverged(model, of.watch(model, 10))
    assert 12 <= error.bead < 24
    assert f"bead {error.bead - 12} of filament 1" in str(error)


def test_a_scaled_model_reports_physical_lengths_and_times() -> None:
    model = of.build(wire(), [Hold(0)])
    error, _ = diverged(model, of.watch(model, 5))
    assert not model.scale.is_identity
    assert np.ptp(error.last_good.value_in_unit(unit.meter)) > 0.5
    said = re.search(rf"segment lengths were ({NUMBER})", str(error))
    assert float(said.group(1)) > 1e6  # nm
    dt = float(re.search(rf"The time step is ({NUMBER}) ps", str(error)).group(1))
    assert dt == pytest.approx(1.5 * of.stable_timestep(model).value_in_unit(PS), rel=1e-5)


def test_frames_before_are_kept_by_the_trajectory(tmp_path: Path) -> None:
    model = of.build(helix())
    error, run = diverged(model, of.trajectory_reporter(model, tmp_path / "run.dcd", 10))
    run.reporters[0].close()
    kept = of.load(tmp_path / "run.dcd")
    good = int(re.search(r"last good frame: step (\d+)", str(error)).group(1))
    assert kept.n_frames == good // 10 + 1
    assert np.isfinite(kept.xyz).all()
    x = error.last_good.value_in_unit(NM)
    np.testing.assert_allclose(kept.xyz[-1], x, rtol=0, atol=tol.SINGLE * np.abs(x).max())


def test_a_run_below_the_limit_is_left_alone(reporter: Any) -> None:
    model = of.build(helix())
    run = simulation(model, 0.5)
    run.reporters.append(reporter(model, 50))
    run.step(500)
    watched = run.context.getState(positions=True).getPositions(asNumpy=True).value_in_unit(NM)
    alone = simulation(model, 0.5)
    alone.step(500)
    np.testing.assert_array_equal(
        watched, alone.context.getState(positions=True).getPositions(asNumpy=True).value_in_unit(NM)
    )


def test_the_error_survives_pickling() -> None:
    """As it must to come out of a worker process."""
    model = of.build(helix())
    error, _ = diverged(model, of.watch(model, 100))
    for other in (pickle.loads(pickle.dumps(error)), copy.copy(error)):
        assert type(other) is DivergedError
        assert (str(other), other.bead, other.term, other.step) == (str(error), error.bead, error.term, error.step)
        np.testing.assert_array_equal(other.last_good.value_in_unit(NM), error.last_good.value_in_unit(NM))


@pytest.mark.parametrize(
    ("interval", "error"), [(0, ValueError), (-5, ValueError), (1.5, TypeError), (True, TypeError)]
)
def test_bad_intervals_are_refused(interval: Any, error: type[Exception]) -> None:
    with pytest.raises(error, match=rf"`interval` must be .* but is {interval}"):
        of.watch(of.build(helix()), interval)


# Heat ---------------------------------------------------------------------------------------------------------------


WARM = 298 * unit.kelvin


def planar(*loads: Any) -> of.Model:
    terms = (stretching.Harmonic(200 * KJ / NM**2), bending.Harmonic(20 * KJ))
    return of.build(of.Filament(of.shapes.line(20, 1 * NM), 10 * unit.dalton, terms), loads or [Hold(0), Plane()])


def velocities(run: app.Simulation) -> Array:
    return run.context.getState(velocities=True).getVelocities(asNumpy=True).value_in_unit(NM / PS)


def thermal(model: of.Model, seed: int = 1) -> app.Simulation:
    run = app.Simulation(model.topology, model.system, of.langevin(model, WARM, seed=seed), REFERENCE)
    run.context.setPositions(model.positions)
    run.context.setVelocitiesToTemperature(model.to_internal(WARM), seed)
    return run


@pytest.mark.parametrize("loads", [(Hold(7),), (Hold([0, 3]),), (Hold(0), Plane())], ids=["held", "two held", "planar"])
def test_the_kinetic_temperature_is_that_of_the_free_degrees(loads: Any) -> None:
    """Against a sum bead by bead, and in mean the one that the velocities were drawn at; |z| <= 4."""
    model = planar(*loads)
    rng = np.random.default_rng(3)
    held, axes = set(model.held.tolist()), 2 if model.planar else 3
    found = []
    for _ in range(400):
        v = rng.normal(size=(21, 3)) * np.sqrt(of.units.BOLTZMANN * 298 / 10)
        found.append(kinetic_temperature(model, v))
    twice = sum(10 * v[i, k] ** 2 for i in range(21) if i not in held for k in range(axes))
    degrees = axes * (21 - len(held))
    assert found[-1] == pytest.approx(twice / (of.units.BOLTZMANN * degrees), rel=tol.ROUNDING)
    assert abs(np.mean(found) - 298) <= tol.SIGMAS * 298 * np.sqrt(2 / degrees / 400)


def test_the_kinetic_temperature_of_openmm_is_the_same() -> None:
    run = thermal(of.build(helix(), [Hold(0)]))
    kinetic = run.context.getState(energy=True).getKineticEnergy().value_in_unit(KJ)
    model = of.build(helix(), [Hold(0)])
    assert kinetic_temperature(model, velocities(run)) == pytest.approx(
        2 * kinetic / (of.units.BOLTZMANN * 33), rel=tol.ROUNDING
    )


@pytest.mark.parametrize("make", [planar, lambda: of.build(helix(), [Hold(0)])], ids=["planar", "3D"])
def test_a_run_that_is_hot_is_stopped_though_finite(make: Any, reporter: Any) -> None:
    """Velocities ten times the thermal ones: a hundred times the temperature."""
    model = make()
    run = thermal(model)
    run.reporters.append(reporter(model, 5))
    run.step(50)
    run.context.setVelocities(10 * velocities(run) * NM / PS)
    with pytest.raises(DivergedError, match=r"heated up to \S+ K by step 55, its thermostat standing at 298 K"):
        run.step(50)


def test_looking_draws_nothing_from_the_random_stream() -> None:
    """A planar run is the same bit for bit with and without a watch (OpenMM's own energy would draw from it)."""
    model = planar()
    ends = []
    for watched in (True, False):
        run = thermal(model)
        if watched:
            run.reporters.append(of.watch(model, 10))
        run.step(200)
        ends.append(velocities(run))
        del run
    np.testing.assert_array_equal(*ends)


def test_integrators_say_their_temperature() -> None:
    for model in (planar(), of.build(helix())):
        assert temperature_of(of.langevin(model, WARM)) == pytest.approx(298, rel=tol.ROUNDING)
        assert temperature_of(of.verlet(model)) is None
        assert temperature_of(of.euler_cromer(model)) is None


def test_a_single_bead_seldom_gives_a_false_alarm() -> None:
    """Two degrees of freedom fluctuate by 100 %: a look at each step of a long run must not stop it."""
    spring = of.Filament(of.shapes.line(1, 5 * NM), 10 * unit.dalton, (stretching.Harmonic(40 * KJ / NM**2),))
    model = of.build(spring, [Hold(0), Plane()])
    v = np.random.default_rng(1).normal(size=(300_000, 2)) * np.sqrt(of.units.BOLTZMANN * 298 / 10)
    worst = np.zeros((2, 3))
    worst[1, :2] = v[np.argmax((v**2).sum(axis=1))]
    assert kinetic_temperature(model, worst) > 298 * 11  # ten standard deviations
    check_heat(model, worst, worst, 298, 1)
    with pytest.raises(DivergedError, match="heated up"):
        check_heat(model, worst, 3 * worst, 298, 1)


# Energy -------------------------------------------------------------------------------------------------------------


def violent(amplitude: float, seed: int) -> app.Simulation:
    """An undamped helix whose beads begin far from where they rest."""
    model = of.build(helix())
    simulation = app.Simulation(model.topology, model.system, of.verlet(model), REFERENCE)
    x = model.positions.value_in_unit(NM)
    simulation.context.setPositions(x + amplitude * np.random.default_rng(seed).normal(size=x.shape))
    simulation.reporters.append(of.watch(model, 20))
    return simulation


def test_a_run_without_thermostat_whose_energy_rises_is_stopped() -> None:
    """Beads thrown so far that dihedrals line up gain energy at any usual step, and stay finite."""
    with pytest.raises(DivergedError, match=r"energy of the run must not rise by more than \S+ of that of its motion"):
        for seed in range(20):
            violent(0.3, seed).step(2000)


@pytest.mark.parametrize("part", [0.1, 0.5, 0.9])
def test_a_run_that_only_swings_is_not(part: float) -> None:
    model = of.build(helix(), [Hold(0)])
    for make in (of.verlet, of.euler_cromer):
        integrator = make(model, timestep=part * of.stable_timestep(model))
        simulation = app.Simulation(model.topology, model.system, integrator, REFERENCE)
        simulation.context.setPositions(model.positions)
        simulation.context.setVelocitiesToTemperature(1 * unit.kelvin, 1)
        simulation.reporters.append(of.watch(model, 7))
        simulation.step(3000)


def test_a_chain_at_rest_is_not_stopped_for_the_rounding_of_nothing() -> None:
    for rest in (of.shapes.helix(11, radius=2 * NM, pitch=3 * NM, turns=1.3), of.shapes.line(11, 1 * NM)):
        model = of.build(of.Filament(rest, 10 * unit.dalton, TERMS[:2]))
        simulation = app.Simulation(model.topology, model.system, of.verlet(model), REFERENCE)
        simulation.context.setPositions(model.positions)
        simulation.reporters.append(of.watch(model, 1))
        simulation.step(500)


def test_a_filament_that_nothing_holds_is_named_where_it_heats_up() -> None:
    line = of.Filament(of.shapes.line(4, 1 * NM), 1 * unit.dalton, (stretching.Harmonic(100 * KJ / NM**2),))
    pull = of.loads.Pull(-1, (0, 0, 1) * KJ / NM)
    fast = np.full((5, 3), 100.0)
    for loads, told in (([pull], True), ([Hold(0), pull], False)):
        model = of.build(line, loads)
        with pytest.raises(DivergedError) as caught:
            check_heat(model, model.positions._value, fast, 300, 1)
        assert ("held nowhere has gone off" in str(caught.value)) == told
