"""Spectra, lines, fits and pitch of signals whose answer is known."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest
import tolerances as tol
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from numpy.typing import NDArray
from scipy import linalg, stats

from openmm_filament import analysis

Array = NDArray[np.float64]

STEP = 5e-5  # s
SAMPLES = 20_000  # 1 s
TIMES = np.arange(SAMPLES) * STEP
RECORDINGS = 100


def ringing(times: Array, frequencies: Array, decays: Any, amplitudes: Any) -> Array:
    """Sum over lines of `Re A exp((-d + 2 pi i f) t)`: (T,), or (T, N) for amplitudes (K, N)."""
    rates = -np.asarray(decays) + 2j * np.pi * np.asarray(frequencies)
    return np.real(np.exp(times[:, None] * rates) @ np.asarray(amplitudes))


def stiff_string(count: int) -> tuple[Array, Array, Array]:
    """Frequencies of a stiff string (Hz), decay rates (1/s) and complex amplitudes of a pluck."""
    n = np.arange(1, count + 1)
    rng = np.random.default_rng(count)
    decays = 1.5 + rng.random(count)
    return 80.3 * n * np.sqrt(1 + 1e-3 * n**2), decays, np.exp(2j * np.pi * rng.random(count)) / n


# Spectrum -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("window", ["hann", "boxcar", "blackmanharris", "flattop"])
def test_a_sinusoid_on_a_bin_shows_its_amplitude_and_the_mean_stands_at_zero(window: str) -> None:
    found = analysis.spectrum(0.5 + 3 * np.sin(2 * np.pi * 440 * TIMES), STEP, window=window)
    assert found.resolution == pytest.approx(1.0)
    assert found.frequencies[440] == pytest.approx(440.0)
    assert_allclose(found.amplitudes[[0, 440]], [0.5, 3.0], rtol=tol.ROUNDING)
    assert found.amplitudes[1000] < 1e-5
    assert found.window == window


def test_parseval(rng: np.random.Generator) -> None:
    """Without a window, the mean square is that of the amplitudes: half each, but whole at both ends."""
    for samples in (1000, 1001):
        signal = rng.normal(size=(samples, 3))
        amplitudes = analysis.spectrum(signal, 0.1, window="boxcar").amplitudes
        weights = np.full(len(amplitudes), 0.5)
        weights[0] = 1.0
        if samples % 2 == 0:
            weights[-1] = 1.0
        assert_allclose(weights @ amplitudes**2, np.mean(signal**2, axis=0), rtol=tol.ROUNDING)


def test_the_spectrum_is_the_sum_it_claims_to_be(rng: np.random.Generator) -> None:
    """Against the plain sum at some frequencies, padded."""
    signal = rng.normal(size=40)
    found = analysis.spectrum(signal, 0.5, padding=3)
    weights = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(40) / 40)
    for k in (1, 7, 31):
        phases = np.exp(-2j * np.pi * found.frequencies[k] * 0.5 * np.arange(40))
        assert found.amplitudes[k] == pytest.approx(
            2 * abs(np.sum(weights * signal * phases)) / weights.sum(), rel=1e-12
        )


def test_columns_are_spectra_of_their_own_and_padding_leaves_the_resolution(rng: np.random.Generator) -> None:
    signal = rng.normal(size=(300, 4))
    together = analysis.spectrum(signal, 0.01, padding=4)
    for column in range(4):
        alone = analysis.spectrum(signal[:, column], 0.01, padding=4)
        assert_allclose(together.amplitudes[:, column], alone.amplitudes, rtol=tol.ROUNDING, atol=tol.ROUNDING)
    assert together.resolution == analysis.spectrum(signal, 0.01).resolution == pytest.approx(1 / 3)
    assert len(together.frequencies) > 4 * 150


# Lines --------------------------------------------------------------------------------------------------------------


@given(st.floats(4.0, 495.0), st.floats(0.0, 8.0), st.floats(-3.0, 3.0), st.integers(0, 1))
def test_one_line_comes_out_to_rounding(place: float, decay: float, phase: float, odd: int) -> None:
    """Anywhere between the bins, steady or decaying, in 1000 or 1001 samples of a unit interval."""
    times = np.arange(1000.0 + odd)
    frequency, rate = place / len(times), decay / len(times)
    found = analysis.lines(7 + ringing(times, np.array([frequency]), rate, [2 * np.exp(1j * phase)]), 1.0, count=1)
    assert found.frequencies[0] * len(times) == pytest.approx(place, abs=tol.LINE)
    assert found.decay_rates[0] * len(times) == pytest.approx(decay, abs=tol.LINE)


def test_a_steady_line_between_two_bins_has_its_amplitude() -> None:
    found = analysis.lines(3 * np.cos(2 * np.pi * 440.37 * TIMES + 1), STEP)
    assert_allclose(found.amplitudes, [3.0], rtol=tol.LINE)


def test_many_lines_come_out_to_rounding() -> None:
    frequencies, decays, amplitudes = stiff_string(40)
    found = analysis.lines(ringing(TIMES, frequencies, decays, amplitudes), STEP, count=40)
    assert_allclose(found.frequencies, frequencies, rtol=tol.ROUNDING)
    assert_allclose(found.decay_rates, decays, rtol=1e-9)


def test_lines_are_chosen_by_count_by_threshold_or_by_place() -> None:
    signal = ringing(TIMES, np.array([100.3, 250.0, 400.2]), 0.0, [1.0, 0.02, 0.5])
    assert_allclose(analysis.lines(signal, STEP).frequencies, [100.3, 250.0, 400.2], rtol=tol.ROUNDING)
    assert_allclose(analysis.lines(signal, STEP, threshold=0.1).frequencies, [100.3, 400.2], rtol=tol.ROUNDING)
    assert_allclose(analysis.lines(signal, STEP, count=1).frequencies, [100.3], rtol=1e-6)
    assert_allclose(analysis.lines(signal, STEP, near=[245.0, 390.0]).frequencies, [250.0, 400.2], rtol=1e-6)
    assert_allclose(analysis.lines(signal, STEP, near=260.0).frequencies, [250.0], rtol=1e-4)  # 130 to 390 Hz


def test_columns_share_lines_but_not_amplitudes(rng: np.random.Generator) -> None:
    """A line that one bead alone shows is found; amplitudes are those of each bead."""
    shapes = np.array([[1.0, 0.0, 2.0, 0.3], [0.0, 0.2, 0.0, 0.0]])
    found = analysis.lines(ringing(TIMES, np.array([93.7, 181.2]), 0.0, shapes), STEP)
    assert_allclose(found.frequencies, [93.7, 181.2], rtol=tol.ROUNDING)
    assert_allclose(found.amplitudes, shapes, atol=1e-9)


# Fit ----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [1, 10, 40])
@pytest.mark.parametrize("guess", ["lines", "theory"])
def test_a_fit_recovers_noiseless_lines(count: int, guess: str) -> None:
    frequencies, decays, amplitudes = stiff_string(count)
    signal = 2.0 + ringing(TIMES, frequencies, decays, amplitudes)
    starts = analysis.lines(signal, STEP, count=count).frequencies if guess == "lines" else frequencies + 0.3
    begun = time.perf_counter()
    fit = analysis.damped_sinusoids(signal, STEP, starts)
    assert time.perf_counter() - begun < tol.FIT_SECONDS
    assert_allclose(fit.frequencies, frequencies, rtol=1e-9)
    assert_allclose(fit.decay_rates, decays, rtol=1e-9)
    assert_allclose(fit.amplitudes, amplitudes, atol=1e-9)
    assert fit.offset == pytest.approx(2.0)
    assert fit.residual < 1e-9
    assert fit.condition < 2
    assert_allclose(fit.at(TIMES), signal, atol=1e-9)


def test_columns_are_fitted_together(rng: np.random.Generator) -> None:
    """200 beads and 12 modes: shared frequencies, a shape each."""
    frequencies, decays, _ = stiff_string(12)
    shapes = rng.normal(size=(12, 200)) + 1j * rng.normal(size=(12, 200))
    signal = ringing(TIMES[::4], frequencies, decays, shapes)
    fit = analysis.damped_sinusoids(signal, 4 * STEP, frequencies + 0.2)
    assert_allclose(fit.frequencies, frequencies, rtol=1e-9)
    assert_allclose(fit.amplitudes, shapes, atol=1e-8)
    assert fit.offset.shape == (200,)


def test_lines_closer_than_a_resolution_are_told_apart_from_good_guesses() -> None:
    frequencies = np.array([200.0, 200.3])
    signal = ringing(TIMES, frequencies, [1.0, 1.4], [1.0, 0.7j])
    fit = analysis.damped_sinusoids(signal, STEP, frequencies + np.array([0.03, -0.03]), decay_rates=[1.0, 1.0])
    assert_allclose(fit.frequencies, frequencies, rtol=1e-9)
    assert fit.condition > 30


def test_without_decay_the_rates_are_zero() -> None:
    signal = ringing(TIMES, np.array([120.4, 333.3]), 0.0, [1.0, 2.0j])
    fit = analysis.damped_sinusoids(signal, STEP, [120.0, 333.0], damped=False)
    assert_allclose(fit.frequencies, [120.4, 333.3], rtol=tol.ROUNDING)
    assert not fit.decay_rates.any()
    assert not fit.decay_rate_errors.any()


@pytest.mark.parametrize("damped", [True, False])
@pytest.mark.parametrize("columns", [1, 3])
def test_errors_cover_the_truth_as_often_as_they_should(damped: bool, columns: int, rng: np.random.Generator) -> None:
    """z of noisy recordings of two lines 0.8 resolutions apart and one alone."""
    times = np.arange(1500) * 1e-3
    frequencies, decays = np.array([60.0, 60.55, 130.0]), np.array([0.6, 1.1, 2.0]) * damped
    amplitudes = rng.normal(size=(3, columns)) + 1j * rng.normal(size=(3, columns)) + 1.0
    clean = ringing(times, frequencies, decays, amplitudes)
    z = []
    for _ in range(RECORDINGS):
        noisy = clean + 0.02 * rng.normal(size=clean.shape)
        guesses = {"decay_rates": decays} if damped else {"damped": False}
        fit = analysis.damped_sinusoids(noisy, 1e-3, frequencies, **guesses)
        z.append((fit.frequencies - frequencies) / fit.frequency_errors)
        if damped:
            z.append((fit.decay_rates - decays) / fit.decay_rate_errors)
        assert fit.residual == pytest.approx(0.02, rel=0.1)
    for deviations in np.array(z).reshape(RECORDINGS, -1).T:
        assert unit_normal(deviations)


def unit_normal(z: Array) -> bool:
    """Whether the squares sum to what those of unit normals do."""
    return bool(tol.CHI_SQUARED < stats.chi2.sf(np.sum(z**2), len(z)) < 1 - tol.CHI_SQUARED)


@pytest.mark.parametrize("factor", [0.75, 1.35])
def test_errors_a_third_off_would_not_pass(factor: float, rng: np.random.Generator) -> None:
    z = rng.normal(size=RECORDINGS)
    assert unit_normal(z)
    assert not unit_normal(z / factor)


def matrix_pencil(signal: Array, interval: float, lines: int) -> tuple[Array, Array]:
    """Frequencies and decay rates from the shift between two Hankel matrices (no least-squares search)."""
    half = len(signal) // 2
    hankel = linalg.hankel(signal[:half], signal[half - 1 :])
    _, _, rows = linalg.svd(hankel, full_matrices=False)
    space = rows[: 2 * lines].T
    shift = linalg.lstsq(space[:-1], space[1:])[0]
    poles = np.log(np.linalg.eigvals(shift)) / interval
    poles = poles[poles.imag > 0]
    order = np.argsort(poles.imag)
    return poles.imag[order] / (2 * np.pi), -poles.real[order]


def test_the_fit_agrees_with_a_matrix_pencil() -> None:
    times = np.arange(400) * 1e-3
    frequencies, decays = np.array([31.0, 87.3, 142.9]), np.array([3.0, 1.0, 8.0])
    signal = ringing(times, frequencies, decays, [1.0, 0.4j, -0.6])
    by_pencil = matrix_pencil(signal, 1e-3, 3)
    fit = analysis.damped_sinusoids(signal, 1e-3, analysis.lines(signal, 1e-3, count=3).frequencies)
    assert_allclose(fit.frequencies, by_pencil[0], rtol=1e-10)
    assert_allclose(fit.decay_rates, by_pencil[1], rtol=1e-8)


def test_the_fit_finds_the_eigenvalues_of_a_chain_that_was_stepped_in_time() -> None:
    """Five beads between walls, damped, moved by the matrix of one Euler-Cromer step: its eigenvalues are known."""
    beads, dt, damping = 5, 2e-4, 2.0
    stiffness = 4e5 * (2 * np.eye(beads) - np.eye(beads, k=1) - np.eye(beads, k=-1))
    kick = np.block([[np.eye(beads), np.zeros((beads, beads))], [-dt * stiffness, (1 - dt * damping) * np.eye(beads)]])
    drift = np.block([[np.eye(beads), dt * np.eye(beads)], [np.zeros((beads, beads)), np.eye(beads)]])
    step = drift @ kick
    poles = np.log(np.linalg.eigvals(step)) / dt
    poles = poles[poles.imag > 0][np.argsort(poles[poles.imag > 0].imag)]
    state = np.zeros(2 * beads)
    state[0] = 1.0
    frames = np.empty((5000, beads))
    for frame in frames:
        frame[:] = state[:beads]
        state = step @ state
    fit = analysis.damped_sinusoids(frames, dt, analysis.lines(frames, dt, count=beads).frequencies)
    assert_allclose(fit.frequencies, poles.imag / (2 * np.pi), rtol=1e-10)
    assert_allclose(fit.decay_rates, -poles.real, rtol=1e-8)


# Pitch --------------------------------------------------------------------------------------------------------------


def test_a_gliding_pitch_is_followed() -> None:
    """A linear glide from 200 to 300 Hz with an overtone, whose amplitude falls."""
    phase = 2 * np.pi * (200 * TIMES + 50 * TIMES**2)
    envelope = np.exp(-2 * TIMES)
    pitch = analysis.instantaneous_pitch(envelope * (np.cos(phase) + 0.5 * np.cos(2 * phase)), STEP, 0.1)
    assert_allclose(pitch.frequencies, 200 + 100 * pitch.times, atol=0.2)
    assert_allclose(pitch.amplitudes, np.exp(-2 * pitch.times), rtol=0.03)
    assert len(pitch.times) > 30


def test_the_band_chooses_the_line() -> None:
    signal = ringing(TIMES, np.array([100.0, 207.3]), 0.0, [1.0, 3.0])
    assert_allclose(analysis.instantaneous_pitch(signal, STEP, 0.2).frequencies, 207.3, atol=1e-3)
    assert_allclose(analysis.instantaneous_pitch(signal, STEP, 0.2, band=(50, 150)).frequencies, 100.0, atol=1e-2)


# Broken input -------------------------------------------------------------------------------------------------------

TONE = np.sin(2 * np.pi * 100 * np.arange(1000) * 1e-3)
NOT_FINITE = np.where(np.arange(1000) == 7, np.nan, TONE)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: analysis.spectrum(NOT_FINITE, 1e-3), "`signal` must be finite, but is nan at index 7"),
        (lambda: analysis.spectrum(TONE[:10], 1e-3), "at least 16 samples, but is 10"),
        (lambda: analysis.spectrum(TONE.reshape(10, 10, 10), 1e-3), r"shape \(10, 10, 10\)"),
        (lambda: analysis.spectrum(TONE, 0.0), "`interval` must be positive"),
        (lambda: analysis.spectrum(TONE, 1e-3, window="bogus"), "name a window"),
        (lambda: analysis.spectrum(TONE, 1e-3, padding=0), "`padding` must be at least 1"),
        (lambda: analysis.lines(np.ones(1000), 1e-3), "vary in time"),
        (lambda: analysis.lines(TONE, 1e-3, count=3, threshold=0.1), "exclude one another"),
        (lambda: analysis.lines(TONE, 1e-3, count=900), "not exceed the"),
        (lambda: analysis.lines(TONE, 1e-3, near=[100.0, 101.5]), "2 Hz apart.*101.5 Hz are 1.5 Hz apart"),
        (lambda: analysis.lines(TONE, 1e-3, near=[600.0]), r"\(2.0, 500.0\) Hz, but is 600"),
        (lambda: analysis.lines(TONE, 1e-3, near=[100.0, 600.0, 50.0]), r"Hz, but is 600\.0 at index 1"),
        (lambda: analysis.lines(TONE, 1e-3, near=[]), "`near` must hold at least one frequency, but is empty"),
        (
            lambda: analysis.lines(TONE, 1e-3, near=[3.0, 6.0, 200.0]),
            "`near` must hold frequencies with a line no further off than half the way to the next of them, but 3 Hz has "
            "none from 1.5 to 4.5 Hz",
        ),
        (lambda: analysis.damped_sinusoids(TONE, 1e-3, [600.0]), "half the sampling rate.*600"),
        (
            lambda: analysis.damped_sinusoids(TONE[:40], 1e-3, np.arange(10, 20)),
            "more samples than the 41 unknowns of 10",
        ),
        (lambda: analysis.damped_sinusoids(TONE, 1e-3, [100.0, 100.0]), "condition number.* 0 resolutions apart"),
        (lambda: analysis.damped_sinusoids(TONE, 1e-3, [100.0, 100.01]), "condition number.*0.01 resolutions apart"),
        (lambda: analysis.damped_sinusoids(TONE, 1e-3, [100.0], decay_rates=[1.0], damped=False), "must be left out"),
        (lambda: analysis.damped_sinusoids(TONE, 1e-3, [100.0], decay_rates=[1.0, 2.0]), "decay_rates"),
        (lambda: analysis.damped_sinusoids(np.ones(1000), 1e-3, [100.0]), "vary in time"),
        (lambda: analysis.damped_sinusoids(TONE, 1e-3, [104.0]), "within .* Hz of a line, but is 104 Hz"),
        (lambda: analysis.instantaneous_pitch(TONE, 1e-3, 2.0), "lie in .* s, 16 samples to the whole signal"),
        (lambda: analysis.instantaneous_pitch(TONE, 1e-3, 0.1, band=(200.0, 100.0)), "hold a multiple"),
        (lambda: analysis.instantaneous_pitch(TONE[:, None], 1e-3, 0.1), "shape"),
        (lambda: analysis.uniform_interval([0.0, 1.0, 2.1, 3.0]), "spaced by 1, but is 2.1 at index 2, 0.1 off"),
        (lambda: analysis.instantaneous_pitch(np.full(1000, 1 / 3), 1e-3, 0.1), "vary in each window, but is constant"),
        (lambda: analysis.uniform_interval([1.0, 0.0]), "`times` must grow"),
    ],
)
def test_broken_input_is_refused_with_its_numbers(call: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()


@pytest.mark.parametrize(
    "call",
    [
        lambda x: analysis.lines(x, 1e-3),
        lambda x: analysis.instantaneous_pitch(x, 1e-3, 0.1),
        lambda x: analysis.spectrum(x, 1e-3),
        lambda x: analysis.damped_sinusoids(x, 1e-3, [440.0]),
    ],
)
def test_a_complex_signal_is_refused(call: Any) -> None:
    with pytest.raises(TypeError, match="`signal` must be real, but is complex"):
        call(TONE + 0j)


def noisy_tone(noise: float, rng: np.random.Generator) -> Array:
    """A line of 440 Hz that decays at 2/s, 1.2 s at 10 kHz, in white noise."""
    times = np.arange(12_000) * 1e-4
    return ringing(times, np.array([440.0]), np.array([2.0]), np.ones(1)) + noise * rng.normal(size=len(times))


def test_a_threshold_below_the_noise_is_refused_at_once(rng: np.random.Generator) -> None:
    begun = time.process_time()
    with pytest.raises(ValueError, match=r"`threshold` must ask for at most 500 lines .*, but is met by 1\d\d\d peaks"):
        analysis.lines(noisy_tone(1e-4, rng), 1e-4, threshold=1e-6)
    assert time.process_time() - begun < 1.0


@pytest.mark.parametrize("noise", [1e-3, 1e-7, 1e-9])
def test_peaks_of_noise_have_finite_heights_and_leave_the_line_alone(noise: float, rng: np.random.Generator) -> None:
    """Without limits some peak of noise comes out as a line that grows by exp(700) or stands 1e7 times too high."""
    signal = noisy_tone(noise, rng)
    found = analysis.lines(signal, 1e-4, count=150)
    assert np.isfinite([found.frequencies, found.decay_rates, found.amplitudes]).all()
    k = int(np.argmax(found.amplitudes))
    alone = analysis.lines(signal, 1e-4, count=1)
    assert found.frequencies[k] == pytest.approx(440.0, abs=10 * noise + 1e-6)
    assert found.amplitudes[k] == pytest.approx(alone.amplitudes[0], rel=10 * noise + 1e-6)


def test_the_interval_of_uniform_times_is_theirs() -> None:
    assert analysis.uniform_interval(3.0 + 0.25 * np.arange(1000)) == pytest.approx(0.25, rel=1e-12)


def test_input_is_left_as_it_was(rng: np.random.Generator) -> None:
    signal = rng.normal(size=(500, 2))
    signal.setflags(write=False)
    analysis.spectrum(signal, 0.1)
    found = analysis.lines(signal, 0.1, count=1)
    analysis.damped_sinusoids(signal, 0.1, found.frequencies, damped=False)
