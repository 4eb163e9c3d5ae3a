"""Starting shapes: their averages are those of exact theory, in space and in a plane, bent, twisted and pulled."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import tolerances as tol
from conftest import KJ, NM, Array, chain_from_angles
from openmm import unit
from scipy.integrate import quad

import openmm_filament as of
from openmm_filament import bending, stretching, torsion, wlc
from openmm_filament.geometry import bending_angles, chain_indices
from openmm_filament.starts import equilibrium_starts

PN = 0.602214076
"""kJ/mol/nm."""
WARM = 298.0
KT = of.units.BOLTZMANN * WARM


def filament(count: int = 12, k: float = 200.0, alpha: float = 8.0, beta: Any = None, form: Any = None) -> of.Filament:
    angle = form(alpha * KJ) if form else bending.Harmonic(alpha * KJ, beta)
    return of.Filament(of.shapes.line(count, 1 * NM), 10 * unit.dalton, (stretching.Harmonic(k * KJ / NM**2), angle))


def helix(*extra: Any, count: int = 14) -> of.Filament:
    rest = of.shapes.helix(count, radius=2 * NM, pitch=3 * NM, turns=1.6)
    return of.Filament(
        rest, 10 * unit.dalton, (stretching.Harmonic(5000 * KJ / NM**2), bending.Harmonic(500 * KJ), *extra)
    )


def starts(chain: of.Filament, force: float, count: int, dimension: int = 3, seed: int = 1) -> Array:
    return equilibrium_starts(chain, force * PN, WARM, count, np.random.default_rng(seed), dimension)


def z_of(samples: Array, exact: float) -> float:
    """Standard errors between the mean of independent samples and the exact value."""
    return abs(samples.mean() - exact) / (samples.std(ddof=1) / math.sqrt(len(samples)))


def average(function: Any, energy: Any, measure: Any, low: float, high: float) -> float:
    """A Boltzmann average over one coordinate, by quadrature; energies in kJ/mol."""

    def weighted(g: Any) -> float:
        return quad(lambda x: g(x) * measure(x) * math.exp(-energy(x) / KT), low, high, limit=200)[0]

    return weighted(function) / weighted(lambda _: 1.0)


CHAINS: dict[str, tuple[of.Filament, dict[str, Any]]] = {
    "stiff": (filament(16, 500, 60), {"bending": 60}),
    "soft": (filament(16, 100, 3), {"bending": 3}),
    "cosine": (filament(10, 100, 8, form=bending.Cosine), {"bending": 8, "bending_form": "cosine"}),
    "bent": (filament(8, 100, 8, 1.0 * unit.radian), {"bending": 8, "rest_angles": 1.0}),
}


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("force", [0.02, 1.0, 10.0, 80.0])
@pytest.mark.parametrize("name", CHAINS)
def test_mean_extension_is_exact(name: str, force: float, dimension: int) -> None:
    if name == "bent" and dimension == 3 and force > 50:
        pytest.skip("a population of 64 leaves a bias there, bounded below")
    chain, theory = CHAINS[name]
    x = starts(chain, force, 600, dimension)
    k = chain.terms[0].stiffness.value_in_unit(KJ / NM**2)
    exact = wlc.extension_discrete(
        force, segments=len(chain) - 1, bond_length=1.0, kT=KT / PN, stretching=k / PN, dimension=dimension,
        **{**theory, "bending": theory["bending"] / PN},
    )  # fmt: skip
    extension = (x[:, -1] - x[:, 0])[:, 2 if dimension == 3 else 0]
    assert z_of(extension, exact) <= tol.SIGMAS


def test_the_bias_of_a_small_population_is_small() -> None:
    """Where the force straightens joints that are bent at rest: starts are not samples."""
    chain, _ = CHAINS["bent"]
    exact = wlc.extension_discrete(
        80.0, segments=8, bond_length=1.0, bending=8 / PN, kT=KT / PN, stretching=100 / PN, rest_angles=1.0
    )
    assert starts(chain, 80.0, 600)[:, -1, 2].mean() == pytest.approx(exact, rel=tol.SMALL_POPULATION)


def test_sequential_weights_do_not_bias_a_strongly_pulled_soft_chain() -> None:
    """More chains than elsewhere: what is left of a bias by finite populations."""
    x = starts(filament(30, 100, 3), 5.0, 800)
    exact = wlc.extension_discrete(5.0, segments=30, bond_length=1.0, bending=3 / PN, kT=KT / PN, stretching=100 / PN)
    assert z_of(x[:, -1, 2], exact) <= tol.SIGMAS


@pytest.mark.parametrize("dimension", [2, 3])
def test_bonds_and_bends_of_a_free_chain_have_their_own_averages(dimension: int) -> None:
    chain = filament(12, 60, 5)
    x = starts(chain, 0.0, 500, dimension)
    lengths = np.linalg.norm(np.diff(x, axis=1), axis=-1)
    exact = average(lambda s: s, lambda s: 30 * (s - 1) ** 2, lambda s: s ** (dimension - 1), 0, 3)
    assert z_of(lengths.ravel(), exact) <= tol.SIGMAS
    angles = bending_angles(x[:, chain_indices(13, 3)])
    measure = math.sin if dimension == 3 else lambda _: 1.0
    exact = average(lambda b: b, lambda b: 2.5 * b**2, measure, 0, math.pi)
    assert z_of(angles.ravel(), exact) <= tol.SIGMAS
    squares = average(lambda b: b**2, lambda b: 2.5 * b**2, measure, 0, math.pi)
    assert z_of(angles.ravel() ** 2, squares) <= tol.SIGMAS


@pytest.mark.parametrize("dimension", [2, 3])
def test_free_chains_point_everywhere(dimension: int) -> None:
    x = starts(filament(), 0.0, 800, dimension)
    end = x[:, -1]
    for axis in range(dimension):
        assert z_of(end[:, axis], 0.0) <= tol.SIGMAS
    squares = [(end[:, axis] ** 2) for axis in range(dimension)]
    for other in squares[1:]:
        assert z_of(squares[0] - other, 0.0) <= tol.SIGMAS


def test_a_planar_chain_bends_either_way_and_stays_in_its_plane() -> None:
    x = starts(filament(8, 200, 30, 1.2 * unit.radian), 0.0, 400, 2)
    assert not x[..., 2].any()
    s = np.diff(x[..., :2], axis=1)
    turn = s[:, :-1, 0] * s[:, 1:, 1] - s[:, :-1, 1] * s[:, 1:, 0]
    assert z_of(np.sign(turn).ravel(), 0.0) <= tol.SIGMAS


@pytest.mark.parametrize("twist", [torsion.Harmonic(400 * KJ), torsion.Periodic(400 * KJ)])
def test_each_term_of_a_stiff_helix_has_half_kt_an_element(twist: Any) -> None:
    """Equipartition, to the order of kT over the stiffness."""
    chain = helix(twist)
    x = starts(chain, 0.0, 300)
    for interaction, fewer in zip(chain.interactions(), (0, 1, 2), strict=True):
        energies = np.array([interaction.energy(one) for one in x])
        assert len(interaction.beads) == 14 - fewer
        assert energies.mean() == pytest.approx(len(interaction.beads) * KT / 2, rel=tol.EQUIPARTITION)


def test_a_helix_has_the_hand_of_its_rest_shape() -> None:
    """Cold: the starts are the rest shape itself, but for where they point."""
    chain = helix(torsion.Harmonic(400 * KJ))
    x = equilibrium_starts(chain, 0.0, 0.01, 5, np.random.default_rng(0))
    rest = chain.rest.value_in_unit(NM)
    distances = np.linalg.norm(rest[:, None] - rest, axis=-1)
    for one in x:
        np.testing.assert_allclose(np.linalg.norm(one[:, None] - one, axis=-1), distances, atol=0.1)
        triple = [np.linalg.det(np.diff(shape, axis=0)[:3]) for shape in (one, rest)]
        assert triple[0] * triple[1] > 0


def test_a_term_that_couples_bends_and_torsions_is_taken_into_account() -> None:
    """`torsion.Weighted` enters by weights alone: its mean energy against direct sampling of two free joints."""
    chain = of.Filament(
        of.shapes.helix(3, radius=2 * NM, pitch=3 * NM, turns=0.4), 10 * unit.dalton,
        (stretching.Harmonic(5000 * KJ / NM**2), bending.Harmonic(6 * KJ, 0.8 * unit.radian),
         torsion.Weighted(6 * KJ, 1.0 * unit.radian)),
    )  # fmt: skip
    weighted = chain.interactions()[2]
    found = np.array([weighted.energy(one) for one in starts(chain, 0.0, 1000)])
    rng = np.random.default_rng(3)
    grid = np.linspace(0, np.pi, 4001)
    cumulative = np.cumsum(np.sin(grid) * np.exp(-3 * (grid - 0.8) ** 2 / KT))
    bends = np.interp(rng.random((8_000, 2)), cumulative / cumulative[-1], grid)
    turns = rng.uniform(-np.pi, np.pi, (8_000, 1))
    shapes = np.array([chain_from_angles(np.ones(3), b, t) for b, t in zip(bends, turns, strict=True)])
    energy = np.array([weighted.energy(one) for one in shapes])
    weights = np.exp(-energy / KT)
    exact = float((weights * energy).sum() / weights.sum())
    error = math.sqrt(float((weights**2 * (energy - exact) ** 2).sum())) / weights.sum()
    spread = math.hypot(found.std(ddof=1) / math.sqrt(len(found)), error)
    assert abs(found.mean() - exact) / spread <= tol.SIGMAS
    assert spread < 0.1 * abs(exact)


def test_starts_are_shaped_held_and_repeatable() -> None:
    chain = filament()
    x, again, other = (starts(chain, 3.0, 7, seed=s) for s in (1, 1, 2))
    assert x.shape == (7, 13, 3)
    assert not x[:, 0].any()
    np.testing.assert_array_equal(x, again)
    assert (x[:, 1:] != other[:, 1:]).all()
    assert np.unique(x[:, -1, 0]).size == 7


def test_a_bond_that_nothing_holds_keeps_its_length() -> None:
    chain = of.Filament(of.shapes.line(5, 2 * NM), 10 * unit.dalton, (bending.Harmonic(8 * KJ),))
    x = starts(chain, 1.0, 20)
    np.testing.assert_allclose(np.linalg.norm(np.diff(x, axis=1), axis=-1), 2.0, rtol=tol.ROUNDING)


@pytest.mark.parametrize("count", [1, 2])
def test_chains_of_one_and_two_segments(count: int) -> None:
    terms = (stretching.Harmonic(100 * KJ / NM**2), bending.Harmonic(8 * KJ))[:count]
    chain = of.Filament(of.shapes.line(count, 1 * NM), 10 * unit.dalton, terms)
    x = starts(chain, 6.0, 1500)
    joints = {"bending": 8 / PN} if count == 2 else {"bending": 1.0}
    exact = wlc.extension_discrete(6.0, segments=count, bond_length=1.0, kT=KT / PN, stretching=100 / PN, **joints)
    assert z_of(x[:, -1, 2], exact) <= tol.SIGMAS
