"""Motion in time: what a run does, recorded as arrays, and plucks that let go while it runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import openmm as mm
from numpy.typing import NDArray
from openmm import app, unit

from openmm_filament import _checks as check
from openmm_filament import units
from openmm_filament.divergence import diagnose, furthest, has_left
from openmm_filament.model import Model

__all__ = ["Motion", "PluckReporter", "pluck_reporter", "record"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Motion:
    """A recorded run, in physical units.

    Attributes
    ----------
    times : Quantity
        (T,), from the time of the Context when recording began.
    interval : Quantity
        Time between samples.
    values : (T, ...) array
        What was observed: by default the positions (T, N, 3) in nm.
    energies : dict of str to (T,) array
        kJ/mol by term, with "kinetic"; empty unless asked for.
    """

    times: unit.Quantity
    interval: unit.Quantity
    values: Array
    energies: dict[str, Array]


def record(
    model: Model,
    context: mm.Context,
    samples: int,
    every: int,
    *,
    observe: Callable[[Array], Any] | None = None,
    energies: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Motion:
    """Run a Context and keep `samples` samples, one every `every` steps, after the one at its present state.

    Plucks let go when their time comes, to the nearest step.

    Parameters
    ----------
    observe : callable, optional
        Takes physical positions (N, 3) in nm and gives the array to keep of them, such as `lambda x: x[:, 0]`.
    energies : bool
        Whether to keep the energy of each term and the kinetic energy. OpenMM's kinetic energy of `verlet` is that of
        the step; `euler_cromer` has velocities half a step earlier.
    progress : callable, optional
        Called about a hundred times with the fraction done.

    Raises
    ------
    DivergedError
        If a coordinate is not finite; it holds the last good sample.
    """
    check.integer("samples", samples, low=1)
    check.integer("every", every, low=1)
    length, energy = model.scale.length, model.scale.factor("energy")
    integrator = context.getIntegrator()
    dt = integrator.getStepSize().value_in_unit(unit.picosecond)
    if not dt > 0:
        raise ValueError(f"Argument `context` must have an integrator of fixed steps, but its step is {dt} ps.")
    begun, since = context.getStepCount(), context.getTime().value_in_unit(unit.picosecond)
    kept: list[Any] = []
    parts: dict[str, list[float]] = {}
    good = None
    bound = furthest(model)
    for sample in range(samples + 1):
        if sample:
            _advance(model, context, every, dt)
        state = context.getState(positions=True, velocities=good is None, energy=energies)
        positions = units.numbers("positions", state.getPositions(asNumpy=True), "length")
        if not positions.max() - positions.min() <= bound and has_left(model, positions):  # NaN compares as false
            raise diagnose(model, context, positions, begun + sample * every, good)
        if good is None:
            good = positions, units.numbers("velocities", state.getVelocities(asNumpy=True), "velocity"), begun
        kept.append(positions * length if observe is None else observe(positions * length))
        if energies:
            for name, value in _energies(model, context, state).items():
                parts.setdefault(name, []).append(value * energy)
        if progress is not None and sample % max(1, samples // 100) == 0:
            progress(sample / samples)
    times = since + every * dt * np.arange(samples + 1)
    return Motion(
        model.to_physical(times, "time"),
        model.to_physical(every * dt, "time"),
        np.array(kept),
        {name: np.array(values) for name, values in parts.items()},
    )


def _advance(model: Model, context: mm.Context, steps: int, dt: float) -> None:
    """Take steps, the plucks letting go on the way."""
    integrator = context.getIntegrator()
    if model.letting_go and context.getParameter("pluck"):
        before = min(max(_last_step(model, dt) - context.getStepCount(), 0), steps)
        integrator.step(before)
        if before < steps:
            context.setParameter("pluck", 0.0)
            integrator.step(steps - before)
        return
    integrator.step(steps)


def _last_step(model: Model, dt: float) -> int:
    """The step at which the plucks let go: the nearest, and one at least."""
    return max(round(model.letting_go / dt), 1)


def _energies(model: Model, context: mm.Context, state: mm.State) -> dict[str, float]:
    out = {"kinetic": units.number("energy", state.getKineticEnergy(), "energy")}
    for name, group in model.groups.items():
        found = context.getState(energy=True, groups=1 << group).getPotentialEnergy()
        out[name] = units.number("energy", found, "energy")
    return out


def pluck_reporter(model: Model) -> PluckReporter:
    """A reporter for `Simulation.reporters` that lets the plucks of a model go when their time has come.

    Raises ValueError for a model without a Pluck.
    """
    return PluckReporter(model)


class PluckReporter:
    """The reporter behind `pluck_reporter`."""

    def __init__(self, model: Model) -> None:
        if not model.letting_go:
            raise ValueError("Argument `model` must have a Pluck to let go, but has none.")
        self._model = model

    def describeNextReport(self, simulation: app.Simulation) -> dict[str, Any]:
        """When OpenMM is to call next: at the step at which the plucks let go, and then never."""
        dt = simulation.integrator.getStepSize().value_in_unit(unit.picosecond)
        left = _last_step(self._model, dt) - simulation.currentStep
        if left <= 0:
            simulation.context.setParameter("pluck", 0.0)
        return {"steps": left if left > 0 else 2**31 - 1, "periodic": None, "include": []}

    def report(self, simulation: app.Simulation, state: mm.State) -> None:
        """Called by OpenMM when the time has come."""
        simulation.context.setParameter("pluck", 0.0)
