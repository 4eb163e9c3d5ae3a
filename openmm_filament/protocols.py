"""Pulling protocols of optical tweezers and force spectroscopy, by Langevin dynamics of many replicas.

Bead 0 is held at the origin, free to turn, and the last bead is led along z by a force, by a clamp that fixes its position,
or by a harmonic trap. `clamp` holds it and reads the mean force, `ramp` leads it from one value to another and back and
records the work. The mean extension under a constant force is `force_extension`.
"""

from __future__ import annotations

import math
import platform as host
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import openmm as mm
from numpy.typing import NDArray
from openmm import unit

from openmm_filament import _checks as check
from openmm_filament import units
from openmm_filament.blocks import clamped_model
from openmm_filament.discretisation import PN
from openmm_filament.filament import Filament
from openmm_filament.holding import tension
from openmm_filament.integrators import FRICTION, thermal_step
from openmm_filament.parallel import run_all
from openmm_filament.ramping import Control, Ramp, RampResult, controlled_model, run_ramp
from openmm_filament.sampling import _workers
from openmm_filament.timestep import slow_frequency

if TYPE_CHECKING:
    import xarray

__all__ = ["clamp", "ramp"]

Array = NDArray[np.float64]

_TOGETHER = 8
"""Replicas in the System of one task."""

_RELAX, _CLAMPED = 10.0, 100.0
"""Time to equilibrate, and to clamp, over the relaxation time of the slowest mode."""

_STRIDE, _BETWEEN = 10, 5
"""Steps between two readings of a clamp, and at most so many between two changes of a ramp."""

_CONTROLS: tuple[Control, ...] = ("force", "extension", "trap")


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
        An extension clamp: the distances (M,), not negative, along z at which the last bead is fixed. The force is minus
        the derivative of `k_B T ln P(R)`, P being the distribution of the end-to-end *vector* of the free chain.
    trap : Quantity
        The positions (M,), not negative, along z of a harmonic trap on the last bead. Force and extension are read.
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
        `extension`, `extension_error` (nm), `extension_of_replica`. Errors are one standard error. After Ctrl-C it holds
        the replicas that were done, NaN for the others, and its attribute `interrupted` is 1.

    Raises
    ------
    ValueError, TypeError
        For arguments that are wrong, before anything runs.
    DivergedError
        If a coordinate is not finite, or a run far hotter than its thermostat.
    """
    control, values, k = _control(None, extension, trap, stiffness)
    chosen = _Settings.of(filament, temperature, replicas, 2, seed, timestep, friction, equilibration, processes)
    tasks: list[Ramp] = []
    for value, child in zip(values, np.random.SeedSequence(seed).spawn(len(values)), strict=True):
        setup = chosen.at(control, value, value, k)
        time = setup.time("duration", duration, _CLAMPED)
        readings = max(2, math.ceil(time / (_STRIDE * setup.longest_step)))
        dt = min(setup.longest_step, time / readings / _STRIDE)
        tasks += setup.tasks(child, np.full(readings + 1, value), dt, _STRIDE, 1, False)
    groups = len(tasks) // len(values)
    results = run_all(run_ramp, tasks, chosen.workers, progress)
    _nothing_done(results)
    done = [_joined(results[i : i + groups], tasks[i : i + groups]) for i in range(0, len(results), groups)]
    force = np.array([part.force[0, :, 1:].mean(axis=-1) for part in done]) / PN
    dims = (control, "replica")
    variables = _means("force", force, dims, "pN", "force of the trap or clamp along z")
    if control == "trap":
        found = np.array([part.extension[0, :, 1:].mean(axis=-1) for part in done])
        variables |= _means("extension", found, dims, "nm", "extension along z")
    named = {"units": "nm", "long_name": "position of the trap" if control == "trap" else "clamped extension"}
    return _dataset(variables, {control: (control, values, named)}, chosen, control, k, tasks, results)


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
    last, equilibrated there and led back. The control changes in jumps at most five steps apart; the work of each is the
    change of the energy, `-z dF` for a force: with Crooks's theorem free energies follow (`free_energy`).

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
    control, values, k = _control(force, extension, trap, stiffness)
    check.shape(control, values, (2,))
    if values[0] == values[1]:
        raise check.fail(control, "hold two different values", f"{values[0]:.6g} twice")
    check.integer("points", points, low=2)
    chosen = _Settings.of(filament, temperature, replicas, 1, seed, timestep, friction, equilibration, processes)
    setup = chosen.at(control, values[0], values[1], k)
    time = setup.time("duration", duration, math.nan)
    every = math.ceil(time / setup.longest_step / _BETWEEN / points)
    stride = math.ceil(time / setup.longest_step / (every * points))
    dt = time / (every * points * stride)
    path = np.linspace(values[0], values[1], every * points + 1)
    tasks = setup.tasks(np.random.SeedSequence(seed), path, dt, stride, every, True)
    results = run_all(run_ramp, tasks, chosen.workers, progress)
    _nothing_done(results)
    kept = [(result, task) for result, task in zip(results, tasks, strict=True) if result is not None]
    done = _joined(*zip(*kept, strict=True))
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
    out = _dataset(variables, coordinates, chosen, control, k, tasks, results)
    return out.assign_attrs(changes=every * points)


def _control(force: Any, extension: Any, trap: Any, stiffness: Any) -> tuple[Control, Array, Array]:
    """Which control was given, its values (M,) in kJ/mol/nm or nm, and the stiffness of the trap (3,), NaN without one."""
    given = {n: v for n, v in zip(_CONTROLS, (force, extension, trap), strict=True) if v is not None}
    if len(given) != 1:
        raise TypeError(
            f"Exactly one control must be given (force, extension or trap), but {', '.join(given) or 'none'} is."
        )
    control = next(name for name in _CONTROLS if name in given)
    dimension = "force" if control == "force" else "length"
    values = check.non_negative(control, np.atleast_1d(units.numbers(control, given[control], dimension)))
    check.shape(control, values, (None,))
    if not len(values):
        raise ValueError(f"Argument `{control}` must hold at least one value, but is empty.")
    if (stiffness is None) == (control == "trap"):
        raise TypeError("Argument `stiffness` must be given with a trap, and only then.")
    if control != "trap":
        return control, values, np.full(3, math.nan)
    k = check.non_negative("stiffness", units.numbers("stiffness", stiffness, "stiffness"))
    if k.ndim:
        check.shape("stiffness", k, (3,))
    k = np.broadcast_to(k, 3)
    check.positive("stiffness", k[2])
    return control, values, k


@dataclass(frozen=True, eq=False)
class _Settings:
    """What all runs of a protocol share, checked: K, ps and 1/ps."""

    filament: Filament
    kelvin: float
    replicas: int
    seed: int
    timestep: unit.Quantity | None
    friction: float | None
    equilibration: float | None
    workers: int

    @classmethod
    def of(
        cls,
        filament: Any,
        temperature: Any,
        replicas: int,
        fewest: int,
        seed: int,
        timestep: Any,
        friction: Any,
        equilibration: Any,
        processes: int | None,
    ) -> _Settings:
        if not isinstance(filament, Filament):
            raise TypeError(f"Argument `filament` must be a Filament, but is {filament!r}.")
        if filament.closed or len(filament) < 2:
            raise ValueError("Argument `filament` must be an open filament of two beads or more to be pulled.")
        kelvin = check.positive("temperature", units.number("temperature", temperature, "temperature")).item()
        check.integer("replicas", replicas, low=fewest)
        check.integer("seed", seed, low=0)

        def positive(name: str, value: Any, dimension: str) -> float | None:
            return None if value is None else check.positive(name, units.number(name, value, dimension)).item()

        rate, time = positive("friction", friction, "rate"), positive("equilibration", equilibration, "time")
        return cls(filament, kelvin, replicas, seed, timestep, rate, time, _workers(processes))

    def at(self, control: Control, first: float, last: float, stiffness: Array) -> _Setup:
        """What follows from where the end is led."""
        filament, kelvin = self.filament, self.kelvin
        if control == "force":
            tensions = first, last
        else:
            k = math.inf if control == "extension" else float(stiffness[2])
            found = {value: tension(filament, value, k, kelvin) for value in {first, last}}
            tensions = found[first], found[last]
        pulled = clamped_model(filament, min(tensions), 3, 1)
        rate = slow_frequency(pulled, kelvin / pulled.scale.factor("temperature")) / pulled.scale.factor("time")
        friction = self.friction or FRICTION * rate
        model = controlled_model(filament, control, first, last, stiffness, 1)
        dt = thermal_step(model, kelvin, self.timestep) * model.scale.factor("time")
        return _Setup(self, control, stiffness, tensions, max(1 / friction, friction / rate**2), friction, dt)


@dataclass(frozen=True, eq=False)
class _Setup:
    """The chain at one place, or on one way; ps and 1/ps."""

    shared: _Settings
    control: Control
    stiffness: Array
    tensions: tuple[float, float]
    relaxation: float
    friction: float
    longest_step: float

    def time(self, name: str, given: Any, relaxations: float) -> float:
        """A time in ps as given, or so many relaxation times."""
        if given is None:
            return relaxations * self.relaxation
        return check.positive(name, units.number(name, given, "time")).item()

    def tasks(self, seeds: Any, values: Array, dt: float, stride: int, every: int, back: bool) -> list[Ramp]:
        """The replicas in groups, whose number and seeds do not depend on that of the processes."""
        shared = self.shared
        counts = [min(_TOGETHER, shared.replicas - i) for i in range(0, shared.replicas, _TOGETHER)]
        warm = shared.equilibration if shared.equilibration is not None else _RELAX * self.relaxation
        return [
            Ramp(
                filament=shared.filament,
                control=self.control,
                values=values,
                stiffness=self.stiffness,
                tensions=self.tensions,
                temperature=shared.kelvin,
                replicas=count,
                seed=int(child.generate_state(1)[0]) % (2**31 - 1) + 1,
                timestep=dt,
                friction=self.friction,
                warm_up=math.ceil(warm / dt),
                stride=stride,
                every=every,
                back=back,
            )
            for count, child in zip(counts, seeds.spawn(len(counts)), strict=True)
        ]


def _nothing_done(results: Sequence[RampResult | None]) -> None:
    if all(result is None for result in results):
        raise KeyboardInterrupt


def _joined(results: Sequence[RampResult | None], tasks: Sequence[Ramp]) -> RampResult:
    """The replicas of several groups, NaN for those that were not done."""
    parts = [
        result
        or RampResult(
            *[np.full((1 + task.back, task.replicas, (len(task.values) - 1) // task.every + 1), math.nan)] * 3
        )
        for result, task in zip(results, tasks, strict=True)
    ]
    return RampResult(*(np.concatenate([getattr(part, name) for part in parts], axis=1) for name in vars(parts[0])))


def _means(name: str, values: Array, dims: tuple[str, str], its_unit: str, meaning: str) -> dict[str, Any]:
    """The mean over replicas (M, R), its standard error, and the values themselves, those that are NaN left out."""
    done = np.isfinite(values)
    count = done.sum(axis=1)
    mean = np.where(done, values, 0.0).sum(axis=1) / np.where(count, count, math.nan)
    squares = np.where(done, (values - mean[:, None]) ** 2, 0.0).sum(axis=1)
    error = np.sqrt(squares / np.where(count > 1, count * (count - 1), math.nan))
    return {
        name: (dims[:1], mean, {"units": its_unit, "long_name": f"mean {meaning}"}),
        f"{name}_error": (dims[:1], error, {"units": its_unit, "long_name": f"one standard error of the {name}"}),
        f"{name}_of_replica": (dims, values, {"units": its_unit, "long_name": f"{meaning}, mean of each replica"}),
    }


def _dataset(
    variables: dict[str, Any],
    coordinates: dict[str, Any],
    chosen: _Settings,
    control: Control,
    stiffness: Array,
    tasks: Sequence[Ramp],
    results: Sequence[RampResult | None],
) -> xarray.Dataset:
    import xarray

    from openmm_filament import __version__

    attributes = {
        "control": control,
        "temperature_K": chosen.kelvin,
        "seed": chosen.seed,
        "time_step_ps": tasks[0].timestep,
        "friction_per_ps": tasks[0].friction,
        "equilibration_steps": tasks[0].warm_up,
        "integrator": "LangevinMiddle",
        "platform": "Reference",
        "interrupted": int(any(result is None for result in results)),
        "openmm_filament_version": __version__,
        "openmm_version": mm.Platform.getOpenMMVersion(),
        "numpy_version": np.__version__,
        "python_version": host.python_version(),
    }
    if control == "trap":
        attributes["stiffness_pN_per_nm"] = (stiffness / PN).tolist()
    return xarray.Dataset(variables, coordinates, attributes)
