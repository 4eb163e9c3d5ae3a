"""What a force-extension curve has sampled, on disk: from it the curve goes on after any end, even a power cut.

One file: a line that says what it is, and records (see `records`), appended one by one. The first, `CALL`, has the arguments
of the call as JSON; a `BLCK` is a finished block as a NumPy .npz file with its samples, its frames where they are kept, and
the OpenMM checkpoint at its end. Nothing written is ever changed, so that an end at any moment costs the block being written
and no other.
"""

from __future__ import annotations

import io
import json
import os
import time
import warnings
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from openmm_filament import _checks as check
from openmm_filament.blocks import BlockResult
from openmm_filament.records import Fault, record, record_at, stored_bytes, taken

__all__ = ["Checkpoint"]

_KIND = b"openmm_filament checkpoint "
_MAGIC = _KIND + b"2\n"
_CALL, _BLOCK = b"CALL", b"BLCK"

_SYNC_SECONDS = 1.0
"""Records are forced to the disk so often: a power cut may cost the blocks of a second, the end of the process none."""

_ANEW = "to begin anew, remove the file or name another"


class Checkpoint:
    """The finished blocks of one call, in the file at `path`, which is made or gone on with.

    Parameters
    ----------
    path : path
    arguments : mapping
        What the numbers depend on, by the names in error messages, as JSON has it.
    files : sequence of str
        Other files that the call writes, which it may replace when it goes on.

    Raises
    ------
    FileNotFoundError, IsADirectoryError, PermissionError, BlockingIOError
        If the file cannot be made or written, or another process is at it.
    ValueError
        If it is something else, a checkpoint whose first record is damaged, or that of a call with other arguments.

    Warns
    -----
    UserWarning
        Where the file ends in the middle of a record or is damaged, with what is dropped.
    """

    def __init__(self, path: str | os.PathLike[str], arguments: Mapping[str, Any], files: tuple[str, ...] = ()) -> None:
        self.path = Path(path)
        if not self.path.parent.is_dir():
            raise FileNotFoundError(f"Argument `checkpoint` must lie in a folder that exists, but {path} does not.")
        if self.path.is_dir():
            raise IsADirectoryError(f"Argument `checkpoint` must name a file, but {path} is a folder.")
        if self.path.exists() and not self.path.is_file():
            raise check.fail("checkpoint", "name a file", f"{path}, which is a device")
        try:
            self._file = os.open(self.path, os.O_RDWR | os.O_CREAT | getattr(os, "O_BINARY", 0), 0o666)
        except OSError as error:
            raise type(error)(
                error.errno,
                f"Argument `checkpoint` must name a file that can be written, but {path} cannot ({error.strerror}).",
            ) from None
        try:
            self._lock()
            self._end = 0
            self._when = time.monotonic()
            self._blocks = 0
            given = json.dumps({"arguments": dict(arguments), "files": files}).encode()
            self._header = _MAGIC + record(_CALL, given)
            self.files = self._begun(arguments)
        except BaseException:
            os.close(self._file)
            raise

    def _lock(self) -> None:
        """Keep other processes out until this one ends, in whatever way."""
        try:
            import fcntl
        except ImportError:  # not on Windows
            return
        try:
            fcntl.lockf(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except (BlockingIOError, PermissionError):
            raise BlockingIOError(
                f"Argument `checkpoint` must not be in use, but another process writes {self.path}."
            ) from None
        except OSError:  # a file system without locks
            return

    @property
    def holds_blocks(self) -> bool:
        """Whether a call could go on from a block, among those read and written so far."""
        return self._blocks > 0

    def _begun(self, arguments: Mapping[str, Any]) -> tuple[str, ...]:
        """Compare the arguments with those that are there; the other files of the call that began it.

        A new file is given its first record with its first block.
        """
        start = stored_bytes(self._file, 0, len(_MAGIC))
        if start != _MAGIC and not _MAGIC.startswith(start):
            if start.startswith(_KIND):
                raise ValueError(
                    "Argument `checkpoint` must name a checkpoint of this version or a new file, but the first line of "
                    f"{self.path} is that of another version, or damaged: {_ANEW}."
                )
            raise check.fail("checkpoint", "name a checkpoint or a new file", f"{self.path}, which is something else")
        found = record_at(self._file, len(_MAGIC), _CALL)
        if isinstance(found, bytes):
            self._end, self._header = len(_MAGIC) + taken(found), b""
            begun = json.loads(found)
            _compare(begun["arguments"], json.loads(json.dumps(dict(arguments))), self.path)
            return tuple(begun["files"])
        if found is Fault.DAMAGED:
            raise ValueError(
                f"Argument `checkpoint` must name a whole checkpoint or a new file, but {self.path} is damaged in its first "
                f"record, which says of what call it is: {_ANEW}."
            )
        if start:
            warnings.warn(
                f"The checkpoint {self.path} ends at byte {self._size()}, before its first block: all is sampled anew.",
                stacklevel=4,
            )
            os.ftruncate(self._file, 0)
        return ()

    def stored(self) -> Iterator[tuple[int, int, BlockResult]]:
        """The point, the run and the result of each block that is there, in the order in which they ended.

        What follows the last good record is cut off, and warned of.
        """
        while self._end:
            found = record_at(self._file, self._end, _BLOCK)
            if isinstance(found, Fault):
                self._cut_off(found)
                break
            self._end += taken(found)
            self._blocks += 1
            yield _unpack(found)

    def _cut_off(self, fault: Fault) -> None:
        """Leave the good records alone, and say what is dropped."""
        dropped = self._size() - self._end
        if dropped:
            found = {
                Fault.CUT: f"ends in the middle of the record at byte {self._end}",
                Fault.DAMAGED: f"is damaged at byte {self._end}",
            }[fault]
            warnings.warn(
                f"The checkpoint {self.path} {found}: what follows is sampled again. {dropped} bytes are dropped, and "
                f"{self._blocks} blocks before them kept.",
                stacklevel=5,
            )
            os.ftruncate(self._file, self._end)

    def _size(self) -> int:
        return os.fstat(self._file).st_size

    def add(self, point: int, run: int, result: BlockResult) -> None:
        """Append a block. Raises OSError, with what is there intact, where the disk does not take it."""
        try:
            self._append(self._header + record(_BLOCK, _pack(point, run, result)))
            self._header = b""
            self._blocks += 1
            if time.monotonic() - self._when > _SYNC_SECONDS:
                self._sync()
        except OSError as error:
            kept = (
                "The file is intact up to the last block before; with the same arguments the run goes on from there."
                if self._blocks
                else "No block has been kept: the run begins anew."
            )
            raise OSError(
                error.errno,
                f"The run has stopped: its checkpoint {self.path} cannot be written ({error.strerror}). {kept}",
            ) from error

    def close(self) -> None:
        """Force everything to the disk, as far as it can be, and close the file; one without a block is removed."""
        with suppress(OSError):
            self._sync()
            if not self._end:
                self.path.unlink()
        os.close(self._file)

    def _append(self, record: bytes) -> None:
        """Write at the end: all of it, or nothing whatever interrupts."""
        os.lseek(self._file, self._end, os.SEEK_SET)
        left = memoryview(record)
        try:
            while left:
                left = left[os.write(self._file, left) :]
        except BaseException:
            with suppress(OSError):
                os.ftruncate(self._file, self._end)
            raise
        self._end += len(record)

    def _sync(self) -> None:
        os.fsync(self._file)
        self._when = time.monotonic()


def _compare(then: Mapping[str, Any], now: Mapping[str, Any], path: Path) -> None:
    """Refuse a checkpoint of other arguments, by their names."""
    different = [name for name in {**then, **now} if then.get(name) != now.get(name)]
    if len(different) > 1 and "plan" in different:  # which follows from the others
        different.remove("plan")
    if not different:
        return
    told = []
    for name in different:
        before, after = (str(values.get(name)) for values in (then, now))
        told.append(f"`{name}` ({before}, now {after})" if len(before + after) < 60 else f"`{name}`")
    raise ValueError(
        f"Argument `checkpoint` must be of a call with the same arguments, but {path} was begun with another "
        f"{' and another '.join(told)}."
    )


def _pack(point: int, run: int, result: BlockResult) -> bytes:
    arrays: dict[str, Any] = {
        "at": np.array([point, run]),
        "extensions": result.extensions,
        "checkpoint": np.frombuffer(result.checkpoint, dtype=np.uint8),
        "seconds": np.array(result.seconds),
    }
    arrays |= {name: value for name in ("start", "frames") if (value := getattr(result, name)) is not None}
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def _unpack(payload: bytes) -> tuple[int, int, BlockResult]:
    with np.load(io.BytesIO(payload), allow_pickle=False) as arrays:
        point, run = arrays["at"].tolist()
        result = BlockResult(
            arrays["extensions"],
            arrays.get("start"),
            arrays.get("frames"),
            arrays["checkpoint"].tobytes(),
            float(arrays["seconds"]),
        )
    return point, run, result
