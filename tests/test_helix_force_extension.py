"""The system helix_force_extension: its quick run, its formulas against one another, and what it refuses."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

import openmm_filament as of
from systems import __main__ as command
from systems.helix_force_extension import coil


@pytest.mark.slow
def test_the_quick_run_passes_and_writes_its_files(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    assert command.main(["helix_force_extension", "--output", str(folder), "--quick"]) == 0
    names = {path.name for path in folder.iterdir()}
    assert {"summary.json", "force_extension.csv", "force_extension.png", "trajectory.dcd", "topology.pdb"} <= names
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
