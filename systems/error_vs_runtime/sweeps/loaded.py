"""The string with heavy beads: its exact discrete lines, and those of the continuous loaded string."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache, partial

import numpy as np
from numpy.typing import NDArray
from openmm import unit
from scipy import linalg

import openmm_filament as of
from systems import strings, weighted_string
from systems.error_vs_runtime.settings import Order, Setting, Study
from systems.error_vs_runtime.sweeps.strung import (
    PARTIALS,
    by_step,
    damping,
    is_damped,
    resting,
    time_step_alone,
)
from systems.error_vs_runtime.sweeps.variants import variants
from systems.error_vs_runtime.sweeps.vibrations import Scene, measure
from systems.weighted_string import chain as weighted

__all__ = ["loaded_string", "weighted_studies"]

Array = NDArray[np.float64]

_CASE = weighted.CASES[1]


def _loaded(setting: Setting, weaker: float = 1.0) -> of.Model:
    pluck = strings.Pluck(round(setting.segments / 30), 0.05 / weaker)
    n = setting.segments
    return strings.string(n, [pluck], heavy=_CASE.factors(n), softer=setting.softer, form=setting.form)  # type: ignore[arg-type]


@cache
def _loaded_modes(segments: int) -> weighted.Modes:
    return weighted.exact(_CASE, segments, 1e-6)


def _weighted_lines(count: int, setting: Setting) -> tuple[Array, Array, Array]:
    modes = _loaded_modes(setting.segments)
    shapes = modes.shapes[:count] * _CASE.masses(setting.segments)
    lines = strings.beats(modes.undamped[:count], damping(setting)).frequencies
    return lines, lines, shapes / np.abs(shapes).sum(axis=1, keepdims=True)


@cache
def loaded_string(count: int, sines: int = 1200) -> Array:
    """The first lines (count,) in Hz of the continuous stiff string with the heavy beads of case (b), undamped.

    In sines, which its hinged ends allow: `K` is diagonal, and a point mass m at x adds `m sin_i(x) sin_j(x)` to the masses.
    """
    n = np.arange(1, sines + 1)
    squared = (2 * np.pi * strings.stiff_law(n)) ** 2
    own = strings.DENSITY * strings.LENGTH / 2
    masses = own * np.eye(sines)
    for place in _CASE.places:
        shape = np.sin(np.pi * n * float(place))
        masses += weighted.HEAVY_MASS * np.outer(shape, shape)
    found = linalg.eigh(np.diag(own * squared), masses, eigvals_only=True, subset_by_index=(0, count - 1))
    return np.asarray(np.sqrt(found) / (2 * np.pi))


def _weighted_body(setting: Setting) -> tuple[Array, Array, Array]:
    lines, _, shapes = _weighted_lines(PARTIALS, setting)
    return lines, strings.beats(loaded_string(PARTIALS), damping(setting)).frequencies, shapes


def weighted_studies(*, quick: bool) -> list[Study]:
    """Case (b): twenty lines of 210 segments, and ten of the continuous loaded string."""
    rate, every = weighted_string.RATE
    limit = of.stable_timestep(_loaded(Setting(weighted.SEGMENTS, softer=strings.SOFTER))).value_in_unit(unit.second)
    timestep = 1 / (rate * every)
    default = Setting(weighted.SEGMENTS, timestep / limit, "LangevinMiddle", softer=strings.SOFTER)
    top = float(_loaded_modes(weighted.SEGMENTS).undamped[weighted.LINES - 1])
    stated = 1.2 * ((2 * math.pi * top * timestep) ** 2 / 24 + strings.DAMPING * timestep / 4)
    scene = Scene(
        _loaded,
        resting,
        partial(_weighted_lines, weighted.LINES),
        0.02 if quick else 0.03,
        0,
        strings.PLUCKING,
        strings.DAMPING,
    )
    weak = replace(scene, build=partial(_loaded, weaker=25.0), seconds=0.006 if quick else 0.015)
    body = replace(scene, lines=_weighted_body, seconds=0.04)
    settings = [
        *by_step(Setting(weighted.SEGMENTS, softer=strings.SOFTER), quick=quick),
        default,
        *variants(Setting(weighted.SEGMENTS, 0.9, softer=strings.SOFTER), opencl=False)[: 1 if quick else None],
    ]
    sizes = (30, 60, 90, 150) if quick else (30, 60, 90, 150, 210, 300)
    return [
        Study(
            "weighted_string", "lines 1 to 20 of 210 segments", "exact discrete string", partial(measure, scene), settings,
            (), default, stated, seconds=3.9 if quick else 14.0, admitted=is_damped,
        ),
        time_step_alone("weighted_string", weak, quick=quick),
        Study(
            "weighted_string", "lines 1 to 10 of the string", "continuous loaded string", partial(measure, body),
            [Setting(n, step, softer=soft_) for n in sizes for soft_, step in ((64.0, 0.2), (64.0, 0.8), (900.0, 0.9))],
            [Order("segments", "segments", -2.0, lambda s: s.step == 0.2 and s.segments >= 90, kind="claim")],
            seconds=2.8 if quick else 11.0,
        ),
    ]  # fmt: skip
