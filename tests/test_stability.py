"""The stability map: its cheap cells are right or refused, a broken copy makes wrong ones, and what it mended stays mended."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable, Iterable
from itertools import islice
from pathlib import Path

import mpmath as mp
import numpy as np
import openmm as mm
import pytest
from conftest import KJ, NM
from openmm import unit

import openmm_filament as of
from openmm_filament import bending, stretching, torsion
from openmm_filament.divergence import DivergedError
from openmm_filament.inspection import PreflightWarning
from systems import stability
from systems.stability import cells, exact, figures, limits, precision, pulls, scales, shapes, thermal

CHEAP: dict[str, Callable[[], Iterable[cells.Cell]]] = {
    "limits": lambda: limits.limits(quick=True, into=[]),
    "masses": lambda: scales.masses(quick=True),
    "sizes": lambda: scales.sizes(quick=True),
    "angles": shapes.angles,
    "coincident": shapes.coincident,
    "dihedrals": shapes.dihedrals,
    "amplitudes": lambda: scales.amplitudes(quick=True),
    "drifts": lambda: limits.drifts(quick=True, into=[]),
    "ratios": lambda: scales.ratios(quick=True),
    "counts": lambda: islice(scales.counts(quick=True), 6),
    "forces": lambda: islice(pulls.forces(quick=True), 6),
    "precision": lambda: islice(precision.precisions(quick=True), 32),
}


@pytest.mark.parametrize("axis", CHEAP)
def test_no_cheap_cell_is_wrong(axis: str) -> None:
    made = list(CHEAP[axis]())
    assert made
    assert [cell for cell in made if cell.outcome in ("wrong", "not available")] == []
    assert any(cell.outcome == "right" for cell in made)


# What the map found, and what became of it --------------------------------------------------------------------------


def test_the_smallest_bends_are_told_of_where_the_arccosine_loses_them() -> None:
    found = {cell.label: cell for cell in shapes.angles() if cell.case == "bending, arccosine, rest 0"}
    for label in ("1e-12", "1e-10", "1e-8"):
        assert found[label].outcome == "warned"
        assert "arctangent" in found[label].message
    assert found["1e-4"].outcome == "right"


def test_a_straight_joint_that_rests_bent_is_told_of() -> None:
    term = bending.Harmonic(30 * KJ, 0.4 * unit.radian)
    model = of.build(of.Filament(of.shapes.line(3, 1 * NM), 10 * unit.dalton, (term,)))
    with pytest.warns(PreflightWarning, match="beads 0, 1 and 2 at 0 rad rest at 0.4 rad: .* no direction"):
        of.preflight(model)


def test_a_violent_run_that_gains_energy_is_stopped() -> None:
    model = of.build(scales._chain(*scales._terms(500.0, 50.0, 10.0)))
    with pytest.raises(DivergedError, match="energy of the run must not rise"):
        scales._kept(model, 10**-0.5, 1000)


def test_a_chain_pulled_too_far_is_refused_in_words_that_fit() -> None:
    with pytest.raises(DivergedError, match="spread over more than 1000 times the extent of the rest shape"):
        pulls._run(1e5)


def test_a_cold_chain_with_dihedrals_has_its_integrator_in_time() -> None:
    rest = of.shapes.helix(11, radius=2 * NM, pitch=3 * NM, turns=1.3)
    terms = (stretching.Harmonic(500 * KJ / NM**2), bending.Harmonic(100 * KJ), torsion.Harmonic(20 * KJ))
    of.langevin(of.build(of.Filament(rest, 10 * unit.dalton, terms)), 1e-6 * unit.kelvin)


# The map can fail ---------------------------------------------------------------------------------------------------


def test_a_force_one_per_cent_off_is_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shapes.exact, "forces", lambda i, x, right=exact.forces: 1.01 * right(i, x))
    found = {cell.label: cell for cell in shapes.angles() if cell.case == "bending, arctangent, rest 0"}
    assert found["1e-3"].outcome == "wrong"


def test_a_limit_ten_per_cent_off_is_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    right = of.stable_timestep
    monkeypatch.setattr(limits.of, "stable_timestep", lambda model: 1.1 * right(model))
    assert next(iter(limits.limits(quick=True, into=[]))).outcome == "wrong"


@pytest.mark.parametrize(
    ("run", "outcome"),
    [
        (lambda: 1e-4, "right"), (lambda: 0.1, "wrong"), (lambda: math.nan, "wrong"), (lambda: (0.1, 0.2), "right"),
        (lambda: of.Filament(np.zeros((2, 3)) * NM, 1 * unit.dalton, ()), "refused"), (lambda: 1 / 0, "wrong"),
        (lambda: math.log(0), "wrong"), (lambda: float("x"), "wrong"), (lambda: mm.VerletIntegrator("x"), "wrong"),
    ],
)  # fmt: skip
def test_a_cell_is_what_came_of_running_it(run: Callable[[], float], outcome: str) -> None:
    assert cells.judged(("a", "b", "c", 1.0), "run", run).outcome == outcome


def test_a_pair_that_is_lost_in_a_nan_is_wrong() -> None:
    spring = stretching.Harmonic(500 * KJ / NM**2)
    model = of.build(of.Filament(of.shapes.line(1, 1 * NM), 1 * unit.dalton, (spring,)))
    assert scales._ringing(model, math.sqrt(1000)) < 1e-9
    assert math.isnan(scales._ringing(model, math.nan))


def test_a_nan_in_the_forces_of_one_term_is_no_smaller_error(monkeypatch: pytest.MonkeyPatch) -> None:
    model = of.build(scales._chain(*scales._terms(500.0, 50.0, 10.0)))
    context = cells.reference(model, mm.VerletIntegrator(1e-12))
    found = iter([1e-9, math.nan, 1e-9])
    monkeypatch.setattr(scales.exact, "error", lambda *_: next(found))
    assert math.isnan(scales._worst_error(model, context, model.positions.value_in_unit(NM)))


def test_a_mean_energy_that_is_nan_is_the_worst() -> None:
    assert thermal._worst([(0.1, 1.0), (0.3, 2.0)]) == (0.3, 2.0)
    for place in range(3):
        found = [(0.01, 0.1)] * 3
        found[place] = (math.nan, math.nan)
        assert math.isnan(thermal._worst(found)[0])


# The exact answers by another route ---------------------------------------------------------------------------------


def test_exact_forces_are_those_of_numpy_on_an_ordinary_chain(rng: np.random.Generator) -> None:
    x = shapes.bent((0.8, 1.3, 0.6, 1.0), (0.7, 1.2, 0.5), (0.9, -2.0))
    for twist in (torsion.Harmonic(7 * KJ), torsion.Periodic(3 * KJ, 2), torsion.Weighted(5 * KJ)):
        terms = (stretching.Harmonic(50 * KJ / NM**2), bending.Harmonic(20 * KJ), bending.Cosine(3 * KJ), twist)
        filament = of.Filament(x * NM, 1 * unit.dalton, terms)
        moved = x + 0.1 * rng.normal(size=x.shape)
        right = of.reference.forces(filament, moved * NM)
        np.testing.assert_allclose(
            exact.forces(filament.interactions(), moved), right, rtol=0, atol=1e-11 * np.abs(right).max()
        )
    assert mp.mp.dps == 15  # the precision of others is left alone


@pytest.mark.parametrize("kelvin", [1e-3, 300.0])
def test_mean_energies_are_half_a_kt_a_degree_of_freedom_where_stiff(kelvin: float) -> None:
    kt = of.units.BOLTZMANN * kelvin
    mean = thermal.exact_energies(kelvin, bent=True)
    for energy in mean.values():
        assert energy == pytest.approx(kt / 2, rel=0.1 if kelvin > 1 else 1e-4)
    assert thermal.exact_energies(kelvin, bent=False)["bending"] == pytest.approx(kt, rel=0.05)


def test_the_figure_and_the_table_are_written(tmp_path: Path) -> None:
    made = stability.Map()
    made.cells = [*islice(limits.limits(quick=True, into=made.limits), 3), *limits.drifts(quick=True, into=made.drifts)]
    made.cells += shapes.coincident()
    cells.write(tmp_path / "stability.csv", made.cells)
    figures.draw(tmp_path / "stability.png", made.cells, made.limits, made.drifts)
    with (tmp_path / "stability.csv").open() as table:
        assert len(list(csv.DictReader(table))) == len(made.cells)
    assert (tmp_path / "stability.png").stat().st_size > 20_000
    assert all(check.passed for check in stability.checks(made))
    json.dumps(stability.findings(made.cells))
