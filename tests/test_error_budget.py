"""Where the error of a thermal extension comes from: segments, soft bonds, time step, sampling."""

from __future__ import annotations

import itertools
import math
import os
from dataclasses import replace

import numpy as np
import pytest
import tolerances as tol
from conftest import KJ, NM
from openmm import unit

import openmm_filament as of
from openmm_filament import bending, stretching, wlc
from openmm_filament.discretisation import choose, exact_chain, time_step_bias
from openmm_filament.integrators import thermal_step

PN = unit.piconewton
ROOM = 298.0
KT = 0.01380649 * ROOM
DNA = of.WormlikeChain(1000 * NM, 53 * NM, 1000 * PN)
FORCES = np.array([0.05, 1.0, 20.0])


def continuous(force: float) -> float:
    return float(wlc.extension_exact(force, 53.0, 1000.0, KT, stretch_modulus=1000.0, finite=True))


def test_the_parts_of_the_bias_are_those_of_the_chains() -> None:
    """Discretisation and stretch against extensions of rigid and soft chains worked out directly."""
    for force, choice in zip(FORCES, choose(DNA, FORCES, ROOM * unit.kelvin, np.full(3, 0.02)), strict=True):
        run = exact_chain(choice.filament, ROOM * unit.kelvin)
        assert run is not None
        whole = float(run.extension(force)) / continuous(force) - 1
        assert choice.bias == pytest.approx(whole, rel=1e-9)
        # its own bonds: a stretch modulus of 1000 pN over segments as long as the contour asks
        hard = DNA.filament(run.segments, ROOM * unit.kelvin, match=of.rods.Match.END_TO_END)
        own = exact_chain(hard, ROOM * unit.kelvin)
        assert own is not None
        assert own.stretching == pytest.approx(1000.0 * run.segments / 1000.0, rel=1e-9)
        assert choice.discretisation == pytest.approx(float(own.extension(force)) / continuous(force) - 1, abs=1e-12)
        assert choice.stretch == pytest.approx(whole - choice.discretisation, abs=1e-12)
        assert choice.known < 0.02


def test_smaller_errors_take_shorter_steps_or_more_segments() -> None:
    coarse, fine = (choose(DNA, FORCES, ROOM * unit.kelvin, np.full(3, error)) for error in (0.05, 0.005))
    for a, b in zip(coarse, fine, strict=True):
        assert len(a.filament) <= len(b.filament)
        assert b.known < 0.005
        assert abs(b.time_step) < 0.005


def test_the_bias_of_a_step_grows_with_it_and_fades_under_large_forces() -> None:
    chain = exact_chain(DNA.filament(40, ROOM * unit.kelvin), ROOM * unit.kelvin)
    assert chain is not None
    weak = [time_step_bias(chain, 0.05, step) for step in (0.1, 0.2, 0.4, 0.8)]
    assert all(b > 3 * a > 0 for a, b in itertools.pairwise(weak))
    assert 0 < time_step_bias(chain, 50.0, 0.8) < 0.05 * weak[-1]
    assert math.isnan(time_step_bias(replace(chain, rest_angles=0.3), 1.0, 0.5))


def test_a_curve_holds_its_split_error() -> None:
    forces = [1.0, 20.0]
    curve = of.force_extension(
        of.WormlikeChain(300 * NM, 53 * NM, 1000 * PN), forces * PN, ROOM * unit.kelvin, 0.06, seed=2
    )
    for name in ("discretisation_bias", "stretch_bias", "time_step_bias"):
        assert curve[name].attrs["units"] == "nm"
        assert np.isfinite(curve[name]).all()
    np.testing.assert_allclose(curve.discretisation_bias + curve.stretch_bias, curve.bias, rtol=1e-9)
    whole = np.abs(curve.bias) + np.abs(curve.time_step_bias) + 2 * curve.extension_error
    assert (whole <= 0.06 * curve.extension * 1.001).all()


def test_a_filament_has_the_bias_of_its_step_alone() -> None:
    terms = (stretching.Harmonic(150 * KJ / NM**2), bending.Harmonic(10 * KJ))
    chain = of.Filament(of.shapes.line(6, 4 * NM), 100 * unit.dalton, terms)
    curve = of.force_extension(chain, [5.0] * PN, ROOM * unit.kelvin, 0.1, seed=1)
    assert np.isnan(curve.discretisation_bias).all()
    assert np.isnan(curve.stretch_bias).all()
    assert (np.abs(curve.time_step_bias) < 0.01 * curve.extension).all()


def test_a_step_whose_own_error_is_too_large_is_refused() -> None:
    """At 0.05 pN steps near the limit cost some two per cent of the extension."""
    plan = choose(DNA, np.array([0.05]), ROOM * unit.kelvin, np.array([0.02]))[0]
    model = of.build(plan.filament, [of.loads.Hold(0), of.loads.Pull(-1, (0, 0, 0.05) * PN)])
    step = thermal_step(model, ROOM, None, 0.95) * model.scale.factor("time") * unit.picosecond
    with pytest.raises(ValueError, match=r"Argument `timestep` must leave an error to be sampled at 0\.05 pN"):
        of.force_extension(DNA, [0.05] * PN, ROOM * unit.kelvin, 0.02, timestep=step)


@pytest.mark.slow
def test_long_steps_are_off_by_what_is_said() -> None:
    """16 segments at 0.05 pN and 0.8 of the limit: one and a half per cent, in a few minutes, to a fraction of that."""
    error = 0.012 if os.environ.get("OPENMM_FILAMENT_SHORT") else 0.004
    chain = choose(DNA, np.array([0.05]), ROOM * unit.kelvin, np.array([0.027]))[0].filament
    model = of.build(chain, [of.loads.Hold(0), of.loads.Pull(-1, (0, 0, 0.05) * PN)])
    step = thermal_step(model, ROOM, None, 0.8) * model.scale.factor("time") * unit.picosecond
    curve = of.force_extension(chain, [0.05] * PN, ROOM * unit.kelvin, error, seed=8, timestep=step)
    exact = float(curve.exact_discrete[0])
    expected = float(curve.time_step_bias[0])
    assert expected > 0.013 * exact
    assert abs(float(curve.extension[0]) - exact - expected) < tol.SIGMAS * float(curve.extension_error[0])
