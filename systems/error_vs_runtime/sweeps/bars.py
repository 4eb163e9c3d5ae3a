"""The free bar: its exact discrete lines, and those of Euler and Bernoulli."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial

import numpy as np
import openmm as mm
from numpy.typing import NDArray

import openmm_filament as of
from systems import xylophone_bar
from systems.error_vs_runtime.settings import Order, Setting, Study
from systems.error_vs_runtime.sweeps.variants import ORDER_STEPS, PLAIN, integrators_at, orders, variants
from systems.error_vs_runtime.sweeps.vibrations import Scene, measure
from systems.xylophone_bar import bar, judgement

__all__ = ["bar_studies"]

Array = NDArray[np.float64]


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


def _of_the_thesis(segments: int, scene: Scene) -> Study:
    """The bar of as many segments as a full run of the system has."""
    default = Setting(segments, xylophone_bar.STEP)
    settings = [Setting(segments, 0.95), default, Setting(segments, 0.4), Setting(segments, 0.8, "Euler-Cromer")]
    return Study(
        "xylophone_bar", f"lines 1 to 5 of {segments} segments", "exact free chain", partial(measure, scene), settings,
        (), default, judgement.TOLERANCE, seconds=13.0,
    )  # fmt: skip


def bar_studies(*, quick: bool) -> list[Study]:
    """Five lines of the free bar: of the discrete one, 60 segments as `--quick` has it, and of the Euler-Bernoulli bar."""

    def build(setting: Setting) -> of.Model:
        return bar.free(setting.segments, form=setting.form)  # type: ignore[arg-type]

    segments, fine = xylophone_bar.QUICK["free"], xylophone_bar.FULL["free"]
    default, full = Setting(segments, xylophone_bar.STEP), Setting(fine, xylophone_bar.STEP)
    scene, body = (Scene(build, _struck, lines, 2e-3, 0) for lines in (_bar_lines, _bar_body))
    weak = replace(scene, begin=partial(_struck, weaker=10.0))
    steps = (0.8, 0.4) if quick else (0.95, 0.8, 0.5, 0.25)
    sizes = (10, 15, 20, 30, 60) if quick else (10, 15, 20, 30, 45, 60, 90, 120)
    return [
        Study(
            "xylophone_bar", "lines 1 to 5 of 60 segments", "exact free chain", partial(measure, scene),
            [
                *integrators_at(segments, steps, PLAIN), Setting(segments, 0.8, "PEFRL"), default,
                *variants(Setting(segments, 0.8), opencl=True)[: 1 if quick else None],
            ],
            (), default, judgement.TOLERANCE, seconds=2.2 if quick else 9.0,
        ),
        *(() if quick else (_of_the_thesis(fine, scene),)),
        Study(
            "xylophone_bar", "time step alone, 30 segments", "exact free chain", partial(measure, weak),
            integrators_at(30, ORDER_STEPS, PLAIN, form="arctangent"), orders(PLAIN, 1e-8), seconds=1.0,
        ),
        Study(
            "xylophone_bar", "lines 1 to 5 of the bar", "Euler and Bernoulli", partial(measure, body),
            [Setting(n, step) for n in sizes for step in (0.25, 0.8)] + ([] if quick else [full]),
            [Order("segments", "segments", -2.0, lambda s: s.step == 0.25 and s.segments >= 20)], seconds=0.9 if quick else 6.0,
        ),
    ]  # fmt: skip
