"""NumPy forces against the same energies in 50 digits, from nearly straight to nearly folded back."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import mpmath as mp
import numpy as np
import pytest
import tolerances as tol
from conftest import KJ, NM, Array, chain_from_angles, random_rotation
from openmm import unit

import openmm_filament as of
from openmm_filament import bending, torsion
from openmm_filament._term import Term

BENDS = (1e-6, 1e-5, 1e-4, 1e-3, 0.1, 1.0, np.pi / 2, 2.5, np.pi - 0.1, np.pi - 1e-2, np.pi - 1e-3)
ALPHA = 30.0


def _vectors(r: list) -> list[mp.matrix]:
    points = [mp.matrix(r[3 * i : 3 * i + 3]) for i in range(len(r) // 3)]
    return [b - a for a, b in pairwise(points)]


def _dot(a: mp.matrix, b: mp.matrix) -> mp.mpf:
    return sum(x * y for x, y in zip(a, b, strict=True))


def _cross(a: mp.matrix, b: mp.matrix) -> mp.matrix:
    return mp.matrix([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _bend(r: list) -> mp.mpf:
    s, t = _vectors(r)
    return mp.acos(_dot(s, t) / mp.sqrt(_dot(s, s) * _dot(t, t)))


def _torsion(r: list) -> mp.mpf:
    """The dihedral by its cosine and the side on which the last bead lies."""
    s, t, u = _vectors(r)
    p, q = _cross(s, t), _cross(t, u)
    angle = mp.acos(_dot(p, q) / mp.sqrt(_dot(p, p) * _dot(q, q)))
    return angle if _dot(s, q) > 0 else -angle


def exact_forces(energy: Callable[[list], mp.mpf], x: Array) -> Array:
    """Minus the gradient of `energy` at the very doubles of `x`, by differences in 50 digits."""
    with mp.workdps(50):
        r = [mp.mpf(float(c)) for c in x.ravel()]
        gradient = [mp.diff(lambda c, i=i: energy([*r[:i], c, *r[i + 1 :]]), r[i]) for i in range(len(r))]
        return -np.array([float(g) for g in gradient]).reshape(x.shape)


def error(term: Term, x: Array, energy: Callable[[list], mp.mpf]) -> float:
    """Largest error of the NumPy force over the largest force."""
    rest = chain_from_angles(np.ones(len(x) - 1), np.ones(len(x) - 2), np.ones(len(x) - 3))
    forces = of.reference.forces(of.Filament(rest * NM, 1 * unit.dalton, (term,)), x * NM)
    exact = exact_forces(energy, x)
    return float(np.abs(forces - exact).max() / np.abs(exact).max())


def triple(bend: float, rng: np.random.Generator) -> Array:
    """Three beads, somewhere in space."""
    x = chain_from_angles(np.array([0.8, 1.3]), np.array([bend]), np.array([]))
    return x @ random_rotation(rng).T + rng.normal(size=3)


@pytest.mark.parametrize("rest", [0.0, 0.4, 1.3, np.pi])
@pytest.mark.parametrize("bend", BENDS)
def test_harmonic_bending_forces_hold_to_nine_digits(bend: float, rest: float, rng: np.random.Generator) -> None:
    term = bending.Harmonic(ALPHA * KJ, rest * unit.radian)
    energy = lambda r: mp.mpf(ALPHA) / 2 * (_bend(r) - mp.mpf(rest)) ** 2  # noqa: E731
    assert error(term, triple(bend, rng), energy) <= tol.HIGH_PRECISION


@pytest.mark.parametrize("bend", BENDS)
def test_cosine_bending_forces_hold_to_nine_digits(bend: float, rng: np.random.Generator) -> None:
    energy = lambda r: -mp.mpf(ALPHA) * mp.cos(_bend(r))  # noqa: E731
    assert error(bending.Cosine(ALPHA * KJ), triple(bend, rng), energy) <= tol.HIGH_PRECISION


def quadruple(bend: float, tau: float, rng: np.random.Generator) -> Array:
    """Four beads, the second bend ordinary, somewhere in space."""
    x = chain_from_angles(np.array([0.8, 1.3, 0.6]), np.array([bend, 1.2]), np.array([tau]))
    return x @ random_rotation(rng).T + rng.normal(size=3)


@pytest.mark.parametrize("tau", [-3.1, -1.0, -1e-3, 1e-6, 0.7, 2.0, 3.14])
@pytest.mark.parametrize("bend", [b for b in BENDS if 1e-3 <= b <= np.pi - 1e-3])
def test_torsion_forces_hold_to_nine_digits(bend: float, tau: float, rng: np.random.Generator) -> None:
    x, rest = quadruple(bend, tau, rng), 0.3
    harmonic = torsion.Harmonic(ALPHA * KJ, rest * unit.radian)
    periodic = torsion.Periodic(ALPHA * KJ, 3, rest * unit.radian)

    def shorter(r: list) -> mp.mpf:
        d = _torsion(r) - mp.mpf(rest)
        return d - 2 * mp.pi * mp.nint(d / (2 * mp.pi))

    assert error(harmonic, x, lambda r: mp.mpf(ALPHA) / 2 * shorter(r) ** 2) <= tol.HIGH_PRECISION
    assert error(periodic, x, lambda r: mp.mpf(ALPHA) * (1 - mp.cos(3 * shorter(r)))) <= tol.HIGH_PRECISION


@pytest.mark.parametrize("bend", BENDS)
def test_weighted_torsion_forces_hold_to_nine_digits_when_straight_too(bend: float, rng: np.random.Generator) -> None:
    def energy(r: list) -> mp.mpf:
        sines = [mp.sin(_bend(r[:9])), mp.sin(_bend(r[3:]))]
        return -mp.mpf(ALPHA) * sines[0] * sines[1] * mp.cos(_torsion(r) - mp.mpf(0.3))

    term = torsion.Weighted(ALPHA * KJ, 0.3 * unit.radian)
    assert error(term, quadruple(bend, 0.9, rng), energy) <= tol.HIGH_PRECISION


def openmm_error(term: Term, x: Array, energy: Callable[[list], mp.mpf]) -> float:
    """Largest error of the OpenMM force over the largest force."""
    model = of.build(of.Filament(of.shapes.line(len(x) - 1, 1 * NM), 1 * unit.dalton, (term,)))
    exact = exact_forces(energy, x)
    return float(np.abs(of.forces(model, x * NM) - exact).max() / np.abs(exact).max())


@pytest.mark.parametrize("rest", [0.0, 0.02, 1.3])
@pytest.mark.parametrize("bend", [1e-10, 1e-8, *BENDS, np.pi - 1e-6])
def test_arctangent_bending_forces_of_openmm_are_as_exact_as_the_coordinates(
    bend: float, rest: float, rng: np.random.Generator
) -> None:
    term = bending.Harmonic(ALPHA * KJ, rest * unit.radian, form="arctangent")
    energy = lambda r: mp.mpf(ALPHA) / 2 * (_bend(r) - mp.mpf(rest)) ** 2  # noqa: E731
    assert openmm_error(term, triple(bend, rng), energy) <= tol.ARCTANGENT / np.sin(bend)


def test_arccosine_bending_forces_of_openmm_are_not(rng: np.random.Generator) -> None:
    energy = lambda r: mp.mpf(ALPHA) / 2 * _bend(r) ** 2  # noqa: E731
    for bend in (1e-4, 1e-6):
        off = openmm_error(bending.Harmonic(ALPHA * KJ), triple(bend, rng), energy)
        assert off > 10 * tol.ARCTANGENT / bend


@pytest.mark.parametrize("rest", [0.0, 0.02])
def test_arctangent_bending_of_a_straight_chain_has_no_force(rest: float) -> None:
    term = bending.Harmonic(ALPHA * KJ, rest * unit.radian, form="arctangent")
    filament = of.Filament(of.shapes.line(9, 1 * NM), 1 * unit.dalton, (term,))
    assert np.abs(of.forces(of.build(filament))).max() <= ALPHA * tol.STRAIGHT


def test_another_form_of_bending_is_refused() -> None:
    with pytest.raises(ValueError, match="`form` must be one of 'arccosine', 'arctangent', but is 'chord'"):
        bending.Harmonic(ALPHA * KJ, form="chord")
