"""The command line of the systems, their output folders, their checks, and what a run leaves behind."""

from __future__ import annotations

import csv
import json
import math
import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mdtraj
import numpy as np
import pytest
import tolerances as tol
from conftest import KJ, NM
from openmm import unit

import openmm_filament as of
from openmm_filament import stretching
from systems import __main__ as command
from systems import scene
from systems.scene import Check, OutputError, Summary, fresh_folder

ROOT = Path(__file__).parents[1]


def check(error: float = 0.5, tolerance: float = 1.0, kind: Any = "exact") -> Check:
    return Check("a number", kind, 1.5, 1.0, error, tolerance)


def summary(checks: list[Check]) -> Summary:
    terms = (stretching.Harmonic(1 * KJ / NM**2),)
    model = of.build(of.Filament(of.shapes.line(3, 1 * NM), 1 * unit.dalton, terms))
    return Summary("fake", [model, model], "Reference", 1.23456, {"length_nm": 3.0}, checks, ["One thing."])


class Fake:
    """A system that writes one file and a summary, or fails after the first."""

    def __init__(
        self, *, checks: list[Check] | None = None, error: BaseException | None = None, text: str = "new"
    ) -> None:
        self.checks, self.error, self.text = checks or [check()], error, text
        self.calls: list[dict[str, Any]] = []

    def options(self, parser: Any) -> Any:
        parser.add_argument("--more", type=int, default=0)
        return parser

    def run(self, folder: Path, *, quick: bool, seed: int, options: Any) -> int:
        self.calls.append({"quick": quick, "seed": seed, "more": options.more})
        (folder / "table.csv").write_text(self.text)
        if self.error is not None:
            raise self.error
        result = summary(self.checks)
        result.write(folder)
        return 0 if result.passed else 1


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Registers a system named "fake"."""

    def register(**options: Any) -> Fake:
        system = Fake(**options)
        monkeypatch.setitem(command.SYSTEMS, "fake", "does nothing")
        monkeypatch.setattr(command, "import_module", lambda name: system if name == "systems.fake" else None)
        return system

    return register


def contents(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in folder.iterdir()}


def exit_code(*arguments: Any) -> int:
    """Of the command line in this process, whether it returns or exits."""
    try:
        return command.main([str(a) for a in arguments])
    except SystemExit as caught:
        return int(caught.code or 0)


# The command line ---------------------------------------------------------------------------------------------------


def test_the_systems_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code() == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list(command.SYSTEMS)
    assert all(len(line.split()) > 3 for line in lines)


def test_the_module_runs_from_the_shell() -> None:
    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "systems", *arguments], cwd=ROOT, capture_output=True, text=True, check=False
        )

    listed, unknown = run(), run("bogus", "--output", "anywhere")
    assert (listed.returncode, unknown.returncode) == (0, 2)
    assert "dna_force_extension" in listed.stdout
    assert "dna_force_extension" in unknown.stderr
    assert "Traceback" not in unknown.stderr


def test_an_unknown_name_is_refused_with_the_names_there_are(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert exit_code("bogus", "--output", tmp_path / "out") == 2
    said = capsys.readouterr().err
    assert "bogus" in said
    assert all(name in said for name in command.SYSTEMS)
    assert not (tmp_path / "out").exists()


def test_a_missing_output_and_unknown_options_are_refused(
    fake: Any, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    fake()
    assert exit_code("fake") == 2
    assert "`--output` must name a folder" in capsys.readouterr().err
    assert exit_code("fake", "--output", tmp_path / "out", "--bogus") == 2
    assert not (tmp_path / "out").exists()


def test_options_reach_the_system(fake: Any, tmp_path: Path) -> None:
    system = fake()
    assert exit_code("fake", "--output", tmp_path / "a") == 0
    assert exit_code("fake", "--output", tmp_path / "b", "--quick", "--seed", "7", "--more", "3") == 0
    assert system.calls == [{"quick": False, "seed": 1, "more": 0}, {"quick": True, "seed": 7, "more": 3}]


@pytest.mark.parametrize(
    ("checks", "code"),
    [
        ([check()], 0),
        ([check(), check(error=2.0)], 1),
        ([check(error=math.nan)], 1),
        ([check(), check(error=2.0, kind="claim"), check(error=2.0, kind="thesis")], 0),
    ],
)
def test_a_failing_exact_check_alone_makes_the_run_fail(
    fake: Any, checks: list[Check], code: int, tmp_path: Path
) -> None:
    fake(checks=checks)
    assert exit_code("fake", "--output", tmp_path / "out") == code
    written = json.loads((tmp_path / "out" / "summary.json").read_text())  # kept either way
    assert [c["passed"] for c in written["checks"]] == [c.passed for c in checks]


def test_bad_values_are_told_without_a_traceback(fake: Any, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    fake(error=ValueError("Argument `x` must be positive, but is -1."))
    assert exit_code("fake", "--output", tmp_path / "out") == 2
    assert "Argument `x` must be positive" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


# Output folders -----------------------------------------------------------------------------------------------------


def test_results_appear_all_at_once(fake: Any, tmp_path: Path) -> None:
    fake()
    assert exit_code("fake", "--output", tmp_path / "deep" / "out") == 0
    assert set(contents(tmp_path / "deep" / "out")) == {"table.csv", "summary.json"}
    assert [f.name for f in (tmp_path / "deep").iterdir()] == ["out"]


def test_an_empty_folder_is_taken(fake: Any, tmp_path: Path) -> None:
    fake()
    (tmp_path / "out").mkdir()
    assert exit_code("fake", "--output", tmp_path / "out") == 0
    assert set(contents(tmp_path / "out")) == {"table.csv", "summary.json"}


def test_results_are_not_overwritten_unasked(fake: Any, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    fake(text="old")
    assert exit_code("fake", "--output", tmp_path / "out") == 0
    before = contents(tmp_path / "out")
    system = fake(text="new")
    assert exit_code("fake", "--output", tmp_path / "out") == 2
    assert "pass --overwrite" in capsys.readouterr().err
    assert contents(tmp_path / "out") == before
    assert system.calls == []
    assert exit_code("fake", "--output", tmp_path / "out", "--overwrite") == 0
    assert contents(tmp_path / "out")["table.csv"] == b"new"
    assert [f.name for f in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize("error", [RuntimeError("lost"), KeyboardInterrupt(), ValueError("bad")])
def test_old_results_stay_until_the_new_ones_are_complete(fake: Any, error: BaseException, tmp_path: Path) -> None:
    fake(text="old")
    exit_code("fake", "--output", tmp_path / "out")
    before = contents(tmp_path / "out")
    fake(text="new", error=error)
    with suppress(RuntimeError, KeyboardInterrupt):
        assert exit_code("fake", "--output", tmp_path / "out", "--overwrite") != 0
    assert contents(tmp_path / "out") == before
    assert [f.name for f in tmp_path.iterdir()] == ["out"]


def test_old_results_come_back_where_the_exchange_fails(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "summary.json").write_text("old")
    rename = Path.rename

    def fails(self: Path, target: Path) -> Path:
        if target == out and "-old-" not in self.parent.name:
            raise OSError("no space")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", fails)
    with pytest.raises(OSError, match="no space"), fresh_folder(out, overwrite=True) as draft:
        (draft.folder / "summary.json").write_text("new")
        draft.settle(complete=True)
    monkeypatch.undo()
    assert (out / "summary.json").read_text() == "old"
    assert [f.name for f in tmp_path.iterdir()] == ["out"]


def test_complete_results_replace_old_ones_and_keep_what_is_no_result(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "summary.json").write_text("old")
    (out / "old.csv").write_text("old")
    (out / "notes.txt").write_text("mine")
    with fresh_folder(out, overwrite=True) as draft:
        (draft.folder / "summary.json").write_text("new")
        assert (out / "summary.json").read_text() == "old"
        assert draft.settle(complete=True) == out
    assert {f.name: f.read_text() for f in out.iterdir()} == {"summary.json": "new", "notes.txt": "mine"}
    assert [f.name for f in tmp_path.iterdir()] == ["out"]


def test_incomplete_results_stand_beside_old_ones(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "summary.json").write_text("old")
    with fresh_folder(out, overwrite=True) as draft:
        (draft.folder / "summary.json").write_text("new")
        place = draft.settle(complete=False)
    assert place == tmp_path / "out-incomplete"
    assert (out / "summary.json").read_text() == "old"
    assert (place / "summary.json").read_text() == "new"


def test_drafts_of_killed_runs_are_removed_and_nothing_else(tmp_path: Path) -> None:
    """Those of this output and machine whose process is gone."""
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    host, dead, alive = socket.gethostname(), gone.pid, os.getpid()
    stale = [f".out-draft-{host}-{dead}-abcd_123", f".out-draft-{host}-{dead}-00000000"]
    kept = [
        f".out-draft-{host}-{alive}-abcd_123", f".out-draft-elsewhere-{dead}-abcd_123", f".other-draft-{host}-{dead}-abcd_123",
        f".out-draft-{host}-{dead}-abc", f".out-draft-{host}-{dead}-abcd_123-mine", ".out-abcd_123", ".out-old-abcd_123",
    ]  # fmt: skip
    for name in (*stale, *kept):
        (tmp_path / name).mkdir()
        (tmp_path / name / "table.csv").write_text("x")
    (tmp_path / f".out-draft-{host}-{dead}-zzzzzzzz").write_text("a file")
    (tmp_path / f".out-draft-{host}-{dead}-yyyyyyyy").symlink_to(tmp_path / kept[-1])
    with fresh_folder(tmp_path / "out", overwrite=False) as draft:
        there = {entry.name for entry in tmp_path.iterdir()}
        assert draft.folder.name in there
        assert not there & set(stale)
    left = {entry.name for entry in tmp_path.iterdir()}
    assert left == {*kept, f".out-draft-{host}-{dead}-zzzzzzzz", f".out-draft-{host}-{dead}-yyyyyyyy"}
    assert (tmp_path / kept[-1] / "table.csv").exists()


@pytest.mark.skipif(sys.platform == "win32", reason="sends signals")
def test_sigterm_ends_a_run_as_ctrl_c_does_and_a_killed_one_is_tidied_up(tmp_path: Path) -> None:
    """With its workers, which are gone soon after; what is done stands in the folder."""
    output = tmp_path / "out"

    def begin(*more: str) -> tuple[subprocess.Popen[str], list[int]]:
        arguments = [
            "dna_force_extension",
            "--output",
            str(output),
            "--relative-error",
            "0.004",
            "--processes",
            "1",
            *more,
        ]
        run = subprocess.Popen(
            [sys.executable, "-m", "systems", *arguments],
            cwd=ROOT,
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )
        children = Path(f"/proc/{run.pid}/task/{run.pid}/children")
        deadline = time.monotonic() + 30
        while time.monotonic() < deadline and len(children.read_text().split()) < 2:  # resource tracker and worker
            time.sleep(0.1)
        time.sleep(3)
        return run, [int(child) for child in children.read_text().split()]

    def drafts() -> list[Path]:
        return list(tmp_path.glob(".out-draft-*"))

    def end(run: subprocess.Popen[str], by: int, workers: list[int]) -> int:
        run.send_signal(by)
        run.communicate(timeout=30)
        deadline = time.monotonic() + 20
        while time.monotonic() < deadline and any(scene._is_running(worker) for worker in workers):
            time.sleep(0.1)
        assert not any(scene._is_running(worker) for worker in workers)
        return run.returncode

    run, workers = begin()
    assert len(workers) >= 2
    assert end(run, signal.SIGKILL, workers) == -signal.SIGKILL
    assert len(drafts()) == 1
    stale = drafts()[0]
    run, workers = begin(*["--resume"] * (tmp_path / "out.checkpoint").exists())
    assert not stale.exists()
    assert end(run, signal.SIGTERM, workers) == 130
    assert not drafts()
    assert "Interrupted" in json.loads((output / "summary.json").read_text())["findings"][0]


def test_a_folder_of_something_else_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    with (
        pytest.raises(OutputError, match=r"has no summary\.json: it is left alone"),
        fresh_folder(tmp_path, overwrite=True),
    ):
        raise AssertionError("something ran")
    assert (tmp_path / "thesis.tex").read_text() == "years of work"


def test_a_file_is_no_folder(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("mine")
    taken = fresh_folder(tmp_path / "out", overwrite=True)
    with pytest.raises(OutputError, match=r"`--output` must be a folder, but .* is a file"), taken:
        raise AssertionError("something ran")
    with pytest.raises(OutputError, match="can be written"), fresh_folder(tmp_path / "out" / "in", overwrite=False):
        raise AssertionError("something ran")


def test_a_folder_that_cannot_be_written_is_refused(
    fake: Any, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    locked = tmp_path / "locked"
    locked.mkdir(mode=0o500)
    if os.access(locked, os.W_OK):
        pytest.skip("this user may write anywhere")
    fake()
    assert exit_code("fake", "--output", locked / "out") == 2
    assert "must be a folder that can be written" in capsys.readouterr().err


def test_a_refusal_of_the_file_system_is_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def refused(*_: Any, **__: Any) -> str:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(scene.tempfile, "mkdtemp", refused)
    refusing = fresh_folder(tmp_path / "out", overwrite=False)
    with pytest.raises(OutputError, match=r"can be written, but .* Permission denied"), refusing:
        raise AssertionError("something ran")


# Checks and summaries -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("error", "tolerance", "passed"),
    [
        (0.5, 1.0, True),
        (1.0, 1.0, True),
        (1.1, 1.0, False),
        (math.nan, 1.0, False),
        (0.5, math.nan, False),
        (math.inf, 1.0, False),
    ],
)
def test_a_check_passes_within_its_tolerance_alone(error: float, tolerance: float, passed: bool) -> None:
    assert check(error, tolerance).passed is passed


def test_a_summary_says_what_the_systems_hold(tmp_path: Path) -> None:
    summary([check(), check(error=3.0, kind="claim")]).write(tmp_path)
    written = json.loads((tmp_path / "summary.json").read_text())
    assert list(written) == ["system", "terms", "platform", "wall_seconds", "filament", "checks", "findings"]
    assert written["terms"] == ["CustomBondForce"]
    assert written["checks"][1] == {
        "name": "a number", "kind": "claim", "value": 1.5, "expected": 1.0, "error": 3.0, "tolerance": 1.0, "passed": False,
    }  # fmt: skip


def test_a_summary_with_nan_is_still_json(tmp_path: Path) -> None:
    """`NaN` is no JSON: other readers than Python's refuse the whole file."""
    summary([check(error=math.nan)]).write(tmp_path)

    def refuse(name: str) -> float:
        raise ValueError(f"{name} is not JSON")

    json.loads((tmp_path / "summary.json").read_text(), parse_constant=refuse)


# The DNA ------------------------------------------------------------------------------------------------------------


def test_the_dna_is_the_one_that_was_asked_for() -> None:
    from systems.dna_force_extension import curve as dna

    assert [(f"{f:.3g}") for f in (dna.FORCES[0], dna.FORCES[-1])] == ["0.05", "50"]
    assert len(dna.FORCES) == 12
    assert abs(dna.KT - 4.114) < 1e-3
    chain = dna.chain()
    assert chain.contour_length.value_in_unit(unit.micrometer) == pytest.approx(1)
    assert (dna.wanted_errors(0.02, quick=True) == 0.02).all()
    assert (dna.wanted_errors(None, quick=False) <= dna.wanted_errors(None, quick=True)).all()


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_the_dna_runs_from_end_to_end(tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = subprocess.run(
        [sys.executable, "-m", "systems", "dna_force_extension", "--output", str(out), "--quick"],
        cwd=ROOT, capture_output=True, text=True, check=False, timeout=400,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    files = {file.name for file in out.iterdir()}
    assert {"summary.json", "force_extension.csv", "topology.pdb", "trajectory.dcd", "trajectory.jsonl"} <= files
    assert any(name.endswith(".png") for name in files)
    written = json.loads((out / "summary.json").read_text())
    assert set(written) == {"system", "terms", "platform", "wall_seconds", "filament", "checks", "findings"}
    assert written["system"] == "dna_force_extension"
    assert written["terms"] == ["CustomAngleForce", "CustomBondForce", "CustomExternalForce"]
    assert written["platform"] == "Reference"
    assert {"bending_form", "temperature_K"} <= set(written["filament"])
    assert written["checks"]
    for one in written["checks"]:
        assert set(one) == {"name", "kind", "value", "expected", "error", "tolerance", "passed"}
        assert one["kind"] in {"exact", "thesis", "claim"}
        assert one["passed"] == (one["error"] <= one["tolerance"])
    assert all(isinstance(line, str) and line.endswith(".") for line in written["findings"])
    with (out / "force_extension.csv").open() as table:
        rows = [SimpleNamespace(**{k: float(v) for k, v in row.items()}) for row in csv.DictReader(table)]
    assert len(rows) == 12
    z = []
    for row in rows:
        exact = of.wlc.extension_discrete(
            row.force_pN, segments=int(row.segments), bond_length=row.bond_length_nm, bending=row.bending_kJ_per_mol / 0.602214076,
            stretching=row.stretching_kJ_per_mol_nm2 / 0.602214076, kT=298 * of.units.BOLTZMANN / 0.602214076,
        )  # fmt: skip
        z.append((row.extension_nm - exact) / row.extension_error_nm)
        assert row.effective_samples > 20
    assert np.abs(z).max() <= tol.SIGMAS
    frames = mdtraj.load_dcd(str(out / "trajectory.dcd"), top=str(out / "topology.pdb"))
    assert frames.n_frames > 10
    assert np.isfinite(of.load(out / "trajectory.dcd").xyz).all()
