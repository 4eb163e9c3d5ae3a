"""Our gradients against the thesis's forces, written term by term after its equations (1.7), (1.16), (1.20, A.6)."""

from __future__ import annotations

import numpy as np
import pytest
import tolerances as tol
from conftest import KJ, NM, Array, chain_from_angles
from openmm import unit

import openmm_filament as of
from openmm_filament import bending, stretching, torsion
from openmm_filament._term import Term
from openmm_filament.geometry import chain_indices, dihedrals

MIRROR = np.array([1.0, 1.0, -1.0])


def right_handed(rng: np.random.Generator, beads: int) -> Array:
    """A random chain with bends and torsions in (0.1, pi - 0.1): the half where arccos and the signed angle agree."""
    inside = rng.uniform(0.1, np.pi - 0.1, (2, beads))
    return chain_from_angles(rng.uniform(0.5, 2, beads - 1), inside[0, : beads - 2], inside[1, : beads - 3])


def filament_and_positions(rng: np.random.Generator, *kinds: type[Term]) -> tuple[of.Filament, Array]:
    beads = int(rng.integers(4, 33))
    stiffness = {
        stretching.Harmonic: rng.uniform(10, 1000, beads - 1) * KJ / NM**2,
        bending.Harmonic: rng.uniform(1, 100, beads - 2) * KJ,
        torsion.Harmonic: rng.uniform(1, 100, beads - 3) * KJ,
    }
    terms = tuple(kind(stiffness[kind]) for kind in kinds)
    return of.Filament(right_handed(rng, beads) * NM, 1 * unit.dalton, terms), right_handed(rng, beads)


KINDS = (stretching.Harmonic, bending.Harmonic, torsion.Harmonic)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.family)
def test_each_force_is_the_thesis_force_on_right_handed_chains(kind: type[Term], rng: np.random.Generator) -> None:
    for _ in range(50):
        filament, x = filament_and_positions(rng, kind)
        ours, theirs = of.reference.forces(filament, x * NM), of.reference.thesis_forces(filament, x * NM)
        assert list(theirs) == [kind.family]
        assert np.abs(ours - theirs[kind.family]).max() <= tol.THESIS * np.abs(ours).max()


def test_the_sum_is_the_total_force(rng: np.random.Generator) -> None:
    for _ in range(20):
        filament, x = filament_and_positions(rng, *KINDS)
        total = sum(of.reference.thesis_forces(filament, x * NM).values())
        for ours in (of.reference.forces(filament, x * NM), of.forces(of.build(filament), x * NM)):
            assert np.abs(ours - total).max() <= tol.THESIS * np.abs(total).max()


def test_the_thesis_cannot_tell_the_hands_apart_and_we_can(rng: np.random.Generator) -> None:
    filament, x = filament_and_positions(rng, torsion.Harmonic)
    mirrored = x * MIRROR
    theirs = of.reference.thesis_forces(filament, x * NM)["torsion"]
    in_mirror = of.reference.thesis_forces(filament, mirrored * NM)["torsion"]
    np.testing.assert_allclose(in_mirror, theirs * MIRROR, rtol=0, atol=tol.THESIS * np.abs(theirs).max())

    (parameters,) = (interaction.parameters for interaction in filament.interactions())
    tau = dihedrals(mirrored[chain_indices(len(x), 4)])
    unsigned = 0.5 * parameters["c"] @ (np.abs(tau) - parameters["tau0"]) ** 2
    before = of.reference.energies(filament, x * NM)["torsion"]
    after = of.reference.energies(filament, mirrored * NM)["torsion"]
    assert unsigned == pytest.approx(before, rel=tol.THESIS)
    assert after > 1.1 * before
    ours = of.reference.forces(filament, mirrored * NM)
    assert np.abs(ours - in_mirror).max() > 0.1 * np.abs(ours).max()


def test_a_left_handed_rest_shape_gives_the_mirrored_forces(rng: np.random.Generator) -> None:
    filament, x = filament_and_positions(rng, *KINDS)
    left = of.Filament(filament.rest.value_in_unit(NM) * MIRROR * NM, filament.masses, filament.terms)
    forces = of.reference.forces(filament, x * NM)
    in_mirror = of.reference.forces(left, x * MIRROR * NM)
    np.testing.assert_allclose(in_mirror, forces * MIRROR, rtol=0, atol=tol.MOVED * np.abs(forces).max())


def test_the_thesis_torsion_does_not_exist_on_a_planar_shape_and_ours_does() -> None:
    zigzag = chain_from_angles(np.ones(3), np.array([1.0, 1.0]), np.array([0.0]))
    filament = of.Filament(zigzag * NM, 1 * unit.dalton, (torsion.Harmonic(1 * KJ, 0.5 * unit.radian),))
    with np.errstate(invalid="ignore", divide="ignore"):
        theirs = of.reference.thesis_forces(filament, filament.rest)["torsion"]
    assert not np.isfinite(theirs).all()
    ours = of.reference.forces(filament, filament.rest)
    assert np.isfinite(ours).all()
    assert np.abs(ours).max() > 0.1


def test_thesis_forces_refuse_what_the_thesis_does_not_cover(rng: np.random.Generator) -> None:
    x = right_handed(rng, 6) * NM
    with pytest.raises(ValueError, match="`filament` must be open"):
        of.reference.thesis_forces(of.Filament(x, 1 * unit.dalton, (), closed=True), x)
    with pytest.raises(ValueError, match="harmonic terms alone, but has Cosine"):
        of.reference.thesis_forces(of.Filament(x, 1 * unit.dalton, (bending.Cosine(1 * KJ),)), x)
