"""Curves that go on: from any end, bit for bit, from the blocks of their checkpoint alone; and ends that are told."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import time
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import NM
from openmm import unit
from test_sampling import CORES, InProcess, filament

import openmm_filament as of
from openmm_filament import checkpoints, sampling
from openmm_filament.checkpoints import Checkpoint
from openmm_filament.progress import Progress
from systems.scene import OutputError, fresh_folder, is_interrupted, prepared_checkpoint

resource = pytest.importorskip("resource", reason="limits of POSIX")

PN = unit.piconewton
WARM = 298 * unit.kelvin
ROOT = Path(__file__).parent.parent
TORN = pytest.mark.filterwarnings("ignore:The checkpoint .* ends:UserWarning")
"""A run may end while it writes a record, and is told of it."""

POSIX = pytest.mark.skipif(sys.platform == "win32", reason="signals and limits of POSIX")


@pytest.fixture
def in_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without worker processes; blocks so short that a curve has dozens."""
    monkeypatch.setattr(sampling, "ProcessPoolExecutor", InProcess)
    monkeypatch.setattr(sampling, "_BLOCK_BEAD_STEPS", 2e4)


def sampled(folder: Path, name: str = "kept", **options: Any) -> Any:
    arguments: dict[str, Any] = {
        "chain": filament(6), "forces": [1.0, 8.0] * PN, "temperature": WARM, "relative_error": 0.04, "seed": 5,
        "checkpoint": folder / f"{name}.checkpoint", "trajectories": {0: folder / f"{name}.dcd"}, "processes": 1,
    }  # fmt: skip
    return of.force_extension(**{**arguments, **options})


def same(curve: Any, other: Any) -> None:
    for name in other:
        np.testing.assert_array_equal(curve[name], other[name], err_msg=name)
    assert curve.attrs == other.attrs


def same_files(folder: Path, name: str, other: str) -> None:
    """Trajectories that agree in every byte but for the time of day in the DCD's title."""
    one, two = ((folder / f"{n}.dcd").read_bytes() for n in (name, other))
    assert len(one) > 5_000
    title = slice(100, 264)  # two lines of 80 characters
    assert one[: title.start] == two[: title.start]
    assert one[title.stop :] == two[title.stop :]
    lines = [(folder / f"{n}.jsonl").read_text().splitlines() for n in (name, other)]
    assert lines[0][1:] == lines[1][1:]
    assert of.load(folder / f"{name}.dcd").n_frames == len(lines[0]) - 1


class Killed(BaseException):
    """An end that nothing in the package expects."""


def killed_after(monkeypatch: pytest.MonkeyPatch, blocks: int, *, torn: int | None = None) -> None:
    """End the run when so many more blocks are kept; with `torn`, after so many bytes of the next one."""
    left = [blocks]
    add = Checkpoint.add

    def dying(self: Checkpoint, *block: Any) -> None:
        if not left[0]:
            if torn is not None:
                before = self._end
                add(self, *block)
                os.ftruncate(self._file, before + torn)
            raise Killed
        left[0] -= 1
        add(self, *block)

    monkeypatch.setattr(Checkpoint, "add", dying)


@TORN
@pytest.mark.parametrize("dimension", [2, 3])
def test_a_run_killed_again_and_again_ends_as_one_that_was_not(
    in_process: None, dimension: int, tmp_path: Path
) -> None:
    whole = sampled(tmp_path, "whole", dimension=dimension, checkpoint=None)
    ends = 0
    while True:
        with pytest.MonkeyPatch.context() as patch:
            killed_after(patch, 3 + 4 * ends, torn=(None, 5, 500)[ends % 3])
            try:
                curve = sampled(tmp_path, dimension=dimension)
                break
            except Killed:
                ends += 1
                assert ends < 20
    assert ends >= 3
    same(curve, whole)
    same_files(tmp_path, "kept", "whole")


def test_no_finished_block_is_run_twice(in_process: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    seen: list[tuple[int, bytes | None]] = []
    real = sampling.run_block

    def run(block: Any) -> Any:
        seen.append((block.seed, block.checkpoint))
        return real(block)

    monkeypatch.setattr(sampling, "run_block", run)
    with monkeypatch.context() as patch:
        killed_after(patch, 20)
        with pytest.raises(Killed):
            sampled(tmp_path)
    lost = len(seen) - 20  # without worker processes, blocks run when they are handed in
    sampled(tmp_path)
    assert len(seen) - len(set(seen)) == lost
    begun = len(seen)
    reports: list[Progress] = []
    again = sampled(tmp_path, progress=reports.append)  # a finished one, which runs nothing
    assert len(seen) == begun
    assert [(report.fraction, report.finished) for report in reports] == [(1.0, 2)]
    assert again.finished.all()


def test_ctrl_c_keeps_the_checkpoint_too(in_process: None, tmp_path: Path) -> None:
    whole = sampled(tmp_path, "whole", checkpoint=None)
    count = [0]

    def progress(_: Progress) -> None:
        count[0] += 1
        if count[0] == 12:
            raise KeyboardInterrupt

    assert sampled(tmp_path, progress=progress).attrs["interrupted"] == 1
    same(sampled(tmp_path), whole)
    same_files(tmp_path, "kept", "whole")


def test_progress_never_falls_and_tells_of_planning(in_process: None, tmp_path: Path) -> None:
    reports: list[Progress] = []
    chain = of.WormlikeChain(300 * NM, 53 * NM, 1000 * PN)
    of.force_extension(chain, [1.0, 20.0] * PN, WARM, 0.06, processes=1, progress=reports.append)
    assert [(r.fraction, r.chosen) for r in reports[:3]] == [(0.0, 0), (0.0, 1), (0.0, 2)]
    fractions = [r.fraction for r in reports]
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1
    assert all(r.seconds_left >= 0 for r in reports[4:])


# Real ends ------------------------------------------------------------------------------------------------------------

SCRIPT = """
import sys
sys.path[:0] = [{tests!r}, {root!r}]
from pathlib import Path
from openmm_filament import sampling
from test_resume import InProcess, sampled
sampling._BLOCK_BEAD_STEPS = 2e4
if __name__ == "__main__":
    if {processes} == 0:
        sampling.ProcessPoolExecutor = InProcess
    sampled(Path({folder!r}), relative_error=0.03, processes=max({processes}, 1))
"""


def start(folder: Path, processes: int) -> subprocess.Popen[str]:
    """A curve in a process of its own, with worker processes or, for 0, without."""
    script = folder / "curve.py"
    script.write_text(SCRIPT.format(tests=str(ROOT / "tests"), root=str(ROOT), folder=str(folder), processes=processes))
    return subprocess.Popen(
        [sys.executable, "-W", "ignore", str(script)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def wait_for_size(path: Path, size: int, run: subprocess.Popen[str]) -> None:
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline and run.poll() is None:
        if path.exists() and path.stat().st_size >= size:
            return
        time.sleep(0.005)
    raise AssertionError(f"{path} did not come to {size} bytes: {run.communicate()[0] if run.poll() else 'too slow'}")


@POSIX
@TORN
def test_sigkill_at_three_moments_loses_nothing(in_process: None, tmp_path: Path) -> None:
    """Of the whole process, its workers follow it: in the first blocks, in the middle, and near the end."""
    whole = sampled(tmp_path, "whole", relative_error=0.03)
    kept, size = tmp_path / "kept.checkpoint", (tmp_path / "whole.checkpoint").stat().st_size
    for part, processes in ((0.02, 1), (0.4, min(CORES, 2)), (0.8, 0)):
        run = start(tmp_path, processes)
        wait_for_size(kept, int(part * size), run)
        run.kill()
        run.communicate()
        assert run.returncode == -signal.SIGKILL
    assert kept.stat().st_size < size
    same(sampled(tmp_path, relative_error=0.03), whole)
    same_files(tmp_path, "kept", "whole")


@POSIX
def test_a_limit_on_files_stops_with_the_checkpoint_intact(in_process: None, tmp_path: Path) -> None:
    """As a full disk does: here files may grow to 150 kB."""
    whole = sampled(tmp_path, "whole", relative_error=0.03)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (150_000, before[1]))
    try:
        with pytest.raises(
            OSError, match=r"its checkpoint .* cannot be written \(File too large\).* intact up to the last"
        ):
            sampled(tmp_path, relative_error=0.03)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert 100_000 < (tmp_path / "kept.checkpoint").stat().st_size <= 150_000
    same(sampled(tmp_path, relative_error=0.03), whole)


@pytest.fixture
def small_disk(tmp_path: Path) -> Any:
    """A file system of 200 kB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=200k", "tmpfs", str(folder)]
    try:
        mounted = subprocess.run(command, capture_output=True, check=False).returncode == 0
    except FileNotFoundError:
        mounted = False
    if not mounted:
        pytest.skip("only root may mount a small file system")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


@pytest.mark.parametrize("full", ["checkpoint", "trajectory"])
def test_a_full_disk_stops_with_the_checkpoint_intact(
    in_process: None, small_disk: Path, tmp_path: Path, full: str
) -> None:
    whole = sampled(tmp_path, "whole", relative_error=0.03, checkpoint=None)
    places = {"checkpoint": tmp_path / "kept.checkpoint", "trajectories": {0: tmp_path / "kept.dcd"}}
    on_disk = (
        {"checkpoint": small_disk / "kept.checkpoint"}
        if full == "checkpoint"
        else {"trajectories": {0: small_disk / "kept.dcd"}}
    )
    (small_disk / "ballast").write_bytes(b"x" * 185_000)
    with pytest.raises(OSError, match=f"its {full} .*disk/kept.* cannot be written .No space left.* intact") as caught:
        sampled(tmp_path, relative_error=0.03, **{**places, **on_disk})
    assert caught.value.errno == errno.ENOSPC
    with pytest.raises(OSError, match=r"No space left"):  # still full
        sampled(tmp_path, relative_error=0.03, **{**places, **on_disk})
    (small_disk / "ballast").unlink()
    subprocess.run(["mount", "-o", "remount,size=20m", str(small_disk)], check=True)
    same(sampled(tmp_path, relative_error=0.03, **{**places, **on_disk}), whole)


# Refused --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seed": 6}, r"another `seed` \(5, now 6\)\.$"),
        ({"forces": [1.0, 9.0] * PN}, r"another `forces` \(\[1\.0, 8\.0\], now \[1\.0, 9\.0\]\)\.$"),
        ({"temperature": 300 * unit.kelvin, "seed": 2}, r"another `temperature` .* and another `seed` \(5, now 2\)"),
        ({"relative_error": 0.07}, "another `relative_error`"),
        ({"chain": filament(6, alpha=10.5)}, "another `chain`"),
        ({"dimension": 2}, r"another `dimension` \(3, now 2\)"),
        ({"timestep": 0.1 * unit.picosecond}, r"another `timestep` \(None, now 0\.1\)"),
        ({"platform": "CPU"}, r"another `platform` \(Reference, now CPU\)"),
        ({"trajectories": None}, r"another `trajectories` \(\[0\], now \[\]\)"),
    ],
)
def test_other_arguments_are_refused_by_name(
    in_process: None, monkeypatch: pytest.MonkeyPatch, change: dict[str, Any], message: str, tmp_path: Path
) -> None:
    with monkeypatch.context() as patch:
        killed_after(patch, 2)
        with pytest.raises(Killed):
            sampled(tmp_path)
    before = (tmp_path / "kept.checkpoint").read_bytes()
    with pytest.raises(ValueError, match=f"`checkpoint` must be of a call with the same arguments, .*{message}"):
        sampled(tmp_path, **change)
    assert (tmp_path / "kept.checkpoint").read_bytes() == before


@pytest.mark.parametrize(
    ("name", "shown"), [("OpenMM", "OpenMM"), ("openmm_filament", "openmm_filament"), ("plan", "plan")]
)
def test_other_versions_are_refused(
    in_process: None, monkeypatch: pytest.MonkeyPatch, name: str, shown: str, tmp_path: Path
) -> None:
    real = sampling.fingerprint
    with monkeypatch.context() as patch:
        patch.setattr(sampling, "fingerprint", lambda *a, **k: {**real(*a, **k), name: "0.0"})
        killed_after(patch, 2)
        with pytest.raises(Killed):
            sampled(tmp_path)
    with pytest.raises(ValueError, match=rf"another `{shown}` \(0\.0, now "):
        sampled(tmp_path)


def test_files_that_are_no_checkpoints_are_left_alone(in_process: None, tmp_path: Path) -> None:
    notes = tmp_path / "notes.txt"
    notes.write_text("open questions")
    with pytest.raises(ValueError, match=r"`checkpoint` must name a checkpoint or a new file, but is .*notes\.txt"):
        sampled(tmp_path, checkpoint=notes)
    assert notes.read_text() == "open questions"
    with pytest.raises(FileNotFoundError, match="`checkpoint` must lie in a folder that exists"):
        sampled(tmp_path, checkpoint=tmp_path / "nowhere" / "a.checkpoint")
    with pytest.raises(IsADirectoryError, match="`checkpoint` must name a file"):
        sampled(tmp_path, checkpoint=tmp_path)
    (tmp_path / "foreign.dcd").write_text("another run's")
    with pytest.raises(FileExistsError, match="pass overwrite=True"):
        sampled(tmp_path, trajectories={0: tmp_path / "foreign.dcd"})
    assert sorted(f.name for f in tmp_path.iterdir()) == ["foreign.dcd", "notes.txt"]


def test_a_file_that_cannot_be_written_is_refused(
    in_process: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def refused(*_: Any) -> int:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(checkpoints.os, "open", refused)
    with pytest.raises(PermissionError, match=r"name a file that can be written, .* cannot \(Permission denied\)"):
        sampled(tmp_path)


@POSIX
def test_two_processes_at_one_checkpoint_are_kept_apart(in_process: None, tmp_path: Path) -> None:
    run = start(tmp_path, 0)
    wait_for_size(tmp_path / "kept.checkpoint", 1, run)
    with pytest.raises(BlockingIOError, match="`checkpoint` must not be in use, but another process writes"):
        sampled(tmp_path, relative_error=0.03)
    run.kill()
    run.communicate()


def test_a_damaged_checkpoint_is_told_of_and_sampled_again(
    in_process: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    whole = sampled(tmp_path, "whole", checkpoint=None)
    sampled(tmp_path)
    path = tmp_path / "kept.checkpoint"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    with pytest.warns(UserWarning, match=r"kept.checkpoint is damaged at byte \d+: what follows is sampled again"):
        curve = sampled(tmp_path)
    same(curve, whole)
    same_files(tmp_path, "kept", "whole")


def test_a_file_cut_anywhere_goes_on(in_process: None, tmp_path: Path) -> None:
    """In its first line, in its arguments, and in a record's head."""
    whole = sampled(tmp_path, "whole", relative_error=0.2, checkpoint=None)
    sampled(tmp_path, relative_error=0.2)
    path = tmp_path / "kept.checkpoint"
    content = path.read_bytes()
    head = content.index(b"BLCK")
    for size in (0, 10, 100, head, head + 6):
        path.write_bytes(content[:size])
        with (
            nullcontext()
            if size in (0, head)
            else pytest.warns(UserWarning, match=rf"checkpoint ends .*{min(size, head)}")
        ):
            same(sampled(tmp_path, relative_error=0.2, overwrite=True), whole)
        assert path.read_bytes()[:head] == content[:head]


# The command ----------------------------------------------------------------------------------------------------------


def dna(output: Path, *more: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "systems", "dna_force_extension", "--quick", "--output", str(output), *more]
    return subprocess.Popen(command, cwd=ROOT, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)


@POSIX
@pytest.mark.slow
def test_the_command_goes_on_after_sigkill(tmp_path: Path) -> None:
    """Twice, and once after SIGINT: the results are those of a run that was let be, and the checkpoint is gone."""
    run = dna(tmp_path / "whole")
    said, _ = run.communicate(timeout=300)
    assert run.returncode == 0, said
    kept, more = tmp_path / "kept.checkpoint", ()
    for size, by in ((1, signal.SIGKILL), (30_000, signal.SIGKILL), (60_000, signal.SIGINT)):
        run = dna(tmp_path / "kept", *more)
        wait_for_size(kept, size, run)
        run.send_signal(by)
        run.communicate(timeout=60)
        assert run.returncode == (130 if by == signal.SIGINT else -by)
        more = ("--resume",)
    run = dna(tmp_path / "kept", "--resume")
    said, _ = run.communicate(timeout=300)
    assert run.returncode == 0, said
    assert sorted(f.name for f in tmp_path.iterdir()) == ["kept", "whole"]
    one, two = tmp_path / "kept", tmp_path / "whole"
    assert (one / "force_extension.csv").read_bytes() == (two / "force_extension.csv").read_bytes()
    assert (one / "force_extension.nc").read_bytes() == (two / "force_extension.nc").read_bytes()
    assert (one / "trajectory.jsonl").read_bytes() == (two / "trajectory.jsonl").read_bytes()
    assert (one / "trajectory.dcd").read_bytes()[264:] == (two / "trajectory.dcd").read_bytes()[264:]


def test_a_command_neither_loses_a_checkpoint_nor_makes_one_up(tmp_path: Path) -> None:
    output = tmp_path / "out"
    with pytest.raises(OutputError, match=r"`--resume` must find the checkpoint .*, but there is no .*out\.checkpoint"):
        prepared_checkpoint(output, resume=True, overwrite=False)
    path = tmp_path / "out.checkpoint"
    assert prepared_checkpoint(output, resume=False, overwrite=False) == path
    path.write_text("days of work")
    with pytest.raises(OutputError, match="pass --resume to go on, or --overwrite to begin anew"):
        prepared_checkpoint(output, resume=False, overwrite=False)
    for overwrite in (False, True):
        assert prepared_checkpoint(output, resume=True, overwrite=overwrite) == path
        assert path.exists()
    output.mkdir()
    (output / "summary.json").write_text('{"findings": ["All is well."]}')
    assert not is_interrupted(output)
    with (
        pytest.raises(OutputError, match="pass --overwrite to replace them, or --resume to go on with the run"),
        fresh_folder(output, overwrite=False),
    ):
        raise AssertionError("something ran")
    (output / "summary.json").write_text('{"findings": ["Interrupted: 3 of 12 forces have an estimate."]}')
    assert is_interrupted(output)
    assert prepared_checkpoint(output, resume=False, overwrite=True) == path
    assert not path.exists()
