"""What steady forces do on filaments that nothing holds, before they meet others: energy of motion, in internal units."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from openmm_filament import contact, traps
from openmm_filament.model import Model

__all__ = ["energy_of_falling"]

Array = NDArray[np.float64]


def energy_of_falling(model: Model, x: Array, friction: float) -> float:
    """The most energy of relative motion that two filaments in contact gain from here on, at internal positions (N, 3).

    Filaments with a held bead or a trap stay where they are, the others fall with the sum of their pulls (and plucks) over
    their mass, straight. On the way on which they could meet, less a diameter, two gain `mu a s` with the reduced mass mu and
    their relative acceleration a, and with a `friction` (rate) no more than at the speed `a/friction` that they end with.
    Bodies turn and bend on a way: what is beside a filament's path by more than both their widths is taken to be missed.
    """
    crowd = contact.crowd_of(model.interactions)
    if crowd is None or not (model.pulls.any() or model.plucks.any()):
        return 0.0
    bodies = _bodies(model, x, crowd.beads[:, 0])
    diameter = float(crowd.parameters["d"].min())
    return max((_gained(*pair, diameter, friction) for pair in combinations(bodies, 2)), default=0.0)


@dataclass(frozen=True)
class _Body:
    """A filament: its beads (N, 3), their mean and how far they are from it, its mass (infinite if held) and acceleration."""

    beads: Array
    centre: Array
    reach: float
    mass: float
    acceleration: Array


def _bodies(model: Model, x: Array, members: NDArray[np.int64]) -> list[_Body]:
    trapped = [i.beads[:, 0] for i in model.interactions if i.term is traps.Harmonic]
    kept = np.zeros(len(x), dtype=bool)
    kept[np.concatenate([model.held, *trapped])] = True
    out = []
    for start, end in zip(model.starts[:-1], model.starts[1:], strict=True):
        own = slice(int(start), int(end))
        if not ((members >= start) & (members < end)).any():
            continue
        beads = x[own]
        centre = beads.mean(axis=0)
        reach = float(np.linalg.norm(beads - centre, axis=-1).max())
        mass, force = float(model.masses[own].sum()), (model.pulls + model.plucks)[own].sum(axis=0)
        if kept[own].any():
            out.append(_Body(beads, centre, reach, math.inf, np.zeros(3)))
        else:
            out.append(_Body(beads, centre, reach, mass, force / mass))
    return out


def _gained(one: _Body, other: _Body, diameter: float, friction: float) -> float:
    relative = one.acceleration - other.acceleration
    size = float(np.linalg.norm(relative))
    if not size:
        return 0.0
    along = relative / size
    apart = other.centre - one.centre
    if np.linalg.norm(apart - (apart @ along) * along) > one.reach + other.reach + diameter:
        return 0.0
    way = max(float((other.beads @ along).max() - (one.beads @ along).min()) - diameter, 0.0)
    reduced = 1 / (1 / one.mass + 1 / other.mass)
    gained = reduced * size * way
    return gained if not friction else min(gained, reduced * (size / friction) ** 2 / 2)
