"""Harmonic traps: energies and forces by two routes, moved and read, and in everything that uses second derivatives."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
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
from openmm_filament import traps
from openmm_filament.hessian import hessian, product
from openmm_filament.inspection import PreflightError
from openmm_filament.loads import Hold, Plane, Pull, Trap
from openmm_filament.trajectory import TrajectoryWriter

STIFF = KJ / NM**2
WARM = 300 * unit.kelvin


def free(x: Array) -> of.Filament:
    return of.Filament(x * NM, 7 * unit.dalton, ())


def wire(scale: float = 1.0) -> of.Filament:
    terms = (of.stretching.Harmonic(500 / scale**2 * STIFF), of.bending.Harmonic(20 * KJ))
    return of.Filament(of.shapes.line(5, scale * NM), 10 * unit.dalton, terms)


def running(model: of.Model, positions: Any = None) -> mm.Context:
    context = mm.Context(model.system, of.verlet(model), mm.Platform.getPlatformByName("Reference"))
    context.setPositions(model.positions if positions is None else model.to_internal(positions))
    return context


@given(chains(2, 8), st.data())
def test_a_trap_is_a_spring_to_a_place(x: Array, data: st.DataObject) -> None:
    numbers = st.tuples(*[st.floats(0, 50)] * 3)
    places = st.tuples(*[st.floats(-20, 20)] * 3)
    drawn = data.draw(
        st.lists(
            st.tuples(st.integers(-len(x), len(x) - 1), numbers.filter(any) | st.floats(0.1, 50), places),
            min_size=1,
            max_size=3,
        )
    )
    loads = [Trap(bead, k * STIFF, place * NM) for bead, k, place in drawn]
    energy, expected = 0.0, np.zeros_like(x)
    for bead, k, place in drawn:
        off = x[bead] - place
        energy += float((k * off * off).sum() / 2)
        expected[bead] -= k * off
    filament = free(random_chain(np.random.default_rng(0), len(x)))
    model = of.build(filament, loads)
    for got in (of.reference.forces(filament, x * NM, loads), of.forces(model, x * NM)):
        np.testing.assert_allclose(got, expected, rtol=0, atol=tol.ROUNDING * max(1.0, np.abs(expected).max()))
    same = pytest.approx(energy, rel=tol.ROUNDING)
    assert of.reference.energies(filament, x * NM, loads) == {"trap": same}
    assert of.energies(model, x * NM) == {"trap": same}


@pytest.mark.parametrize("scale", [1.0, 0.01])
def test_a_trap_moves_and_is_read_in_physical_units(scale: float) -> None:
    x = random_chain(np.random.default_rng(1), 6) * scale
    here, there, moved = (np.array(v) * scale for v in ([1.0, 0, 6], [0, 2.0, 1], [0.5, -1.0, 2]))
    stiff = np.array([1, 2, 0]) / scale**2
    loads = [Trap(-1, 3 / scale**2 * STIFF, here * NM), Trap(2, stiff * STIFF, there * NM)]
    model = of.build([wire(scale), wire(scale)], [loads, loads])
    assert model.scale.is_identity == (scale == 1.0)
    twice = np.concatenate([x, x + 0.1 * scale])
    context = running(model, twice * NM)
    of.move_trap(model, context, moved * NM, trap=1)
    for trap, k, centre, bead in ((0, 3 / scale**2, here, 5), (1, stiff, there + moved, 2)):
        read = of.trap_forces(model, context, trap).value_in_unit(KJ / NM)
        np.testing.assert_allclose(read, k * (centre - twice[[bead, bead + 6]]), rtol=0, atol=1e-9 / scale)
    group = model.groups["trap"]
    found = context.getState(forces=True, groups=1 << group).getForces(asNumpy=True)
    total = model.to_physical(found, "force").value_in_unit(KJ / NM)
    np.testing.assert_allclose(total[[2, 8]], stiff * (there + moved - twice[[2, 8]]), rtol=0, atol=1e-9 / scale)
    assert of.preflight(model, context).force_errors["trap"] < 1e-12
    of.move_trap(model, context, [0, 0, 0] * NM, trap=1)
    context.setParameter("trap0_x", 1.0)
    assert of.preflight(model, context).force_errors["trap"] < 1e-12


def test_traps_of_one_number_move_together_and_others_do_not() -> None:
    place = [0.0, 0.0, 1.0] * NM
    first, second = ([Trap(-1, 3 * STIFF, place, number=n), Trap(0, 2 * STIFF, place)] for n in (4, 7))
    model = of.build([wire(), wire(), wire()], [first, second, first])
    assert model.trap_numbers.tolist() == [4, 1, 7, 1, 4, 1]
    context = running(model)
    before = {n: of.trap_forces(model, context, n).value_in_unit(KJ / NM) for n in (1, 4, 7)}
    of.move_trap(model, context, [0.5, 0, 0] * NM, trap=4)
    for number, moved in ((4, 1.5), (7, 0.0), (1, 0.0)):
        change = of.trap_forces(model, context, number).value_in_unit(KJ / NM) - before[number]
        np.testing.assert_allclose(change, np.outer(np.ones(len(change)), [moved, 0, 0]), atol=1e-12)
    assert of.preflight(model, context).force_errors["trap"] < 1e-12
    with pytest.raises(ValueError, match=r"`trap` must be the number of a trap of the model \(1, 4, 7\), but is 0"):
        of.trap_forces(model, context)
    with pytest.raises(ValueError, match="`number` must be at least 0, but is -1"):
        Trap(0, 3 * STIFF, place, number=-1)


def test_preflight_finds_a_trap_of_another_stiffness() -> None:
    load, softer = (Trap(-1, k * STIFF, [0, 1, 4] * NM) for k in (3.0, 2.97))
    model, other = of.build(wire(), [load]), of.build(wire(), [softer])
    wrong = replace(model, system=other.system)
    with pytest.raises(PreflightError, match=r"Forces of trap must agree .* differ by 0.01 at bead 5"):
        of.preflight(model, running(wrong))


def test_the_hessian_has_the_stiffness_on_the_bead() -> None:
    with_trap = of.build(wire(), [Hold(0), Trap(3, [1.0, 2.0, 3.0] * STIFF, [0, 1, 4] * NM)])
    without = of.build(wire(), [Hold(0)])
    x = random_chain(np.random.default_rng(2), 6)
    extra = (hessian(with_trap, x) - hessian(without, x)).toarray()
    expected = np.zeros((18, 18))
    expected[[9, 10, 11], [9, 10, 11]] = [1, 2, 3]
    np.testing.assert_allclose(extra, expected, rtol=0, atol=1e-10)
    direction = np.random.default_rng(3).normal(size=x.shape)
    np.testing.assert_allclose(
        (hessian(with_trap, x) @ direction.ravel()).reshape(-1, 3),
        product(with_trap.interactions, x, direction),
        rtol=0,
        atol=1e-8,
    )


def test_a_bead_in_a_trap_swings_at_its_frequency() -> None:
    """And the time step is that of the stiffest axis."""
    bead = of.Filament(np.zeros((1, 3)) * NM, 7 * unit.dalton, ())
    model = of.build(bead, [Trap(0, [63.0, 28.0, 7.0] * STIFF, [0, 0, 0] * NM)])
    exact = np.sqrt([1.0, 4.0, 9.0]) / (2 * np.pi) * 1e12
    np.testing.assert_allclose(of.normal_modes(model).frequencies, exact, rtol=tol.ROUNDING)
    assert of.stable_timestep(model).value_in_unit(unit.picosecond) == pytest.approx(2 / 3, rel=tol.ROUNDING)


@pytest.mark.parametrize("force", [0.0, 30.0])
def test_a_chain_comes_to_rest_where_trap_and_bonds_balance(force: float) -> None:
    """Springs in series along z: bonds of stiffness 500/5 and the trap, with a pull on the trapped bead."""
    k, place = 40.0, 6.5
    loads: list[Any] = [Hold(0), Trap(-1, k * STIFF, [0, 0, place] * NM)]
    if force:
        loads.append(Pull(-1, [0, 0, force] * KJ / NM))
    rest = of.equilibrium(of.build(wire(), loads))
    assert rest.converged
    assert rest.is_minimum
    z = (5 * 100 + k * place + force) / (100 + k)
    assert rest.positions.value_in_unit(NM)[-1] == pytest.approx([0, 0, z], abs=1e-9)
    assert rest.energies["trap"] == pytest.approx(k / 2 * (z - place) ** 2)
    alone = of.equilibrium(of.build(wire(), [*loads[1:], Trap(0, k * STIFF, [0, 0, 0] * NM)]))  # nothing is held
    assert alone.converged


def test_a_trapped_bead_has_the_fluctuations_of_its_trap() -> None:
    """Equipartition, axis by axis; the axes of one bead are as three replicas."""
    k = np.array([10.0, 20.0, 40.0])
    beads = [of.Filament(np.zeros((1, 3)) * NM, 7 * unit.dalton, ())] * 500
    model = of.build(beads, [[Trap(0, k * STIFF, [1, 2, 3] * NM)]] * 500)
    limit = of.stable_timestep(model)
    context = mm.Context(
        model.system,
        of.langevin(model, WARM, timestep=0.9 * limit, friction=1 / unit.picosecond, seed=1),
        mm.Platform.getPlatformByName("Reference"),
    )
    context.setPositions(model.positions)
    context.getIntegrator().step(200)
    off = context.getState(positions=True).getPositions(asNumpy=True).value_in_unit(NM) - [1, 2, 3]
    squares = k * off**2 / (of.units.BOLTZMANN * 300)
    assert (np.abs(squares.mean(axis=0) - 1) < tol.SIGMAS * np.sqrt(2 / 500)).all()


def test_a_plane_keeps_a_trap_from_pulling_out_of_it() -> None:
    model = of.build(wire(), [Plane(), Trap(-1, 5 * STIFF, [1, 1, 9] * NM)])
    context = running(model)
    context.getIntegrator().step(50)
    moved = context.getState(positions=True).getPositions(asNumpy=True).value_in_unit(
        NM
    ) - model.positions.value_in_unit(NM)
    assert not moved[:, 2].any()
    assert np.abs(moved[-1, :2]).min() > 1e-3


def test_a_trajectory_keeps_the_traps_in_its_sidecar(tmp_path: Path) -> None:
    model = of.build(wire(), [Trap(-1, [1, 2, 3] * STIFF, [0, 1, 4] * NM)])
    writer = TrajectoryWriter(model, tmp_path / "run.dcd")
    writer.write(model.positions.value_in_unit(NM), 0, 0.0)
    writer.close()
    header = json.loads((tmp_path / "run.jsonl").read_text().split("\n")[0])
    assert header["loads"][0]["trapped"] == [5]
    assert header["loads"][0]["stiffness_kJ_per_mol_nm2"] == [[1, 2, 3]]
    assert header["loads"][0]["trap_nm"] == [[0, 1, 4]]


# Refused ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("stiffness", "position", "error", "message"),
    [
        (3.0, [0, 0, 1] * NM, TypeError, "`stiffness` must be a Quantity of stiffness"),
        (3.0 * KJ, [0, 0, 1] * NM, TypeError, "`stiffness` must have a unit of stiffness"),
        (-3.0 * STIFF, [0, 0, 1] * NM, ValueError, "`stiffness` must not be negative, but is -3"),
        (0.0 * STIFF, [0, 0, 1] * NM, ValueError, "`stiffness` must be positive along an axis"),
        ([1.0, 2.0] * STIFF, [0, 0, 1] * NM, ValueError, r"`stiffness` must have shape \(3,\)"),
        (
            [1.0, -2.0, 0.0] * STIFF,
            [0, 0, 1] * NM,
            ValueError,
            "`stiffness` must not be negative, but is -2.0 at index 1",
        ),
        (3.0 * STIFF, [0, 0, 1], TypeError, "`position` must be a Quantity of length"),
        (3.0 * STIFF, 1 * NM, ValueError, r"`position` must have shape \(3,\)"),
        (3.0 * STIFF, [0, np.nan, 1] * NM, ValueError, "`position` must be finite, but is nan at index 1"),
    ],
)
def test_a_trap_that_is_none_is_refused(stiffness: Any, position: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        Trap(0, stiffness, position)


def test_a_trap_on_a_held_bead_and_beyond_the_chain_is_refused() -> None:
    trap = Trap(-1, 3 * STIFF, [0, 0, 1] * NM)
    with pytest.raises(ValueError, match="must not trap a held bead, but bead 5 is both held and trapped"):
        of.build(wire(), [Hold(5), trap])
    with pytest.raises(ValueError, match=r"`Trap.bead` must be a bead index from -6 to 5, but is 6"):
        of.build(wire(), [Trap(6, 3 * STIFF, [0, 0, 1] * NM)])
    with pytest.raises(TypeError, match=r"`Trap.bead` must be a whole number"):
        of.build(wire(), [Trap([0, 1], 3 * STIFF, [0, 0, 1] * NM)])  # type: ignore[arg-type]


def test_moving_and_reading_a_trap_that_is_not_there_is_refused() -> None:
    model = of.build(wire(), [Trap(-1, 3 * STIFF, [0, 0, 1] * NM)])
    context = running(model)
    with pytest.raises(ValueError, match=r"`trap` must be the number of a trap of the model \(0\), but is 1"):
        of.move_trap(model, context, [0, 0, 1] * NM, trap=1)
    with pytest.raises(ValueError, match="`trap` must be at least 0, but is -1"):
        of.trap_forces(model, context, -1)
    with pytest.raises(TypeError, match="`displacement` must be a Quantity of length"):
        of.move_trap(model, context, [0, 0, 1])
    with pytest.raises(ValueError, match=r"`displacement` must have shape \(3,\)"):
        of.move_trap(model, context, 1 * NM)
    untrapped = of.build(wire(), [])
    with pytest.raises(ValueError, match=r"`trap` must be the number of a trap of the model \(it has none\), but is 0"):
        of.trap_forces(untrapped, running(untrapped))


def test_a_trap_among_the_terms_of_a_filament_is_refused() -> None:
    with pytest.raises(TypeError, match="A trap must be given as a load"):
        of.Filament(of.shapes.line(2, 1 * NM), 1 * unit.dalton, (traps.Harmonic(),))


def test_a_trap_keeps_its_numbers_when_the_arrays_change() -> None:
    place = np.array([0.0, 0.0, 1.0])
    trap = Trap(0, 3 * STIFF, unit.Quantity(place, NM))
    place[2] = 7
    assert trap.position.value_in_unit(NM).tolist() == [0, 0, 1]
