"""One contract for every energy term: OpenMM, NumPy and a difference quotient agree, and mechanics is obeyed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
import tolerances as tol
from conftest import KJ, NM, Array, chain_from_angles, random_chain, random_rotation
from hypothesis import given
from hypothesis import strategies as st
from openmm import unit

import openmm_filament as of
from openmm_filament import bending, electrostatics, stretching, torsion
from openmm_filament._term import Term

Pair = tuple[of.Filament, Array]


@dataclass(frozen=True)
class Draw:
    """Random numbers for the parameters of a term: one for all, or one an element."""

    rng: np.random.Generator
    beads: int
    elements: int
    arrays: bool

    def __call__(self, low: float, high: float) -> Array | float:
        return self.rng.uniform(low, high, self.elements if self.arrays else None)

    def by_bead(self, low: float, high: float) -> Array | float:
        return self.rng.uniform(low, high, self.beads if self.arrays else None)


@dataclass(frozen=True)
class Case:
    """A term under test; `relaxed` where its energy is zero at the rest shape."""

    name: str
    span: int
    make: Callable[[Draw], Term]
    relaxed: bool = False


TERMS = (
    Case("stretching from shape", 2, lambda d: stretching.Harmonic(d(10, 1000) * KJ / NM**2), relaxed=True),
    Case("stretching given", 2, lambda d: stretching.Harmonic(d(10, 1000) * KJ / NM**2, d(0.5, 2) * NM)),
    Case("bending from shape", 3, lambda d: bending.Harmonic(d(1, 100) * KJ), relaxed=True),
    Case("bending given", 3, lambda d: bending.Harmonic(d(1, 100) * KJ, d(0, np.pi) * unit.radian)),
    Case("bending arctangent", 3, lambda d: bending.Harmonic(d(1, 100) * KJ, form="arctangent"), relaxed=True),
    Case(
        "bending arctangent given",
        3,
        lambda d: bending.Harmonic(d(1, 100) * KJ, d(0, np.pi) * unit.radian, form="arctangent"),
    ),
    Case("bending cosine", 3, lambda d: bending.Cosine(d(1, 100) * KJ)),
    Case("torsion from shape", 4, lambda d: torsion.Harmonic(d(1, 100) * KJ), relaxed=True),
    Case("torsion given", 4, lambda d: torsion.Harmonic(d(1, 100) * KJ, d(-180, 180) * unit.degree)),
    Case("torsion periodic 1", 4, lambda d: torsion.Periodic(d(1, 100) * KJ), relaxed=True),
    Case("torsion periodic 3", 4, lambda d: torsion.Periodic(d(1, 100) * KJ, 3), relaxed=True),
    Case("torsion periodic 2 given", 4, lambda d: torsion.Periodic(d(1, 100) * KJ, 2, d(-3, 3) * unit.radian)),
    Case("torsion weighted", 4, lambda d: torsion.Weighted(d(1, 100) * KJ)),
    Case("torsion weighted given", 4, lambda d: torsion.Weighted(d(1, 100) * KJ, d(-3, 3) * unit.radian)),
    Case("electrostatics", 2, lambda d: electrostatics.Neighbour(d.by_bead(-2, 2) * unit.elementary_charge)),
)


def random_filament(case: Case, rng: np.random.Generator, beads: int, closed: bool, arrays: bool) -> Pair:
    """A filament of this one term and positions unlike its rest shape, in nm."""
    elements = beads if closed else beads - case.span + 1
    term = case.make(Draw(rng, beads, elements, arrays))
    filament = of.Filament(random_chain(rng, beads) * NM, 1 * unit.dalton, (term,), closed=closed)
    return filament, random_chain(rng, beads)


def sample(case: Case, count: int, longest: int, *, positions: int = 1, seed: int = 1) -> list[Pair]:
    """So many filaments of the fewest beads possible to `longest`; open and closed, numbers and arrays by turns.

    Each comes several times, with other `positions`.
    """
    rng = np.random.default_rng([seed, *case.name.encode()])
    out = []
    for i in range(count):
        closed, arrays = i % 4 == 0, i % 2 == 1 or i % 8 == 0
        fewest = max(case.span, 3 if closed else 2)
        beads = fewest if i < 16 else int(np.exp(rng.uniform(np.log(fewest), np.log(longest + 1))))
        filament, x = random_filament(case, rng, beads, closed, arrays)
        out += [(filament, x), *((filament, random_chain(rng, beads)) for _ in range(positions - 1))]
    return out


# The contract -------------------------------------------------------------------------------------------------------


def check_openmm_agrees(pairs: list[Pair], batch: int = 500) -> None:
    for start in range(0, len(pairs), batch):
        some = pairs[start : start + batch]
        model = of.build([filament for filament, _ in some])
        x = np.concatenate([positions for _, positions in some]) * NM
        bound = {filament: filament.interactions()[0] for filament, _ in some}
        by_openmm = model.split(of.forces(model, x))
        by_numpy = [bound[filament].forces(positions) for filament, positions in some]
        errors = [np.abs(a - b).max() / np.abs(b).max() for a, b in zip(by_openmm, by_numpy, strict=True)]
        assert max(errors) <= tol.OPENMM_FORCES
        ((_, energy),) = of.energies(model, x).items()
        energies = [bound[filament].energy(positions) for filament, positions in some]
        assert abs(energy - sum(energies)) <= tol.OPENMM_ENERGIES * np.abs(energies).sum()


def check_forces_are_the_gradient(filament: of.Filament, x: Array) -> None:
    (interaction,) = filament.interactions()
    h, difference = 1e-4, np.zeros_like(x)
    for place in np.ndindex(x.shape):
        energies = []
        for shift in (-2 * h, -h, h, 2 * h):
            moved = x.copy()
            moved[place] += shift
            energies.append(interaction.energy(moved))
        difference[place] = np.dot([1, -8, 8, -1], energies) / (12 * h)
    forces = interaction.forces(x)
    assert np.abs(forces + difference).max() <= tol.CENTRAL_DIFFERENCE * np.abs(forces).max()


def check_all(check: Callable[..., None], pairs: list[Pair], *others: object) -> None:
    for filament, x in pairs:
        check(filament, x, *others)


def check_nothing_pulls_or_turns_the_whole(filament: of.Filament, x: Array) -> None:
    forces = of.reference.forces(filament, x * NM)
    torques = np.cross(x - x.mean(axis=0), forces)
    assert np.abs(forces.sum(axis=0)).max() <= tol.NET * np.abs(forces).sum()
    assert np.abs(torques.sum(axis=0)).max() <= tol.NET * np.abs(x - x.mean(axis=0)).max() * np.abs(forces).sum()


def check_moves_with_the_filament(filament: of.Filament, x: Array, rng: np.random.Generator) -> None:
    rotation, shift = random_rotation(rng), rng.normal(scale=10, size=3)
    moved = (x @ rotation.T + shift) * NM
    forces = of.reference.forces(filament, x * NM)
    error = np.abs(of.reference.forces(filament, moved) - forces @ rotation.T).max()
    assert error <= tol.MOVED * np.abs(forces).max()
    (before,) = of.reference.energies(filament, x * NM).values()
    (after,) = of.reference.energies(filament, moved).values()
    assert abs(after - before) <= tol.MOVED * max(abs(before), np.abs(forces).max())


def check_relaxed_at_rest(filament: of.Filament, x: Array) -> None:
    model = of.build(filament)
    (size,) = of.reference.energies(filament, x * NM).values()
    strength = np.abs(of.reference.forces(filament, x * NM)).max()
    for energies in (of.reference.energies(filament, filament.rest), of.energies(model)):
        (energy,) = energies.values()
        assert abs(energy) <= tol.AT_REST * size
    for forces in (of.reference.forces(filament, filament.rest), of.forces(model)):
        assert np.abs(forces).max() <= tol.AT_REST * strength


def check_leaves_inputs_alone(filament: of.Filament, x: Array) -> None:
    (interaction,) = filament.interactions()
    kept = {name: values.copy() for name, values in interaction.parameters.items()}
    frozen = x.copy()
    frozen.flags.writeable = False  # writing would raise
    for values in interaction.parameters.values():
        values.flags.writeable = False
    interaction.energy(frozen)
    interaction.forces(frozen)
    of.reference.forces(filament, frozen * NM)
    for name, values in interaction.parameters.items():
        np.testing.assert_array_equal(values, kept[name])


every_term = pytest.mark.parametrize("case", TERMS, ids=lambda case: case.name)


@every_term
def test_openmm_agrees_with_numpy_on_a_thousand_chains(case: Case) -> None:
    check_openmm_agrees(sample(case, 125, 64, positions=8))


@every_term
def test_forces_are_the_gradient_of_the_energy(case: Case) -> None:
    check_all(check_forces_are_the_gradient, sample(case, 24, 8))


@every_term
def test_internal_forces_neither_pull_nor_turn_the_whole(case: Case) -> None:
    check_all(check_nothing_pulls_or_turns_the_whole, sample(case, 60, 64))


@every_term
def test_energy_stays_and_forces_turn_with_the_filament(case: Case, rng: np.random.Generator) -> None:
    check_all(check_moves_with_the_filament, sample(case, 60, 32), rng)


@pytest.mark.parametrize("case", [case for case in TERMS if case.relaxed], ids=lambda case: case.name)
def test_rest_shape_is_free_of_energy_and_force(case: Case) -> None:
    check_all(check_relaxed_at_rest, sample(case, 24, 32))


@every_term
def test_inputs_are_left_alone(case: Case) -> None:
    pairs = sample(case, 24, 8)
    check_all(check_leaves_inputs_alone, pairs)
    rest = [filament.rest.value_in_unit(NM).copy() for filament, _ in pairs]
    x = np.concatenate([positions for _, positions in pairs])
    x.flags.writeable = False
    of.energies(of.build([filament for filament, _ in pairs]), x * NM)
    for (filament, _), before in zip(pairs, rest, strict=True):
        np.testing.assert_array_equal(filament.rest.value_in_unit(NM), before)


@every_term
def test_arrays_of_equal_numbers_do_what_one_number_does(case: Case, rng: np.random.Generator) -> None:
    beads, draws = 9, rng.uniform(0.1, 0.9, 4)
    fixed = [iter(draws), iter(draws)]

    @dataclass(frozen=True)
    class Fixed(Draw):
        def __call__(self, low: float, high: float) -> Array | float:
            value = low + (high - low) * next(fixed[self.arrays])
            return np.full(self.elements, value) if self.arrays else value

        def by_bead(self, low: float, high: float) -> Array | float:
            value = low + (high - low) * next(fixed[self.arrays])
            return np.full(self.beads, value) if self.arrays else value

    rest, x = random_chain(rng, beads) * NM, random_chain(rng, beads) * NM
    one, many = (
        of.Filament(rest, 1 * unit.dalton, (case.make(Fixed(rng, beads, beads - case.span + 1, arrays)),))
        for arrays in (False, True)
    )
    np.testing.assert_array_equal(of.reference.forces(one, x), of.reference.forces(many, x))


# Broken copies: the contract must notice ----------------------------------------------------------------------------


class StifferStretching(stretching.Harmonic):
    expression = "0.5*(1.01*k)*(r-r0)^2"


class StifferBending(bending.Harmonic):
    expression = "0.5*(1.01*alpha)*(theta-theta0)^2; theta0=3.141592653589793-beta0"


class StifferArctangent(bending.ArctangentHarmonic):
    expression = bending.ArctangentHarmonic.expression.replace("0.5*alpha", "0.505*alpha")


class StifferCharges(electrostatics.Neighbour):
    expression = "1.01*q/r"


class MirroredTorsion(torsion.Harmonic):
    expression = torsion.Harmonic.expression.replace("d=theta-tau0", "d=-theta-tau0")


class MirroredPeriodic(torsion.Periodic):
    expression = torsion.Periodic.expression.replace("theta-tau0", "-theta-tau0")


class MirroredWeighted(torsion.Weighted):
    expression = torsion.Weighted.expression.replace("+sin(tau0)", "-sin(tau0)")


class LongWayRound(torsion.Harmonic):
    expression = "0.5*c*(theta-tau0)^2"


class BendingFromTheta(bending.Cosine):
    """Forgets that OpenMM's theta is pi - beta."""

    expression = "-alpha*cos(theta)"


@pytest.mark.parametrize(
    ("like", "broken"),
    [
        ("stretching from shape", StifferStretching),
        ("bending from shape", StifferBending),
        ("bending from shape", StifferArctangent),
        ("electrostatics", StifferCharges),
        ("torsion from shape", MirroredTorsion),
        ("torsion from shape", LongWayRound),
        ("torsion periodic 1", MirroredPeriodic),
        ("torsion weighted", MirroredWeighted),
        ("bending cosine", BendingFromTheta),
    ],
)
def test_a_broken_openmm_expression_fails_the_contract(like: str, broken: type[Term]) -> None:
    with pytest.raises(AssertionError):
        check_openmm_agrees(sample(broken_case(like, broken), 100, 16))


class StifferGradient(stretching.Harmonic):
    @staticmethod
    def gradient(x, p):
        return 1.01 * stretching.Harmonic.gradient(x, p)


class DroppedMinus(bending.Harmonic):
    @staticmethod
    def gradient(x, p):
        g = bending.Harmonic.gradient(x, p).copy()
        g[:, 0] *= -1
        return g


class FlippedTorsion(torsion.Harmonic):
    @staticmethod
    def gradient(x, p):
        return -torsion.Harmonic.gradient(x, p)


class UnevenTorsion(torsion.Periodic):
    """Reaction on one bead of four forgotten."""

    @staticmethod
    def gradient(x, p):
        g = torsion.Periodic.gradient(x, p).copy()
        g[:, 3] = 0
        return g


broken_gradients = pytest.mark.parametrize(
    ("like", "broken"),
    [
        ("stretching from shape", StifferGradient),
        ("bending from shape", DroppedMinus),
        ("torsion from shape", FlippedTorsion),
        ("torsion periodic 1", UnevenTorsion),
    ],
)


def broken_case(like: str, broken: type[Term]) -> Case:
    (good,) = (case for case in TERMS if case.name == like)

    def make(draw: Draw) -> Term:
        term = good.make(draw)
        return broken(**{name: getattr(term, name) for name in type(term).__dataclass_fields__})

    return Case(good.name, good.span, make, good.relaxed)


@broken_gradients
def test_a_broken_gradient_fails_the_contract(like: str, broken: type[Term]) -> None:
    pairs = sample(broken_case(like, broken), 24, 8)
    with pytest.raises(AssertionError):
        check_openmm_agrees(pairs)
    with pytest.raises(AssertionError):
        check_all(check_forces_are_the_gradient, pairs)


@pytest.mark.parametrize(
    ("like", "broken"), [("bending from shape", DroppedMinus), ("torsion periodic 1", UnevenTorsion)]
)
def test_an_unbalanced_gradient_leaves_a_net_force(like: str, broken: type[Term]) -> None:
    with pytest.raises(AssertionError):
        check_all(check_nothing_pulls_or_turns_the_whole, sample(broken_case(like, broken), 24, 8))


class TiedToSpace(stretching.Harmonic):
    """A spring on the z component alone."""

    @staticmethod
    def energy(x, p):
        return 0.5 * p["k"] * (np.abs(x[:, 1, 2] - x[:, 0, 2]) - p["r0"]) ** 2


def test_a_term_tied_to_directions_in_space_fails_the_contract(rng: np.random.Generator) -> None:
    with pytest.raises(AssertionError):
        check_all(check_moves_with_the_filament, sample(broken_case("stretching from shape", TiedToSpace), 24, 8), rng)


class Prestressed(stretching.Harmonic):
    def parameters(self, rest, closed):
        good = super().parameters(rest, closed)
        return good | {"r0": 1.001 * good["r0"]}


class WritesOnItsInput(stretching.Harmonic):
    @staticmethod
    def energy(x, p):
        p["k"][...] *= 2
        return stretching.Harmonic.energy(x, p)


def test_a_prestressed_copy_and_one_that_writes_on_its_input_fail_the_contract() -> None:
    ((filament, x),) = sample(broken_case("stretching from shape", Prestressed), 1, 8)
    with pytest.raises(AssertionError):
        check_relaxed_at_rest(filament, x)
    ((filament, x),) = sample(broken_case("stretching from shape", WritesOnItsInput), 1, 8)
    with pytest.raises(ValueError, match="read-only"):
        check_leaves_inputs_alone(filament, x)


# The seam of the torsion --------------------------------------------------------------------------------------------


def torsion_energies(term: Term, tau: float) -> tuple[float, float]:
    """NumPy and OpenMM energies of four beads at the torsion `tau`."""
    x = chain_from_angles(np.ones(3), np.array([1.0, 1.5]), np.array([tau])) * NM
    filament = of.Filament(x, 1 * unit.dalton, (term,))
    return of.reference.energies(filament, x)["torsion"], of.energies(of.build(filament), x)["torsion"]


@given(st.floats(-np.pi, np.pi), st.floats(-np.pi, np.pi))
def test_harmonic_torsion_goes_the_shorter_way_round(tau: float, rest: float) -> None:
    shortest = min(abs(tau - rest + turn * 2 * np.pi) for turn in (-1, 0, 1))
    for energy in torsion_energies(torsion.Harmonic(2 * KJ, rest * unit.radian), tau):
        assert energy == pytest.approx(shortest**2, rel=tol.ANGLE, abs=tol.ANGLE)


@pytest.mark.parametrize(("rest", "tau"), [(170, -170), (-170, 170), (180, -160), (-180, 160), (180, 160)])
def test_twenty_degrees_across_the_seam_are_twenty_degrees(rest: float, tau: float) -> None:
    x = chain_from_angles(np.ones(3), np.array([1.0, 1.5]), np.radians([tau])) * NM
    filament = of.Filament(x, 1 * unit.dalton, (torsion.Harmonic(2 * KJ, rest * unit.degree),))
    assert of.reference.energies(filament, x)["torsion"] == pytest.approx(np.radians(20) ** 2, rel=tol.ANGLE)
    check_openmm_agrees([(filament, x.value_in_unit(NM))])
    check_forces_are_the_gradient(filament, x.value_in_unit(NM))


@given(st.floats(-np.pi, np.pi), st.floats(-np.pi, np.pi), st.integers(1, 6))
def test_periodic_torsion_has_as_many_minima_as_its_multiplicity(tau: float, rest: float, n: int) -> None:
    for energy in torsion_energies(torsion.Periodic(2 * KJ, n, rest * unit.radian), tau):
        assert energy == pytest.approx(2 - 2 * np.cos(n * (tau - rest)), rel=tol.ANGLE, abs=tol.ANGLE)


def test_weighted_torsion_is_the_cosine_times_the_sines_of_the_bends(rng: np.random.Generator) -> None:
    bends, (tau, rest) = rng.uniform(0, np.pi, (50, 2)), rng.uniform(-np.pi, np.pi, (2, 50))
    bends[:3] = [[0, 1], [1, 0], [0, 0]]
    x = [chain_from_angles(np.array([0.7, 1.0, 1.6]), b, [t]) for b, t in zip(bends, tau, strict=True)]
    terms = [torsion.Weighted(3 * KJ, angle * unit.radian) for angle in rest]
    filaments = [of.Filament(p * NM, 1 * unit.dalton, (term,)) for p, term in zip(x, terms, strict=True)]
    expected = -3 * np.sin(bends).prod(axis=1) * np.cos(tau - rest)
    energies = [of.reference.energies(f, p * NM)["torsion"] for f, p in zip(filaments, x, strict=True)]
    np.testing.assert_allclose(energies, expected, rtol=0, atol=tol.ROUNDING)
    total = of.energies(of.build(filaments), np.concatenate(x) * NM)["torsion"]
    assert total == pytest.approx(expected.sum(), rel=tol.ROUNDING)


def test_weighted_torsion_is_smooth_on_a_straight_chain() -> None:
    filament = of.Filament(of.shapes.line(9, 1 * NM), 1 * unit.dalton, (torsion.Weighted(10 * KJ),))
    assert of.energies(of.build(filament)) == {"torsion": 0.0}
    np.testing.assert_array_equal(of.forces(of.build(filament)), np.zeros((10, 3)))
    np.testing.assert_array_equal(of.reference.forces(filament, filament.rest), np.zeros((10, 3)))


def test_mirror_images_differ_for_a_torsion_that_is_not_zero(rng: np.random.Generator) -> None:
    x = random_chain(rng, 8)
    filament = of.Filament(x * NM, 1 * unit.dalton, (torsion.Harmonic(10 * KJ),))
    assert of.reference.energies(filament, x * [1, 1, -1] * NM)["torsion"] > 1


def test_coulomb_half_is_as_printed() -> None:
    term = electrostatics.Neighbour(3 * unit.elementary_charge)
    filament = of.Filament(of.shapes.line(1, 2 * NM), 1 * unit.dalton, (term,))
    expected = 0.5 * of.units.COULOMB * 9 / 2
    assert of.reference.energies(filament, filament.rest)["electrostatics"] == pytest.approx(expected, rel=tol.ROUNDING)


def test_terms_of_one_family_add_up(rng: np.random.Generator) -> None:
    rest, x = random_chain(rng, 7) * NM, random_chain(rng, 7) * NM
    parts = (torsion.Harmonic(3 * KJ), torsion.Periodic(2 * KJ, 3), torsion.Periodic(5 * KJ, 1), bending.Cosine(1 * KJ))
    whole = of.Filament(rest, 1 * unit.dalton, parts)
    single = [of.Filament(rest, 1 * unit.dalton, (part,)) for part in parts]
    total = sum(of.reference.forces(filament, x) for filament in single)
    size = np.abs(total).max()
    np.testing.assert_allclose(of.reference.forces(whole, x), total, rtol=0, atol=tol.ROUNDING * size)
    np.testing.assert_allclose(of.forces(of.build(whole), x), total, rtol=0, atol=tol.OPENMM_FORCES * size)
    assert set(of.energies(of.build(whole), x)) == {"torsion", "bending"}
