"""Masses on springs: nine of them against their exact lines, and more and more against the continuous string."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
import openmm as mm
from numpy.typing import NDArray
from openmm import unit

import openmm_filament as of
from systems import mass_spring
from systems.error_vs_runtime.settings import Order, Setting, Study
from systems.error_vs_runtime.sweeps.variants import PLAIN, integrators_at, orders, variants
from systems.error_vs_runtime.sweeps.vibrations import Scene, measure
from systems.mass_spring import table
from systems.mass_spring.chain import Chain, continuum_frequency

__all__ = ["mass_spring_studies"]

Array = NDArray[np.float64]


def _lines(setting: Setting) -> tuple[Array, Array, Array]:
    chain = Chain(setting.segments)
    shapes = np.zeros((chain.masses, chain.masses + 2))
    shapes[:, 1:-1] = chain.shapes
    return chain.frequencies, chain.frequencies, shapes


def _first(setting: Setting) -> tuple[Array, Array, Array]:
    lines, _, shapes = _lines(setting)
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
    default = Setting(9, mass_spring.PHASE / limit, "PEFRL")
    steps = (0.4, 0.1, 0.02) if quick else (0.8, 0.4, 0.2, 0.1, 0.05, 0.025, 0.012, 0.006, 0.003)
    scene = Scene(lambda s: Chain(s.segments).model, partial(_moved, first=True), _lines, 0.1, 1)
    settings = [
        *integrators_at(9, steps, PLAIN),
        *integrators_at(9, (0.8, 0.4, 0.2) if quick else (0.8, 0.4, 0.2, 0.1), ("PEFRL",)),
        default,
        *variants(Setting(9, 0.2), opencl=True, form=False)[: 2 if quick else None],
    ]
    long = Scene(lambda s: Chain(s.segments).model, partial(_moved, first=False), _first, 0.025, 1)
    masses = (1, 3, 7, 15, 31, 63, 127, 255) if quick else (1, 3, 7, 15, 31, 63, 127, 255, 511, 1023)
    digit = (table.DIGIT - 0.005) / float(chain.frequencies[-1])
    return [
        Study(
            "mass_spring", "lines of 9 masses", "exact chain", partial(measure, scene), settings,
            orders((*PLAIN, "PEFRL"), 1e-8, 0.45), default, digit, seconds=2.0 if quick else 3.0,
        ),
        Study(
            "mass_spring", "first line of a string", "continuous string", partial(measure, long),
            [Setting(n, step) for n in masses for step in (0.1, 0.4)],
            [Order("masses", "segments", -1.0, lambda s: s.step == 0.1 and s.segments >= 15)], seconds=0.8 if quick else 6.5,
        ),
    ]  # fmt: skip
