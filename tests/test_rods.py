"""Rods and worm-like chains: the stiffnesses of their terms, and what the discrete chain shares with the continuous one."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import tolerances as tol
from conftest import KJ, NM, Array, magnitudes
from hypothesis import assume, given
from hypothesis import strategies as st
from openmm import unit
from scipy import constants
from scipy.integrate import quad

import openmm_filament as of
from openmm_filament import bending, stretching, torsion

PN = unit.piconewton
KELVIN = unit.kelvin
WARM = 298 * KELVIN
KT = constants.k * constants.N_A * 298 / 1000
"""kJ/mol."""
PICONEWTON = constants.N_A * 1e-24
"""kJ/mol/nm."""


def chain(**changes: Any) -> of.WormlikeChain:
    """DNA of 1 um, but for what the test changes."""
    arguments = {"contour_length": 1000 * NM, "persistence_length": 53 * NM, "stretch_modulus": 1000 * PN}
    return of.WormlikeChain(**{**arguments, **changes})


def numbers(filament: of.Filament) -> tuple[float, float, float]:
    """k (kJ/mol/nm^2), b0 (nm) and alpha (kJ/mol) of a uniform filament."""
    bound = {i.term: i.parameters for i in filament.interactions()}
    assert set(bound) == {stretching.Harmonic, bending.Harmonic}
    values = (bound[stretching.Harmonic]["k"], bound[stretching.Harmonic]["r0"], bound[bending.Harmonic]["alpha"])
    assert all(np.ptp(v) == 0 for v in values)
    assert not bound[bending.Harmonic]["beta0"].any()
    return tuple(float(v[0]) for v in values)


def moment(power: int, rest: float, stiffness: float) -> float:
    """`<s^power>` of a harmonic bond in three dimensions, by quadrature; stiffness over k_B T."""
    width = 1 / math.sqrt(stiffness)
    ends = max(0.0, rest - 12 * width), rest + 12 * width

    def weighted(n: int) -> float:
        return quad(
            lambda s: s ** (2 + n) * math.exp(-stiffness * (s - rest) ** 2 / 2), *ends, points=[rest], epsabs=0, epsrel=1e-12
        )[0]  # fmt: skip

    return weighted(power) / weighted(0)


def mean_cosine(ratio: float) -> float:
    """`<cos beta>` of a harmonic joint of alpha = ratio k_B T in three dimensions, by quadrature."""
    end = min(math.pi, 14 / math.sqrt(ratio))

    def weighted(function: Any) -> float:
        return quad(
            lambda b: function(b) * math.sin(b) * math.exp(-ratio * b * b / 2), 0, end, epsabs=0, epsrel=1e-12, limit=200
        )[0]  # fmt: skip

    return 1 - weighted(lambda b: 2 * math.sin(b / 2) ** 2) / weighted(lambda _: 1.0)


# Rods ---------------------------------------------------------------------------------------------------------------


@given(magnitudes(1e-3, 1e3), magnitudes(1e-3, 1e3), magnitudes(1e-2, 1e2), magnitudes(1e-2, 1e2))
def test_stiffnesses_of_a_rod_follow_from_material_and_section(e: float, g: float, r: float, l0: float) -> None:
    terms = of.rod_terms(e * unit.pascal * 1e9, g * unit.pascal * 1e9, r * NM, l0 * NM)
    assert [type(term) for term in terms] == [stretching.Harmonic, bending.Harmonic, torsion.Harmonic]
    metres = 1e-9
    area, second = math.pi * (r * metres) ** 2, math.pi * (r * metres) ** 4 / 4
    wanted = (
        e * 1e9 * area / (l0 * metres) * metres**2,  # N/m = J/m^2 -> J/nm^2
        e * 1e9 * second / (l0 * metres),
        g * 1e9 * 2 * second / (l0 * metres),
    )
    for term, joule, its_unit in zip(terms, wanted, (KJ / NM**2, KJ, KJ), strict=True):
        assert term.stiffness.value_in_unit(its_unit) == pytest.approx(joule * constants.N_A / 1000, rel=tol.SI)


def test_a_steel_wire_is_accepted_in_metres() -> None:
    """By hand: E = 200 GPa, R = 0.5 mm, l0 = 1 cm: k = E S/l0 = 1.5708e7 N/m, alpha = E I/l0 = 0.98175 N m."""
    stretch, bend = of.rod_terms(2e11 * unit.pascal, None, 0.5 * unit.millimeter, 1 * unit.centimeter)
    newton_per_metre = unit.joule / unit.meter**2
    assert (stretch.stiffness / unit.AVOGADRO_CONSTANT_NA).value_in_unit(newton_per_metre) == pytest.approx(
        1.570796e7, rel=1e-6
    )
    assert (bend.stiffness / unit.AVOGADRO_CONSTANT_NA).value_in_unit(unit.joule) == pytest.approx(0.9817477, rel=1e-6)


def test_without_a_shear_modulus_there_is_no_torsion_term() -> None:
    terms = of.rod_terms(1e9 * unit.pascal, None, 1 * NM, 2 * NM)
    assert [type(term) for term in terms] == [stretching.Harmonic, bending.Harmonic]


def test_rest_values_of_a_rod_are_those_of_the_rest_shape() -> None:
    helix = of.shapes.helix(12, radius=3 * NM, pitch=4 * NM, turns=1.5)
    terms = of.rod_terms(1e9 * unit.pascal, 4e8 * unit.pascal, 1 * NM, 2 * NM)
    filament = of.Filament(helix, 1 * unit.dalton, terms)
    assert set(of.reference.energies(filament, helix)) == {"stretching", "bending", "torsion"}
    assert sum(of.reference.energies(filament, helix).values()) < 1e-20 * terms[0].stiffness.value_in_unit(KJ / NM**2)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"youngs_modulus": 0 * unit.pascal}, ValueError, r"`youngs_modulus` must be positive, but is 0\.0"),
        ({"shear_modulus": -1e9 * unit.pascal}, ValueError, "`shear_modulus` must be positive, but is -"),
        ({"radius": -2 * NM}, ValueError, r"`radius` must be positive, but is -2\.0"),
        ({"segment_length": math.nan * NM}, ValueError, "`segment_length` must be finite, but is nan"),
        (
            {"youngs_modulus": 1e9},
            TypeError,
            r"`youngs_modulus` must be a Quantity of pressure .* but is 1000000000\.0",
        ),
        ({"radius": 1 * PN}, TypeError, "`radius` must have a unit of length .* but has piconewton"),
        (
            {"segment_length": [1.0, 2.0] * NM},
            ValueError,
            r"`segment_length` must have shape \(\), but has shape \(2,\)",
        ),
    ],
)
def test_bad_rods_are_refused(change: dict[str, Any], error: type[Exception], message: str) -> None:
    good = {
        "youngs_modulus": 1e9 * unit.pascal,
        "shear_modulus": 4e8 * unit.pascal,
        "radius": 1 * NM,
        "segment_length": 2 * NM,
    }
    with pytest.raises(error, match=message):
        of.rod_terms(**{**good, **change})


# Worm-like chains ---------------------------------------------------------------------------------------------------


@given(magnitudes(5, 500), st.integers(8, 200))
def test_the_discrete_chain_has_the_persistence_length_asked_for(lp: float, count: int) -> None:
    assume(1000 / count < 6 * lp)
    _, _, alpha = numbers(chain(persistence_length=lp * NM).filament(count, WARM))
    cosine = mean_cosine(alpha / KT)
    assert -1000 / count / math.log(cosine) == pytest.approx(lp, rel=10 * tol.QUADRATURE * max(1, lp * count / 1000))


@given(magnitudes(50, 5000), st.integers(4, 150), st.floats(100, 500))
def test_bonds_have_the_mean_length_that_adds_up_to_the_contour(modulus: float, count: int, kelvin: float) -> None:
    filament = chain(stretch_modulus=modulus * PN).filament(count, kelvin * KELVIN)
    k, b0, _ = numbers(filament)
    kt = KT * kelvin / 298
    b = 1000 / count
    assert k == pytest.approx(modulus * PICONEWTON / b, rel=tol.SI)
    assert moment(1, b0, k / kt) == pytest.approx(b, rel=tol.QUADRATURE)
    small = kt / (k * b**2)
    assert b0 + 2 * kt / (k * b0) == pytest.approx(b, rel=8 * small**2)  # the formula is of first order in `small`


@given(st.integers(10, 60), st.floats(0.05, 20), magnitudes(30, 300))
def test_softer_bonds_under_tension_have_the_mean_length_of_the_stiff_chain(
    count: int, tension: float, softer: float
) -> None:
    """A tension along a bond shifts its energy by `-f s`: the mean under it must be `b (1 + f/S)`."""
    b = 1000 / count
    filament = chain().filament(count, WARM, stretch_modulus=softer * PN, tension=tension * PN)
    k, b0, _ = numbers(filament)
    assert k == pytest.approx(softer * PICONEWTON / b, rel=tol.SI)
    assert moment(1, b0 + tension * PICONEWTON / k, k / KT) == pytest.approx(
        b * (1 + tension / 1000), rel=tol.QUADRATURE
    )


@pytest.mark.parametrize("modulus", [None, 300 * PN, 1000 * PN])
@pytest.mark.parametrize(("lp", "count"), [(53, 40), (53, 160), (200, 12), (20, 100)])
def test_end_to_end_match_gives_the_distance_of_the_continuous_chain(lp: float, count: int, modulus: Any) -> None:
    """`<R^2> = N <s^2> + <s>^2 sum_{i != j} <cos beta>^|i-j|`, summed bond by bond, against the continuous formula."""
    wormlike = chain(persistence_length=lp * NM, stretch_modulus=modulus)
    k, b0, alpha = numbers(wormlike.filament(count, WARM, match=of.Match.END_TO_END))
    apart = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    off_diagonal = (mean_cosine(alpha / KT) ** apart).sum() - count
    squared = count * moment(2, b0, k / KT) + moment(1, b0, k / KT) ** 2 * off_diagonal
    continuous = 2 * lp * 1000 * (1 - lp / 1000 * (1 - math.exp(-1000 / lp)))
    assert squared == pytest.approx(continuous, rel=100 * tol.QUADRATURE)


def test_the_filament_is_straight_and_has_its_mass() -> None:
    filament = chain().filament(20, WARM)
    rest: Array = filament.rest.value_in_unit(NM)
    assert rest.shape == (21, 3)
    assert not rest[:, :2].any()
    np.testing.assert_allclose(np.diff(rest[:, 2]), numbers(filament)[1], rtol=tol.ROUNDING)
    np.testing.assert_allclose(filament.masses.value_in_unit(unit.dalton), 650 / 0.34 * 50, rtol=tol.ROUNDING)
    light = chain(line_density=10 * unit.dalton / NM).filament(20, WARM)
    np.testing.assert_allclose(light.masses.value_in_unit(unit.dalton), 500, rtol=tol.ROUNDING)
    assert (filament.damping, filament.closed, len(filament.terms)) == (None, False, 2)


def test_a_chain_without_stretch_modulus_has_bonds_that_hardly_stretch() -> None:
    k, b0, _ = numbers(chain(stretch_modulus=None).filament(40, WARM))
    mean = moment(1, b0, k / KT)
    assert mean == pytest.approx(25, rel=tol.QUADRATURE)
    assert math.sqrt(moment(2, b0, k / KT) - mean**2) < 0.1 * mean


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"contour_length": -1 * NM}, ValueError, r"`contour_length` must be positive, but is -1\.0"),
        ({"persistence_length": 0 * NM}, ValueError, r"`persistence_length` must be positive, but is 0\.0"),
        (
            {"persistence_length": 53},
            TypeError,
            "`persistence_length` must be a Quantity of length .* but is 53 without",
        ),
        ({"stretch_modulus": 1000 * PN / NM}, TypeError, "`stretch_modulus` must have a unit of force"),
        ({"stretch_modulus": -5 * PN}, ValueError, "`stretch_modulus` must be positive, but is -"),
        ({"line_density": 650 * unit.dalton}, TypeError, "`line_density` must have a unit of line_density"),
    ],
)
def test_bad_wormlike_chains_are_refused(change: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        chain(**change)


@pytest.mark.parametrize(
    ("arguments", "options", "error", "message"),
    [
        ((1, WARM), {}, ValueError, "`segments` must be at least 2, but is 1"),
        ((10.0, WARM), {}, TypeError, r"`segments` must be a whole number, but is 10\.0"),
        ((True, WARM), {}, TypeError, "`segments` must be a whole number, but is True"),
        ((10, 0 * KELVIN), {}, ValueError, r"`temperature` must be positive, but is 0\.0"),
        ((10, 298), {}, TypeError, "`temperature` must be a Quantity of temperature .* but is 298 without"),
        ((10, WARM), {"match": "end_to_end"}, ValueError, "`match` must be one of .* but is 'end_to_end'"),
        ((10, WARM), {"tension": -1 * PN}, ValueError, "`tension` must not be negative, but is -"),
        ((10, WARM), {"stretch_modulus": 0 * PN}, ValueError, r"`stretch_modulus` must be positive, but is 0\.0"),
        (
            (10, WARM),
            {"stretch_modulus": 10 * PN, "tension": 50 * PN},
            ValueError,
            "`stretch_modulus` must be well above the tension, but is 0.2 times it",
        ),
        ((2, WARM), {"match": of.Match.END_TO_END}, ValueError, "`segments` must be larger .* but is 2"),
    ],
)
def test_bad_discretisations_are_refused(
    arguments: tuple[Any, ...], options: dict[str, Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        chain().filament(*arguments, **options)
