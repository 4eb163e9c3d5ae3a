"""The planar chain cold and hot: its equilibria by other routes, its moves, what a wrong number does, its quick run."""

from __future__ import annotations

import csv
import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import openmm_filament as of
from systems import __main__ as command
from systems.planar_force_extension import chain, cold, fits, hot, report, warm


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


def test_mirror_moves_keep_what_they_must() -> None:
    rng = np.random.default_rng(4)
    x = np.repeat(chain.REST[None] / chain.STEP, 40, axis=0)
    v = rng.normal(size=x.shape) * (1, 1, 0)
    lengths, speeds = np.linalg.norm(np.diff(x, axis=1), axis=-1), (v**2).sum(axis=-1)
    moved, after = x, v
    for _ in range(60):
        moved, after = hot.mirrored(moved, after, 0.5, 1.0, rng)
    assert (moved != x).any(axis=(1, 2)).all()
    assert_allclose(np.linalg.norm(np.diff(moved, axis=1), axis=-1), lengths, rtol=1e-12)
    assert_allclose((after**2).sum(axis=-1), speeds, rtol=1e-12)
    assert not moved[..., 2].any()
    assert_allclose(moved[:, 0], x[:, 0])


def test_mirror_moves_alone_weigh_the_two_sides_of_a_joint_right(monkeypatch: pytest.MonkeyPatch) -> None:
    # three bonds: shapes with the first bond and the sizes of the bends as they were weigh as the force does work
    bends, pull, heat = np.array([0.9, 0.5]), 0.7, 0.2
    monkeypatch.setattr(chain, "BENDS", bends)
    rng = np.random.default_rng(2)
    heading = np.concatenate([[0.3], 0.3 + np.cumsum(bends)])
    shape = np.concatenate([[[0, 0, 0]], np.cumsum(np.stack([np.cos(heading), np.sin(heading), 0 * heading], -1), 0)])
    x = np.repeat(shape[None], 4000, axis=0)
    v = np.zeros_like(x)
    for _ in range(40):
        x, v = hot.mirrored(x, v, pull, heat, rng)
    same = np.abs(np.abs(chain.signed_bends(x)) - bends).max(axis=1) < 1e-9
    same &= np.abs(x[:, 1] - shape[1]).max(axis=1) < 1e-9
    ends, counts = np.unique(x[same, -1, 0].round(6), return_counts=True)
    assert len(ends) == 4
    assert_allclose(np.log(counts / counts[0]), pull * (ends - ends[0]), atol=4 * np.sqrt(2 / counts.min()))


def test_a_short_run_agrees_with_the_exact_chain_and_not_with_a_wrong_one() -> None:
    job = hot.Job(0.1, 100.0, 3.0, 6e5, 5)
    found = hot.sample(job)
    exact = warm.exact(job)
    assert abs(found.extension - exact) < 4 * found.error
    for change in ({"heat": 0.2}, {"ratio": 60.0}, {"force": 2.4}):
        assert abs(found.extension - warm.exact(dataclasses.replace(job, **change))) > 4 * found.error, change


def test_sampled_points_that_are_off_fail_the_check(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report, "_zero_temperature", list)  # tested by the quick run: it takes a second
    job = hot.Job(1.0, 100.0, 1.0, 1e6, 5)
    exact = warm.exact(job)

    def checks(extension: float) -> dict[str, bool]:
        sampled = hot.Sampled(job, extension, 0.001, 100.0, 1.0, np.zeros(29))
        return {check.name: check.passed for check in report.hot_checks([sampled])}

    assert all(checks(exact + 0.001).values())
    assert sum(not passed for passed in checks(exact * 1.01).values()) == 2


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
    assert {"summary.json", "topology.pdb", "trajectory.dcd", *tables, *figures} <= names
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
