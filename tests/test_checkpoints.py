"""A damaged checkpoint: what is good before the damage is taken, or it is refused; never another result."""

from __future__ import annotations

import errno
import os
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from openmm_filament import checkpoints, keeping
from openmm_filament.blocks import BlockResult
from openmm_filament.checkpoints import Checkpoint
from systems.scene import what_goes_on

ARGUMENTS = {"seed": 5, "forces": [1.0, 8.0]}
FILES = ("kept.dcd",)
REFUSED = r"^Argument `checkpoint` must name a .* new file, but .*kept\.checkpoint.*(to begin anew|something else)"
TOLD = r"The checkpoint .*kept\.checkpoint (ends|is damaged) .* (is sampled again|sampled anew)"


def result(number: int) -> BlockResult:
    return BlockResult(np.array([[0.5 + number]]), None, None, bytes([number, 7]), float(number))


def flat(block: BlockResult) -> tuple[Any, ...]:
    return block.extensions.tolist(), block.start, block.frames, block.checkpoint, block.seconds


@pytest.fixture
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A checkpoint of two blocks; nothing is forced to the disk."""
    monkeypatch.setattr(checkpoints.os, "fsync", lambda _: None)
    path = tmp_path / "kept.checkpoint"
    store = Checkpoint(path, ARGUMENTS, FILES)
    assert list(store.stored()) == []
    for number in range(2):
        store.add(number, 0, result(number))
    store.close()
    return path


def read(path: Path) -> tuple[list[Any], list[str], str | None]:
    """The blocks, the warnings and the refusal; any other error passes."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            store = Checkpoint(path, ARGUMENTS, FILES)
        except ValueError as error:
            return [], [], str(error)
        assert store.files in (FILES, ())
        blocks = [(point, run, flat(block)) for point, run, block in store.stored()]
        store.close()
    return blocks, [str(warning.message) for warning in told], None


def test_every_damaged_byte_is_told_of_or_refused(kept: Path) -> None:
    content = kept.read_bytes()
    whole, told, refusal = read(kept)
    assert (len(whole), told, refusal) == (2, [], None)
    first = content.index(b"BLCK")
    for i in range(len(content)):
        kept.write_bytes(content[:i] + bytes([content[i] ^ 1 << i % 8]) + content[i + 1 :])
        blocks, told, refusal = read(kept)
        if i < first:
            assert re.search(REFUSED, refusal or ""), (i, refusal)
            continue
        assert refusal is None, (i, refusal)
        assert blocks == whole[: len(blocks)], i
        assert len(blocks) == (i >= content.rindex(b"BLCK")), i
        assert [bool(re.search(TOLD, text)) for text in told] == [True], (i, told)
        assert f"{len(blocks)} blocks before" in told[0]
        assert read(kept) == (blocks, [], None)  # what is left is whole


def test_every_cut_leaves_the_blocks_before_it(kept: Path) -> None:
    content = kept.read_bytes()
    whole, _, _ = read(kept)
    ends = [content.index(b"BLCK"), content.rindex(b"BLCK"), len(content)]  # of the call, and of the blocks
    for size in range(len(content)):
        kept.write_bytes(content[:size])
        blocks, told, refusal = read(kept)
        assert refusal is None, (size, refusal)
        assert blocks == whole[: sum(size >= end for end in ends[1:])], size
        assert [bool(re.search(TOLD, text)) for text in told] == ([] if size in (0, *ends) else [True]), (size, told)


def test_damage_in_the_middle_of_a_file_is_mended_by_going_on(kept: Path) -> None:
    content = kept.read_bytes()
    damaged = bytearray(content)
    damaged[content.rindex(b"BLCK") + 9] ^= 64  # a length far beyond the end of the file
    kept.write_bytes(damaged)
    store = Checkpoint(kept, ARGUMENTS, FILES)
    with pytest.warns(UserWarning, match=rf"is damaged at byte {content.rindex(b'BLCK')}: what follows is sampled"):
        assert len(list(store.stored())) == 1
    store.add(1, 0, result(1))
    store.close()
    assert kept.read_bytes() == content


def test_a_checkpoint_of_another_version_is_refused(kept: Path) -> None:
    kept.write_bytes(b"openmm_filament checkpoint 1\n{}\n")
    with pytest.raises(ValueError, match=r"must name a checkpoint of this version .*: to begin anew, remove the file"):
        Checkpoint(kept, ARGUMENTS, FILES)


def test_no_error_promises_a_checkpoint_that_is_not_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "new.checkpoint"
    store = Checkpoint(path, ARGUMENTS)
    assert "intact" not in keeping.intact(store)
    assert "begins anew" in keeping.intact(store)

    def full(*_: Any) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(checkpoints.os, "write", full)
        with pytest.raises(
            OSError, match=r"cannot be written .*\. No block has been kept: the run begins anew"
        ) as told:
            store.add(0, 0, result(0))
    assert "intact" not in str(told.value)
    store.add(0, 0, result(0))
    assert keeping.intact(store).endswith("new.checkpoint is intact: the same call goes on from it.")
    store.close()
    assert path.exists()
    assert what_goes_on(path) == "the same command with --resume goes on"
    path.unlink()
    assert "nothing to resume" in what_goes_on(path)
