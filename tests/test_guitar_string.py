"""The guitar string: its quick run, checks that can fail, and what it refuses."""

from __future__ import annotations

import json
import math
from argparse import Namespace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import openmm_filament as of
from systems import __main__ as command
from systems import guitar_string, stage, strings
from systems.guitar_string import hard, soft


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> tuple[int, Path]:
    folder = tmp_path_factory.mktemp("string") / "out"
    return command.main(["guitar_string", "--output", str(folder), "--quick"]), folder


@pytest.mark.slow
def test_the_quick_run_passes_its_exact_checks_and_writes_its_files(results: tuple[int, Path]) -> None:
    code, folder = results
    written = {file.name for file in folder.iterdir()}
    wanted = {"summary.json", "harmonics.csv", "hard_pluck.csv", "guitar_string.wav"}
    wanted |= {"topology.pdb", "trajectory.dcd", "trajectory.jsonl"}
    wanted |= {f"{name}.png" for name in ("shapes", "spectra", "harmonics", "decay", "hard_pluck")}
    assert code == 0
    assert wanted <= written
    summary = json.loads((folder / "summary.json").read_text())
    bends = {"CustomAngleForce", "CustomCompoundBondForce"}  # the second, by arctangent, where energy is to stay
    assert set(summary["terms"]) == {*bends, "CustomBondForce", "CustomExternalForce"}
    assert {check["kind"] for check in summary["checks"]} == {"exact", "thesis", "claim"}
    claim = next(check for check in summary["checks"] if check["kind"] == "thesis")
    assert not claim["passed"]
    assert claim["value"] == pytest.approx(10.27, abs=0.02)
    assert of.sound.strongest_line(folder / "guitar_string.wav") == pytest.approx(80.0, abs=0.05)


@pytest.mark.slow
def test_a_tension_one_per_cent_off_would_not_pass(results: tuple[int, Path]) -> None:
    rows = np.genfromtxt(results[1] / "harmonics.csv", delimiter=",", names=True)
    n = np.arange(1, soft.HARMONICS)
    seen = rows["frequency_Hz_bead10"][: len(n)]
    for tension, passes in ((strings.TENSION, True), (1.01 * strings.TENSION, False)):
        exact = strings.beats(strings.discrete_law(n, soft.SEGMENTS, tension), strings.DAMPING).frequencies
        assert bool(np.abs(seen / exact - 1).max() < 1e-4) is passes


def test_the_discrete_law_is_that_of_the_model_and_tends_to_the_stiff_string() -> None:
    n = np.arange(1, 6)
    found = soft.transverse(strings.string(40))[:5]
    np.testing.assert_allclose(found, strings.discrete_law(n, 40), rtol=1e-9)
    off = [np.abs(strings.discrete_law(n, k) / strings.stiff_law(n) - 1).max() for k in (50, 100, 200)]
    assert off[0] / off[1] == pytest.approx(4, rel=0.02)
    assert off[1] / off[2] == pytest.approx(4, rel=0.02)


def test_the_lines_of_the_time_steps_are_the_roots_of_one_step() -> None:
    frequency, gamma, dt = 500.0, 40.0, 2e-4
    step = np.array([[1 - gamma * dt, -((2 * np.pi * frequency) ** 2) * dt]])
    matrix = np.vstack([step, [0, 1] + dt * step[0]])  # (v, x) by Euler-Cromer
    root = np.linalg.eigvals(matrix)[0]
    line = strings.beats(np.array([frequency]), gamma, dt)
    assert abs(np.angle(root)) / (2 * np.pi * dt) == pytest.approx(line.frequencies[0], rel=1e-12)
    assert -np.log(abs(root)) / dt == pytest.approx(line.decay_rates[0], rel=1e-12)
    fine = strings.beats(np.array([frequency]), gamma, 1e-6)
    assert fine.frequencies[0] == pytest.approx(strings.beats(np.array([frequency]), gamma).frequencies[0], rel=2e-5)


def test_beads_damped_alike_move_as_by_euler_cromer() -> None:
    model = strings.string(40, [strings.Pluck(10, 0.01)])
    frames = []
    for alike in (False, True):
        context = strings.start(model, 12_000, 4, alike=alike)
        frames.append(of.record(model, context, 240, 4, observe=lambda x: x[:, 0]).values)
    largest = np.abs(frames[0]).max()
    assert np.abs(frames[1] - frames[0]).max() < 2e-3 * largest  # the force is 3e-5 less over 20 ms of all modes
    assert np.abs(frames[1] - frames[0]).max() > 0


def test_tension_is_told_from_the_lengths_of_the_bonds() -> None:
    rest = np.zeros((1, hard.SEGMENTS + 1, 3))
    rest[0, :, 2] = np.linspace(0, strings.LENGTH, hard.SEGMENTS + 1)
    np.testing.assert_allclose(hard.tensions(rest), strings.TENSION, rtol=1e-6)
    strain = 1e-4
    stretched = strings.TENSION + strain * strings.YOUNG * np.pi * strings.RADIUS**2
    np.testing.assert_allclose(hard.tensions(rest * (1 + strain)), stretched, rtol=1e-6)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: strings.string(20, [strings.Pluck(0, 0.01)]), "must not pluck a held bead"),
        (lambda: strings.string(20, [strings.Pluck(21, 0.01)]), "beads"),
        (lambda: strings.string(20, tension=-1.0), "tension"),
        (lambda: strings.start(strings.string(20), 1000, 1), "stability limit"),
        (lambda: strings.start(strings.string(20, damping=1e6), 50_000, 1), "damping"),
    ],
)
def test_bad_strings_are_refused(make: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()


def test_a_recording_too_short_for_its_lines_is_refused_before_it_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stage, "context", lambda *_: pytest.fail("it ran"))
    for seconds in (0.05, math.nan, math.inf):
        with pytest.raises(ValueError, match=f"`--seconds` must be finite and at least 0.2, .* but is {seconds:g}"):
            guitar_string.run(tmp_path, quick=True, seed=1, options=Namespace(seconds=seconds))
