"""Loads: what they do to energies, forces and masses, and what they refuse."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import openmm as mm
import pytest
import tolerances as tol
from conftest import KJ, NM, Array, chains, random_chain
from hypothesis import given
from hypothesis import strategies as st
from openmm import unit

import openmm_filament as of
from openmm_filament import stretching
from openmm_filament.loads import Hold, Plane, Pluck, Pull, Tension, resolve

PN = unit.piconewton
FORCE = np.array([1.0, -2.0, 0.5])


def free(x: Array) -> of.Filament:
    """Beads that nothing holds together: what acts on them is the loads alone."""
    return of.Filament(x * NM, 7 * unit.dalton, ())


@given(chains(2, 9), st.data())
def test_a_pull_is_a_constant_force_and_minus_its_work(x: Array, data: st.DataObject) -> None:
    indices = st.integers(-len(x), len(x) - 1)
    forces = st.tuples(*[st.floats(-50, 50)] * 3)
    drawn = data.draw(st.lists(st.tuples(st.lists(indices, min_size=1, max_size=3), forces), min_size=1, max_size=3))
    loads = [Pull(beads, force * PN) for beads, force in drawn]
    expected = np.zeros_like(x)
    for beads, force in drawn:
        for i in {i % len(x) for i in beads}:  # twice the same bead in one load counts once
            expected[i] += 0.602214076 * np.array(force)
    filament = free(random_chain(np.random.default_rng(0), len(x)))
    model = of.build(filament, loads)
    size = max(1.0, np.abs(expected).max())
    for got in (of.reference.forces(filament, x * NM, loads), of.forces(model, x * NM)):
        np.testing.assert_allclose(got, expected, rtol=0, atol=tol.ROUNDING * size)
    work = pytest.approx(-(expected * x).sum(), rel=tol.ROUNDING, abs=tol.ROUNDING * size * np.abs(x).sum())
    assert of.reference.energies(filament, x * NM, loads) == {"pull": work}
    assert of.energies(model, x * NM) == {"pull": work}


@given(chains(2, 9), st.data())
def test_held_beads_have_no_mass_and_no_force_is_added(x: Array, data: st.DataObject) -> None:
    beads = data.draw(st.lists(st.integers(-len(x), len(x) - 1), max_size=4))
    model = of.build(free(x), [Hold(beads)])
    held = {i % len(x) for i in beads}
    masses = [model.system.getParticleMass(i).value_in_unit(unit.dalton) for i in range(len(x))]
    assert masses == [0.0 if i in held else 7.0 for i in range(len(x))]
    assert set(model.held) == held
    assert len(model.held) == len(held)
    np.testing.assert_array_equal(model.masses, np.full(len(x), 7.0))
    assert model.system.getNumForces() == 0


def test_held_beads_stay_and_pulled_ones_accelerate() -> None:
    x = random_chain(np.random.default_rng(3), 4)
    model = of.build(free(x), [Hold(0), Hold([1, -2]), Pull(-1, FORCE * PN)])
    context = mm.Context(model.system, mm.VerletIntegrator(0.01), mm.Platform.getPlatformByName("Reference"))
    context.setPositions(model.positions)
    context.getIntegrator().step(100)
    moved = context.getState(positions=True).getPositions(asNumpy=True).value_in_unit(NM) - x
    np.testing.assert_array_equal(moved[:3], np.zeros((3, 3)))
    steps = 100 * 101 / 2  # leapfrog from rest, the first velocity being half a step late
    np.testing.assert_allclose(moved[3], 0.602214076 * FORCE / 7 * 0.01**2 * steps, rtol=1e-10)


def test_the_plane_adds_no_force_and_is_told_to_the_model() -> None:
    x = random_chain(np.random.default_rng(4), 4)
    assert of.build(free(x), [Plane()]).planar
    assert of.build(free(x), [Plane()]).system.getNumForces() == 0
    assert not of.build(free(x)).planar


def test_a_pull_adds_to_the_internal_forces() -> None:
    x, y = (random_chain(np.random.default_rng(seed), 5) for seed in (5, 6))
    filament = of.Filament(x * NM, 1 * unit.dalton, (stretching.Harmonic(10 * KJ / NM**2),))
    loads = [Hold(0), Pull([2, -1], FORCE * PN)]
    model = of.build(filament, loads)
    total = of.reference.forces(filament, y * NM, loads)
    np.testing.assert_allclose(of.forces(model, y * NM), total, rtol=0, atol=tol.OPENMM_FORCES * np.abs(total).max())
    internal = of.reference.forces(filament, y * NM)
    np.testing.assert_allclose((total - internal)[[2, 4]], np.tile(0.602214076 * FORCE, (2, 1)), rtol=tol.ROUNDING)
    np.testing.assert_array_equal((total - internal)[[0, 1, 3]], 0)


def wire(closed: bool = False, **stretched: Any) -> of.Filament:
    """Six segments of 2 nm along z, k = 30 kJ/mol/nm^2 in the first and 50 in the others."""
    k = [30.0, 50.0, 50.0, 50.0, 50.0, 50.0] * KJ / NM**2
    return of.Filament(
        of.shapes.line(6, 2 * NM), 5 * unit.dalton, (stretching.Harmonic(k, **stretched),), closed=closed
    )


def test_tension_pulls_at_both_held_ends_alike_and_leaves_the_chain_at_rest() -> None:
    loads = [Hold([0, -1]), Tension(20 * KJ / NM)]
    model = of.build(wire(), loads)
    expected = np.zeros((7, 3))
    expected[0, 2], expected[-1, 2] = 20, -20
    for got in (of.forces(model), of.reference.forces(wire(), wire().rest, loads)):
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-11)
    stored = 20**2 / 2 * (1 / 30 + 5 / 50)  # T^2/2k a segment
    assert of.energies(model) == {"stretching": pytest.approx(stored, rel=tol.ROUNDING)}
    assert of.reference.energies(wire(), wire().rest, loads) == {"stretching": pytest.approx(stored, rel=tol.ROUNDING)}
    assert model.system.getNumForces() == 1


def test_tension_counts_from_the_rest_shape_whatever_rest_length_was_given() -> None:
    loads = [Hold([0, -1]), Tension(20 * KJ / NM)]
    given_length = of.build(wire(rest_length=1.0 * NM), loads)
    np.testing.assert_allclose(of.forces(given_length), of.forces(of.build(wire(), loads)), atol=1e-11)


def test_a_pluck_is_a_pull_with_a_switch() -> None:
    x = random_chain(np.random.default_rng(7), 5)
    chain = free(x)
    pluck, pulled = ([kind([1, -1], FORCE * PN, *more)] for kind, more in ((Pluck, (3 * unit.picosecond,)), (Pull, ())))
    on = of.build(chain, pluck)
    np.testing.assert_array_equal(of.forces(on, x * NM), of.forces(of.build(chain, pulled), x * NM))
    np.testing.assert_array_equal(of.reference.forces(chain, x * NM, pluck), of.reference.forces(chain, x * NM, pulled))
    assert of.energies(on, x * NM) == {"pluck": pytest.approx(of.reference.energies(chain, x * NM, pulled)["pull"])}
    assert on.letting_go == 3
    context = mm.Context(on.system, mm.VerletIntegrator(0.01), mm.Platform.getPlatformByName("Reference"))
    context.setPositions(on.positions)
    context.setParameter("pluck", 0.0)
    assert not np.any(context.getState(forces=True).getForces(asNumpy=True))


# Refused ------------------------------------------------------------------------------------------------------------


def pull(beads: Any) -> Pull:
    return Pull(beads, FORCE * PN)


@pytest.mark.parametrize("load", [Hold, pull])
@given(beads=st.integers(2, 9), beyond=st.integers(0, 100), data=st.data())
def test_a_bead_index_out_of_range_is_refused(load: Any, beads: int, beyond: int, data: st.DataObject) -> None:
    bad = data.draw(st.sampled_from([beads + beyond, -beads - 1 - beyond]))
    rule = rf"`(Hold|Pull)\.beads` must be a bead index from -{beads} to {beads - 1}, but is {bad}\."
    chain = free(random_chain(np.random.default_rng(0), beads))
    for given_beads in (bad, [0, bad]):
        with pytest.raises(ValueError, match=rule):
            of.build(chain, [load(given_beads)])
        with pytest.raises(ValueError, match=rule):
            of.reference.forces(chain, chain.rest, [load(given_beads)])


@pytest.mark.parametrize("load", [Hold, pull])
@pytest.mark.parametrize("bad", [1.0, None, True, [0.5], "first", [True]])
def test_a_bead_index_that_is_no_whole_number_is_refused(load: Callable[[Any], Any], bad: object) -> None:
    with pytest.raises(TypeError, match=r"`(Hold|Pull)\.beads` must be"):
        resolve([load(bad)], 5)


@given(st.integers(2, 9), st.data())
def test_a_held_bead_that_is_also_pulled_is_refused(beads: int, data: st.DataObject) -> None:
    i = data.draw(st.integers(0, beads - 1))
    held, pulled = data.draw(st.tuples(*[st.sampled_from([i, i - beads])] * 2))
    for loads in ([Hold(held), pull(pulled)], [pull([pulled]), Hold([held])]):
        with pytest.raises(ValueError, match=f"`loads` must not pull a held bead, but bead {i} is both"):
            resolve(loads, beads)


@pytest.mark.parametrize("bad", [1.0, FORCE, (0, 0, 5), None])
def test_a_force_without_a_unit_is_refused(bad: object) -> None:
    with pytest.raises(TypeError, match=r"`force` must be a Quantity of force .* without a unit"):
        Pull(0, bad)


@pytest.mark.parametrize("its_unit", [KJ, NM, KJ / NM**2, unit.kelvin])
def test_a_force_of_another_dimension_is_refused(its_unit: unit.Unit) -> None:
    with pytest.raises(TypeError, match="`force` must have a unit of force"):
        Pull(0, FORCE * its_unit)


@pytest.mark.parametrize("shape", [(), (1,), (2,), (4,), (1, 3)])
def test_a_force_that_is_no_vector_is_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=rf"`force` must have shape \(3,\), but has shape {re.escape(str(shape))}"):
        Pull(0, np.ones(shape) * PN)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_force_that_is_not_finite_is_refused(bad: float) -> None:
    with pytest.raises(ValueError, match=f"`force` must be finite, but is {bad} at index 1"):
        Pull(0, [0, bad, 0] * PN)


def test_tension_is_refused_where_nothing_can_hold_it() -> None:
    tension = Tension(20 * KJ / NM)
    for loads in ([tension], [tension, Hold(0)], [tension, Hold([0, -2])]):
        with pytest.raises(ValueError, match="must hold both ends under Tension, but bead [06] is free"):
            of.build(wire(), loads)
    with pytest.raises(ValueError, match="only for a filament with one harmonic stretching term"):
        of.build(free(random_chain(np.random.default_rng(0), 4)), [tension, Hold([0, -1])])
    with pytest.raises(ValueError, match="must not hold Tension for a closed filament"):
        ring = of.Filament(
            of.shapes.ring(6, 1 * NM), 1 * unit.dalton, (stretching.Harmonic(1 * KJ / NM**2),), closed=True
        )
        of.build(ring, [tension, Hold([0, -1])])
    with pytest.raises(ValueError, match=r"`tension` must be below k b = 60 kJ/mol/nm.*segment 0 .*is 60 kJ"):
        of.build(wire(), [Tension(60 * KJ / NM), Hold([0, -1])])
    with pytest.raises(ValueError, match="`tension` must be finite and not negative, but is -1"):
        Tension(-1 * KJ / NM)


def test_a_pluck_is_refused_on_a_held_bead_without_a_duration_and_with_two() -> None:
    now, later = (Pluck(2, FORCE * PN, t * unit.picosecond) for t in (1, 2))
    with pytest.raises(ValueError, match="`loads` must not pluck a held bead, but bead 2 is both held and plucked"):
        of.build(wire(), [Hold(2), now])
    with pytest.raises(ValueError, match=r"`loads` must let all plucks go together, but has \[1.0, 2.0\] ps"):
        of.build(wire(), [now, later])
    with pytest.raises(ValueError, match="`loads` must let all plucks go together"):
        of.build([wire(), wire()], [[now], [later]])
    with pytest.raises(ValueError, match="`duration` must be positive, but is 0"):
        Pluck(2, FORCE * PN, 0 * unit.picosecond)
    with pytest.raises(TypeError, match="`duration` must be a Quantity of time"):
        Pluck(2, FORCE * PN, 1.0)


def test_what_is_no_load_is_refused() -> None:
    chain = free(random_chain(np.random.default_rng(0), 4))
    with pytest.raises(TypeError, match=r"`loads` must be a sequence of loads, but is one Hold: write \[Hold"):
        of.build(chain, Hold(0))
    with pytest.raises(TypeError, match=r"`loads` must hold loads .* but holds 3"):
        of.build(chain, [3])
    with pytest.raises(TypeError, match=r"`loads` must hold loads .* but holds <class"):
        of.build(chain, [Plane])


def test_loads_keep_their_numbers_when_the_arrays_change() -> None:
    force, beads = np.array([0.0, 0.0, 1.0]), [2, 3]
    pull, hold = of.loads.Pull(beads, unit.Quantity(force, unit.piconewton)), of.loads.Hold(beads)
    force[2], beads[0] = 7.0, 0
    assert pull.force.value_in_unit(unit.piconewton).tolist() == [0.0, 0.0, 1.0]
    assert list(pull.beads) == list(hold.beads) == [2, 3]
