"""Filaments: what is accepted is kept, and every bad input is refused with argument, rule and value."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import FrozenInstanceError
from typing import Any

import numpy as np
import pytest
from conftest import KJ, NM, Array, chains, random_chain
from hypothesis import given
from hypothesis import strategies as st
from openmm import unit

import openmm_filament as of
from openmm_filament import bending, electrostatics, stretching, torsion
from openmm_filament._term import Term

STIFFNESS = KJ / NM**2
RATE = unit.picosecond**-1
SPRING = stretching.Harmonic(100 * STIFFNESS)
DIHEDRALS = (torsion.Harmonic, torsion.Periodic)

STIFF_TERMS: tuple[tuple[Callable[[Any], Term], unit.Unit, int], ...] = (
    (stretching.Harmonic, STIFFNESS, 2),
    (bending.Harmonic, KJ, 3),
    (bending.Cosine, KJ, 3),
    (torsion.Harmonic, KJ, 4),
    (torsion.Periodic, KJ, 4),
    (torsion.Weighted, KJ, 4),
)
"""Class, unit of the stiffness, fewest beads."""

stiff_terms = pytest.mark.parametrize(("kind", "its_unit", "span"), STIFF_TERMS)


def filament(
    rest: Array | None = None, masses: Any = 1 * unit.dalton, terms: Any = (SPRING,), **options: Any
) -> of.Filament:
    """A filament of one spring term and a bent chain of six beads, but for what the test spoils."""
    shape = random_chain(np.random.default_rng(0), 6) if rest is None else rest
    return of.Filament(shape * NM, masses, terms, **options)


# Kept ---------------------------------------------------------------------------------------------------------------


@given(chains(4), st.booleans())
def test_a_filament_keeps_shape_masses_and_terms_and_is_frozen(x: Array, closed: bool) -> None:
    given_shape = x.copy()
    chain = of.Filament(given_shape * NM, 2 * unit.dalton, (SPRING,), damping=0.1 * RATE, closed=closed)
    given_shape[:] = 0  # the filament has its own copy
    assert len(chain) == len(x)
    np.testing.assert_array_equal(chain.rest.value_in_unit(NM), x)
    np.testing.assert_array_equal(chain.masses.value_in_unit(unit.dalton), np.full(len(x), 2.0))
    np.testing.assert_array_equal(chain.damping.value_in_unit(RATE), np.full(len(x), 0.1))
    for values in (chain.rest, chain.masses, chain.damping):
        with pytest.raises(ValueError, match="read-only"):
            values._value[0] = 0.0
    with pytest.raises(FrozenInstanceError):
        chain.rest = x * NM
    (interaction,) = chain.interactions()
    assert len(interaction.beads) == len(x) - (not closed)


def test_a_filament_prints_in_one_line() -> None:
    terms = (stretching.Harmonic(1 * KJ / NM**2), bending.Cosine(1 * KJ))
    ring = of.Filament(of.shapes.ring(30, 1 * NM), 1 * unit.dalton, terms, damping=1 / unit.picosecond, closed=True)
    assert repr(ring) == "<Filament: 30 beads; stretching.Harmonic, bending.Cosine; closed; damped>"
    assert repr(of.Filament(np.eye(3) * NM, 1 * unit.dalton, ())) == "<Filament: 3 beads; no terms>"


@pytest.mark.parametrize("form", [np.array, list])
def test_terms_keep_their_numbers_when_the_arrays_change(form: Any) -> None:
    given = form([1.0, 2.0, 3.0])
    term = stretching.Harmonic(unit.Quantity(given, KJ / NM**2))
    given[1] = 50.0
    bound = of.Filament(of.shapes.line(3, 1 * NM), 1 * unit.dalton, (term,)).interactions()[0]
    np.testing.assert_allclose(bound.parameters["k"], [1.0, 2.0, 3.0])
    if form is np.array:
        with pytest.raises(ValueError, match="read-only"):
            term.stiffness._value[0] = 5.0


def test_units_are_converted_on_the_way_in() -> None:
    x = random_chain(np.random.default_rng(1), 5)
    chain = of.Filament(10 * x * unit.angstrom, np.full(5, 0.018) * unit.kilogram / unit.mole, [SPRING])
    np.testing.assert_allclose(chain.rest.value_in_unit(NM), x, rtol=1e-15)
    np.testing.assert_allclose(chain.masses.value_in_unit(unit.dalton), 18.0)
    assert chain.terms == (SPRING,)
    assert chain.damping is None


def test_masses_may_be_given_in_kilograms() -> None:
    chain = filament(masses=1.66053906892e-27 * unit.kilogram)
    np.testing.assert_allclose(chain.masses.value_in_unit(unit.dalton), 1.0)


def test_no_damping_and_no_terms_are_allowed() -> None:
    assert filament(damping=0 * RATE).damping.value_in_unit(RATE).tolist() == [0.0] * 6
    assert filament(terms=()).interactions() == []
    assert len(of.Filament([[0.0, 0.0, 0.0]] * NM, 1 * unit.dalton, ())) == 1


@stiff_terms
def test_the_fewest_beads_of_a_term_are_enough(kind: Callable[..., Term], its_unit: unit.Unit, span: int) -> None:
    rest = random_chain(np.random.default_rng(2), span)
    assert len(filament(rest, terms=(kind(1 * its_unit),)).interactions()[0].beads) == 1
    rest = random_chain(np.random.default_rng(2), max(span, 3))
    assert len(filament(rest, terms=(kind(1 * its_unit),), closed=True).interactions()[0].beads) == len(rest)


def test_the_ends_of_the_angle_ranges_are_allowed() -> None:
    for angle in (0, 180):
        filament(terms=(bending.Harmonic(1 * KJ, angle * unit.degree),))
    for angle in (-180, 180):
        for kind in (torsion.Harmonic, torsion.Weighted):
            filament(terms=(kind(1 * KJ, rest_angle=angle * unit.degree),))


def test_a_straight_rest_shape_suits_every_term_but_the_dihedrals() -> None:
    terms = (SPRING, bending.Harmonic(1 * KJ), bending.Cosine(1 * KJ), torsion.Weighted(1 * KJ))
    assert len(of.Filament(of.shapes.line(6, 1 * NM), 1 * unit.dalton, terms).terms) == 4


# Refused ------------------------------------------------------------------------------------------------------------


@stiff_terms
@pytest.mark.parametrize("closed", [False, True])
def test_too_few_beads_are_refused(kind: Callable[..., Term], its_unit: unit.Unit, span: int, closed: bool) -> None:
    needed = max(span, 3) if closed else span
    rest = random_chain(np.random.default_rng(0), needed - 1)
    term = kind(1 * its_unit)
    name = f"{term.family}.{type(term).__name__}"
    with pytest.raises(ValueError, match=rf"must have at least {needed} beads for {name}, but has {needed - 1}\."):
        filament(rest, terms=(term,), closed=closed)


def test_no_beads_are_refused() -> None:
    with pytest.raises(ValueError, match="`rest` must have at least one bead, but has 0"):
        filament(np.zeros((0, 3)), terms=())


@given(chains(3), st.data())
def test_coincident_neighbours_are_refused_by_index(x: Array, data: st.DataObject) -> None:
    closed = data.draw(st.booleans())
    i = data.draw(st.integers(0, len(x) - 1 if closed else len(x) - 2))
    j = (i + 1) % len(x)
    x[i] = x[j]
    with pytest.raises(ValueError, match=rf"`rest` must not have coincident beads, but beads {i} and {j} are both at"):
        filament(x, closed=closed)


@given(chains(3), st.sampled_from([np.nan, np.inf, -np.inf]), st.data())
def test_beads_that_are_not_finite_are_refused_by_index(x: Array, bad: float, data: st.DataObject) -> None:
    i, k = data.draw(st.integers(0, len(x) - 1)), data.draw(st.integers(0, 2))
    x[i, k] = bad
    with pytest.raises(ValueError, match=rf"`rest` must be finite, but is {bad} at index \({i}, {k}\)"):
        filament(x)


@pytest.mark.parametrize("shape", [(6,), (6, 2), (6, 4), (2, 6, 3), ()])
def test_rest_shapes_of_another_form_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=rf"`rest` must have shape \(n, 3\), but has shape {re.escape(str(shape))}"):
        filament(np.ones(shape))


def spoilt(good: float, bad: float, index: int, count: int) -> Array:
    values = np.full(count, float(good))
    values[index] = bad
    return values


NOT_POSITIVE = st.one_of(st.just(0.0), st.floats(-1e6, -1e-6))


@given(NOT_POSITIVE, st.integers(0, 5))
def test_masses_that_are_not_positive_are_refused(bad: float, i: int) -> None:
    with pytest.raises(ValueError, match=rf"`masses` must be positive, but is {re.escape(str(bad))}\."):
        filament(masses=bad * unit.dalton)
    with pytest.raises(ValueError, match=rf"`masses` must be positive, but is {re.escape(str(bad))} at index {i}\."):
        filament(masses=spoilt(1, bad, i, 6) * unit.dalton)


@given(st.floats(-1e6, -1e-6), st.integers(0, 5))
def test_negative_damping_is_refused(bad: float, i: int) -> None:
    with pytest.raises(ValueError, match=rf"`damping` must not be negative, but is {re.escape(str(bad))} at index {i}"):
        filament(damping=spoilt(0, bad, i, 6) * RATE)


@stiff_terms
@given(bad=NOT_POSITIVE, data=st.data())
def test_a_stiffness_that_is_not_positive_is_refused(
    kind: Callable[..., Term], its_unit: unit.Unit, span: int, bad: float, data: st.DataObject
) -> None:
    with pytest.raises(ValueError, match=rf"`stiffness` must be positive, but is {re.escape(str(bad))}\."):
        filament(terms=(kind(bad * its_unit),))
    i = data.draw(st.integers(0, 6 - span))
    values = spoilt(1, bad, i, 7 - span) * its_unit
    with pytest.raises(ValueError, match=rf"`stiffness` must be positive, but is {re.escape(str(bad))} at index {i}\."):
        filament(terms=(kind(values),))


@given(NOT_POSITIVE, st.integers(0, 4))
def test_a_rest_length_that_is_not_positive_is_refused(bad: float, i: int) -> None:
    term = stretching.Harmonic(1 * STIFFNESS, rest_length=spoilt(1, bad, i, 5) * NM)
    with pytest.raises(ValueError, match=rf"`rest_length` must be positive, but is {re.escape(str(bad))} at index {i}"):
        filament(terms=(term,))


@stiff_terms
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_numbers_that_are_not_finite_are_refused(kind: Any, its_unit: unit.Unit, span: int, bad: float) -> None:
    with pytest.raises(ValueError, match=f"`stiffness` must be finite, but is {bad}"):
        filament(terms=(kind(bad * its_unit),))
    with pytest.raises(ValueError, match=f"`masses` must be finite, but is {bad}"):
        filament(masses=bad * unit.dalton)
    with pytest.raises(ValueError, match=f"`damping` must be finite, but is {bad}"):
        filament(damping=bad * RATE)
    with pytest.raises(ValueError, match=f"`charges` must be finite, but is {bad}"):
        filament(terms=(electrostatics.Neighbour(bad * unit.elementary_charge),))


@stiff_terms
@given(wrong=st.integers(0, 9))
def test_arrays_of_another_length_are_refused(kind: Any, its_unit: unit.Unit, span: int, wrong: int) -> None:
    def refused(name: str, right: int) -> Any:
        return pytest.raises(ValueError, match=rf"`{name}` must have shape \({right},\), but has shape \({wrong},\)")

    if wrong != 7 - span:
        with refused("stiffness", 7 - span):
            filament(terms=(kind(np.ones(wrong) * its_unit),))
    if wrong != 6:
        with refused("masses", 6):
            filament(masses=np.ones(wrong) * unit.dalton)
        with refused("damping", 6):
            filament(damping=np.ones(wrong) * RATE)
        with refused("charges", 6):
            filament(terms=(electrostatics.Neighbour(np.ones(wrong) * unit.elementary_charge),))
        with refused("stiffness", 6):
            filament(terms=(kind(np.ones(wrong) * its_unit),), closed=True)
    if wrong != 5:
        with refused("rest_length", 5):
            filament(terms=(stretching.Harmonic(1 * STIFFNESS, np.ones(wrong) * NM),))


@given(st.one_of(st.floats(-100, -1e-9), st.floats(np.pi + 1e-9, 100)))
def test_a_bending_rest_angle_outside_its_range_is_refused(bad: float) -> None:
    rule = r"`rest_angle` must lie in \[0\S*, 3\.14\S*\] rad, but is " + re.escape(str(bad))
    with pytest.raises(ValueError, match=rule):
        filament(terms=(bending.Harmonic(1 * KJ, bad * unit.radian),))


@pytest.mark.parametrize(
    "make",
    [torsion.Harmonic, lambda k, a: torsion.Periodic(k, 2, a), torsion.Weighted],
    ids=["Harmonic", "Periodic", "Weighted"],
)
@given(bad=st.one_of(st.floats(-100, -np.pi - 1e-9), st.floats(np.pi + 1e-9, 100)), i=st.integers(0, 2))
def test_a_torsion_rest_angle_outside_its_range_is_refused(make: Callable[..., Term], bad: float, i: int) -> None:
    rule = r"`rest_angle` must lie in \[-3\.14\S*, 3\.14\S*\] rad, but is " + re.escape(str(bad))
    with pytest.raises(ValueError, match=rule):
        filament(terms=(make(1 * KJ, bad * unit.radian),))
    with pytest.raises(ValueError, match=f"{rule} at index {i}"):
        filament(terms=(make(1 * KJ, spoilt(0, bad, i, 3) * unit.radian),))


@pytest.mark.parametrize("bad", [0, -1, 1.0, 2.5, True, "2", None])
def test_a_multiplicity_that_is_no_positive_whole_number_is_refused(bad: object) -> None:
    with pytest.raises((ValueError, TypeError), match=f"`multiplicity` must be .* but is {re.escape(repr(bad))}"):
        filament(terms=(torsion.Periodic(1 * KJ, bad),))


@pytest.mark.parametrize("kind", DIHEDRALS)
@given(x=chains(4), data=st.data())
def test_a_dihedral_on_collinear_beads_is_refused_with_a_way_out(kind: Any, x: Array, data: st.DataObject) -> None:
    i = data.draw(st.integers(0, len(x) - 3))
    x[i + 2] = x[i + 1] + data.draw(st.sampled_from([-0.5, 0.25, 2.0])) * (x[i + 1] - x[i])
    beads = f"{i}, {i + 1}, {i + 2}"
    wanted = rf"`rest` must be bent .* for torsion\.{kind.__name__}, but beads {beads} are collinear.*torsion\.Weighted"
    for rest_angle in (None, 0.5 * unit.radian):  # a given rest angle does not make the dihedral exist
        with pytest.raises(ValueError, match=wanted):
            filament(x, terms=(kind(1 * KJ, rest_angle=rest_angle),))


def test_collinear_beads_across_the_seam_of_a_ring_are_refused() -> None:
    rest = np.array([[1.0, 0, 0], [2, 0, 0], [2, 1, 0.3], [0, 1, 0.1], [0, 0, 0]])
    filament(rest, terms=(torsion.Harmonic(1 * KJ),))
    with pytest.raises(ValueError, match="beads 4, 0, 1 are collinear"):
        filament(rest, terms=(torsion.Harmonic(1 * KJ),), closed=True)


ARGUMENTS: tuple[tuple[str, str, Callable[[Any], object]], ...] = (
    ("rest", "length", lambda v: of.Filament(v, 1 * unit.dalton, ())),
    ("masses", "mass", lambda v: filament(masses=v)),
    ("damping", "rate", lambda v: filament(damping=v)),
    ("stiffness", "stiffness", lambda v: filament(terms=(stretching.Harmonic(v),))),
    ("rest_length", "length", lambda v: filament(terms=(stretching.Harmonic(1 * STIFFNESS, v),))),
    ("stiffness", "energy", lambda v: filament(terms=(bending.Harmonic(v),))),
    ("rest_angle", "angle", lambda v: filament(terms=(bending.Harmonic(1 * KJ, v),))),
    ("stiffness", "energy", lambda v: filament(terms=(bending.Cosine(v),))),
    ("stiffness", "energy", lambda v: filament(terms=(torsion.Harmonic(v),))),
    ("rest_angle", "angle", lambda v: filament(terms=(torsion.Harmonic(1 * KJ, v),))),
    ("stiffness", "energy", lambda v: filament(terms=(torsion.Periodic(v),))),
    ("rest_angle", "angle", lambda v: filament(terms=(torsion.Periodic(1 * KJ, rest_angle=v),))),
    ("stiffness", "energy", lambda v: filament(terms=(torsion.Weighted(v),))),
    ("charges", "charge", lambda v: filament(terms=(electrostatics.Neighbour(v),))),
)


@pytest.mark.parametrize(("name", "dimension", "make"), ARGUMENTS)
def test_a_missing_or_wrong_unit_is_refused(name: str, dimension: str, make: Callable[[Any], object]) -> None:
    for bare in (1.0, np.ones(6), [1.0, 2.0], "1 nm"):
        with pytest.raises(TypeError, match=f"`{name}` must be a Quantity of {dimension} .* without a unit"):
            make(bare)
    for wrong in (1.0 * unit.volt, 1.0 * unit.kelvin, np.ones(6) * unit.candela, 1.0 * unit.dimensionless):
        its_name = wrong.unit.get_name()
        with pytest.raises(TypeError, match=f"`{name}` must have a unit of {dimension} .* but has {its_name}"):
            make(wrong)


def test_a_spring_constant_where_an_energy_belongs_is_refused_and_the_reverse() -> None:
    with pytest.raises(TypeError, match=r"`stiffness` must have a unit of stiffness .* but has kilojoule"):
        filament(terms=(stretching.Harmonic(1 * KJ),))
    with pytest.raises(TypeError, match="`stiffness` must have a unit of energy"):
        filament(terms=(bending.Harmonic(1 * unit.piconewton / NM),))


def test_what_is_no_term_is_refused() -> None:
    with pytest.raises(TypeError, match=r"`terms` must be a tuple .* write \(stretching\.Harmonic"):
        filament(terms=SPRING)
    with pytest.raises(TypeError, match=r"`terms` must hold terms .* but holds 3"):
        filament(terms=(SPRING, 3))
    with pytest.raises(TypeError, match=r"`terms` must hold terms .* but holds <class"):
        filament(terms=(stretching.Harmonic,))


@given(chains(3), st.data())
def test_the_reference_refuses_positions_that_do_not_fit(x: Array, data: st.DataObject) -> None:
    chain = filament(x)
    for function in (of.reference.energies, of.reference.forces):
        n = len(x)
        with pytest.raises(ValueError, match=rf"`positions` must have shape \({n}, 3\), but has shape \({n - 1}, 3\)"):
            function(chain, x[1:] * NM)
        with pytest.raises(TypeError, match="`positions` must be a Quantity of length"):
            function(chain, x)
        bad = x.copy()
        i, k = data.draw(st.integers(0, len(x) - 1)), data.draw(st.integers(0, 2))
        bad[i, k] = np.nan
        with pytest.raises(ValueError, match=rf"`positions` must be finite, but is nan at index \({i}, {k}\)"):
            function(chain, bad * NM)


@given(NOT_POSITIVE)
def test_temperatures_and_lengths_of_a_wormlike_chain_must_be_positive(bad: float) -> None:
    value = re.escape(str(bad))
    with pytest.raises(ValueError, match=f"`contour_length` must be positive, but is {value}"):
        of.WormlikeChain(bad * NM, 50 * NM)
    with pytest.raises(ValueError, match=f"`persistence_length` must be positive, but is {value}"):
        of.WormlikeChain(1000 * NM, bad * NM)
    with pytest.raises(ValueError, match=f"`temperature` must be positive, but is {value}"):
        of.WormlikeChain(1000 * NM, 50 * NM).filament(40, bad * unit.kelvin)
    with pytest.raises(TypeError, match="`temperature` must have a unit of temperature"):
        of.WormlikeChain(1000 * NM, 50 * NM).filament(40, 298 * NM)
