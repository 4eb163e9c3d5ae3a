"""What a force-extension curve has sampled, on disk: from it the curve goes on after any end, even a power cut.

One file: a line that says what it is, a line of JSON with the arguments of the call, and one record a finished block,
appended when the block ends. A record is `BLCK`, the CRC-32 and the length of what follows (little-endian, 4 and 8 bytes),
and a NumPy .npz file with the block's samples, its frames where they are kept, and the OpenMM checkpoint at its end.
Nothing written is ever changed, so that an end at any moment costs the block being written and no other.
"""

from __future__ import annotations

import io
import json
import os
import struct
import time
import warnings
import zlib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from openmm_filament import _checks as check
from openmm_filament.blocks import BlockResult

__all__ = ["Checkpoint"]

_MAGIC = b"openmm_filament checkpoint 1\n"
_MARK = b"BLCK"
_HEAD = struct.Struct("<4sIQ")

_SYNC_SECONDS = 1.0
"""Records are forced to the disk so often: a power cut may cost the blocks of a second, the end of the process none."""


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
        If it is something else, or the checkpoint of a call with other arguments.
    """

    def __init__(self, path: str | os.PathLike[str], arguments: Mapping[str, Any], files: tuple[str, ...] = ()) -> None:
        self.path = Path(path)
        if not self.path.parent.is_dir():
            raise FileNotFoundError(f"Argument `checkpoint` must lie in a folder that exists, but {path} does not.")
        if self.path.is_dir():
            raise IsADirectoryError(f"Argument `checkpoint` must name a file, but {path} is a folder.")
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
            self._header = b""
            header = _MAGIC + json.dumps({"arguments": dict(arguments), "files": files}).encode() + b"\n"
            self.files = self._begun(header, arguments)
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

    def _begun(self, header: bytes, arguments: Mapping[str, Any]) -> tuple[str, ...]:
        """Compare the header with the one that is there; the other files of the call that began it.

        A new file is given its header with its first block.
        """
        start = self._read(0, len(_MAGIC))
        if start != _MAGIC and not _MAGIC.startswith(start):
            raise check.fail("checkpoint", "name a checkpoint or a new file", f"{self.path}, which is something else")
        line = self._line(len(_MAGIC))
        if line is None:  # new, or ended before its first block
            self._header = header
            return ()
        self._end = len(_MAGIC) + len(line)
        begun = json.loads(line)
        _compare(begun["arguments"], json.loads(json.dumps(dict(arguments))), self.path)
        return tuple(begun["files"])

    def stored(self) -> Iterator[tuple[int, int, BlockResult]]:
        """The point, the run and the result of each block that is there, in the order in which they ended.

        What follows the last whole record is cut off; a record that is whole but damaged is warned of.
        """
        size = os.fstat(self._file).st_size
        while self._end:
            mark, crc, length = _HEAD.unpack(self._read(self._end, _HEAD.size).ljust(_HEAD.size, b"\0"))
            body = self._end + _HEAD.size
            if _MARK.startswith(mark.rstrip(b"\0")) and body + length > size:  # cut off, or the end
                break
            payload = self._read(body, length) if mark == _MARK else b""
            if not payload or zlib.crc32(payload) != crc:
                warnings.warn(
                    f"The checkpoint {self.path} is damaged at byte {self._end}: what follows is sampled again.",
                    stacklevel=4,
                )
                break
            yield _unpack(payload)
            self._end = body + length
        if self._end:
            os.ftruncate(self._file, self._end)

    def add(self, point: int, run: int, result: BlockResult) -> None:
        """Append a block. Raises OSError, with what is there intact, where the disk does not take it."""
        payload = _pack(point, run, result)
        try:
            self._append(self._header + _HEAD.pack(_MARK, zlib.crc32(payload), len(payload)) + payload)
            self._header = b""
            if time.monotonic() - self._when > _SYNC_SECONDS:
                self._sync()
        except OSError as error:
            raise OSError(
                error.errno,
                f"The run has stopped: its checkpoint {self.path} cannot be written ({error.strerror}). The file is "
                "intact up to the last block before; with the same arguments the run goes on from there.",
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

    def _read(self, start: int, length: int) -> bytes:
        os.lseek(self._file, start, os.SEEK_SET)
        parts = []
        while length and (part := os.read(self._file, length)):
            parts.append(part)
            length -= len(part)
        return b"".join(parts)

    def _line(self, start: int) -> bytes | None:
        """The line that starts there, with its end; None where it has none."""
        line = b""
        while part := self._read(start + len(line), 1 << 16):
            line += part
            if b"\n" in part:
                return line[: line.index(b"\n") + 1]
        return None


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
