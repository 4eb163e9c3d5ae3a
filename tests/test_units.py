"""Quantities to numbers and back: dimensions, moles, constants, scales."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.constants as sc
import tolerances as tol
from conftest import KJ, NM, magnitudes
from hypothesis import given
from hypothesis import strategies as st
from openmm import unit

from openmm_filament import units

EXAMPLES = {
    "length": (unit.angstrom, 0.1),
    "time": (unit.femtosecond, 1e-3),
    "mass": (unit.kilogram, 1e3 * sc.Avogadro),  # OpenMM's dalton is 1 g/mol, 1e-9 lighter than the SI's
    "energy": (unit.kilocalorie_per_mole, 4.184),
    "force": (unit.piconewton, 0.602214076),
    "stiffness": (unit.newton / unit.meter, 602.214076),
    "pressure": (unit.pascal, 6.02214076e-7),
    "temperature": (unit.kelvin, 1.0),
    "angle": (unit.degree, math.pi / 180),
    "charge": (unit.coulomb, 1 / sc.elementary_charge),
    "rate": (unit.second**-1, 1e-12),
    "velocity": (unit.meter / unit.second, 1e-3),
    "line_density": (unit.kilogram / unit.meter, 1e-6 * sc.Avogadro),
    "pure": (unit.dimensionless, 1.0),
    "energy_length": (unit.kilocalorie_per_mole * unit.nanometer, 4.184),
}
"""A unit of each dimension and its value in the package's own unit."""

dimensions = pytest.mark.parametrize("dimension", EXAMPLES)


def test_every_dimension_has_an_example() -> None:
    assert set(EXAMPLES) == set(units._UNITS)


@dimensions
def test_numbers_converts(dimension: str) -> None:
    given_unit, value = EXAMPLES[dimension]
    assert units.number("x", 3.0 * given_unit, dimension) == pytest.approx(3 * value, rel=tol.CONSTANT)
    assert units.numbers("x", [1.0, 2.0] * given_unit, dimension) == pytest.approx([value, 2 * value], rel=tol.CONSTANT)


@dimensions
def test_quantity_is_the_inverse_of_numbers(dimension: str) -> None:
    values = np.array([[1.5, -2.0], [0.0, 1e6]])
    np.testing.assert_array_equal(units.numbers("x", units.quantity(values, dimension), dimension), values)


@dimensions
def test_dimension_of_names_the_dimension(dimension: str) -> None:
    assert units.dimension_of("x", 2.0 * EXAMPLES[dimension][0]) == dimension
    assert units.dimension_of("x", units.quantity(1.0, dimension)) == dimension


@dimensions
def test_a_bare_number_is_refused(dimension: str) -> None:
    with pytest.raises(TypeError, match=rf"`thing` must be a Quantity of {dimension} .* is 3\.0 without a unit"):
        units.numbers("thing", 3.0, dimension)


@dimensions
def test_another_dimension_is_refused(dimension: str) -> None:
    for other, (its_unit, _) in EXAMPLES.items():
        if other != dimension:
            with pytest.raises(TypeError, match=f"Argument `thing` must have a unit of {dimension} "):
                units.numbers("thing", 1.0 * its_unit, dimension)


@pytest.mark.parametrize("bad", [None, "3 nm", [1.0, 2.0], [1.0 * NM, 2.0], np.ones(3), True, unit.nanometer])
def test_anything_without_a_unit_is_refused(bad: object) -> None:
    with pytest.raises(TypeError, match="`thing` must be a Quantity of length"):
        units.numbers("thing", bad, "length")
    with pytest.raises(TypeError, match="`thing` must be a Quantity"):
        units.dimension_of("thing", bad)


@pytest.mark.parametrize("bad", [["a", "b"] * NM, [[1.0, 2.0], [3.0]] * NM])
def test_a_quantity_of_no_numbers_is_refused(bad: unit.Quantity) -> None:
    with pytest.raises(TypeError, match="`thing` must be numeric"):
        units.numbers("thing", bad, "length")


def test_an_unknown_dimension_is_refused() -> None:
    for bad in (1.0 * unit.candela, 1.0 * unit.meter**2, 1.0 * unit.volt):
        with pytest.raises(TypeError, match="`thing` must have a unit of length"):
            units.dimension_of("thing", bad)
    with pytest.raises(ValueError, match=r"`dimension` must be one of .*'length'"):
        units.Scale().factor("luminosity")


def test_number_refuses_an_array() -> None:
    with pytest.raises(ValueError, match=r"`thing` must have shape \(\), but has shape \(2,\)"):
        units.number("thing", [1.0, 2.0] * NM, "length")


def test_a_list_of_quantities_is_an_array() -> None:
    vectors = [[0.0, 1.0, 2.0] * NM, [0.0, 10.0, 20.0] * unit.angstrom]
    np.testing.assert_allclose(units.numbers("x", vectors, "length"), [[0, 1, 2], [0, 1, 2]])


def test_the_result_is_a_new_array() -> None:
    given_array = np.ones(3)
    units.numbers("x", given_array * NM, "length")[:] = 7
    units.numbers("x", unit.Quantity(given_array, NM), "length")[:] = 7
    np.testing.assert_array_equal(given_array, np.ones(3))


@pytest.mark.parametrize(
    ("per_molecule", "per_mole", "dimension"),
    [
        (1.0 * unit.joule, 6.02214076e20 * KJ, "energy"),
        (4.11 * unit.piconewton * NM, 4.11 * 0.602214076 * KJ, "energy"),
        (1.0 * unit.piconewton, 0.602214076 * KJ / NM, "force"),
        (1.0 * unit.newton / unit.meter, 602.214076 * KJ / NM**2, "stiffness"),
        (1.0 * unit.piconewton / NM, 0.602214076 * KJ / NM**2, "stiffness"),
        (1.0 * unit.joule / unit.meter**2, 1.0 * unit.newton / unit.meter, "stiffness"),
        (1e9 * unit.pascal, 602.214076 * KJ / NM**3, "pressure"),
        (1.0 * unit.newton / unit.meter**2, 1.0 * unit.pascal, "pressure"),
    ],
)
def test_per_molecule_and_per_mole_meet(per_molecule: unit.Quantity, per_mole: unit.Quantity, dimension: str) -> None:
    values = [units.number("x", q, dimension) for q in (per_molecule, per_mole)]
    assert values[0] == pytest.approx(values[1], rel=tol.ROUNDING)


def test_a_piconewton_is_0_602214_of_openmms_unit_of_force() -> None:
    assert units.number("f", 1.0 * unit.piconewton, "force") == pytest.approx(0.602214, abs=1e-6)


def test_constants_are_those_of_scipy() -> None:
    coulomb = sc.elementary_charge**2 / (4 * math.pi * sc.epsilon_0) * sc.Avogadro / sc.kilo / sc.nano
    assert pytest.approx(coulomb, rel=tol.CONSTANT) == units.COULOMB
    assert pytest.approx(sc.Boltzmann * sc.Avogadro / sc.kilo, rel=tol.CONSTANT) == units.BOLTZMANN


# Scales -------------------------------------------------------------------------------------------------------------

scales = st.builds(units.Scale, magnitudes(1e-6, 1e9), magnitudes(1e-3, 1e30), magnitudes(1e-6, 1e30))


@given(scales)
def test_factors_of_a_scale_belong_together(scale: units.Scale) -> None:
    f = scale.factor
    assert (f("length"), f("mass"), f("energy")) == (scale.length, scale.mass, scale.energy)
    assert f("time") == pytest.approx(f("length") * math.sqrt(f("mass") / f("energy")), rel=tol.ROUNDING)
    assert f("rate") * f("time") == pytest.approx(1, rel=tol.ROUNDING)
    assert f("velocity") == pytest.approx(f("length") / f("time"), rel=tol.ROUNDING)
    assert f("force") == pytest.approx(f("mass") * f("length") / f("time") ** 2, rel=tol.ROUNDING)
    assert f("force") * f("length") == pytest.approx(f("energy"), rel=tol.ROUNDING)
    assert f("stiffness") * f("length") ** 2 == pytest.approx(f("energy"), rel=tol.ROUNDING)
    assert f("pressure") * f("length") ** 3 == pytest.approx(f("energy"), rel=tol.ROUNDING)
    assert f("energy_length") == pytest.approx(f("energy") * f("length"), rel=tol.ROUNDING)
    assert f("line_density") * f("length") == pytest.approx(f("mass"), rel=tol.ROUNDING)
    assert f("temperature") == f("energy")  # k_B keeps its number
    assert f("angle") == f("pure") == 1


def test_the_scale_of_the_nanometre_is_the_identity() -> None:
    assert units.NANOMETER_SCALE.is_identity
    assert all(units.NANOMETER_SCALE.factor(dimension) == 1 for dimension in units._POWERS)
    assert not units.Scale(energy=2.0).is_identity


def test_every_dimension_can_be_scaled() -> None:
    assert set(units._UNITS) <= set(units._POWERS)
