"""Stopping a run that has diverged, with a report of where and why, and the last good frame kept."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import openmm as mm
from numpy.typing import NDArray
from openmm import app, unit

from openmm_filament import _checks as check
from openmm_filament import units
from openmm_filament.bookkeeping import Books, allowed_rise
from openmm_filament.evaluation import internal_positions, kinetic_temperature
from openmm_filament.geometry import bending_angles, dihedrals
from openmm_filament.integrators import temperature_of
from openmm_filament.model import Model
from openmm_filament.refusals import describe_bead
from openmm_filament.timestep import highest_frequency

__all__ = ["DivergedError", "Watch", "check_heat", "diagnose", "furthest", "has_left", "watch"]

Array = NDArray[np.float64]

_FAR = 1e3
"""Extent over that of the rest positions that only a run gone wrong reaches."""

_SURE = 50.0
"""A look at a thermal run is a false alarm with a probability below e to the minus this."""

_RISE = 0.1
"""Rise of the energy of a run without thermostat, over what it moves between its kinds, that no good time step makes."""

_REPLAY = 2000
"""At most so many single steps are repeated from the last good frame to find the step at which a run diverged."""


class DivergedError(RuntimeError):
    """A run whose coordinates are no longer finite.

    Attributes
    ----------
    bead : int
        The first bad bead, in the whole model.
    term : str
        The term that did it.
    step : int
        The step by which it had happened.
    last_good : Quantity
        Positions (N, 3) of the last good frame, physical.
    """

    def __init__(self, message: str, bead: int, term: str, step: int, last_good: unit.Quantity) -> None:
        super().__init__(message)
        self.bead, self.term, self.step, self.last_good = bead, term, step, last_good

    def __reduce__(self) -> tuple[Any, ...]:
        return DivergedError, (str(self), self.bead, self.term, self.step, self.last_good)


def watch(model: Model, interval: int) -> Watch:
    """A reporter that stops a Simulation with DivergedError when a coordinate is not finite or the run heats up.

    Every `interval` steps it looks at the positions and keeps them as the last good frame. A run heats up where its
    kinetic temperature is far above its thermostat's; without a thermostat, under `verlet` and `euler_cromer`, where its
    energy rises although nothing drives it (plucks and traps do).
    """
    return Watch(model, interval)


class Watch:
    """The reporter behind `watch`; `trajectory_reporter` looks out in the same way before it writes a frame."""

    def __init__(self, model: Model, interval: int) -> None:
        self._model = model
        self._interval = check.integer("interval", interval, low=1)
        self._good: tuple[Array, Array, int] | None = None
        self._books = Books(model)
        self._allowed: float | None = None

    def describeNextReport(self, simulation: app.Simulation) -> dict[str, Any]:
        """When OpenMM is to call next, and with what; the first call keeps the starting frame."""
        if self._allowed is None:
            self._allowed = allowed_rise(self._model, simulation.integrator)
        wanted = ["positions", "velocities"]
        if math.isfinite(self._allowed):  # asking a thermostat for its energy may draw from its random stream
            wanted.append("energy")
        if self._good is None:
            self.look(simulation, simulation.context.getState(**dict.fromkeys(wanted, True)))
        steps = self._interval - simulation.currentStep % self._interval
        return {"steps": steps, "periodic": None, "include": wanted}

    def report(self, simulation: app.Simulation, state: mm.State) -> None:
        """Called by OpenMM every `interval` steps."""
        self.look(simulation, state)

    def look(self, simulation: app.Simulation, state: mm.State) -> Array:
        """The positions (N, 3) of the state in internal units if they are finite; raises DivergedError otherwise."""
        positions = units.numbers("positions", state.getPositions(asNumpy=True), "length")
        if not has_left(self._model, positions):
            velocities = units.numbers("velocities", state.getVelocities(asNumpy=True), "velocity")
            if (temperature := temperature_of(simulation.integrator)) is not None:
                check_heat(self._model, positions, velocities, temperature, simulation.currentStep)
            elif self._allowed is not None and math.isfinite(self._allowed):
                self._check_energy(simulation, state, positions, self._allowed)
            self._good = positions, velocities, simulation.currentStep
            return positions
        raise diagnose(self._model, simulation.context, positions, simulation.currentStep, self._good)

    def _check_energy(self, simulation: app.Simulation, state: mm.State, positions: Array, allowed: float) -> None:
        """Raise DivergedError where the energy has risen though nothing drives the run."""
        rise = self._books.rise(state)
        if rise > allowed:
            raise DivergedError(
                f"The energy of the run must not rise by more than {allowed:.3g} of that of its motion, nothing driving "
                f"it, but has risen by {rise:.3g} of it by step {simulation.currentStep}: the time step is too long for "
                "motion so large.",
                0,
                "unknown",
                simulation.currentStep,
                self._model.to_physical(positions, "length"),
            )


def has_left(model: Model, positions: Array) -> bool:
    """Whether beads are not finite, or spread further than any motion would take them."""
    if not np.isfinite(positions).all():
        return True
    return bool(np.ptp(positions, axis=0).max() > furthest(model))


def furthest(model: Model) -> float:
    """The spread of beads along an axis, internal, above which `has_left` says that they have left."""
    return float(_FAR * np.ptp(internal_positions(model), axis=0).max())


def check_heat(
    model: Model,
    positions: Array,
    velocities: Array,
    temperature: float,
    step: int,
    beads: NDArray[np.bool_] | None = None,
) -> None:
    """Raise DivergedError where a thermal run is far hotter than its thermostat: unstable, though finite.

    Positions and velocities (N, 3) and the temperature (K) are internal; with `beads` (N,) only these are looked at. Nothing
    is drawn from a random stream. A time step below the stability limit makes the kinetic temperature too low, never too
    high. A thermal run exceeds the bound with a probability of e^-50 a look: chi-squared of n degrees exceeds
    `n + 2 sqrt(n y) + 2 y` with less than e^-y (Laurent and Massart, Ann. Stat. 2000).
    """
    found = kinetic_temperature(model, velocities, beads)
    free = np.ones(len(velocities), dtype=bool) if beads is None else beads.copy()
    free[model.held] = False
    degrees = (2 if model.planar else 3) * int(free.sum())
    if not degrees or found <= temperature * (1 + 2 * math.sqrt(_SURE / degrees) + 2 * _SURE / degrees):
        return
    to_kelvin = model.scale.factor("temperature")
    lined_up = any(interaction.term.needs_bends for interaction in model.interactions)
    raise DivergedError(
        f"The run has heated up to {found * to_kelvin:.4g} K by step {step}, its thermostat standing at "
        f"{temperature * to_kelvin:.4g} K: the time step is too long, or the start was far from equilibrium"
        f"{', or beads under a dihedral have come into line' if lined_up else ''}"
        f"{', or a filament that is pulled and held nowhere has gone off' if _loose(model) else ''}.",
        0,
        "unknown",
        step,
        model.to_physical(positions, "length"),
    )


def _loose(model: Model) -> bool:
    """Whether a filament is pulled and neither held nor trapped."""
    return any(load.pulls and not load.held and not len(load.traps.beads) for load in model.loads)


def diagnose(
    model: Model, context: mm.Context, bad: Array, step: int, good: tuple[Array, Array, int] | None
) -> DivergedError:
    """The report on a run that diverged by `step`, from its last good positions, velocities and step.

    The steps since are repeated one by one to find where it happened; the Context is left where that ends.
    """
    first = int(np.argmax(~np.isfinite(bad).all(axis=1)))  # 0 where all are finite
    if good is None:
        nothing = model.to_physical(np.full(bad.shape, np.nan), "length")
        return DivergedError(
            f"{describe_bead(model, first).capitalize()} is not finite at step {step}, the first that was looked at.",
            first,
            "unknown",
            step,
            nothing,
        )
    kept, velocities, since = good
    limit = _limit(model, kept)
    before, at = _replay(model, context, kept, velocities, since, step)
    term, bead = _culprit(model, context, before)
    context.setStepCount(step)
    dt = context.getIntegrator().getStepSize().value_in_unit(unit.picosecond)
    to_ps = model.scale.factor("time")
    gone = (
        f"the beads are spread over more than {_FAR:g} times the extent of the rest shape"
        if np.isfinite(bad).all()
        else f"{describe_bead(model, bead)} is not finite"
    )
    message = (
        f"The run diverged at step {at} (last good frame: step {since}): {gone}, by the force of {term} on "
        f"{describe_bead(model, bead)}. Just before, {_surroundings(model, before, bead)}. "
        f"The time step is {dt * to_ps:.6g} ps; the stability limit at the last good frame was {limit * to_ps:.6g} ps."
    )
    return DivergedError(message, bead, term, at, model.to_physical(kept, "length"))


def _replay(
    model: Model, context: mm.Context, positions: Array, velocities: Array, since: int, step: int
) -> tuple[Array, int]:
    """Positions at the last step before the run diverged, and the step at which it did."""
    context.setPositions(positions)
    context.setVelocities(velocities)
    before = positions
    for at in range(since + 1, min(step, since + _REPLAY) + 1):
        context.getIntegrator().step(1)
        after = units.numbers("positions", context.getState(positions=True).getPositions(asNumpy=True), "length")
        if has_left(model, after):
            return before, at
        before = after
    return before, step


def _limit(model: Model, positions: Array) -> float:
    """The stability limit in internal units; NaN at positions where a term does not exist."""
    try:
        with np.errstate(all="ignore"):
            return 2.0 / highest_frequency(model, positions)
    except (ValueError, np.linalg.LinAlgError):
        return np.nan


def _culprit(model: Model, context: mm.Context, positions: Array) -> tuple[str, int]:
    """The term whose force is the first not finite, or the largest, and the bead that it acts on."""
    context.setPositions(positions)
    largest, found = -1.0, ("unknown", 0)
    for name, group in model.groups.items():
        state = context.getState(forces=True, groups=1 << group)
        size = np.abs(units.numbers("forces", state.getForces(asNumpy=True), "force")).max(axis=1)
        if not np.isfinite(size).all():
            return name, int(np.argmax(~np.isfinite(size)))
        if size.max() > largest:
            largest, found = float(size.max()), (name, int(np.argmax(size)))
    return found


def _surroundings(model: Model, positions: Array, bead: int) -> str:
    """Segment lengths, bending angles and torsions about a bead, in physical units and radians."""
    filament = int(np.searchsorted(model.starts, bead, side="right")) - 1
    low = max(int(model.starts[filament]), bead - 2)
    high = min(int(model.starts[filament + 1]), bead + 3)
    local = positions[low:high]
    first, last = low - model.starts[filament], high - 1 - model.starts[filament]
    parts = []
    with np.errstate(invalid="ignore", divide="ignore"):
        lengths = np.linalg.norm(np.diff(local, axis=0), axis=-1) * model.scale.length
        parts.append(f"from bead {first} to {last} the segment lengths were {_listed(lengths)} nm")
        if len(local) > 2:
            angles = bending_angles(np.stack([local[i : i + 3] for i in range(len(local) - 2)]))
            parts.append(f"the bending angles {_listed(angles)} rad")
        if len(local) > 3 and "torsion" in model.groups:
            torsions = dihedrals(np.stack([local[i : i + 4] for i in range(len(local) - 3)]))
            parts.append(f"the torsions {_listed(torsions)} rad")
    return ", ".join(parts)


def _listed(values: Array) -> str:
    return ", ".join(f"{value:.6g}" for value in values)
