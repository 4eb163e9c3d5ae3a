"""What to run at each force of a curve: the chain, its time step and friction, and how often to take a sample."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from openmm import unit

from openmm_filament import units
from openmm_filament.blocks import Block, check_ends, clamped_model
from openmm_filament.discretisation import PN, Choice, choose, exact_chain, time_step_bias
from openmm_filament.filament import Filament
from openmm_filament.integrators import FRICTION, LANGEVIN_STEP, thermal_step
from openmm_filament.model import Model
from openmm_filament.rods import WormlikeChain
from openmm_filament.timestep import slow_frequency

__all__ = ["GROUPS", "REPLICAS", "Plan", "plan_curve"]

Array = NDArray[np.float64]

GROUPS = 4
"""Independent runs a force, so that several processes can share one force."""

REPLICAS = 2
"""Chains in the System of each run."""

_SAMPLE_TIME, _WARM_UP_TIME = 0.2, 2.5
"""Between samples, and before the first: times over 1/omega of the slowest mode."""

_STRAIGHTENED, _LONGER = 100.0, 3.0
"""Work of the force on a segment over k_B T above which starts, drawn bond by bond, are too little aligned (by a tenth of a
radian), and how much longer the way to the first sample then is."""


@dataclass(frozen=True, eq=False)
class Plan:
    """What to run at one force.

    The force in pN, the wanted error and the choice made for it, whose biases are NaN for a chain that is run as it is;
    the chain as a model of one replica; `timestep` in ps and `friction` in 1/ps; samples are taken every `stride` steps
    after `warm_up` steps.
    """

    force: float
    relative_error: float
    choice: Choice
    model: Model
    timestep: float
    friction: float
    stride: int
    warm_up: int

    def block(self, seed: int, kelvin: float, dimension: int, platform: str) -> Block:
        """The run of a group of replicas, before its first sample."""
        return Block(
            filament=self.choice.filament,
            force=self.force * PN,
            temperature=kelvin,
            dimension=dimension,
            replicas=REPLICAS,
            seed=seed,
            timestep=self.timestep,
            friction=self.friction,
            stride=self.stride,
            samples=0,
            warm_up=self.warm_up,
            platform=platform,
            keep_frames=False,
        )


def plan_curve(
    chain: WormlikeChain | Filament,
    forces: Array,
    kelvin: float,
    wanted: Array,
    dimension: int,
    timestep: unit.Quantity | None,
    chosen: Callable[[int], None] = lambda _: None,
) -> list[Plan]:
    """A plan for each of the forces (M,) in pN to its wanted relative error (M,); `chosen` as in `choose`."""
    temperature = kelvin * unit.kelvin
    if isinstance(chain, WormlikeChain):
        if dimension != 3:
            raise ValueError("Argument `dimension` must be 3 for a WormlikeChain, but is 2: pass a Filament.")
        chains = choose(chain, forces, temperature, wanted, chosen)
    elif isinstance(chain, Filament):
        check_ends("chain", chain)
        flat = chain if dimension == 3 else _laid_flat(chain)
        chains = [Choice(flat, math.nan, math.nan, LANGEVIN_STEP, math.nan)] * len(forces)
    else:
        raise TypeError(f"Argument `chain` must be a WormlikeChain or a Filament, but is {chain!r}.")
    plans = []
    for choice, force, error in zip(chains, forces, wanted, strict=True):
        model = clamped_model(choice.filament, force * PN, dimension, 1)
        rate = slow_frequency(model, kelvin / model.scale.factor("temperature"))
        dt = thermal_step(model, kelvin, timestep, choice.step)
        step = choice.step if timestep is None else choice.step * dt / thermal_step(model, kelvin, None, choice.step)
        settled = timestep is None and not math.isnan(choice.time_step)
        to_ps = model.scale.factor("time")
        length = float(np.linalg.norm(np.diff(model.positions._value, axis=0), axis=-1).max())
        aligned = force * PN * length * model.scale.length > _STRAIGHTENED * units.BOLTZMANN * kelvin
        plans.append(
            Plan(
                force=float(force),
                relative_error=float(error),
                choice=choice if settled else _timed(choice, step, float(force), float(error), temperature, dimension),
                model=model,
                timestep=dt * to_ps,
                friction=FRICTION * rate / to_ps,
                stride=max(1, round(_SAMPLE_TIME / rate / dt)),
                warm_up=round((_LONGER if aligned else 1.0) * _WARM_UP_TIME / rate / dt),
            )
        )
    return plans


def _timed(
    choice: Choice, step: float, force: float, wanted: float, temperature: unit.Quantity, dimension: int
) -> Choice:
    """The choice with the time step that it gets, refused where the error of that step leaves none to be sampled."""
    exact = exact_chain(choice.filament, temperature) if dimension == 3 else None
    timed = replace(choice, step=step, time_step=math.nan if exact is None else time_step_bias(exact, force, step))
    if timed.known > 0.9 * wanted:
        raise ValueError(
            f"Argument `timestep` must leave an error to be sampled at {force:.6g} pN, but at {step:.3g} of the limit of "
            f"stability its own {abs(timed.time_step):.3g} and the bias of the chain take {timed.known:.3g} of {wanted:.3g}."
        )
    return timed


def _laid_flat(chain: Filament) -> Filament:
    """The filament with its rest shape turned into the xy plane, the only place where a planar run can hold it.

    Raises ValueError if no plane holds it.
    """
    rest = units.numbers("rest", chain.rest, "length")
    if not rest[:, 2].any():
        return chain
    centred = rest - rest.mean(axis=0)
    _, sizes, axes = np.linalg.svd(centred, full_matrices=False)
    if sizes[2] > 1e-9 * sizes[0]:
        raise ValueError(
            "Argument `chain` must have a rest shape in one plane for dimension 2, but it leaves the best one by "
            f"{np.abs(centred @ axes[2]).max():.3g} nm."
        )
    flat = centred @ axes.T
    flat[:, 2] = 0.0
    return replace(chain, rest=units.quantity(flat, "length"))
