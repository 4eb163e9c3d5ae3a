"""What the protocols share: their arguments checked, the runs that follow from them, and datasets of what these gave."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from openmm import unit

from openmm_filament import _checks as check
from openmm_filament import contact, units
from openmm_filament.blocks import check_ends, clamped_model
from openmm_filament.curves import provenance
from openmm_filament.discretisation import PN
from openmm_filament.executors import available_workers
from openmm_filament.filament import Filament
from openmm_filament.holding import tension
from openmm_filament.integrators import FRICTION, drawn_seed, thermal_step
from openmm_filament.ramping import Control, Ramp, RampResult, controlled_model
from openmm_filament.timestep import slow_frequency

if TYPE_CHECKING:
    import xarray

__all__ = ["Settings", "Setup", "control_of", "dataset", "joined", "means", "refuse_nothing"]

Array = NDArray[np.float64]

_TOGETHER = 8
"""Replicas in the System of one task."""

_RELAX = 10.0
"""Time to equilibrate over the relaxation time of the slowest mode."""

_MOST_STEPS = 2**31 - 1
"""Steps that OpenMM takes at a time, and that a replica takes at most: hours of a few beads."""

_CONTROLS: tuple[Control, ...] = ("force", "extension", "trap")


def control_of(force: Any, extension: Any, trap: Any, stiffness: Any) -> tuple[Control, Array, Array]:
    """Which control was given, its values (M,) in kJ/mol/nm or nm, and the stiffness of the trap (3,), NaN without one.

    Errors name forces in pN and stiffnesses in pN/nm.
    """
    given = {n: v for n, v in zip(_CONTROLS, (force, extension, trap), strict=True) if v is not None}
    if len(given) != 1:
        raise TypeError(
            f"Exactly one control must be given (force, extension or trap), but {', '.join(given) or 'none'} is."
        )
    control = next(name for name in _CONTROLS if name in given)
    dimension = "force" if control == "force" else "length"
    values = np.atleast_1d(units.numbers(control, given[control], dimension))
    check.shape(control, values, (None,))
    if not len(values):
        raise ValueError(f"Argument `{control}` must hold at least one value, but is empty.")
    own, its_unit = (values / PN, "pN") if control == "force" else (values, "nm")
    check.non_negative(control, own, unit=its_unit)
    if (stiffness is None) == (control == "trap"):
        raise TypeError("Argument `stiffness` must be given with a trap, and only then.")
    if control != "trap":
        return control, values, np.full(3, math.nan)
    k = units.numbers("stiffness", stiffness, "stiffness")
    check.non_negative("stiffness", k / PN, unit="pN/nm")
    if k.ndim:
        check.shape("stiffness", k, (3,))
    k = np.broadcast_to(k, 3)
    check.positive("stiffness", k[2] / PN, unit="pN/nm")
    return control, values, k


@dataclass(frozen=True, eq=False)
class Settings:
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
    ) -> Settings:
        """The arguments, checked; at least so many replicas."""
        if not isinstance(filament, Filament):
            raise TypeError(f"Argument `filament` must be a Filament, but is {filament!r}.")
        check_ends("filament", filament)
        contact.refuse("filament", filament.interactions(), "in a protocol")
        kelvin = check.positive("temperature", units.number("temperature", temperature, "temperature")).item()
        check.integer("replicas", replicas, low=fewest)
        check.integer("seed", seed, low=0)

        def positive(name: str, value: Any, dimension: str) -> float | None:
            return None if value is None else check.positive(name, units.number(name, value, dimension)).item()

        rate, time = positive("friction", friction, "rate"), positive("equilibration", equilibration, "time")
        return cls(filament, kelvin, replicas, seed, timestep, rate, time, available_workers(processes))

    def at(self, control: Control, first: float, last: float, stiffness: Array) -> Setup:
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
        return Setup(self, control, stiffness, tensions, max(1 / friction, friction / rate**2), friction, dt)


@dataclass(frozen=True, eq=False)
class Setup:
    """The chain at one place, or on one way; ps and 1/ps."""

    shared: Settings
    control: Control
    stiffness: Array
    tensions: tuple[float, float]
    relaxation: float
    friction: float
    longest_step: float

    def time(self, name: str, given: Any, relaxations: float) -> float:
        """A time in ps as given, or so many relaxation times. Raises ValueError where it takes too many steps."""
        if given is None:
            return self._bounded(name, relaxations * self.relaxation, self.longest_step, given=False)
        time = check.positive(name, units.number(name, given, "time"), unit="ps").item()
        return self._bounded(name, time, self.longest_step, given=True)

    def _bounded(self, name: str, time: float, dt: float, *, given: bool) -> float:
        if time <= dt * _MOST_STEPS:
            return time
        long = f"{time:.3g} ps, {time / dt:.3g} steps of {dt:.3g} ps"
        most = f"at most {_MOST_STEPS} steps"
        if given:
            raise check.fail(name, f"take {most}", long)
        raise ValueError(
            f"Argument `{name}` must be given, of {most}, for a chain and a friction that relax in {self.relaxation:.3g} ps, "
            f"but is left out: by default it is {long}."
        )

    def tasks(
        self, seeds: Any, values: Array, dt: float, stride: int, *, every: int = 1, back: bool = False, reads: int = 1
    ) -> list[Ramp]:
        """The replicas in groups, whose number and seeds do not depend on that of the processes."""
        shared = self.shared
        counts = [min(_TOGETHER, shared.replicas - i) for i in range(0, shared.replicas, _TOGETHER)]
        given = shared.equilibration is not None
        warm = shared.equilibration if shared.equilibration is not None else _RELAX * self.relaxation
        self._bounded("equilibration", warm, dt, given=given)
        return [
            Ramp(
                filament=shared.filament,
                control=self.control,
                values=values,
                stiffness=self.stiffness,
                tensions=self.tensions,
                temperature=shared.kelvin,
                replicas=count,
                seed=drawn_seed(child),
                timestep=dt,
                friction=self.friction,
                warm_up=math.ceil(warm / dt),
                stride=stride,
                every=every,
                back=back,
                reads=reads,
            )
            for count, child in zip(counts, seeds.spawn(len(counts)), strict=True)
        ]


def refuse_nothing(results: Sequence[RampResult | None]) -> None:
    """Pass Ctrl-C on where it left nothing to return."""
    if all(result is None for result in results):
        raise KeyboardInterrupt


def joined(results: Sequence[RampResult | None], tasks: Sequence[Ramp]) -> RampResult:
    """The replicas of several groups, NaN for those that were not done."""
    parts = [
        result
        or RampResult(
            *[np.full((1 + task.back, task.replicas, (len(task.values) - 1) // task.every + 1), math.nan)] * 3
        )
        for result, task in zip(results, tasks, strict=True)
    ]
    return RampResult(*(np.concatenate([getattr(part, name) for part in parts], axis=1) for name in vars(parts[0])))


def means(name: str, values: Array, dims: tuple[str, str], its_unit: str, meaning: str) -> dict[str, Any]:
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


def dataset(
    variables: dict[str, Any],
    coordinates: dict[str, Any],
    chosen: Settings,
    control: Control,
    stiffness: Array,
    results: Sequence[RampResult | None],
) -> xarray.Dataset:
    """Variables and coordinates with what all runs share in the attributes."""
    import xarray

    attributes = {
        "control": control,
        "temperature_K": chosen.kelvin,
        "seed": chosen.seed,
        "platform": "Reference",
        "interrupted": int(any(result is None for result in results)),
        **provenance(),
    }
    if control == "trap":
        attributes["stiffness_pN_per_nm"] = (stiffness / PN).tolist()
    return xarray.Dataset(variables, coordinates, attributes)
