"""Recorded runs against stepping by hand, energies against NumPy, and plucks against the impulse they give."""

from __future__ import annotations

from typing import Any

import numpy as np
import openmm as mm
import pytest
import tolerances as tol
from conftest import KJ, NM, random_chain
from openmm import app, unit

import openmm_filament as of
from openmm_filament import bending, stretching
from openmm_filament.divergence import DivergedError
from openmm_filament.loads import Hold, Pluck, Pull

REFERENCE = mm.Platform.getPlatformByName("Reference")
PS = unit.picosecond
MILLI = unit.meter * 1e-3


def chain(scale: Any = NM) -> of.Filament:
    """A bent chain of six beads, in nm or made macroscopic."""
    x = random_chain(np.random.default_rng(1), 6)
    k = 40 * KJ / NM**2 if scale is NM else 4e3 * unit.newton / unit.meter
    alpha = 30 * KJ if scale is NM else 0.02 * unit.joule
    mass = 10 * unit.dalton if scale is NM else 1e-4 * unit.kilogram
    return of.Filament(x * scale, mass, (stretching.Harmonic(k), bending.Harmonic(alpha)))


def context(model: of.Model, integrator: mm.Integrator) -> mm.Context:
    made = mm.Context(model.system, integrator, REFERENCE)
    made.setPositions(model.positions)
    return made


@pytest.mark.parametrize("scale", [NM, MILLI])
def test_a_recorded_run_is_the_run_by_hand(scale: Any) -> None:
    force = (0, 3, 1) * (KJ / NM if scale is NM else unit.newton)
    loads = [Hold(0), Pull(-1, force)]
    model = of.build(chain(scale), loads)
    motion = of.record(model, context(model, of.verlet(model)), 5, 7, energies=True)
    by_hand = context(model, of.verlet(model))
    dt = by_hand.getIntegrator().getStepSize()
    for sample in range(6):
        if sample:
            by_hand.getIntegrator().step(7)
        state = by_hand.getState(positions=True, energy=True)
        x = model.to_physical(state.getPositions(asNumpy=True), "length")
        np.testing.assert_array_equal(motion.values[sample], x.value_in_unit(NM))
        expected = of.reference.energies(model.filaments[0], x, loads)
        assert {"kinetic", *expected} == motion.energies.keys()
        size = sum(map(abs, expected.values())) + 1e-300
        for name, value in expected.items():
            assert motion.energies[name][sample] == pytest.approx(value, abs=1e-10 * size)
        kinetic = model.to_physical(state.getKineticEnergy(), "energy").value_in_unit(KJ)
        assert motion.energies["kinetic"][sample] == pytest.approx(kinetic, rel=tol.ROUNDING)
    step = model.to_physical(dt, "time").value_in_unit(PS)
    np.testing.assert_allclose(motion.times.value_in_unit(PS), 7 * step * np.arange(6), rtol=tol.ROUNDING)
    assert motion.interval.value_in_unit(PS) == pytest.approx(7 * step, rel=tol.ROUNDING)


def test_recording_goes_on_where_it_stopped_and_keeps_what_is_observed() -> None:
    model = of.build(chain(), [Hold(0), Pull(-1, (0, 3, 1) * KJ / NM)])
    whole = of.record(model, context(model, of.verlet(model)), 8, 3)
    running = context(model, of.verlet(model))
    seen: list[float] = []
    first = of.record(model, running, 5, 3, observe=lambda x: x[-1, 1], progress=seen.append)
    second = of.record(model, running, 3, 3, observe=lambda x: x[-1, 1])
    np.testing.assert_array_equal(first.values, whole.values[:6, -1, 1])
    np.testing.assert_array_equal(second.values, whole.values[5:, -1, 1])
    assert second.times[0].value_in_unit(PS) == pytest.approx(first.times[-1].value_in_unit(PS), rel=tol.ROUNDING)
    assert seen == [0, 0.2, 0.4, 0.6, 0.8, 1.0]


@pytest.mark.parametrize("every", [1, 7, 40, 1000])
def test_a_pluck_gives_its_impulse_and_no_more(every: int) -> None:
    bead = of.Filament(np.zeros((1, 3)) * NM, 4 * unit.dalton, ())
    model = of.build(bead, [Pluck(0, (0, 0, 8) * KJ / NM, 2.5 * PS)])
    running = context(model, mm.VerletIntegrator(0.01))
    motion = of.record(model, running, 1000 // every, every)
    steps = every * np.arange(1000 // every + 1)
    pushed = np.minimum(steps, 250)
    expected = 2.0 * 0.01**2 * (pushed * (pushed + 1) / 2 + 250 * (steps - pushed))  # leapfrog, 8/4 = 2 nm/ps^2
    np.testing.assert_allclose(motion.values[:, 0, 2], expected, rtol=1e-10)
    assert running.getParameter("pluck") == 0


def test_a_reporter_lets_a_pluck_of_a_simulation_go_at_the_same_step() -> None:
    model = of.build(chain(), [Hold(0), Pluck(3, (0, 5, 0) * KJ / NM, 1 * PS)])
    recorded = of.record(model, context(model, of.verlet(model, timestep=0.01 * PS)), 3, 90)
    simulation = app.Simulation(model.topology, model.system, of.verlet(model, timestep=0.01 * PS), REFERENCE)
    simulation.context.setPositions(model.positions)
    simulation.reporters.append(of.pluck_reporter(model))
    for sample in (1, 2, 3):
        simulation.step(90)
        x = simulation.context.getState(positions=True).getPositions(asNumpy=True).value_in_unit(NM)
        np.testing.assert_array_equal(x, recorded.values[sample])
    with pytest.raises(ValueError, match="`model` must have a Pluck to let go, but has none"):
        of.pluck_reporter(of.build(chain()))


def test_a_run_that_diverges_says_where_and_keeps_the_last_good_frame() -> None:
    model = of.build(chain(), [Hold(0), Pull(-1, (0, 3, 1) * KJ / NM)])
    running = context(model, mm.VerletIntegrator(5 * of.stable_timestep(model).value_in_unit(PS)))
    with pytest.raises(DivergedError, match="The run diverged at step") as caught:
        of.record(model, running, 1000, 10)
    assert np.isfinite(caught.value.last_good.value_in_unit(NM)).all()


@pytest.mark.parametrize(("samples", "every"), [(0, 1), (1, 0), (-3, 1)])
def test_recording_nothing_is_refused(samples: int, every: int) -> None:
    model = of.build(chain())
    with pytest.raises(ValueError, match="`(samples|every)` must be at least 1, but is"):
        of.record(model, context(model, of.verlet(model)), samples, every)
