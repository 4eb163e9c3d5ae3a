"""What every system hands to the runner: its results on disk, its checks, and what it found."""

from __future__ import annotations

import json
import math
import os
import re
import shutil
import socket
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from openmm_filament import Model

__all__ = [
    "Check",
    "Draft",
    "OutputError",
    "Summary",
    "checkpoint_of",
    "fresh_folder",
    "is_interrupted",
    "prepared_checkpoint",
    "what_goes_on",
]


_RESULTS = frozenset({".json", ".csv", ".nc", ".png", ".pdb", ".dcd", ".jsonl", ".wav", ".mp4", ".gif"})
"""Suffixes of the files that systems write, which new results replace."""


_DRAFT = "draft"
"""Word in the names of drafts, before the machine and the process that write them."""


class OutputError(ValueError):
    """An output folder that cannot be used."""


@dataclass(frozen=True)
class Check:
    """A number that was computed, held against the one that is expected.

    `kind` is "exact" for an exact answer (a failure makes the run fail), "thesis" for a figure of the thesis and "claim"
    for one of its statements (a failure is a finding). `unit` is that of `value` and `expected`, empty for pure numbers;
    `error` is relative or absolute, as the tolerance is meant.
    """

    name: str
    kind: Literal["exact", "thesis", "claim"]
    value: float
    expected: float
    error: float
    tolerance: float
    unit: str = ""

    @property
    def passed(self) -> bool:
        """Whether the error is within the tolerance; a NaN is not."""
        return bool(self.error <= self.tolerance)


@dataclass(frozen=True)
class Summary:
    """The contents of `summary.json`; see `write`."""

    system: str
    models: Sequence[Model]
    platform: str
    wall_seconds: float
    filament: dict[str, Any]
    checks: Sequence[Check]
    findings: Sequence[str] = field(default_factory=tuple)

    @property
    def passed(self) -> bool:
        """Whether every exact check passed."""
        return all(check.passed for check in self.checks if check.kind == "exact")

    def write(self, folder: Path) -> None:
        """Write `summary.json`; "terms" are the OpenMM force classes that the Systems were found to hold."""
        terms = {type(force).__name__ for model in self.models for force in model.system.getForces()}
        content = {
            "system": self.system,
            "terms": sorted(terms),
            "platform": self.platform,
            "wall_seconds": round(self.wall_seconds, 3),
            "filament": self.filament,
            "checks": [_entry(check) for check in self.checks],
            "findings": list(self.findings),
        }
        (folder / "summary.json").write_text(json.dumps(_without_nan(content), indent=2, allow_nan=False) + "\n")


def _entry(check: Check) -> dict[str, Any]:
    """A check as it stands in the summary, its unit, where there is one, at the end of its name."""
    entry = {**asdict(check), "passed": check.passed}
    if unit := entry.pop("unit"):
        entry["name"] = f"{check.name} ({unit})"
    return entry


def _without_nan(value: Any) -> Any:
    """The same content with null for numbers that JSON does not have."""
    if isinstance(value, dict):
        return {name: _without_nan(entry) for name, entry in value.items()}
    if isinstance(value, list):
        return [_without_nan(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


class Draft:
    """A folder that results are written into, before they stand where they were asked for."""

    def __init__(self, folder: Path, output: Path) -> None:
        self.folder, self.output = folder, output

    def settle(self, *, complete: bool) -> Path:
        """Put the results in their place, which is returned.

        Incomplete ones never replace others: they go beside them, under a name with "-incomplete".
        """
        place = self.output
        if not complete and _holds_anything(place):
            place = _free_name(place.with_name(f"{place.name}-incomplete"))
        _replace(place, self.folder)
        return place


def checkpoint_of(output: Path) -> Path:
    """Where a run into this folder keeps its checkpoint: beside it, so that it outlives every draft."""
    return output.absolute().with_name(f"{output.absolute().name}.checkpoint")


def prepared_checkpoint(output: Path, *, resume: bool, overwrite: bool) -> Path:
    """The checkpoint to go on from, or a new one.

    Raises
    ------
    OutputError
        If there is none to resume, or one that would be lost.
    """
    path = checkpoint_of(output)
    if resume and not path.exists():
        raise OutputError(
            f"Argument `--resume` must find the checkpoint of a run that was ended, but there is no {path}."
        )
    if path.exists() and not resume:
        if not overwrite:
            raise OutputError(
                f"Argument `--output` must not be that of a run that can go on, but {path} exists: pass --resume to go on, "
                "or --overwrite to begin anew."
            )
        path.unlink()
    return path


def what_goes_on(checkpoint: Path) -> str:
    """What the end of a run that was interrupted leaves to go on from, for the user."""
    if checkpoint.exists():
        return "the same command with --resume goes on"
    return "no block was finished, so that there is nothing to resume"


def is_interrupted(output: Path) -> bool:
    """Whether a folder holds the results of a run that was interrupted."""
    try:
        findings = json.loads((output / "summary.json").read_text())["findings"]
    except (OSError, ValueError, KeyError):
        return False
    return bool(findings) and str(findings[0]).startswith("Interrupted")


def _holds_anything(folder: Path) -> bool:
    return folder.is_dir() and any(folder.iterdir())


def _free_name(path: Path) -> Path:
    number = 1
    candidate = path
    while candidate.exists():
        number += 1
        candidate = path.with_name(f"{path.name}-{number}")
    return candidate


@contextmanager
def fresh_folder(output: Path, *, overwrite: bool) -> Iterator[Draft]:
    """A folder to write results into, which `Draft.settle` puts in the place of `output`.

    Raises
    ------
    OutputError
        If `output` holds anything and is not to be overwritten, is a file, or cannot be written.
    """
    if output.exists() and not output.is_dir():
        raise OutputError(f"Argument `--output` must be a folder, but {output} is a file.")
    if _holds_anything(output) and not overwrite:
        goes_on = ", or --resume to go on with the run that was ended" if checkpoint_of(output).exists() else ""
        raise OutputError(
            f"Argument `--output` must be empty or new, but {output} holds results: pass --overwrite to replace "
            f"them{goes_on}."
        )
    if _holds_anything(output) and not (output / "summary.json").exists():
        raise OutputError(
            f"Argument `--output` must hold nothing but results, but {output} has no summary.json: it is left alone."
        )
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        _remove_stale_drafts(output)
        prefix = f".{output.name}-{_DRAFT}-{socket.gethostname()}-{os.getpid()}-"
        draft = Path(tempfile.mkdtemp(prefix=prefix, dir=output.parent))
    except OSError as error:
        raise OutputError(
            f"Argument `--output` must be a folder that can be written, but {output} cannot: {error}."
        ) from error
    try:
        draft.chmod(0o755)
        yield Draft(draft, output)
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def _remove_stale_drafts(output: Path) -> None:
    """Remove the drafts of killed runs into this output: folders named as drafts of this machine, their process gone."""
    name = re.compile(rf"\.{re.escape(output.name)}-{_DRAFT}-{re.escape(socket.gethostname())}-(\d+)-[a-z0-9_]{{8}}")
    for entry in output.parent.iterdir():
        found = name.fullmatch(entry.name)
        if found and entry.is_dir() and not entry.is_symlink() and not _is_running(int(found[1])):
            shutil.rmtree(entry, ignore_errors=True)


def _is_running(process: int) -> bool:
    """Whether there is a process of this number; where that cannot be asked, there may be."""
    if os.name != "posix":
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


def _replace(output: Path, draft: Path) -> None:
    """Put `draft` in the place of `output`, the old results being moved aside until the new ones stand."""
    if not output.exists():
        draft.rename(output)
        return
    for entry in output.iterdir():  # what is no result of a system's is kept
        if entry.suffix not in _RESULTS and not (draft / entry.name).exists():
            (shutil.copytree if entry.is_dir() else shutil.copy2)(entry, draft / entry.name)
    aside = Path(tempfile.mkdtemp(prefix=f".{output.name}-old-", dir=output.parent)) / output.name
    output.rename(aside)
    try:
        draft.rename(output)
    except OSError:
        aside.rename(output)
        raise
    finally:
        shutil.rmtree(aside.parent, ignore_errors=True)
