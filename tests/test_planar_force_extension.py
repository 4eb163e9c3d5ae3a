"""The planar chain cold and hot: its equilibria by other routes, its moves, what a wrong number does, its quick run."""

from __future__ import annotations

import csv
import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from openmm import unit

import openmm_filament as of
from openmm_filament.discretisation import PN
from systems import __main__ as command
from systems.planar_force_extension import chain, cold, fits, hot, report, warm
from systems.planar_force_extension.moves import Moves, wrapped


@pytest.fixture(scope="module")
def curves() -> list[cold.Curve]:
    return [cold.pulled(young, np.geomspace(1e-4, 1.0, 9)) for young in chain.YOUNG[:2]]


def test_every_check_of_the_cold_curves_passes(curves: list[cold.Curve]) -> None:
    assert [check.name for check in report.cold_checks(curves) if not check.passed] == []


@pytest.mark.parametrize(
    ("what", "changed"),
    [
        ("STIFFNESS_RATIO", chain.STIFFNESS_RATIO * 1.01),
        ("BENDS", chain.BENDS * 1.01),
        ("RADIUS", chain.RADIUS * 1.01),
    ],
)
def test_one_per_cent_off_is_seen(
    curves: list[cold.Curve], monkeypatch: pytest.MonkeyPatch, what: str, changed: object
) -> None:
    monkeypatch.setattr(chain, what, changed)
    failed = [check.name for check in report.cold_checks(curves) if not check.passed]
    assert any("headings" in name for name in failed)
    assert any("straight" in name for name in failed)


def test_castigliano_is_the_slope_of_a_rigid_bend() -> None:
    # every joint turns by F y/alpha: the chain rebuilt with those bends, its bonds longer by F cos/k
    force, young = 1e-9, 1e12
    bond, joint = chain.rigidities(young)
    s = np.diff(chain.REST[:, :2], axis=0)
    turn = np.concatenate([[0.0], np.cumsum(force * chain.REST[1:-1, 1] / joint)])
    heading = np.arctan2(s[:, 1], s[:, 0]) + turn
    length = np.hypot(*s.T) + force * s[:, 0] / np.hypot(*s.T) / bond
    span = np.array([(length * np.cos(heading)).sum(), (length * np.sin(heading)).sum()])
    # to first order: the chain turns as a whole so that its ends stay on x, which changes the distance at second order
    assert (np.hypot(*span) - chain.REST[-1, 0]) / force == pytest.approx(cold.compliance(young), rel=1e-4)


def test_letting_go_leaves_joints_turned_over(curves: list[cold.Curve]) -> None:
    back = cold.let_go(curves[1])
    assert all(point.converged for point in back)
    assert curves[1].points[0].over <= 1 < back[-1].over
    assert back[-1].extension > curves[1].points[0].extension + 0.05 * chain.CONTOUR


def test_moves_weigh_chains_as_openmm_does() -> None:
    heat, force, ratio = 0.2, 0.7, 100.0
    rng = np.random.default_rng(4)
    model = warm.model(hot.Job(heat, ratio, force, 1, 1))
    moves = Moves(heat, force, chain.FREE, rng)
    s = np.ones((1, chain.SEGMENTS))
    weights, energies = [], []
    for h in rng.uniform(-np.pi, np.pi, (5, 1, chain.SEGMENTS)):
        ends = np.cumsum(s * np.exp(1j * h)) * hot.LENGTH
        x = np.zeros((chain.SEGMENTS + 1, 3))
        x[1:, 0], x[1:, 1] = ends.real, ends.imag
        weights.append(float(moves.log_weight(h, s)[0]))
        energies.append(sum(of.energies(model, x * unit.nanometer).values()))
    kT = chain.KT * PN
    assert_allclose(np.diff(weights), -np.diff(energies) / kT, rtol=1e-6)


def test_turning_a_joint_over_keeps_its_size_and_undoes_itself() -> None:
    moves = Moves(0.01, 0.3, tuple(float(i != 7) for i in range(29)), np.random.default_rng(1))
    h = np.random.default_rng(2).uniform(-np.pi, np.pi, (6, 30))
    kink = moves.kinds[-1]  # a single free joint: the last kind turns it over
    once = kink(h)
    before, after = (wrapped(np.diff(headings, axis=1)) for headings in (h, once))
    assert_allclose(after[:, 7], -before[:, 7], atol=1e-12)
    assert_allclose(wrapped(kink(once) - h), 0.0, atol=1e-12)


def test_moves_alone_reach_the_exact_chain_of_rigid_bonds() -> None:
    heat, force, rng = 0.1, 0.3, np.random.default_rng(3)
    s = np.ones((128, chain.SEGMENTS))
    h = np.cumsum(np.concatenate([np.zeros((128, 1)), np.tile(chain.BENDS, (128, 1))], axis=1), axis=1)
    moves = Moves(heat, force, chain.FREE, rng)
    h = moves(h, s, 600)
    means = []
    for _ in range(30):
        h = moves(h, s, 50)
        means.append((s * np.cos(h)).mean(axis=1))
    each = np.mean(means, axis=0)
    exact = of.wlc.extension_discrete(
        force, segments=30, bond_length=1.0, bending=1.0, kT=heat, rest_angles=np.abs(chain.BENDS), dimension=2
    )
    assert abs(each.mean() - exact / 30) < 4 * each.std() / np.sqrt(len(each))


def test_moves_never_turn_held_joints() -> None:
    rng = np.random.default_rng(5)
    sides = tuple((np.sign(chain.BENDS) * (np.abs(chain.BENDS) > 0.4)).tolist())
    h = np.cumsum(np.concatenate([np.zeros((8, 1)), np.tile(chain.BENDS, (8, 1))], axis=1), axis=1)
    after = Moves(0.5, 0.1, sides, rng)(h, np.ones((8, 30)), 400)
    held, signs = np.array(sides) != 0, np.sign(wrapped(np.diff(after, axis=1)))
    assert (signs[:, held] == np.sign(chain.BENDS)[held]).all()
    assert (signs[:, ~held] != np.sign(chain.BENDS)[~held]).any()


def test_cold_joints_near_zero_or_pi_are_not_frozen() -> None:
    shape = cold.shapes_at((0.01,))[0]
    sides = np.array(warm.sides(shape, 1e-3))
    bends = chain.signed_bends(shape)
    assert 0 < (sides == 0).sum() < 5
    assert np.abs(bends[sides == 0]).max() < warm.CLEAR * np.sqrt(1e-3)
    assert (np.array(warm.sides(shape, 1e-2)) == 0).sum() > (sides == 0).sum()


def test_a_short_run_agrees_with_the_exact_chain_and_not_with_a_wrong_one() -> None:
    job = hot.Job(0.1, 100.0, 3.0, 60, 5)
    found = hot.sample(job)
    exact = warm.exact(job)
    assert abs(found.extension - exact) < 4 * found.error
    for change in ({"heat": 0.2}, {"ratio": 60.0}, {"force": 2.4}):
        assert abs(found.extension - warm.exact(dataclasses.replace(job, **change))) > 4 * found.error, change


def test_sampled_points_that_are_off_fail_the_check(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report, "_zero_temperature", list)  # tested by the quick run: it takes a second
    job = hot.Job(1.0, 100.0, 1.0, 100, 5)
    exact = warm.exact(job)

    def checks(extension: float, r_hat: float = 1.0) -> dict[str, bool]:
        sampled = hot.Sampled(job, extension, 0.001, 100.0, r_hat, np.zeros(29), np.zeros((1, 31, 3)))
        return {check.name: check.passed for check in report.hot_checks([sampled])}

    assert all(checks(exact + 0.001).values())
    assert sum(not passed for passed in checks(exact * 1.01).values()) == 2
    left_out = checks(exact * 1.01, 1.2)
    assert len(left_out) == len(checks(exact)) - 2
    assert sum(not passed for passed in left_out.values()) == 1  # its temperature has no point left


def test_each_form_is_fitted_back_to_itself() -> None:
    force = np.geomspace(1e-3, 10, 12)
    for form, function in fits.FORMS.items():
        fit = fits.fitted(force, function(force, 0.02), form)
        assert fit.scale == pytest.approx(0.02, rel=1e-4)
        assert fit.rms < 1e-5
    exact = of.wlc.extension_exact(force / 0.02, 1.0, 1.0, 1.0, dimension=2)
    assert_allclose(fits.FORMS[report.EXACT](force, 0.02), exact, atol=2e-6)


@pytest.mark.parametrize("points", ["8", "11"])
def test_points_that_do_not_divide_the_decades_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], points: str
) -> None:
    assert command.main(["planar_force_extension", "--output", str(tmp_path / "out"), "--points", points]) == 2
    assert f"`--points` must be 9, 13, 17, ... so that forces are alike in every decade, but is {points}" in (
        capsys.readouterr().err
    )


@pytest.mark.slow
def test_the_quick_run_passes_and_writes_its_files(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    assert command.main(["planar_force_extension", "--output", str(folder), "--quick"]) == 0
    names = {path.name for path in folder.iterdir()}
    tables = {"force_extension.csv", "thermal_force_extension.csv", "fits.csv", "misfit.csv"}
    figures = {"force_extension.png", "thermal_force_extension.png"}
    assert {"summary.json", "topology.pdb", "trajectory.dcd", "thermal_trajectory.dcd", *tables, *figures} <= names
    assert ("still.png" in names) == of.rendering.available()
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["terms"] == ["CustomAngleForce", "CustomBondForce", "CustomExternalForce"]
    with (folder / "force_extension.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if float(row["youngs_modulus_Pa"]) == 1e12]
    frames = of.load(folder / "trajectory.dcd")
    found = (frames.xyz[:, -1, 0] - frames.xyz[:, 0, 0]) * 1e-9
    assert_allclose(found, [float(row["extension_m"]) for row in rows], rtol=1e-5)
    with (folder / "thermal_force_extension.csv").open() as file:
        hot_rows = list(csv.DictReader(file))
    assert {float(row["kT_over_alpha"]) for row in hot_rows} == {1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0}
