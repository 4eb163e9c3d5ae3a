"""A motion becomes a WAV file that sounds as it moved."""

from __future__ import annotations

import wave
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tolerances as tol
from conftest import Array
from openmm import unit

import openmm_filament as of
from openmm_filament import analysis

SECOND = unit.second


def string(interval: float, seconds: float, fundamental: float = 80.31) -> Array:
    """A decaying string tone of a few partials, in metres."""
    times = np.arange(round(seconds / interval)) * interval
    n = np.arange(1, 9)
    frequencies = fundamental * n * np.sqrt(1 + 3e-4 * n**2)
    waves = np.exp(-1.5 * times[:, None]) * np.cos(2 * np.pi * frequencies * times[:, None])
    return 1e-6 * waves @ (np.sin(n * np.pi / 4) / n**2) + 5e-3


def pcm(path: Path) -> tuple[Any, Array]:
    """Parameters and samples by the standard library, which is not what wrote them."""
    with wave.open(str(path)) as file:
        return file.getparams(), np.frombuffer(file.readframes(file.getnframes()), dtype="<i2").astype(np.float64)


def tone(frequency: float, rate: float, seconds: float = 2.0) -> Array:
    return np.sin(2 * np.pi * frequency * np.arange(round(rate * seconds)) / rate)


@pytest.mark.parametrize("rate", [2.2e3, 44_100.0, 46_051.7, 1e6 / np.pi, 7.1e5])
def test_a_string_is_heard_at_its_pitch(rate: float, tmp_path: Path) -> None:
    """Recorded at rates below and above that of the file, no whole or simple multiple of it."""
    made = of.sound.write_wav(tmp_path / "a.wav", string(1 / rate, 2.01), SECOND / rate)
    parameters, samples = pcm(made.path)
    assert (parameters.nchannels, parameters.sampwidth, parameters.framerate) == (1, 2, 44_100)
    assert parameters.nframes == 2 * 44_100
    assert made.seconds == 2.0
    assert of.sound.strongest_line(made.path) == pytest.approx(80.31 * np.sqrt(1 + 3e-4), abs=tol.HEARD)
    assert np.abs(samples).max() == pytest.approx(32767 * 10 ** (-1 / 20), abs=1)
    assert abs(samples.mean()) < 40  # the offset of 5 mm is gone
    assert samples[0] == samples[-1] == 0


@pytest.mark.parametrize("rate", [4_000.0, 50_000.0, 1e6])
def test_the_samples_are_the_motion(rate: float, tmp_path: Path) -> None:
    """Away from the faded ends, the motion at the file's own times, to the rounding of 16 bits."""
    of.sound.write_wav(tmp_path / "a.wav", tone(1234.5, rate, 0.5), SECOND / rate, seconds=0.5)
    _, samples = pcm(tmp_path / "a.wav")
    times = np.arange(len(samples)) / 44_100
    table = np.stack([np.sin(2 * np.pi * 1234.5 * times), np.ones(len(samples))], axis=1)[2000:-2000]
    left = samples[2000:-2000] - table @ np.linalg.lstsq(table, samples[2000:-2000])[0]  # size and mean are not kept
    assert np.abs(left).max() < tol.SIXTEEN_BITS


def test_what_lies_above_the_files_range_does_not_fold_back(tmp_path: Path) -> None:
    """30 kHz would fold to 14.1 kHz; plainly taking every n-th sample shows that it does."""
    rate = 441_000.0
    motion = tone(1000.0, rate) + tone(30_000.0, rate)
    of.sound.write_wav(tmp_path / "a.wav", motion, SECOND / rate)
    heard = analysis.spectrum(pcm(tmp_path / "a.wav")[1], 1 / 44_100)
    naive = analysis.spectrum(motion[::10], 1 / 44_100)
    folded = int(np.argmin(np.abs(heard.frequencies - 14_100)))
    assert naive.amplitudes[folded] == pytest.approx(1.0)
    assert heard.amplitudes[folded] < 1e-4 * heard.amplitudes.max()
    assert of.sound.strongest_line(tmp_path / "a.wav") == pytest.approx(1000.0, abs=1e-3)


def test_18_kilohertz_pass_whole(tmp_path: Path) -> None:
    of.sound.write_wav(tmp_path / "a.wav", tone(1000.0, 2e5) + tone(18_000.0, 2e5), SECOND / 2e5)
    heard = analysis.lines(pcm(tmp_path / "a.wav")[1], 1 / 44_100, count=2)
    assert heard.amplitudes[1] / heard.amplitudes[0] == pytest.approx(1.0, abs=1e-3)


def test_speed_brings_a_molecule_within_hearing(tmp_path: Path) -> None:
    motion = tone(3.3e9, 1e11, 2e-6) * unit.nanometer
    made = of.sound.write_wav(tmp_path / "a.wav", motion, 10 * unit.picosecond, speed=1e-7, seconds=1.0, overwrite=True)
    assert made.speed == 1e-7
    assert of.sound.strongest_line(made.path) == pytest.approx(330.0, abs=tol.HEARD)


def test_a_file_is_only_replaced_if_told(tmp_path: Path) -> None:
    motion = tone(440.0, 8e3)
    of.sound.write_wav(tmp_path / "a.wav", motion, SECOND / 8e3)
    with pytest.raises(FileExistsError, match="overwrite=True"):
        of.sound.write_wav(tmp_path / "a.wav", motion, SECOND / 8e3)
    of.sound.write_wav(tmp_path / "a.wav", tone(660.0, 8e3), SECOND / 8e3, overwrite=True)
    assert of.sound.strongest_line(tmp_path / "a.wav") == pytest.approx(660.0, abs=tol.HEARD)


NOT_FINITE = np.where(np.arange(16_000) == 7, np.nan, tone(440.0, 8e3))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"signal": NOT_FINITE}, "`signal` must be finite, but is nan at index 7"),
        ({"signal": np.full(16_000, 0.3)}, "must move, but is silent: 0.3"),
        ({"signal": np.ones(3)}, "at least 16 samples"),
        ({"signal": tone(440.0, 8e3)[:, None]}, "shape"),
        ({"seconds": 2.5}, "not exceed the recording, 2 s played at speed 1 in 2 s, but is 2.5 s"),
        ({"seconds": 2.5}, r"record for longer, pass seconds=2, or play it slower, speed=0.8 or less"),
        ({"speed": 2.0}, "not exceed the recording, 2 s played at speed 2 in 1 s"),
        ({"speed": 0.0}, "`speed` must be positive"),
        ({"seconds": 0.0}, r"`seconds` must lie in"),
        ({"interval": 1 * unit.picosecond, "speed": 1e-10}, "such as 8.08e-09, for 440 Hz"),
        ({"speed": 1e-3}, "`interval` must be below 2.5e-05 s to sound at speed 0.001, but is 0.000125 s"),
        ({"signal": tone(3.0, 8e3)}, r"such as 147, for 440 Hz\), but is 1, which plays its strongest line at 3 Hz"),
        ({"interval": -1 * unit.second}, "`interval` must be positive"),
        ({"signal": 1e-310 * tone(440.0, 8e3)}, "`signal` must move, but is silent"),
        ({"path": "a.mp3"}, "end in .wav, but is"),
    ],
)
def test_broken_input_is_refused_before_anything_is_written(
    change: dict[str, Any], message: str, tmp_path: Path
) -> None:
    given = {"path": "a.wav", "signal": tone(440.0, 8e3), "interval": SECOND / 8e3, **change}
    with pytest.raises(ValueError, match=message):
        of.sound.write_wav(tmp_path / given.pop("path"), given.pop("signal"), given.pop("interval"), **given)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("interval", [1e-4, 1 * unit.nanometer])
def test_an_interval_without_a_unit_of_time_is_refused(interval: Any, tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="interval"):
        of.sound.write_wav(tmp_path / "a.wav", tone(440.0, 8e3), interval)


def test_missing_folders_and_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="folder that exists"):
        of.sound.write_wav(tmp_path / "no" / "a.wav", tone(440.0, 8e3), SECOND / 8e3)
    with pytest.raises(FileNotFoundError):
        of.sound.strongest_line(tmp_path / "a.wav")
