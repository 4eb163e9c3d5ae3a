"""Records in a file that is only ever appended to, in which no damaged byte goes unseen.

A record is four letters, the length of its content, the CRC-32 of the content, that of these 16 bytes (little-endian, 8, 4
and 4 bytes), and the content.
"""

from __future__ import annotations

import os
import struct
import zlib
from enum import Enum

__all__ = ["Fault", "record", "record_at", "stored_bytes", "taken"]

_HEAD, _CRC = struct.Struct("<4sQI"), struct.Struct("<I")
_BEFORE = _HEAD.size + _CRC.size


class Fault(Enum):
    """Why there is no record: the file ends first, as where a run was ended, or what is there is not what was written."""

    CUT = "cut"
    DAMAGED = "damaged"


def record(mark: bytes, content: bytes) -> bytes:
    """The bytes of a record of this kind, four letters."""
    head = _HEAD.pack(mark, len(content), zlib.crc32(content))
    return head + _CRC.pack(zlib.crc32(head)) + content


def taken(content: bytes) -> int:
    """Bytes that a record of this content takes."""
    return _BEFORE + len(content)


def record_at(file: int, start: int, mark: bytes) -> bytes | Fault:
    """The content of the record of this kind that starts at a byte of an open file, or why there is none."""
    head = stored_bytes(file, start, _BEFORE)
    if len(head) < _BEFORE:
        return Fault.CUT
    found, length, crc = _HEAD.unpack_from(head)
    if zlib.crc32(head[: _HEAD.size]) != _CRC.unpack_from(head, _HEAD.size)[0] or found != mark:
        return Fault.DAMAGED
    if start + _BEFORE + length > os.fstat(file).st_size:
        return Fault.CUT
    content = stored_bytes(file, start + _BEFORE, length)
    return content if zlib.crc32(content) == crc else Fault.DAMAGED


def stored_bytes(file: int, start: int, length: int) -> bytes:
    """So many bytes from there, or as many as there are."""
    os.lseek(file, start, os.SEEK_SET)
    parts = []
    while length and (part := os.read(file, length)):
        parts.append(part)
        length -= len(part)
    return b"".join(parts)
