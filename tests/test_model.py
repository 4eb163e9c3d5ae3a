"""Models: the forces of a System, its groups, replicas, scales, topology, and what OpenMM and mdtraj make of them."""

from __future__ import annotations

from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import mdtraj
import numpy as np
import openmm as mm
import pytest
import tolerances as tol
from conftest import KJ, NM, Array, chain_from_angles, magnitudes, random_chain
from hypothesis import given
from hypothesis import strategies as st
from openmm import app, unit

import openmm_filament as of
from openmm_filament import bending, electrostatics, stretching, torsion, units
from openmm_filament._term import Term
from openmm_filament.loads import Hold, Plane, Pull

PN = unit.piconewton
REFERENCE = mm.Platform.getPlatformByName("Reference")

# One of each term, its OpenMM force, its group.
TERMS: tuple[tuple[Term, str, str], ...] = (
    (stretching.Harmonic(100 * KJ / NM**2), "CustomBondForce", "stretching"),
    (bending.Harmonic(10 * KJ), "CustomAngleForce", "bending"),
    (bending.Cosine(10 * KJ), "CustomAngleForce", "bending"),
    (torsion.Harmonic(5 * KJ), "CustomTorsionForce", "torsion"),
    (torsion.Periodic(5 * KJ, 3), "CustomTorsionForce", "torsion"),
    (torsion.Weighted(5 * KJ), "CustomCompoundBondForce", "torsion"),
    (electrostatics.Neighbour(0.5 * unit.elementary_charge), "CustomBondForce", "electrostatics"),
    (bending.Harmonic(10 * KJ, form="arctangent"), "CustomCompoundBondForce", "bending"),
)
ELASTIC = (TERMS[0][0], TERMS[1][0], TERMS[3][0])


def chain(seed: int = 0, beads: int = 8, terms: Any = ELASTIC, **options: Any) -> of.Filament:
    return of.Filament(random_chain(np.random.default_rng(seed), beads) * NM, 10 * unit.dalton, terms, **options)


def positions(model: of.Model, seed: int = 9) -> unit.Quantity:
    """Random physical positions for all beads of a model of nanometre scale."""
    return random_chain(np.random.default_rng(seed), int(model.starts[-1])) * NM


def assert_openmm_is_numpy(model: of.Model, x: unit.Quantity, loads: Any = None) -> None:
    """Forces bead by bead and energies group by group, against the NumPy reference of each filament."""
    loads = loads or [()] * len(model.filaments)
    parts = [part * NM for part in model.split(x.value_in_unit(NM))]
    expected = [of.reference.forces(f, p, load) for f, p, load in zip(model.filaments, parts, loads, strict=True)]
    for got, wanted in zip(model.split(of.forces(model, x)), expected, strict=True):
        np.testing.assert_allclose(got, wanted, rtol=0, atol=tol.OPENMM_FORCES * np.abs(wanted).max())
    by_filament = [of.reference.energies(f, p, load) for f, p, load in zip(model.filaments, parts, loads, strict=True)]
    energies = of.energies(model, x)
    assert set(energies) == set().union(*by_filament)
    for name, energy in energies.items():
        single = [e.get(name, 0.0) for e in by_filament]
        assert energy == pytest.approx(sum(single), rel=0, abs=tol.OPENMM_ENERGIES * np.abs(single).sum())


# Forces and groups --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", range(len(TERMS) + 1))
def test_there_is_one_force_for_each_term_present_and_no_other(count: int) -> None:
    for chosen in list(combinations(TERMS, count))[:6]:
        model = of.build(chain(terms=[term for term, _, _ in chosen]))
        system = model.system
        forces = system.getForces()
        assert [type(force).__name__ for force in forces] == [force for _, force, _ in chosen]
        assert set(model.groups) == {family for _, _, family in chosen}
        assert len(set(model.groups.values())) == len(model.groups)
        assert [force.getForceGroup() for force in forces] == [model.groups[family] for _, _, family in chosen]
        assert (system.getNumParticles(), system.getNumConstraints()) == (8, 0)
        assert not system.usesPeriodicBoundaryConditions()


def test_a_term_given_twice_is_one_force_with_both() -> None:
    once, twice = (of.build(chain(terms=(stretching.Harmonic(50 * KJ / NM**2),) * n)) for n in (1, 2))
    assert twice.system.getNumForces() == 1
    x = positions(once)
    energy = of.energies(once, x)["stretching"]
    assert of.energies(twice, x)["stretching"] == pytest.approx(2 * energy, rel=tol.ROUNDING)


def test_a_pull_adds_one_external_force_and_holding_or_the_plane_none() -> None:
    bare = of.build(chain()).system.getNumForces()
    assert of.build(chain(), [Hold([0, 1]), Plane()]).system.getNumForces() == bare
    model = of.build(chain(), [Hold(0), Pull(-1, [0, 0, 1] * PN), Pull([3, -1], [1, 0, 0] * PN)])
    assert model.system.getNumForces() == bare + 1
    last = model.system.getForce(bare)
    assert isinstance(last, mm.CustomExternalForce)
    assert last.getNumParticles() == 2
    assert last.getForceGroup() == model.groups["pull"]


def test_groups_separate_the_energies() -> None:
    model = of.build(chain(terms=[term for term, _, _ in TERMS]))
    assert_openmm_is_numpy(model, positions(model))


# Several filaments --------------------------------------------------------------------------------------------------


def test_replicas_take_their_own_pull() -> None:
    filament, n = chain(beads=6), 5
    loads = [[Hold(0), Pull(-1, [0, 0, force] * PN)] for force in range(n)]
    model = of.build([filament] * n, loads)
    x = random_chain(np.random.default_rng(1), 6)
    same = np.tile(x, (n, 1)) * NM
    assert_openmm_is_numpy(model, same, loads)
    differences = np.diff(of.forces(model, same).reshape(n, 6, 3), axis=0)
    assert differences[:, -1, 2] == pytest.approx(0.602214076, rel=tol.OPENMM_FORCES)
    np.testing.assert_allclose(differences[:, :-1], 0, atol=1e-9)


def test_bead_indices_of_loads_are_local_to_their_filament() -> None:
    filaments = [chain(1, 5), chain(2, 7, closed=True), chain(3, 4)]
    loads = [[Hold(-1)], [Hold(0), Pull([1, -1], [1, 2, 3] * PN)], []]
    model = of.build(filaments, loads)
    assert model.starts.tolist() == [0, 5, 12, 16]
    assert model.held.tolist() == [4, 5]
    massless = [i for i in range(16) if model.system.getParticleMass(i)._value == 0]
    assert massless == [4, 5]
    assert np.flatnonzero(model.pulls.any(axis=1)).tolist() == [6, 11]
    assert_openmm_is_numpy(model, positions(model), loads)


def test_filaments_of_different_terms_live_in_one_model() -> None:
    filaments = [
        chain(1, 4, terms=[TERMS[0][0]]),
        chain(2, 9, terms=[TERMS[2][0], TERMS[4][0]], closed=True),
        chain(3, 2, terms=[TERMS[6][0]]),
        chain(4, 6, terms=[stretching.Harmonic(np.arange(1, 6) * PN / NM), torsion.Periodic(np.arange(1, 4) * KJ, 2)]),
        chain(5, 3, terms=()),
    ]
    model = of.build(filaments)
    assert model.system.getNumForces() == 4  # one a class, shared by the filaments that have it
    assert_openmm_is_numpy(model, positions(model))


def test_filaments_do_not_feel_one_another() -> None:
    first, second = chain(1, 6), chain(2, 6)
    x = random_chain(np.random.default_rng(3), 12)
    together = of.forces(of.build([first, second]), x * NM)
    alone = [of.forces(of.build(f), part * NM) for f, part in zip((first, second), (x[:6], x[6:]), strict=True)]
    np.testing.assert_array_equal(together, np.concatenate(alone))


def test_a_model_prints_in_one_line() -> None:
    terms = (stretching.Harmonic(1 * KJ / NM**2), bending.Harmonic(1 * KJ))
    chain = of.Filament(of.shapes.line(9, 1 * NM), 1 * unit.dalton, terms)
    assert repr(of.build([chain] * 2)) == "<Model: 20 beads; 2 filaments; stretching.Harmonic, bending.Harmonic>"
    small = of.Filament(of.shapes.line(9, 1 * unit.meter), 1 * unit.dalton, ())
    assert repr(of.build(small, [of.loads.Plane()])) == "<Model: 10 beads; 1 filaments; no terms; scaled; planar>"


def test_building_leaves_filaments_and_loads_as_they_are() -> None:
    filament, force = chain(), np.array([1.0, 2.0, 3.0])
    before = filament.rest.value_in_unit(NM).copy()
    loads = [Hold(0), Pull(-1, force * PN)]
    first, second = (of.build(filament, loads) for _ in range(2))
    assert mm.XmlSerializer.serialize(first.system) == mm.XmlSerializer.serialize(second.system)
    np.testing.assert_array_equal(filament.rest.value_in_unit(NM), before)
    np.testing.assert_array_equal(filament.masses.value_in_unit(unit.dalton), np.full(8, 10.0))
    np.testing.assert_array_equal(force, [1, 2, 3])


@pytest.mark.parametrize("bad", [[], None, [1], "chain", [[]]])
def test_what_is_no_filament_is_refused(bad: Any) -> None:
    with pytest.raises(TypeError, match="`filaments` must be a Filament or a sequence of them"):
        of.build(bad)


def test_loads_that_do_not_match_the_filaments_are_refused() -> None:
    filament = chain()
    for loads in ([[]], [[], [], []], [Hold(0), Hold(1)], [[], Hold(0)]):
        with pytest.raises((ValueError, TypeError), match="`loads` must hold one sequence of loads per filament, 2"):
            of.build([filament, filament], loads)
    with pytest.raises(ValueError, match="`loads` must put all filaments in the plane or none"):
        of.build([filament, filament], [[Plane()], []])
    with pytest.raises(TypeError, match="`loads` must hold loads"):
        of.build(filament, [[Hold(0)]])
    with pytest.raises((ValueError, TypeError), match="`loads` must"):
        of.build([filament], Hold(0))


def test_positions_that_do_not_fit_the_model_are_refused() -> None:
    model = of.build(chain())
    for function in (of.energies, of.forces):
        with pytest.raises(ValueError, match=r"`positions` must have shape \(8, 3\), but has shape \(7, 3\)"):
            function(model, np.ones((7, 3)) * NM)
        with pytest.raises(TypeError, match="`positions` must be a Quantity of length"):
            function(model, np.ones((8, 3)))


# Scales -------------------------------------------------------------------------------------------------------------


def in_metres(x: Array, mass: unit.Quantity, k: Any, alpha: Any, c: Any) -> of.Filament:
    terms = (stretching.Harmonic(k), bending.Harmonic(alpha), torsion.Harmonic(c), torsion.Weighted(alpha))
    return of.Filament(x * unit.meter, mass, terms)


def steel_string() -> of.Filament:
    """The thesis's guitar string as a slack coil: 25 of its segments of 3.6 mm; E = 190 GPa, R = 0.25 mm, G = E/2.6."""
    l0, radius, e = 3.6e-3, 0.25e-3, 190e9
    stiffness = [e * np.pi * radius**2 / l0, e * np.pi * radius**4 / 4 / l0, e / 2.6 * np.pi * radius**4 / 2 / l0]
    units_of = (unit.newton / unit.meter, unit.joule, unit.joule)
    given_stiffness = [value * u for value, u in zip(stiffness, units_of, strict=True)]
    mass = 1.55e-3 * l0 / 1.66053906892e-27 * unit.dalton
    return in_metres(l0 * random_chain(np.random.default_rng(1), 26), mass, *given_stiffness)


def tiny_chain() -> of.Filament:
    """Segments of an Angstrom."""
    x = random_chain(np.random.default_rng(2), 20) * 1e-10
    return in_metres(x, 12 * unit.dalton, 300 * unit.newton / unit.meter, 1e-19 * unit.joule, 50 * KJ)


def test_dna_runs_in_openmms_own_units() -> None:
    rest = of.shapes.line(40, 25 * NM)
    filament = of.Filament(rest, 47794 * unit.dalton, (stretching.Harmonic(40 * PN / NM), bending.Harmonic(5.3 * KJ)))
    model = of.build(filament)
    assert model.scale.is_identity
    np.testing.assert_array_equal(model.positions.value_in_unit(NM), rest.value_in_unit(NM))
    assert model.to_internal(3 * unit.picosecond) == 3 * unit.picosecond


@pytest.mark.parametrize("make", [steel_string, tiny_chain])
def test_far_from_the_nanometre_the_internal_segments_are_of_order_one(make: Any) -> None:
    filament = make()
    model = of.build(filament)
    assert not model.scale.is_identity
    internal = np.linalg.norm(np.diff(model.positions.value_in_unit(NM), axis=0), axis=1)
    assert 0.9 < internal.min() < internal.max() < 4
    masses = [model.system.getParticleMass(i).value_in_unit(unit.dalton) for i in range(len(filament))]
    np.testing.assert_allclose(masses, 1, rtol=tol.ROUNDING)
    largest = max(np.abs(values).max() for part in model.interactions for values in part.parameters.values())
    assert 0.1 < largest < 10
    physical = model.to_physical(model.positions, "length").value_in_unit(NM)
    np.testing.assert_allclose(physical, filament.rest.value_in_unit(NM), rtol=tol.ROUNDING)


@pytest.mark.parametrize("make", [steel_string, tiny_chain])
def test_scaled_energies_and_forces_are_the_physical_ones(make: Any, rng: np.random.Generator) -> None:
    filament = make()
    rest = filament.rest.value_in_unit(NM)
    step = np.linalg.norm(np.diff(rest, axis=0), axis=1).mean()
    pull = of.reference.forces(filament, (rest + 0.01 * step * rng.normal(size=rest.shape)) * NM)[5]
    loads = [[Hold(0), Pull(-1, pull * KJ / NM)]]
    for amplitude in (0.01, 0.3):
        moved = (rest + amplitude * step * rng.normal(size=rest.shape)) * NM
        assert_openmm_is_numpy(of.build([filament], loads), moved, loads)


@pytest.mark.parametrize("short", [0.29, 0.31])
def test_a_few_short_segments_keep_their_small_bends(short: float) -> None:
    """OpenMM floors |s1 x s2| at 1e-6: no scale may bring the shortest segments there."""
    lengths = np.full(100, 10.0)
    lengths[:2] = short
    x = chain_from_angles(lengths, np.full(99, 1e-3), np.full(98, 0.3)) * NM
    model = of.build(of.Filament(x, 1 * unit.dalton, (bending.Harmonic(10 * KJ, 0 * unit.radian),)))
    expected = of.reference.forces(model.filaments[0], x)
    np.testing.assert_allclose(of.forces(model), expected, rtol=0, atol=tol.MILLIRADIAN * np.abs(expected).max())


def test_scaled_charges_and_rings_too() -> None:
    x = random_chain(np.random.default_rng(4), 7) * 1e-3
    charges = np.linspace(-1, 1, 7) * unit.coulomb
    terms = (stretching.Harmonic(1 * unit.newton / unit.meter), electrostatics.Neighbour(charges))
    filament = of.Filament(x * unit.meter, 1e20 * unit.dalton, terms, closed=True)
    model = of.build([filament, filament])
    assert not model.scale.is_identity
    assert_openmm_is_numpy(model, np.tile(x[::-1] * 1e9, (2, 1)) * NM)


def test_a_scaled_filament_without_energies_can_be_built() -> None:
    for terms in ((), (electrostatics.Neighbour(0 * unit.elementary_charge),)):
        model = of.build(of.Filament(of.shapes.line(3, 1 * unit.meter), 1 * unit.dalton, terms))
        assert np.isfinite(of.forces(model)).all()


def test_scaled_oscillations_have_the_physical_period() -> None:
    """Half a period of a steel spring turns its elongation round: mass, length, energy and time fit together."""
    k, mass = 1e4 * unit.newton / unit.meter, 0.01  # kg
    rest = np.array([[0.0, 0, 0], [0, 0, 0.02]])
    filament = of.Filament(rest * unit.meter, mass / 1.66053906892e-27 * unit.dalton, (stretching.Harmonic(k),))
    model = of.build(filament, [Hold(0)])
    half = np.pi * np.sqrt(mass / 1e4)
    steps = 2000
    integrator = mm.VerletIntegrator(model.to_internal(half / steps * unit.second))
    context = mm.Context(model.system, integrator, REFERENCE)
    start = rest + np.array([[0, 0, 0], [0, 0, 1e-4]])
    context.setPositions(model.to_internal(start * unit.meter))
    integrator.step(steps)
    state = context.getState(positions=True)
    end = model.to_physical(state.getPositions(asNumpy=True), "length").value_in_unit(unit.meter)
    assert end[1, 2] - 0.02 == pytest.approx(-1e-4, rel=1e-5)
    assert model.to_physical(state.getTime(), "time").value_in_unit(unit.second) == pytest.approx(half, rel=1e-9)


@pytest.mark.parametrize("make", [chain, steel_string, tiny_chain])
@pytest.mark.parametrize("dimension", list(units._UNITS))
@given(value=magnitudes(1e-20, 1e20))
def test_internal_and_physical_quantities_go_round(make: Any, dimension: str, value: float) -> None:
    model = MODELS[make]
    physical = units.quantity(value, dimension)
    internal = model.to_internal(physical)
    assert units.dimension_of("x", internal) == dimension
    expected = value / model.scale.factor(dimension)
    assert units.number("x", internal, dimension) == pytest.approx(expected, rel=tol.ROUNDING)
    for again in (model.to_physical(internal, dimension), model.to_physical(internal._value, dimension)):
        assert units.number("x", again, dimension) == pytest.approx(value, rel=tol.ROUNDING)


MODELS = {make: of.build(make()) for make in (chain, steel_string, tiny_chain)}


def test_conversions_refuse_what_they_do_not_know() -> None:
    model = MODELS[chain]
    with pytest.raises(TypeError, match="`value` must be a Quantity"):
        model.to_internal(1.0)
    with pytest.raises(TypeError, match="`value` must have a unit of time"):
        model.to_physical(1.0 * NM, "time")
    with pytest.raises(ValueError, match="`dimension` must be one of"):
        model.to_physical(1.0, "luminosity")


@given(st.integers(1, 5))
def test_arrays_convert_to_arrays_and_numbers_to_numbers(n: int) -> None:
    model = MODELS[steel_string]
    assert isinstance(model.to_internal(1.0 * unit.meter)._value, float)
    assert model.to_internal(np.ones((n, 3)) * unit.meter)._value.shape == (n, 3)
    assert isinstance(model.to_physical(1.0, "energy")._value, float)


# Topology, files, simulations ---------------------------------------------------------------------------------------


def test_the_topology_has_a_chain_per_filament_and_bonds_along_it() -> None:
    sizes, rings = [3, 5, 2], [False, True, False]
    terms = (stretching.Harmonic(1 * KJ / NM**2),)
    filaments = [chain(i, n, terms, closed=ring) for i, (n, ring) in enumerate(zip(sizes, rings, strict=True))]
    model = of.build(filaments)
    topology = model.topology
    assert topology is model.topology
    assert [len(list(c.atoms())) for c in topology.chains()] == sizes
    assert [atom.index for atom in topology.atoms()] == list(range(10))
    bonds = {frozenset((a.index, b.index)) for a, b in topology.bonds()}
    assert bonds == {frozenset(pair) for pair in [(0, 1), (1, 2), *pairwise(range(3, 8)), (7, 3), (8, 9)]}
    assert topology.getNumBonds() == len(bonds)


@pytest.mark.parametrize(
    "filaments",
    [[chain(1, 6), chain(2, 9, closed=True)], [steel_string()], [tiny_chain()]],
    ids=["chain and ring", "steel", "tiny"],
)
def test_mdtraj_reads_the_pdb_file_back(filaments: list[of.Filament], tmp_path: Path) -> None:
    model = of.build(filaments)
    with (tmp_path / "filament.pdb").open("w") as file:
        app.PDBFile.writeFile(model.topology, model.positions, file)
    trajectory = mdtraj.load(str(tmp_path / "filament.pdb"))
    assert trajectory.n_atoms == model.topology.getNumAtoms()
    assert trajectory.topology.n_bonds == model.topology.getNumBonds()
    assert trajectory.topology.n_chains == len(model.filaments)
    np.testing.assert_allclose(trajectory.xyz[0], model.positions.value_in_unit(NM), atol=1e-4)


@pytest.mark.parametrize("make", [chain, steel_string, tiny_chain])
def test_a_simulation_steps_and_keeps_its_energy(make: Any) -> None:
    model = of.build(make(), [Hold(0)])
    simulation = app.Simulation(model.topology, model.system, mm.VerletIntegrator(1e-3), REFERENCE)
    simulation.context.setPositions(model.positions)
    simulation.context.setVelocitiesToTemperature(0.1, 1)
    energies = []
    for _ in range(3):
        simulation.step(50)
        state = simulation.context.getState(energy=True, positions=True)
        energies.append((state.getKineticEnergy() + state.getPotentialEnergy()).value_in_unit(KJ))
    assert np.isfinite(state.getPositions(asNumpy=True)._value).all()
    np.testing.assert_array_equal(state.getPositions(asNumpy=True)._value[0], model.positions._value[0])
    assert np.ptp(energies) < 0.01 * abs(state.getKineticEnergy().value_in_unit(KJ))
