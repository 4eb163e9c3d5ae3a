"""The fastest OpenMM platform for a model, by a short measurement."""

from __future__ import annotations

import math
import time
import warnings
from typing import Any

import numpy as np
import openmm as mm
from openmm import unit

from openmm_filament import _checks as check
from openmm_filament import units
from openmm_filament.model import Model

__all__ = ["GPUS", "fastest_platform", "needed_precision", "platform_properties"]

GPUS = ("CUDA", "HIP", "OpenCL")
"""Platforms that run on graphics cards."""

_WORTH_TRYING = 30e-6
"""Time of one step on Reference, in seconds, below which no other platform can win: the CPU platform spends 40 to 240 us
a step on waking its threads (measured with 10 beads), a GPU some 50 us on starting its kernels."""

_SMALL_ANGLE = 0.03
"""Bending angle in rad down to which mixed precision is trusted: acos in single precision is then good to 1e-4."""

_measured: dict[tuple[Any, ...], str] = {}


def needed_precision(model: Model, temperature: unit.Quantity | None = None) -> str:
    """ "double" or "mixed": whether single precision will do for the forces.

    It will not without a temperature: strains and angles of mechanical motion may be as small as they like. Thermal
    angles are judged by the rest angles and by their size sqrt(k_B T/alpha).
    """
    if temperature is None:
        return "double"
    kt = units.BOLTZMANN * units.number("temperature", temperature, "temperature") / model.scale.energy
    for interaction in model.interactions:
        if interaction.term.family != "bending" or not len(interaction.beads):
            continue
        rest = interaction.parameters.get("beta0", np.zeros(1))
        smallest = np.sqrt(kt / interaction.parameters["alpha"].max() + rest.min() ** 2)
        if smallest < _SMALL_ANGLE:
            return "double"
    return "mixed"


def platform_properties(
    model: Model, platform: mm.Platform | str, temperature: unit.Quantity | None = None
) -> dict[str, str]:
    """Properties for a Context or Simulation on `platform`: the precision that the model needs, where there is a choice.

    `platform` may be its name. The properties are for one Context; a Platform is one object per process, so its defaults
    are left alone.
    """
    name = platform if isinstance(platform, str) else platform.getName()
    check.one_of("platform", name, [mm.Platform.getPlatform(i).getName() for i in range(mm.Platform.getNumPlatforms())])
    if name in GPUS:
        return {"Precision": needed_precision(model, temperature)}
    return {}


def fastest_platform(model: Model, temperature: unit.Quantity | None = None) -> mm.Platform:
    """The platform with the shortest measured time per step, among those with the precision that the model needs.

    Each candidate makes a few Verlet steps of the model; the choice is kept for models of this kind and size for the
    rest of the process. Reference is measured first, and a platform is not started at all where it cannot win.
    The CPU platform computes custom forces in double precision. Platforms that cannot run the model are passed over
    with a warning that says why.
    """
    precision = needed_precision(model, temperature)
    size = int(model.starts[-1])
    key = (round(4 * math.log2(max(size, 1))), tuple(sorted(model.groups)), precision)
    if key not in _measured:
        _measured[key] = _measure(model, precision)
    return mm.Platform.getPlatformByName(_measured[key])


def _measure(model: Model, precision: str) -> str:
    available = [mm.Platform.getPlatform(i).getName() for i in range(mm.Platform.getNumPlatforms())]
    best, shortest = "Reference", _seconds_per_step(model, "Reference", {})
    baseline = shortest
    for name in available:
        if name == "Reference" or baseline < _WORTH_TRYING:
            continue
        try:
            seconds = _seconds_per_step(model, name, {"Precision": precision} if name in GPUS else {})
        except mm.OpenMMException as error:
            warnings.warn(
                f"Platform {name} cannot run this model in {precision} precision ({error}); it is passed over.",
                stacklevel=4,
            )
            continue
        if seconds < shortest:
            best, shortest = name, seconds
    return best


def _seconds_per_step(model: Model, name: str, properties: dict[str, str]) -> float:
    """The median of five short runs at a time step too small to move anything."""
    integrator = mm.VerletIntegrator(1e-9)
    context = mm.Context(model.system, integrator, mm.Platform.getPlatformByName(name), properties)
    context.setPositions(model.positions)
    integrator.step(2)
    steps, spent = 1, 0.0
    while spent < 1e-3:
        steps *= 2
        spent = _timed(context, integrator, steps)
        if spent > 0.2:  # a large model: one measurement is enough
            return spent / steps
    return float(np.median([_timed(context, integrator, steps) for _ in range(5)])) / steps


def _timed(context: mm.Context, integrator: mm.Integrator, steps: int) -> float:
    start = time.perf_counter()
    integrator.step(steps)
    context.getState(positions=True)  # waits for a GPU, which an empty State does not
    return time.perf_counter() - start
