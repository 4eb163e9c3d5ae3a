"""The loaded string: where it is heavy, its exact modes by a route that knows no OpenMM, and its motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

import openmm_filament as of
from openmm_filament import analysis
from systems import stage, strings
from systems.strings import Pluck

__all__ = ["CASES", "LINES", "Case", "Modes", "Playing", "exact", "matrices", "play", "sounding"]

Array = NDArray[np.float64]
Form = Literal["arccosine", "arctangent"]

SEGMENTS = 210
"""209 moving beads, so that the middle, 2 L/5 and 2 L/3 are beads; the thesis's 200 have none there."""

HEAVIER = 40.0
HEAVY_MASS = (HEAVIER - 1) * strings.DENSITY * strings.LENGTH / SEGMENTS
"""kg, added to a bead: it becomes 40 times as heavy as the others of 210 segments."""

LINES = 20
_FITTED = 26
"""Lines that are fitted together: those above the last that is reported would disturb it."""
_FIT_SECONDS = 1.0


@dataclass(frozen=True)
class Case:
    """Heavy beads at these parts of the length, and their damping rate in 1/s."""

    name: str
    places: tuple[Fraction, ...]
    damping: float = strings.DAMPING

    @property
    def label(self) -> str:
        """In words."""
        at = " and ".join(f"{place.numerator}L/{place.denominator}".replace("1L", "L") for place in self.places)
        more = f", heavy beads damped at {self.damping:.0f}/s" if self.damping != strings.DAMPING else ""
        return f"({self.name}) heavy at {at}{more}"

    def heavy(self, segments: int) -> list[int]:
        """The heavy beads; their places must be beads."""
        beads = [place * segments for place in self.places]
        if any(bead.denominator != 1 for bead in beads):
            raise ValueError(
                f"Argument `segments` must put a bead at each of {', '.join(map(str, self.places))}, but is {segments}."
            )
        return [int(bead) for bead in beads]

    def masses(self, segments: int) -> Array:
        """Of all beads in kg, (segments + 1,)."""
        masses = np.full(segments + 1, strings.DENSITY * strings.LENGTH / segments)
        masses[self.heavy(segments)] += HEAVY_MASS
        return masses

    def rates(self, segments: int) -> Array:
        """Damping of all beads in 1/s, (segments + 1,)."""
        rates = np.full(segments + 1, strings.DAMPING)
        rates[self.heavy(segments)] = self.damping
        return rates

    def factors(self, segments: int) -> dict[int, float]:
        """What the masses of the heavy beads are multiplied by."""
        plain = strings.DENSITY * strings.LENGTH / segments
        return dict.fromkeys(self.heavy(segments), 1 + HEAVY_MASS / plain)

    @property
    def alike(self) -> bool:
        """Whether all beads are damped alike."""
        return self.damping == strings.DAMPING

    @property
    def form(self) -> Form:
        """Of the bending: hard damping leaves bends so small that OpenMM's arccosine disturbs them."""
        return "arccosine" if self.alike else "arctangent"

    def model(self, segments: int, *, weaker: float = 1.0, form: Form | None = None) -> of.Model:
        """The string, plucked near L/4 in x (0.01 N) and near L/30, a node of none of its lines, in y (0.05 N).

        Both plucks are divided by `weaker`; `form` is that of the bending, by default the case's.
        """
        places = (round(segments / 4), 0.01, 0), (round(segments / 30), 0.05, 1)
        plucks = [Pluck(bead, force / weaker, direction) for bead, force, direction in places]
        return strings.string(
            segments,
            plucks,
            damping=self.rates(segments),
            heavy=self.factors(segments),
            form=form or self.form,
        )


_TWO = (Fraction(2, 5), Fraction(2, 3))
CASES = (Case("a", (Fraction(1, 2),)), Case("b", _TWO), Case("c", _TWO, damping=120.0))


def matrices(segments: int, tension: float = strings.TENSION) -> Array:
    """Stiffness of the moving beads across the string in N/m, (segments - 1, segments - 1), of straight hinged beads.

    `T/a sum (x_{i+1} - x_i)^2/2 + (E I/a^3) sum (x_{i+1} - 2 x_i + x_{i-1})^2/2` with `x_0 = x_segments = 0`.
    """
    a = strings.LENGTH / segments
    first = np.diff(np.eye(segments + 1), axis=0)[:, 1:-1]
    second = np.diff(np.eye(segments + 1), 2, axis=0)[:, 1:-1]
    return np.asarray(tension / a * first.T @ first + strings.BENDING / a**3 * second.T @ second)


@dataclass(frozen=True, eq=False)
class Modes:
    """Exact lines in rising order: (K,) arrays in Hz and 1/s.

    Attributes
    ----------
    undamped : (K,) array
    frequencies, decay_rates : (K,) arrays
        With damping.
    stepped, stepped_rates : (K,) arrays
        With damping and Euler-Cromer's time step.
    shapes : (K, segments + 1) array
        Of the undamped modes, largest displacement 1.
    """

    undamped: Array
    frequencies: Array
    decay_rates: Array
    stepped: Array
    stepped_rates: Array
    shapes: Array


def exact(case: Case, segments: int, timestep: float, tension: float = strings.TENSION) -> Modes:
    """All modes across the string, from its matrices, in rising order of their frequencies."""
    masses, rates = case.masses(segments)[1:-1], case.rates(segments)[1:-1]
    stiffness = matrices(segments, tension)
    squared, vectors = linalg.eigh(stiffness, np.diag(masses))
    size = len(masses)
    pull, drag = -stiffness / masses[:, None], -np.diag(rates)
    flow = np.block([[np.zeros((size, size)), np.eye(size)], [pull, drag]])
    felt = pull * (1 - strings.DAMPING * timestep / 2 if case.alike else 1.0)  # see stage.alike
    kick = np.block([[np.eye(size), np.zeros((size, size))], [timestep * felt, np.eye(size) + timestep * drag]])
    drift = np.block([[np.eye(size), timestep * np.eye(size)], [np.zeros((size, size)), np.eye(size)]])
    smooth = linalg.eigvals(flow)
    steps = np.log(linalg.eigvals(drift @ kick)) / timestep
    lines = []
    for values in (smooth, steps):
        rising = np.sort_complex(1j * values[values.imag > 0].conj())  # real part: angular frequency, imaginary: decay
        lines += [rising.real / (2 * np.pi), -rising.imag]
    shapes = np.zeros((size, segments + 1))
    shapes[:, 1:-1] = (vectors / np.abs(vectors).max(axis=0)).T
    return Modes(np.sqrt(squared) / (2 * np.pi), lines[0], lines[1], lines[2], lines[3], shapes)


@dataclass(frozen=True, eq=False)
class Playing:
    """A run of a case.

    Attributes
    ----------
    frequencies, decay_rates : (LINES,) arrays
        Hz and 1/s, fitted to the motion after the pluck.
    strengths : (LINES,) array
        Amplitude of each line in the sound, in m.
    sound : (T,) array
        Mean over the beads of x after the pluck, in m.
    beads : (T', N, 2) array
        x and y of all beads in m, from the start.
    """

    case: Case
    model: of.Model
    modes: Modes
    rate: float
    timestep: float
    frequencies: Array
    decay_rates: Array
    strengths: Array
    sound: Array
    beads: Array


def play(
    case: Case,
    segments: int,
    seconds: float,
    rate: float,
    every: int,
    progress: Callable[[float], None] | None = None,
    kept: float = 0.25,
) -> Playing:
    """Pluck, run and fit."""
    model, timestep = case.model(segments), 1 / (rate * every)
    context = strings.start(model, rate, every, alike=case.alike)
    modes = exact(case, segments, timestep)
    masses = case.masses(segments)
    shapes = modes.shapes[:_FITTED]
    shares = shapes * masses / np.sum(shapes**2 * masses, axis=1)[:, None]
    weights = np.vstack([np.append(0.0, np.append(np.full(segments - 1, 1 / (segments - 1)), 0.0)), shares])
    first = of.record(model, context, round(kept * rate), every, observe=lambda x: x.astype(np.float32)[:, :2])
    rest = of.record(
        model, context, round((seconds - kept) * rate), every, observe=lambda x: weights @ x[:, :2], progress=progress
    )
    beads = stage.metres(first.values.astype(float))
    heard = np.concatenate([np.einsum("kj,tjd->tkd", weights, beads), stage.metres(rest.values)[1:]])
    heard = heard[int(np.argmax(strings.released(first))) :]
    fit = _fit(heard[:, 1:], rate)
    sound = heard[:, 0, 0]
    decaying = np.exp((2j * np.pi * fit.frequencies - fit.decay_rates) * np.arange(len(sound))[:, None] / rate)
    parts = np.linalg.lstsq(np.hstack([decaying.real, -decaying.imag]), sound, rcond=None)[0].reshape(2, -1)
    strengths = np.hypot(*parts)
    return Playing(
        case,
        model,
        modes,
        rate,
        timestep,
        fit.frequencies[:LINES],
        fit.decay_rates[:LINES],
        strengths[:LINES],
        sound,
        beads,
    )


def sounding(
    case: Case, segments: int, seconds: float, rate: float, every: int, *, weaker: float, form: Form
) -> tuple[Array, Modes]:
    """The sound after the pluck, as in `Playing`, and the exact modes; for `weaker` and `form` see `Case.model`."""
    context = strings.start(model := case.model(segments, weaker=weaker, form=form), rate, every, alike=case.alike)
    motion = of.record(model, context, round(seconds * rate), every, observe=lambda x: x[1:-1, 0].mean())
    return stage.metres(motion.values)[strings.released(motion)], exact(case, segments, 1 / (rate * every))


def _fit(motion: Array, rate: float) -> analysis.DampedSinusoids:
    """All lines fitted together to the motion (T, _FITTED, 2) of the modes after the pluck that moves each more, brought to
    the same size.

    Damping that differs between beads couples the modes: a column shows lines of others too.
    """
    motion = motion[: round(_FIT_SECONDS * rate)]
    sizes = np.abs(motion).max(axis=0)
    stronger = sizes.argmax(axis=1)[:, None]
    columns = np.take_along_axis(motion, stronger[None], 2)[:, :, 0] / np.take_along_axis(sizes, stronger, 1)[:, 0]
    guesses = [float(analysis.lines(column, 1 / rate, count=1).frequencies[0]) for column in columns.T]
    return analysis.damped_sinusoids(columns, 1 / rate, guesses)
