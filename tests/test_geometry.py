"""Segments, bending angles and dihedrals against chains built from them and against OpenMM's own angles."""

from __future__ import annotations

import numpy as np
import openmm as mm
import pytest
import tolerances as tol
from conftest import Array, bent_chains, chain_from_angles, chains
from hypothesis import given
from hypothesis import strategies as st

from openmm_filament import geometry


def openmm_angle(force: mm.Force, x: Array) -> float:
    """The energy of one element whose expression is `theta`."""
    system = mm.System()
    for _ in x:
        system.addParticle(1.0)
    (force.addAngle if isinstance(force, mm.CustomAngleForce) else force.addTorsion)(*range(len(x)), ())
    system.addForce(force)
    context = mm.Context(system, mm.VerletIntegrator(1), mm.Platform.getPlatformByName("Reference"))
    context.setPositions(x)
    return context.getState(energy=True).getPotentialEnergy()._value


@given(bent_chains(margin=1e-3))
def test_lengths_and_angles_built_in_are_measured_again(parts: tuple[Array, Array, Array]) -> None:
    lengths, bends, torsions = parts
    x = chain_from_angles(*parts)
    np.testing.assert_allclose(np.linalg.norm(geometry.segments(x), axis=1), lengths, rtol=tol.ROUNDING)
    triples, quadruples = (x[geometry.chain_indices(len(x), span)] for span in (3, 4))
    np.testing.assert_allclose(geometry.bending_angles(triples), bends, rtol=0, atol=tol.ANGLE)
    np.testing.assert_allclose(geometry.dihedrals(quadruples), torsions, rtol=0, atol=tol.ANGLE)


@given(bent_chains(3, 3))
def test_angles_are_openmms(parts: tuple[Array, Array, Array]) -> None:
    x = chain_from_angles(*parts)
    theta = openmm_angle(mm.CustomAngleForce("theta"), x[:3])
    assert geometry.bending_angles(x[:3]) == pytest.approx(np.pi - theta, abs=tol.ANGLE)
    assert geometry.dihedrals(x) == pytest.approx(openmm_angle(mm.CustomTorsionForce("theta"), x), abs=tol.ANGLE)


@given(bent_chains())
def test_a_mirror_keeps_bends_and_turns_torsions_round(parts: tuple[Array, Array, Array]) -> None:
    x = chain_from_angles(*parts)
    triples, quadruples = (geometry.chain_indices(len(x), span) for span in (3, 4))
    mirrored = x * [-1, 1, 1]
    np.testing.assert_array_equal(geometry.bending_angles(mirrored[triples]), geometry.bending_angles(x[triples]))
    np.testing.assert_array_equal(geometry.dihedrals(mirrored[quadruples]), -geometry.dihedrals(x[quadruples]))


@given(bent_chains())
def test_a_chain_read_backwards_has_the_same_angles(parts: tuple[Array, Array, Array]) -> None:
    x = chain_from_angles(*parts)
    quadruples = geometry.chain_indices(len(x), 4)
    forwards, backwards = geometry.dihedrals(x[quadruples]), geometry.dihedrals(x[::-1][quadruples])[::-1]
    np.testing.assert_allclose(backwards, forwards, rtol=0, atol=tol.ANGLE)


@pytest.mark.parametrize("angle", [1e-12, 1e-9, 1e-6, np.pi - 1e-6, np.pi - 1e-9])
def test_small_bends_and_nearly_folded_ones_keep_their_digits(angle: float) -> None:
    x = np.array([[-1.0, 0, 0], [0, 0, 0], [np.cos(angle), np.sin(angle), 0]])
    measured = geometry.bending_angles(x)
    if angle < 1:
        assert measured == pytest.approx(angle, rel=1e-14)
    else:
        assert np.pi - measured == pytest.approx(np.pi - angle, rel=1e-6)


def test_straight_folded_cis_and_trans() -> None:
    assert geometry.bending_angles(np.array([[0.0, 0, 0], [1, 0, 0], [3, 0, 0]])) == 0
    assert geometry.bending_angles(np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 0, 0]])) == np.pi
    cis = np.array([[0.0, 1, 0], [0, 0, 0], [1, 0, 0], [1, 1, 0]])
    assert geometry.dihedrals(cis) == 0
    trans = cis - [[0, 0, 0], [0, 0, 0], [0, 0, 0], [0, 2, 0]]
    assert geometry.dihedrals(trans) == np.pi
    up = np.array([[0.0, 1, 0], [0, 0, 0], [1, 0, 0], [1, 0, 1]])  # looking along x, from y to z: clockwise
    assert geometry.dihedrals(up) == pytest.approx(np.pi / 2)


@given(st.integers(0, 12), st.integers(1, 4))
def test_chain_indices_are_runs_of_successive_beads(beads: int, span: int) -> None:
    runs = geometry.chain_indices(beads, span)
    assert runs.shape == (max(beads - span + 1, 0), span)
    assert all(list(run) == list(range(run[0], run[0] + span)) for run in runs)
    if beads >= span:
        ring = geometry.chain_indices(beads, span, closed=True)
        assert ring.tolist() == [[(i + k) % beads for k in range(span)] for i in range(beads)]


@given(chains(3))
def test_the_segments_of_a_ring_close(x: Array) -> None:
    ring = geometry.segments(x, closed=True)
    assert ring.shape == x.shape
    np.testing.assert_array_equal(ring[:-1], geometry.segments(x))
    np.testing.assert_allclose(ring.sum(axis=0), 0, atol=tol.ROUNDING * np.abs(x).sum())


@given(chains(2))
def test_vector_algebra_is_numpys(x: Array) -> None:
    y = x[::-1]
    np.testing.assert_array_equal(geometry.cross(x, y), np.cross(x, y))
    size = np.abs(x).max() ** 2
    np.testing.assert_allclose(geometry.dot(x, y), (x * y).sum(axis=1), rtol=0, atol=tol.ROUNDING * size)
    np.testing.assert_allclose(np.linalg.norm(geometry.unit_vectors(x), axis=1), 1, rtol=tol.ROUNDING)


@given(chains(4))
def test_stacks_of_chains_are_taken_at_once(x: Array) -> None:
    both = np.stack([x, 2 * x])
    np.testing.assert_array_equal(geometry.segments(both)[1], geometry.segments(2 * x))
    np.testing.assert_array_equal(geometry.segments(both, closed=True)[0], geometry.segments(x, closed=True))
    quadruples = geometry.chain_indices(len(x), 4)
    np.testing.assert_array_equal(geometry.dihedrals(both[:, quadruples])[0], geometry.dihedrals(x[quadruples]))
