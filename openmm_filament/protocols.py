"""Pulling protocols of optical tweezers and force spectroscopy, by Langevin dynamics of many replicas.

Bead 0 is held at the origin, free to turn, and the last bead is led along z by a force, by a clamp that fixes its position,
or by a harmonic trap. `clamp` holds it and reads the mean force, `ramp` leads it from one value to another and back and
records the work. The mean extension under a constant force is `force_extension`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from openmm import unit

from openmm_filament import _checks as check
from openmm_filament._protocol import Settings, control_of, dataset, joined, means, refuse_nothing
from openmm_filament.discretisation import PN
from openmm_filament.filament import Filament
from openmm_filament.parallel import run_all
from openmm_filament.ramping import Ramp, run_ramp

if TYPE_CHECKING:
    import xarray

__all__ = ["clamp", "ramp"]

Array = NDArray[np.float64]

_CLAMPED = 100.0
"""Time that a clamp is read, over the relaxation time of the slowest mode."""

_STRIDE, _BETWEEN = 10, 5
"""Steps between two readings of a clamp, and at most so many between two changes of a ramp."""

_RECORDS, _CHANGES = 1000, 1_000_000
"""Means that a replica of a clamp keeps at most, and changes of a ramp at most unless it has more points: those of longer
runs are of more readings, and further apart."""


def clamp(
    filament: Filament,
    temperature: unit.Quantity,
    *,
    extension: unit.Quantity | None = None,
    trap: unit.Quantity | None = None,
    stiffness: unit.Quantity | None = None,
    duration: unit.Quantity | None = None,
    replicas: int = 16,
    seed: int = 1,
    timestep: unit.Quantity | None = None,
    friction: unit.Quantity | None = None,
    equilibration: unit.Quantity | None = None,
    processes: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> xarray.Dataset:
    """The mean force of a filament whose end is clamped, or held by a trap at rest.

    Exactly one of `extension` and `trap` is given.

    Parameters
    ----------
    filament : Filament
        Open; sampled as it is.
    temperature : Quantity
    extension : Quantity
        An extension clamp: the distances (M,), not negative, none of them twice, along z at which the last bead is fixed.
        The force is minus the derivative of `k_B T ln P(R)`, P being the distribution of the end-to-end *vector* of the free
        chain.
    trap : Quantity
        The positions (M,), as the distances, along z of a harmonic trap on the last bead. Force and extension are read.
    stiffness : Quantity
        Of the trap: one number, or (3,) along x, y and z.
    duration : Quantity, optional
        Physical time that each replica is read; by default 100 relaxation times of the slowest mode.
    replicas : int
        Independent chains, at least 2: the standard errors come from the scatter of their means.
    seed : int
        The same seed gives the same numbers whatever the number of processes.
    timestep, friction : Quantity, optional
        As of `langevin`, the friction for the chain at its smallest tension.
    equilibration : Quantity, optional
        Time before anything is read; by default 10 relaxation times.
    processes : int, optional
        Worker processes; by default one for each core that this process may use.
    progress : callable, optional
        Called with the fraction done.

    Returns
    -------
    xarray.Dataset
        Over the coordinate `extension` or `trap` (nm): `force`, `force_error` (pN), `force_of_replica`; for a trap also
        `extension`, `extension_error` (nm), `extension_of_replica`. Errors are one standard error. What was run follows from
        the tension, and stands beside each value: `time_step` (ps), `friction` (1/ps), `equilibration_steps`, and `steps`,
        those that were read. After Ctrl-C it holds the replicas that were done, NaN for the others, and its attribute
        `interrupted` is 1.

    Raises
    ------
    ValueError, TypeError
        For arguments that are wrong, and for times of more than 2^31 - 1 steps, before anything runs.
    DivergedError
        If a coordinate is not finite, or a run far hotter than its thermostat.
    """
    control, values, k = control_of(None, extension, trap, stiffness)
    check.distinct(control, values, unit="nm")
    chosen = Settings.of(filament, temperature, replicas, 2, seed, timestep, friction, equilibration, processes)
    tasks: list[Ramp] = []
    for value, child in zip(values, np.random.SeedSequence(seed).spawn(len(values)), strict=True):
        setup = chosen.at(control, value, value, k)
        time = setup.time("duration", duration, _CLAMPED)
        readings = max(2, math.ceil(time / (_STRIDE * setup.longest_step)))
        records = min(readings, _RECORDS)
        reads = math.ceil(readings / records)
        dt = min(setup.longest_step, time / (records * reads * _STRIDE))
        tasks += setup.tasks(child, np.full(records + 1, value), dt, _STRIDE, reads=reads)
    groups = len(tasks) // len(values)
    results = run_all(run_ramp, tasks, chosen.workers, progress)
    refuse_nothing(results)
    done = [joined(results[i : i + groups], tasks[i : i + groups]) for i in range(0, len(results), groups)]
    force = np.array([part.force[0, :, 1:].mean(axis=-1) for part in done]) / PN
    dims = (control, "replica")
    variables = means("force", force, dims, "pN", "force of the trap or clamp along z")
    if control == "trap":
        found = np.array([part.extension[0, :, 1:].mean(axis=-1) for part in done])
        variables |= means("extension", found, dims, "nm", "extension along z")
    ran = tasks[::groups]
    run = {
        "time_step": ([task.timestep for task in ran], "ps", "time step"),
        "friction": ([task.friction for task in ran], "1/ps", "friction"),
        "equilibration_steps": ([task.warm_up for task in ran], "1", "steps of each replica before any is read"),
        "steps": ([len(t.values[1:]) * t.reads * t.stride for t in ran], "1", "steps that each replica is read"),
    }
    for name, (column, its_unit, meaning) in run.items():
        variables[name] = (control,), np.array(column), {"units": its_unit, "long_name": meaning}
    named = {"units": "nm", "long_name": "position of the trap" if control == "trap" else "clamped extension"}
    return dataset(variables, {control: (control, values, named)}, chosen, control, k, results)


def ramp(
    filament: Filament,
    temperature: unit.Quantity,
    duration: unit.Quantity,
    *,
    force: unit.Quantity | None = None,
    extension: unit.Quantity | None = None,
    trap: unit.Quantity | None = None,
    stiffness: unit.Quantity | None = None,
    points: int = 100,
    replicas: int = 32,
    seed: int = 1,
    timestep: unit.Quantity | None = None,
    friction: unit.Quantity | None = None,
    equilibration: unit.Quantity | None = None,
    processes: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> xarray.Dataset:
    """Lead the end of a filament evenly from one force, extension or trap position to another and back, with the work.

    Exactly one of `force`, `extension` and `trap` is given. Each replica is equilibrated at the first value, led to the
    last, equilibrated there and led back. The control changes in jumps at most five steps apart, or a millionth of the way
    where that is longer; the work of each is the change of the energy, `-z dF` for a force: with Crooks's theorem free
    energies follow (`free_energy`).

    Parameters
    ----------
    duration : Quantity
        Physical time of the way there, and of the way back.
    force, extension, trap : Quantity
        The first and the last value, (2,), not negative and different: the force on the last bead along z, the distance at
        which it is fixed, or the position of the trap.
    points : int
        Records after the first, at equal times; at least 2.
    replicas : int
        At least 1.

    The other arguments and the errors are those of `clamp`.

    Returns
    -------
    xarray.Dataset
        Over `direction` ("forward", "reverse"), `replica` and `point` (0 to `points`): `force` (pN), `extension`, `trap`
        (nm; the control without `replica`), `work` (kJ/mol) done on the filament and its trap since the first point of that
        direction, and `time` (ps). `hysteresis` is the mean work of both ways together, the area between the two curves,
        with its standard error. What friction and how long, so how much is dissipated, is the caller's choice: the
        default friction is not that of water. After Ctrl-C it holds the replicas that were done.
    """
    control, values, k = control_of(force, extension, trap, stiffness)
    check.shape(control, values, (2,))
    if values[0] == values[1]:
        same = f"{values[0] / PN:.6g} pN" if control == "force" else f"{values[0]:.6g} nm"
        raise check.fail(control, "hold two different values", f"{same} twice")
    check.integer("points", points, low=2, high=_CHANGES)
    chosen = Settings.of(filament, temperature, replicas, 1, seed, timestep, friction, equilibration, processes)
    setup = chosen.at(control, values[0], values[1], k)
    time = setup.time("duration", duration, math.nan)
    every = math.ceil(min(time / setup.longest_step / _BETWEEN, _CHANGES) / points)
    stride = math.ceil(time / setup.longest_step / (every * points))
    dt = time / (every * points * stride)
    path = np.linspace(values[0], values[1], every * points + 1)
    tasks = setup.tasks(np.random.SeedSequence(seed), path, dt, stride, every=every, back=True)
    results = run_all(run_ramp, tasks, chosen.workers, progress)
    refuse_nothing(results)
    kept = [(result, task) for result, task in zip(results, tasks, strict=True) if result is not None]
    done = joined(*zip(*kept, strict=True))
    dims = ("direction", "replica", "point")
    records = {"force": done.force / PN, "extension": done.extension, "work": done.work}
    meant = {"force": ("pN", "force along z"), "extension": ("nm", "extension along z")}
    variables: dict[str, Any] = {
        name: (dims, records[name], {"units": its_unit, "long_name": meaning})
        for name, (its_unit, meaning) in meant.items()
        if name != control
    }
    variables["work"] = dims, done.work, {"units": "kJ/mol", "long_name": "work done since the first point"}
    there = path[::every] / (PN if control == "force" else 1.0)
    led = {"units": "pN" if control == "force" else "nm", "long_name": "control: what leads the last bead"}
    variables[control] = ("direction", "point"), np.stack([there, there[::-1]]), led
    total = done.work[:, :, -1].sum(axis=0)
    error = total.std(ddof=1) / math.sqrt(len(total)) if len(total) > 1 else math.nan
    variables["hysteresis"] = (), total.mean(), {"units": "kJ/mol", "long_name": "mean work there and back"}
    variables["hysteresis_error"] = (), error, {"units": "kJ/mol", "long_name": "one standard error"}
    at = dt * stride * every * np.arange(points + 1)
    coordinates = {
        "direction": ("direction", ["forward", "reverse"]),
        "time": ("point", at, {"units": "ps", "long_name": "time since the first point"}),
    }
    out = dataset(variables, coordinates, chosen, control, k, results)
    return out.assign_attrs(
        time_step_ps=dt,
        friction_per_ps=setup.friction,
        equilibration_steps=tasks[0].warm_up,
        changes=every * points,
    )
