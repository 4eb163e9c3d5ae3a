"""The guitar string: its exact discrete lines, and those of the continuous stiff string; what the loaded one shares with it."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import openmm as mm
from numpy.typing import NDArray
from openmm import unit

import openmm_filament as of
from systems import strings
from systems.error_vs_runtime.settings import Order, Setting, Study
from systems.error_vs_runtime.sweeps.variants import DAMPED, ORDER_STEPS, integrators_at, orders, variants
from systems.error_vs_runtime.sweeps.vibrations import Scene, measure
from systems.guitar_string import report, soft

__all__ = [
    "PARTIALS",
    "by_step",
    "damping",
    "guitar_studies",
    "is_damped",
    "resting",
    "time_step_alone",
]

Array = NDArray[np.float64]

PARTIALS = 10
"""Lines of the strings that are held against the continuous body."""

ORDER_SEGMENTS = 45
"""Segments of the chain that it is measured with: bending by arctangent, for the rounding of the arccosine hides small errors."""


def resting(context: mm.Context, model: of.Model) -> None:
    """A pluck sets it in motion."""


def _plucked(setting: Setting, weaker: float = 1.0) -> of.Model:
    pluck = strings.Pluck(max(1, round(setting.segments / 30)), 0.01 / weaker)
    return strings.string(setting.segments, [pluck], softer=setting.softer, form=setting.form)  # type: ignore[arg-type]


def is_damped(setting: Setting) -> bool:
    """Whether the integrator lets the strings decay, as their systems need it; the lines are held against its own."""
    return setting.integrator in {"Euler-Cromer", "LangevinMiddle"}


def damping(setting: Setting) -> float:
    """That of the beads in 1/s, where the integrator knows it."""
    return strings.DAMPING if is_damped(setting) else 0.0


def _guitar_lines(count: int, setting: Setting) -> tuple[Array, Array, Array]:
    n = np.arange(1, count + 1)
    lines = strings.beats(strings.discrete_law(n, setting.segments), damping(setting)).frequencies
    return lines, lines, soft.sines(setting.segments, count)


def _guitar_body(setting: Setting) -> tuple[Array, Array, Array]:
    lines, _, shapes = _guitar_lines(PARTIALS, setting)
    body = strings.stiff_law(np.arange(1, PARTIALS + 1))
    return lines, strings.beats(body, damping(setting)).frequencies, shapes


def by_step(base: Setting, *, quick: bool) -> list[Setting]:
    """Every integrator at long steps and short ones; quick, the short ones for the integrator that the systems use alone."""
    steps = (0.9,) if quick else (0.9, 0.7, 0.5, 0.25)
    out = [replace(base, step=step, integrator=name) for name in DAMPED for step in steps]
    last = (
        replace(base, step=0.6, integrator="LangevinMiddle") if quick else replace(base, step=0.9, integrator="PEFRL")
    )
    return [*out, last]


def time_step_alone(system: str, scene: Scene, *, quick: bool) -> Study:
    """The order of a string's lines in the time step, at an amplitude so small that nothing else shows."""
    steps = ORDER_STEPS[:2] if quick else ORDER_STEPS
    return Study(
        system, f"time step alone, {ORDER_SEGMENTS} segments", "exact discrete string", partial(measure, scene),
        integrators_at(ORDER_SEGMENTS, steps, DAMPED, softer=strings.SOFTER, form="arctangent"),
        orders(DAMPED, 1e-7), seconds=1.0 if quick else 2.2,
    )  # fmt: skip


def guitar_studies(*, quick: bool) -> list[Study]:
    """Twenty lines of the string of 200 beads, and ten of the continuous stiff one."""
    limit = of.stable_timestep(strings.string(soft.SEGMENTS)).value_in_unit(unit.second)
    default = Setting(
        soft.SEGMENTS, 1 / (strings.RATE * strings.EVERY) / limit, "LangevinMiddle", softer=strings.SOFTER
    )
    scene = Scene(
        _plucked, resting, partial(_guitar_lines, soft.HARMONICS), 0.02 if quick else 0.04, 0, strings.PLUCKING,
        strings.DAMPING,
    )  # fmt: skip
    weak = replace(scene, build=partial(_plucked, weaker=5.0), seconds=0.006 if quick else 0.015)
    body = replace(scene, lines=_guitar_body, seconds=0.03)
    settings = [
        *by_step(Setting(soft.SEGMENTS, softer=strings.SOFTER), quick=quick),
        default,
        *variants(Setting(soft.SEGMENTS, 0.9, softer=strings.SOFTER), opencl=True)[: 1 if quick else None],
    ]
    sizes = (24, 36, 60, 100) if quick else (24, 36, 50, 72, 100, 150, 201)
    return [
        Study(
            "guitar_string", "lines 1 to 20 of 200 beads", "exact discrete string", partial(measure, scene), settings,
            (), default, report.LINE, seconds=3.8 if quick else 23.0, admitted=is_damped,
        ),
        time_step_alone("guitar_string", weak, quick=quick),
        Study(
            "guitar_string", "lines 1 to 10 of the string", "stiff string (2.11)", partial(measure, body),
            [Setting(n, step, softer=soft_) for n in sizes for soft_, step in ((64.0, 0.2), (64.0, 0.8), (900.0, 0.9))],
            [Order("segments", "segments", -2.0, lambda s: s.step == 0.2)], seconds=1.4 if quick else 5.5,
        ),
    ]  # fmt: skip
