"""The weighted string: its quick run, its exact modes by another route, and what it refuses."""

from __future__ import annotations

import csv
import json
import math
from argparse import Namespace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

from systems import __main__ as command
from systems import strings, weighted_string
from systems.weighted_string import chain


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> tuple[int, Path]:
    folder = tmp_path_factory.mktemp("string") / "out"
    return command.main(["weighted_string", "--output", str(folder), "--quick"]), folder


@pytest.mark.slow
def test_the_quick_run_passes_its_exact_checks_and_writes_its_files(results: tuple[int, Path]) -> None:
    code, folder = results
    written = {file.name for file in folder.iterdir()}
    wanted = {"summary.json", "lines.csv", "spectra.png", "decay.png", "shapes.png", "topology.pdb", "trajectory.dcd"}
    assert code == 0
    assert wanted | {f"weighted_string_{name}.wav" for name in "abc"} <= written
    summary = json.loads((folder / "summary.json").read_text())
    assert set(summary["terms"]) == {
        "CustomAngleForce",
        "CustomBondForce",
        "CustomCompoundBondForce",
        "CustomExternalForce",
    }
    claims = [check for check in summary["checks"] if check["kind"] == "claim"]
    assert [check["passed"] for check in claims] == [True]
    assert claims[0]["value"] > 3


@pytest.mark.slow
def test_a_tension_one_per_cent_off_would_not_pass(results: tuple[int, Path]) -> None:
    with (results[1] / "lines.csv").open() as lines:
        rows = [row for row in csv.DictReader(lines) if row["case"] == "b"]
    seen = np.array([float(row["frequency_Hz"]) for row in rows])
    for tension, passes in ((strings.TENSION, True), (1.01 * strings.TENSION, False)):
        exact = chain.exact(chain.CASES[1], 30, 1 / 48_000, tension).stepped[: len(seen)]
        assert bool(np.abs(seen / exact - 1).max() < 5e-5) is passes


def test_without_bending_the_modes_are_those_of_a_loaded_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    # one mass at the middle of a string: the odd modes obey 2 T k cot(k L/2) = M omega^2
    monkeypatch.setattr(strings, "BENDING", 0.0)
    speed, mass = math.sqrt(strings.TENSION / strings.DENSITY), chain.HEAVY_MASS

    def balance(omega: float) -> float:
        k = omega / speed
        return 2 * strings.TENSION * k * math.cos(k * strings.LENGTH / 2) - mass * omega**2 * math.sin(
            k * strings.LENGTH / 2
        )

    first = brentq(balance, 1.0, math.pi * speed / strings.LENGTH) / (2 * math.pi)
    off = [chain.exact(chain.CASES[0], k, 1e-6).undamped[0] / first - 1 for k in (60, 120, 240)]
    assert abs(off[2]) < 2e-4
    assert off[0] / off[1] == pytest.approx(4, rel=0.05)
    assert off[1] / off[2] == pytest.approx(4, rel=0.05)


def test_even_harmonics_stay_and_odd_ones_fall_with_one_heavy_bead_at_the_middle() -> None:
    found = chain.exact(chain.CASES[0], 60, 1e-6).undamped[:10]
    plain = strings.discrete_law(np.arange(1, 11), 60)
    np.testing.assert_allclose(found[1::2], plain[1::2], rtol=1e-10)
    assert (found[::2] < 0.97 * plain[::2]).all()


def test_a_rate_common_to_all_beads_damps_every_mode_alike() -> None:
    modes = chain.exact(chain.CASES[1], 30, 1e-5)
    np.testing.assert_allclose(modes.decay_rates, strings.DAMPING / 2, rtol=1e-6)
    felt = modes.undamped * math.sqrt(1 - strings.DAMPING * 1e-5 / 2)  # see `stage.alike`
    expected = strings.beats(felt, strings.DAMPING, 1e-5)
    np.testing.assert_allclose(modes.stepped, expected.frequencies, rtol=1e-9)
    np.testing.assert_allclose(modes.stepped_rates, expected.decay_rates, rtol=1e-6)


def test_segments_without_beads_at_the_places_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="`--segments` must be a multiple of 30, but is 201"):
        weighted_string.run(tmp_path, quick=True, seed=1, options=Namespace(segments=201))
    with pytest.raises(ValueError, match="must put a bead at each of 1/2, but is 201"):
        chain.CASES[0].masses(201)
