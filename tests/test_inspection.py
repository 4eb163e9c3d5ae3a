"""Preflight: every refusal and warning names beads and values, and a clean model passes."""

from __future__ import annotations

import math
import pickle
from typing import Any

import numpy as np
import openmm as mm
import pytest
import tolerances as tol
from conftest import KJ, NM, Array, random_chain
from openmm import unit

import openmm_filament as of
from openmm_filament import bending, stretching, torsion
from openmm_filament.inspection import Preflight, PreflightError, PreflightWarning, describe_bead
from openmm_filament.loads import Hold, Plane, Pull

PS = unit.picosecond
WARM = 298 * unit.kelvin
REFERENCE = mm.Platform.getPlatformByName("Reference")
TERMS = (stretching.Harmonic(200 * KJ / NM**2), bending.Harmonic(200 * KJ), torsion.Harmonic(3 * KJ))


def helix(terms: Any = TERMS) -> of.Filament:
    return of.Filament(of.shapes.helix(11, radius=2 * NM, pitch=3 * NM, turns=1.3), 10 * unit.dalton, terms)


def wire() -> of.Model:
    """A steel wire of 1 m: a scaled model."""
    terms = of.rod_terms(2e11 * unit.pascal, None, 0.5 * unit.millimeter, 5 * unit.centimeter)
    return of.build(of.Filament(of.shapes.line(20, 5 * unit.centimeter), 0.3 * unit.gram, terms), [Hold(0)])


def context(model: of.Model, positions: Array | None = None, integrator: Any = None) -> mm.Context:
    """On Reference, at internal positions."""
    made = mm.Context(model.system, integrator or of.verlet(model), REFERENCE)
    made.setPositions(model.positions if positions is None else positions * NM)
    return made


def internal(model: of.Model) -> Array:
    return model.positions.value_in_unit(NM).copy()


# Clean --------------------------------------------------------------------------------------------------------------


def test_a_clean_model_passes_and_returns_what_was_measured(rng: np.random.Generator) -> None:
    model = of.build(helix(), [Hold(0), Pull(-1, (0, 0, 3) * unit.piconewton)])
    x = internal(model) + 0.02 * rng.normal(size=(12, 3))
    integrator = of.langevin(model, WARM)
    found = of.preflight(model, context(model, x, integrator))
    assert isinstance(found, Preflight)
    assert found.timestep == integrator.getStepSize()
    limit = of.stable_timestep(model, x * NM)
    assert found.timestep_limit.value_in_unit(PS) == pytest.approx(limit.value_in_unit(PS), rel=tol.ROUNDING)
    assert set(found.force_errors) == {"stretching", "bending", "torsion"}
    assert max(found.force_errors.values()) < tol.OPENMM_FORCES


def test_without_a_context_the_rest_shape_is_looked_at() -> None:
    model = of.build(helix())
    found = of.preflight(model)
    assert (found.timestep, found.force_errors) == (None, {})
    assert found.timestep_limit == of.stable_timestep(model)


@pytest.mark.parametrize("make", [of.verlet, of.euler_cromer, lambda model: of.langevin(model, WARM)])
def test_the_integrators_of_the_package_pass(make: Any) -> None:
    for model in (of.build(helix()), of.build([helix(), helix(TERMS[:2])])):
        assert of.preflight(model, context(model, integrator=make(model))).timestep is not None


def test_a_macroscopic_model_passes_and_its_times_are_physical() -> None:
    model = wire()
    assert not model.scale.is_identity
    found = of.preflight(model, context(model, integrator=of.verlet(model)))
    assert found.timestep_limit.value_in_unit(unit.second) == pytest.approx(
        of.stable_timestep(model).value_in_unit(unit.second), rel=tol.ROUNDING
    )
    assert found.timestep / found.timestep_limit == pytest.approx(0.1)
    assert 1e-8 < found.timestep_limit.value_in_unit(unit.second) < 1e-4


def test_a_filament_at_rest_and_one_without_terms_of_bending_pass() -> None:
    straight = of.Filament(of.shapes.line(8, 1 * NM), 10 * unit.dalton, TERMS[:2])
    springs = of.Filament(of.shapes.line(8, 1 * NM), 10 * unit.dalton, TERMS[:1])
    for filament in (straight, springs):
        model = of.build(filament)
        assert max(of.preflight(model, context(model)).force_errors.values()) < tol.OPENMM_FORCES


def test_the_context_is_left_as_it_was(rng: np.random.Generator) -> None:
    model = of.build(helix())
    made = context(model, internal(model) + 0.02 * rng.normal(size=(12, 3)))
    made.setVelocitiesToTemperature(298, 1)
    before = made.createCheckpoint()
    of.preflight(model, made)
    assert made.createCheckpoint() == before


# Positions ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_positions_that_are_not_finite_are_refused_by_bead(bad: float) -> None:
    model = of.build(helix())
    x = internal(model)
    x[5, 1] = bad
    with pytest.raises(PreflightError, match=rf"Positions must be finite, but bead 5 is at .*{bad}"):
        of.preflight(model, context(model, x))


def test_coincident_neighbours_are_refused_by_bead() -> None:
    model = of.build(helix())
    x = internal(model)
    x[7] = x[6]
    with pytest.raises(PreflightError, match="Neighbours must not coincide, but beads 6 and 7 do"):
        of.preflight(model, context(model, x))


def test_beads_are_named_within_their_filament() -> None:
    model = of.build([helix(), helix()])
    assert [describe_bead(model, i) for i in (0, 11, 12, 23)] == [
        "bead 0 of filament 0", "bead 11 of filament 0", "bead 0 of filament 1", "bead 11 of filament 1",
    ]  # fmt: skip
    x = internal(model)
    x[12 + 3] = x[12 + 4]
    with pytest.raises(PreflightError) as caught:
        of.preflight(model, context(model, x))
    assert "beads 3 and 4 of filament 1" in str(caught.value)


def test_collinear_beads_under_a_dihedral_are_refused_by_bead() -> None:
    model = of.build(helix())
    x = internal(model)
    x[5] = (x[4] + x[6]) / 2
    with pytest.raises(
        PreflightError, match=r"torsion\.Harmonic must not be collinear, but beads 4, 5 and 6 .*: use torsion\.Weighted"
    ):
        of.preflight(model, context(model, x))


@pytest.mark.parametrize("middle", [1, 10])
def test_the_first_and_last_bend_count_too(middle: int) -> None:
    model = of.build(helix())
    x = internal(model)
    x[middle] = (x[middle - 1] + x[middle + 1]) / 2
    with pytest.raises(PreflightError, match=f"beads {middle - 1}, {middle} and {middle + 1}"):
        of.preflight(model, context(model, x))


def test_nearly_collinear_beads_under_a_dihedral_are_warned_of() -> None:
    model = of.build(helix())
    x = internal(model)
    x[5] = (x[4] + x[6]) / 2 + 1e-4 * (x[5] - (x[4] + x[6]) / 2) / np.linalg.norm(x[5] - (x[4] + x[6]) / 2)
    tiny = mm.VerletIntegrator(1e-9)  # the torsion is so stiff there that the default step is too long
    with pytest.warns(PreflightWarning, match=r"Nearly collinear beads 4, 5 and 6 \(sin of the bending angle \S+\)"):
        of.preflight(model, context(model, x, tiny))


def test_collinear_beads_without_a_dihedral_pass() -> None:
    for terms in (TERMS[:2], (*TERMS[:2], torsion.Weighted(3 * KJ))):
        model = of.build(of.Filament(of.shapes.line(11, 1 * NM), 10 * unit.dalton, terms))
        of.preflight(model, context(model))


# Time step and temperature ------------------------------------------------------------------------------------------


def test_a_time_step_above_the_limit_is_refused_with_both_numbers() -> None:
    """The Context's own integrator, built by hand."""
    model = of.build(helix())
    limit = of.stable_timestep(model).value_in_unit(PS)
    for integrator in (mm.VerletIntegrator(1.01 * limit), mm.LangevinMiddleIntegrator(298, 1.0, 1.5 * limit)):
        with pytest.raises(PreflightError, match=r"at most the stability limit of \S+ ps, but is \S+ ps") as caught:
            of.preflight(model, context(model, integrator=integrator))
        assert f"{limit:.6g} ps" in str(caught.value)
        assert f"{integrator.getStepSize().value_in_unit(PS):.6g} ps" in str(caught.value)
    of.preflight(model, context(model, integrator=mm.VerletIntegrator(0.99 * limit)))


def test_the_limit_is_that_of_the_positions_of_the_context() -> None:
    """Shorter segments make bending stiffer."""
    terms = (stretching.Harmonic(1 * KJ / NM**2), bending.Cosine(90 * KJ))
    model = of.build(of.Filament(of.shapes.line(9, 1 * NM), 1 * unit.dalton, terms))
    integrator = mm.VerletIntegrator(0.9 * of.stable_timestep(model).value_in_unit(PS))
    with pytest.raises(PreflightError, match="stability limit"):
        of.preflight(model, context(model, 0.5 * internal(model), integrator))


def test_a_physical_time_step_on_a_scaled_model_is_caught() -> None:
    """1 fs and 1 us, written as OpenMM users do, are far too short or long in internal units."""
    model = wire()
    second = of.stable_timestep(model).value_in_unit(unit.second)
    with pytest.warns(
        PreflightWarning, match=r"The time step is \S+ of the stability limit: .*; this model runs in scaled units"
    ):
        of.preflight(model, context(model, integrator=mm.VerletIntegrator(1e-15 / second * 1e-3)))
    with pytest.raises(PreflightError, match=r"stability limit .*scaled units .*model\.to_internal"):
        of.preflight(model, context(model, integrator=mm.VerletIntegrator(0.1 * second * unit.second)))


@pytest.mark.parametrize("part", [0.01, 0.1, 0.5, 0.99])
@pytest.mark.parametrize("make", [mm.VerletIntegrator, lambda dt: mm.LangevinMiddleIntegrator(1e-9, 1.0, dt)])
def test_an_integrator_of_the_user_on_a_scaled_model_is_asked_about(part: float, make: Any) -> None:
    """A physical step may by chance lie anywhere below the limit; the warning says what it is physically."""
    model = wire()
    dt = part * model.to_internal(of.stable_timestep(model)).value_in_unit(PS)
    with pytest.warns(PreflightWarning, match=r"not openmm_filament's.* model\.to_internal .*scaled units") as caught:
        of.preflight(model, context(model, integrator=make(dt)))
    assert len(caught) == 1
    physical = part * of.stable_timestep(model).value_in_unit(PS)
    said = str(caught[0].message).split("limit: ")[1].split(" ps")[0]
    assert float(said) == pytest.approx(physical, rel=1e-5)


def test_the_packages_own_integrators_pass_on_a_scaled_model() -> None:
    """Those made for this model's units, in the plane too; one made for other units is the user's."""
    for model in (wire(), of.build(wire().filaments[0], [Hold(0), Plane()])):
        for make in (of.verlet, of.euler_cromer, lambda model: of.langevin(model, WARM)):
            of.preflight(model, context(model, integrator=make(model)))
    other = of.verlet(of.build(helix()), timestep=1e-4 * PS)
    other.setStepSize(0.1 * model.to_internal(of.stable_timestep(model)))
    with pytest.warns(PreflightWarning, match="not openmm_filament's"):
        of.preflight(model, context(model, integrator=other))


def test_an_own_step_far_below_the_limit_is_still_warned_of() -> None:
    model = wire()
    integrator = of.verlet(model, timestep=1e-3 * of.stable_timestep(model))
    with pytest.warns(PreflightWarning, match=r"The time step is 0\.001 of the stability limit; this model"):
        of.preflight(model, context(model, integrator=integrator))


def test_a_physical_temperature_on_a_scaled_model_is_caught() -> None:
    model = wire()
    assert model.to_internal(WARM).value_in_unit(unit.kelvin) < 1e-10
    dt = 0.1 * model.to_internal(of.stable_timestep(model)).value_in_unit(PS)
    with pytest.raises(PreflightError, match=r"k_B T must be small .* but is \S+ times it; .*scaled units"):
        of.preflight(model, context(model, integrator=mm.LangevinMiddleIntegrator(298000, 1.0, dt)))
    of.preflight(model, context(model, integrator=of.langevin(model, WARM)))


def test_room_temperature_in_internal_units_on_a_scaled_model_is_caught() -> None:
    """298 K as it stands, the likeliest mistake: the bonds of the wire would have thermal strains of 160 %."""
    model = wire()
    dt = 0.1 * model.to_internal(of.stable_timestep(model)).value_in_unit(PS)
    with pytest.raises((PreflightError, PreflightWarning), match="scaled units"):
        of.preflight(model, context(model, integrator=mm.LangevinMiddleIntegrator(298, 1.0, dt)))


# Forces -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("factor", [1.01, 0.5])
def test_a_stiffness_changed_by_hand_is_refused(factor: float) -> None:
    """Of one bond of the System, with all bonds stretched by 3 %."""
    terms = (stretching.Harmonic(np.linspace(150, 250, 11) * KJ / NM**2), *TERMS[1:])
    model = of.build(helix(terms))
    force = model.system.getForce(0)
    names = [force.getPerBondParameterName(i) for i in range(force.getNumPerBondParameters())]
    i, j, values = force.getBondParameters(4)
    values = list(values)
    values[names.index("k")] *= factor
    force.setBondParameters(4, i, j, values)
    x = 1.03 * internal(model)
    with pytest.raises(
        PreflightError,
        match=r"Forces of stretching must agree .* but differ by \S+ at bead [45] on Reference in double",
    ):
        of.preflight(model, context(model, x))


def test_a_removed_bend_is_refused_with_the_angles(rng: np.random.Generator) -> None:
    model = of.build(helix())
    force = model.system.getForce(1)
    force.setAngleParameters(3, 0, 1, 2, force.getAngleParameters(3)[3])
    x = internal(model) + 0.02 * rng.normal(size=(12, 3))
    with pytest.raises(
        PreflightError, match=r"Forces of bending must agree .* with bending angles from \S+ to \S+ rad"
    ):
        of.preflight(model, context(model, x))


def test_the_force_tolerance_can_be_set() -> None:
    model = of.build(helix((stretching.Harmonic(np.linspace(150, 250, 11) * KJ / NM**2), *TERMS[1:])))
    force = model.system.getForce(0)
    i, j, values = force.getBondParameters(4)
    force.setBondParameters(4, i, j, [v * 1.001 for v in values])
    x = 1.03 * internal(model)
    slow = mm.VerletIntegrator(1e-4)
    found = of.preflight(model, context(model, x, slow), force_tolerance=0.5)
    assert 5e-4 < found.force_errors["stretching"] < 1.5e-3
    with pytest.raises(PreflightError, match="Forces of stretching must agree with the NumPy reference to 1e-06"):
        of.preflight(model, context(model, x, mm.VerletIntegrator(1e-4)), force_tolerance=1e-6)


def test_openmms_floor_under_short_segments_is_refused() -> None:
    """Segments of 0.01 nm at 1e-3 rad: OpenMM's bending force is ten times too small. A scale keeps `build` from it."""
    filament = of.Filament(
        of.shapes.line(6, 0.01 * NM), 10 * unit.dalton, (stretching.Harmonic(1e4 * KJ / NM**2), TERMS[1])
    )
    model = of.build(filament)
    assert not model.scale.is_identity
    x = internal(model)
    x[3, 0] += 5e-4
    of.preflight(model, context(model, x))
    system = mm.System()  # the same chain in nm, as one would build it by hand
    for _ in range(7):
        system.addParticle(10)
    bond, angle = mm.CustomBondForce("5000*(r-0.01)^2"), mm.CustomAngleForce("10*(theta-3.141592653589793)^2")
    for i in range(6):
        bond.addBond(i, i + 1, [])
    for i in range(5):
        angle.addAngle(i, i + 1, i + 2, [])
    angle.setForceGroup(1)
    system.addForce(bond)
    system.addForce(angle)
    by_hand = of.Model(
        system, filament.rest, of.units.NANOMETER_SCALE, model.groups, model.filaments, model.loads,
        tuple(filament.interactions()), planar=False,
    )  # fmt: skip
    y = filament.rest.value_in_unit(NM).copy()
    y[3, 0] += 5e-6
    made = mm.Context(system, mm.VerletIntegrator(1e-5), REFERENCE)
    made.setPositions(y * NM)
    with pytest.raises(PreflightError, match="Forces of bending must agree"):
        of.preflight(by_hand, made)


def test_a_context_of_another_system_is_refused() -> None:
    model, other = of.build(helix()), of.build([helix(), helix()])
    with pytest.raises(PreflightError, match="`context` must be of the model's System with 12 beads, but has 24"):
        of.preflight(model, context(other))


def test_a_context_without_positions_is_refused() -> None:
    model = of.build(helix())
    made = mm.Context(model.system, of.verlet(model), REFERENCE)
    with pytest.raises((PreflightError, mm.OpenMMException), match=r"[Pp]ositions|coincide"):
        of.preflight(model, made)


def test_errors_are_value_errors_and_survive_pickling() -> None:
    error = pickle.loads(pickle.dumps(PreflightError("said")))
    assert isinstance(error, ValueError)
    assert str(error) == "said"


def test_a_random_chain_passes(rng: np.random.Generator) -> None:
    for seed in range(5):
        x = random_chain(np.random.default_rng(seed), 15)
        model = of.build(of.Filament(x * NM, 10 * unit.dalton, TERMS))
        of.preflight(model, context(model))
