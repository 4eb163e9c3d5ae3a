"""The systems that swing: what each is asked, what it is held against, and which settings are tried."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
import openmm as mm
from numpy.typing import NDArray
from openmm import unit
from scipy import linalg

import openmm_filament as of
from systems import mass_spring, strings, weighted_string, xylophone_bar
from systems.error_vs_runtime.integrators import available
from systems.error_vs_runtime.settings import Order, Setting, Study
from systems.error_vs_runtime.sweeps.vibrations import Scene, measure
from systems.guitar_string import report, soft
from systems.mass_spring import table
from systems.mass_spring.chain import Chain, continuum_frequency
from systems.weighted_string import chain as weighted
from systems.xylophone_bar import bar, judgement

__all__ = ["bar_studies", "guitar_studies", "loaded_string", "mass_spring_studies", "weighted_studies"]

Array = NDArray[np.float64]

PARTIALS = 10
"""Lines of the strings that are held against the continuous body."""

FRACTIONS, QUICK_FRACTIONS = (0.9, 0.7, 0.5, 0.25), (0.9, 0.6)
"""Time steps over the stability limit."""

ORDER_STEPS = (0.8, 0.4, 0.2)
"""The same where the order of convergence is measured."""

ORDER_SEGMENTS = 45
"""Segments of the chain that it is measured with: bending by arctangent, for the rounding of the arccosine hides small errors."""


def _integrators(segments: int, steps: tuple[float, ...], names: tuple[str, ...], **more: Any) -> list[Setting]:
    """Every integrator at every step."""
    return [Setting(segments, step, name, **more) for name in names for step in steps]


def _variants(base: Setting, *, opencl: bool, form: bool = True) -> list[Setting]:
    """The same on other platforms, precisions and with the other form of bending."""
    out = [replace(base, form="arctangent")] if form else []
    if "CPU" in available():
        out.append(replace(base, platform="CPU"))
    if opencl and "OpenCL" in available():
        out += [replace(base, platform="OpenCL", precision=p) for p in ("single", "mixed", "double")]
    return out


def _of(name: str, longest: float, setting: Setting) -> bool:
    return setting.integrator == name and setting.platform == "Reference" and setting.step <= longest


def _orders(names: tuple[str, ...], floor: float, longest: float = 0.85) -> list[Order]:
    theory = {"PEFRL": 4.0}
    return [
        Order(f"{name}, time step", "step", theory.get(name, 2.0), partial(_of, name, longest), floor) for name in names
    ]


DAMPED, PLAIN = ("Verlet", "Euler-Cromer", "LangevinMiddle"), ("Verlet", "Euler-Cromer")


def _mass_spring_lines(setting: Setting) -> tuple[Array, Array, Array]:
    chain = Chain(setting.segments)
    shapes = np.zeros((chain.masses, chain.masses + 2))
    shapes[:, 1:-1] = chain.shapes
    return chain.frequencies, chain.frequencies, shapes


def _mass_spring_first(setting: Setting) -> tuple[Array, Array, Array]:
    lines, _, shapes = _mass_spring_lines(setting)
    return lines[:1], np.array([continuum_frequency()]), shapes[:1]


def _moved(context: mm.Context, model: of.Model, *, first: bool) -> None:
    """Masses aside: the first alone, which sets all modes in motion, or all in the shape of the first mode."""
    masses = int(model.starts[-1]) - 2
    x = model.positions.value_in_unit(unit.nanometer).copy()
    spacing = float(x[1, 0] - x[0, 0])
    shape = np.eye(masses)[0] if first else np.sin(np.arange(1, masses + 1) * math.pi / (masses + 1))
    x[1:-1, 1] += table.AMPLITUDE * spacing * shape
    context.setPositions(x * unit.nanometer)


def mass_spring_studies(*, quick: bool) -> list[Study]:
    """Nine masses against their exact lines, and up to 1023 against the continuous string."""
    chain = Chain(9)
    limit = of.stable_timestep(chain.model).value_in_unit(unit.second) * chain.cutoff
    default = Setting(9, mass_spring.PHASE / limit)
    steps = (0.4, 0.1, 0.02) if quick else (0.8, 0.4, 0.2, 0.1, 0.05, 0.025, 0.012, 0.006, 0.003)
    scene = Scene(lambda s: Chain(s.segments).model, partial(_moved, first=True), _mass_spring_lines, 0.1, 1)
    settings = [
        *_integrators(9, steps, PLAIN),
        *_integrators(9, (0.8, 0.4, 0.2) if quick else (0.8, 0.4, 0.2, 0.1), ("PEFRL",)),
        default,
        *_variants(Setting(9, 0.2), opencl=True, form=False)[: 2 if quick else None],
    ]
    long = Scene(lambda s: Chain(s.segments).model, partial(_moved, first=False), _mass_spring_first, 0.025, 1)
    masses = (1, 3, 7, 15, 31, 63, 127, 255) if quick else (1, 3, 7, 15, 31, 63, 127, 255, 511, 1023)
    digit = (table.DIGIT - 0.005) / float(chain.frequencies[-1])
    return [
        Study(
            "mass_spring", "lines of 9 masses", "exact chain", partial(measure, scene), settings,
            _orders((*PLAIN, "PEFRL"), 1e-8, 0.45), default, digit, share=3.0,
        ),
        Study(
            "mass_spring", "first line of a string", "continuous string", partial(measure, long),
            [Setting(n, step) for n in masses for step in (0.1, 0.4)],
            [Order("masses", "segments", -1.0, lambda s: s.step == 0.1 and s.segments >= 15)], share=1.0,
        ),
    ]  # fmt: skip


def _resting(context: mm.Context, model: of.Model) -> None:
    """A pluck sets it in motion."""


def _plucked(setting: Setting, weaker: float = 1.0) -> of.Model:
    pluck = strings.Pluck(max(1, round(setting.segments / 30)), 0.01 / weaker)
    return strings.string(setting.segments, [pluck], softer=setting.softer, form=setting.form)  # type: ignore[arg-type]


def _is_damped(setting: Setting) -> bool:
    """Whether the integrator lets the strings decay, as their systems need it; the lines are held against its own."""
    return setting.integrator in {"Euler-Cromer", "LangevinMiddle"}


def _damping(setting: Setting) -> float:
    return strings.DAMPING if _is_damped(setting) else 0.0


def _guitar_lines(count: int, setting: Setting) -> tuple[Array, Array, Array]:
    n = np.arange(1, count + 1)
    lines = strings.beats(strings.discrete_law(n, setting.segments), _damping(setting)).frequencies
    return lines, lines, soft.sines(setting.segments, count)


def _guitar_body(setting: Setting) -> tuple[Array, Array, Array]:
    lines, _, shapes = _guitar_lines(PARTIALS, setting)
    body = strings.stiff_law(np.arange(1, PARTIALS + 1))
    return lines, strings.beats(body, _damping(setting)).frequencies, shapes


def _time_step_alone(system: str, scene: Scene) -> Study:
    """The order of a string's lines in the time step, at an amplitude so small that nothing else shows."""
    return Study(
        system, f"time step alone, {ORDER_SEGMENTS} segments", "exact discrete string", partial(measure, scene),
        _integrators(ORDER_SEGMENTS, ORDER_STEPS, DAMPED, softer=strings.SOFTER, form="arctangent"),
        _orders(DAMPED, 1e-7), share=3.0,
    )  # fmt: skip


def guitar_studies(*, quick: bool) -> list[Study]:
    """Twenty lines of the string of 200 beads, and ten of the continuous stiff one."""
    limit = of.stable_timestep(strings.string(soft.SEGMENTS)).value_in_unit(unit.second)
    default = Setting(
        soft.SEGMENTS, 1 / (strings.RATE * strings.EVERY) / limit, "LangevinMiddle", softer=strings.SOFTER
    )
    steps = QUICK_FRACTIONS if quick else FRACTIONS
    scene = Scene(
        _plucked, _resting, partial(_guitar_lines, soft.HARMONICS), 0.02 if quick else 0.04, 0, strings.PLUCKING,
        strings.DAMPING,
    )  # fmt: skip
    weak = replace(scene, build=partial(_plucked, weaker=5.0), seconds=0.006 if quick else 0.015)
    body = replace(scene, lines=_guitar_body, seconds=0.03)
    settings = [
        *_integrators(soft.SEGMENTS, steps, DAMPED, softer=strings.SOFTER),
        *(() if quick else (Setting(soft.SEGMENTS, 0.9, "PEFRL", softer=strings.SOFTER),)),
        default,
        *_variants(Setting(soft.SEGMENTS, 0.8, softer=strings.SOFTER), opencl=not quick),
    ]
    sizes = (24, 36, 60, 100) if quick else (24, 36, 50, 72, 100, 150, 201)
    return [
        Study(
            "guitar_string", "lines 1 to 20 of 200 beads", "exact discrete string", partial(measure, scene), settings,
            (), default, report.LINE, share=5.0, admitted=_is_damped,
        ),
        _time_step_alone("guitar_string", weak),
        Study(
            "guitar_string", "lines 1 to 10 of the string", "stiff string (2.11)", partial(measure, body),
            [Setting(n, step, softer=soft_) for n in sizes for soft_, step in ((64.0, 0.2), (64.0, 0.8), (900.0, 0.9))],
            [Order("segments", "segments", -2.0, lambda s: s.step == 0.2)], share=3.0,
        ),
    ]  # fmt: skip


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
    lines = strings.beats(modes.undamped[:count], _damping(setting)).frequencies
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
    return lines, strings.beats(loaded_string(PARTIALS), _damping(setting)).frequencies, shapes


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
        _resting,
        partial(_weighted_lines, weighted.LINES),
        0.02 if quick else 0.03,
        0,
        strings.PLUCKING,
        strings.DAMPING,
    )
    weak = replace(scene, build=partial(_loaded, weaker=25.0), seconds=0.006 if quick else 0.015)
    body = replace(scene, lines=_weighted_body, seconds=0.04)
    steps = QUICK_FRACTIONS if quick else FRACTIONS
    settings = [
        *_integrators(weighted.SEGMENTS, steps, DAMPED, softer=strings.SOFTER),
        *(() if quick else (Setting(weighted.SEGMENTS, 0.9, "PEFRL", softer=strings.SOFTER),)),
        default,
        *_variants(Setting(weighted.SEGMENTS, 0.8, softer=strings.SOFTER), opencl=False),
    ]
    sizes = (30, 60, 90, 150) if quick else (30, 60, 90, 150, 210, 300)
    return [
        Study(
            "weighted_string", "lines 1 to 20 of 210 segments", "exact discrete string", partial(measure, scene), settings,
            (), default, stated, share=5.0, admitted=_is_damped,
        ),
        _time_step_alone("weighted_string", weak),
        Study(
            "weighted_string", "lines 1 to 10 of the string", "continuous loaded string", partial(measure, body),
            [Setting(n, step, softer=soft_) for n in sizes for soft_, step in ((64.0, 0.2), (64.0, 0.8), (900.0, 0.9))],
            [Order("segments", "segments", -2.0, lambda s: s.step == 0.2 and s.segments >= 90, kind="claim")], share=3.0,
        ),
    ]  # fmt: skip


@cache
def _bar_shapes(segments: int) -> Array:
    """What projects on the first five modes, (5, N): exact shapes times masses."""
    model = bar.free(segments)
    _, shapes = bar.modes(model, 5)
    return np.asarray(shapes * model.masses)


def _bar_lines(setting: Setting) -> tuple[Array, Array, Array]:
    lines = bar.discrete_free(5, setting.segments)
    return lines, lines, _bar_shapes(setting.segments)


def _bar_body(setting: Setting) -> tuple[Array, Array, Array]:
    return bar.discrete_free(5, setting.segments), bar.beam(), _bar_shapes(setting.segments)


def _struck(context: mm.Context, model: of.Model, weaker: float = 1.0) -> None:
    place, rise = xylophone_bar.PLACES["free"], xylophone_bar.RISES["free"] / weaker
    bar.set_velocities(context, model, bar.strike(model, place, rise=rise))


def bar_studies(*, quick: bool) -> list[Study]:
    """Five lines of the free bar: of 60 segments as `--quick` has it, and of the Euler-Bernoulli bar."""

    def build(setting: Setting) -> of.Model:
        return bar.free(setting.segments, form=setting.form)  # type: ignore[arg-type]

    segments = xylophone_bar.QUICK["free"]
    default = Setting(segments, xylophone_bar.step_of(segments))
    full = Setting(xylophone_bar.FULL["free"], xylophone_bar.step_of(xylophone_bar.FULL["free"]))
    scene, body = (Scene(build, _struck, lines, 2e-3, 0) for lines in (_bar_lines, _bar_body))
    weak = replace(scene, begin=partial(_struck, weaker=10.0))
    steps = (0.8,) if quick else (0.95, 0.8, 0.5, 0.25, 0.12)
    sizes = (10, 15, 20, 30, 60) if quick else (10, 15, 20, 30, 45, 60, 90, 120)
    variants = _variants(Setting(segments, 0.5), opencl=not quick)
    return [
        Study(
            "xylophone_bar", "lines 1 to 5 of 60 segments", "exact free chain", partial(measure, scene),
            [*_integrators(segments, steps, PLAIN), Setting(segments, 0.8, "PEFRL"), default, *variants],
            (), default, judgement.TOLERANCE, share=4.0,
        ),
        Study(
            "xylophone_bar", "time step alone, 30 segments", "exact free chain", partial(measure, weak),
            _integrators(30, ORDER_STEPS, PLAIN, form="arctangent"), _orders(PLAIN, 1e-8), share=2.0,
        ),
        Study(
            "xylophone_bar", "lines 1 to 5 of the bar", "Euler and Bernoulli", partial(measure, body),
            [Setting(n, step) for n in sizes for step in (0.25, 0.8)] + ([] if quick else [full]),
            [Order("segments", "segments", -2.0, lambda s: s.step == 0.25 and s.segments >= 20)], share=4.0,
        ),
    ]  # fmt: skip
