"""The system helix_force_extension: its quick run, its formulas against one another, and what it refuses."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

import openmm_filament as of
from systems import __main__ as command
from systems.helix_force_extension import coil, thermal


@pytest.mark.slow
def test_the_quick_run_passes_and_writes_its_files(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    assert command.main(["helix_force_extension", "--output", str(folder), "--quick"]) == 0
    names = {path.name for path in folder.iterdir()}
    assert {"summary.json", "force_extension.csv", "force_extension.png", "trajectory.dcd", "topology.pdb"} <= names
    assert {"tangent_correlations.csv", "tangent_correlations.png", "trajectory_thermal.dcd"} <= names
    assert ("still.png" in names) == of.rendering.available()
    summary = json.loads((folder / "summary.json").read_text())
    assert all(check["passed"] for check in summary["checks"] if check["kind"] == "exact")
    assert summary["terms"] == [
        "CustomAngleForce", "CustomBondForce", "CustomCompoundBondForce", "CustomExternalForce", "CustomTorsionForce",
    ]  # fmt: skip
    with (folder / "force_extension.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) >= 30
    frames = of.load(folder / "trajectory.dcd")
    steel = [row for row in rows if row["torsion"] == "harmonic" and float(row["shear_modulus_Pa"]) == 1e9]
    found = (frames.xyz[:, -1, 2] - frames.xyz[:, 0, 2]) * 1e-9
    np.testing.assert_allclose(found, [float(row["extension_m"]) for row in steel], rtol=1e-6)


def test_the_formula_at_any_force_has_the_small_load_stiffness() -> None:
    for shear in coil.SHEAR:
        on_axis = 1.5 * (
            1 / (1 / coil.end_stiffness(shear) - coil.CONTOUR * (coil.HEIGHT / coil.CONTOUR) ** 2 / coil.STRETCHING)
        )
        force = 1e-4 * on_axis * coil.HEIGHT
        longer = coil.free_helix_extension(shear, force) - coil.HEIGHT
        # the stretching of the wire adds to both
        softness = 1 / on_axis + coil.CONTOUR * (coil.HEIGHT / coil.CONTOUR) ** 2 / coil.STRETCHING
        assert longer / force == pytest.approx(softness, rel=2e-3)


def test_a_wrong_stiffness_is_seen() -> None:
    exact = coil.end_stiffness(1e9)
    found = coil.end_stiffness_found(1e9, 55, 2e-5 * exact)
    assert abs(found / exact - 1) < 0.01
    assert abs(found / coil.end_stiffness(1.05e9) - 1) > 0.01


def test_too_few_points_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["helix_force_extension", "--output", str(tmp_path / "out"), "--points", "3"]) == 2
    assert "`--points` must be at least 6, one a decade, but is 3" in capsys.readouterr().err


# --- the thermal helix --------------------------------------------------------------------------------------------


def test_a_thermal_helix_has_the_exact_tangent_correlations_and_sizes() -> None:
    run = thermal.sampled(500, 4)
    assert [check.name for check in thermal.checks(run) if not check.passed] == []
    assert 0 < run.found.errors[1:].max() < 0.05  # of correlations up to 0.7


def test_a_thermal_helix_of_other_torsion_fails(tmp_path: Path) -> None:
    run = thermal.sampled(500, 4, torsion=0.6 * thermal.TORSION)
    assert [check for check in thermal.checks(run) if not check.passed]
    thermal.write(tmp_path, run)
    frames = of.load(tmp_path / "trajectory_thermal.dcd")
    assert 100 < len(frames) <= thermal.FRAMES
    np.testing.assert_allclose(frames.xyz[0], run.positions[0].reshape(-1, 3), atol=1e-5)
    again = of.analysis.tangent_correlation(frames)  # its four chains from the topology
    np.testing.assert_allclose(again.values[:4], run.found.values[:4], atol=0.05)


@pytest.mark.slow
def test_a_long_run_of_a_thermal_helix_agrees_to_a_hundredth() -> None:
    run = thermal.sampled(8000, 5)
    assert run.found.errors[1:].max() < 0.01
    assert np.abs(thermal.deviations(run)).max() < thermal.SIGMAS
