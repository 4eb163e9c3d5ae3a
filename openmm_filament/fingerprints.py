"""What the numbers of a force-extension curve depend on, so that it goes on only where it may."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Sequence
from typing import Any

import numpy as np
import openmm as mm
from numpy.typing import NDArray
from openmm import unit

from openmm_filament import units
from openmm_filament.filament import Filament
from openmm_filament.planning import Plan
from openmm_filament.rods import WormlikeChain

__all__ = ["fingerprint"]

Array = NDArray[np.float64]


def fingerprint(
    chain: WormlikeChain | Filament,
    plans: Sequence[Plan],
    kelvin: float,
    timestep: unit.Quantity | None,
    trajectories: Collection[int],
    **others: Any,
) -> dict[str, Any]:
    """The arguments of a call by their names, in numbers, words and hashes that JSON keeps exactly.

    `plan` is a hash of the runs that follow from them, which other versions of NumPy or SciPy may round otherwise.
    """
    from openmm_filament import __version__

    return {
        "chain": _filament(chain) if isinstance(chain, Filament) else _wormlike(chain),
        "forces": [plan.force for plan in plans],
        "temperature": kelvin,
        "relative_error": [plan.relative_error for plan in plans],
        "timestep": None if timestep is None else units.number("timestep", timestep, "time"),
        **others,
        "trajectories": sorted(trajectories),
        "OpenMM": mm.Platform.getOpenMMVersion(),
        "openmm_filament": __version__,
        "plan": _hash(
            [
                (_filament(p.choice.filament), p.force, p.choice.known, p.timestep, p.friction, p.stride, p.warm_up)
                for p in plans
            ]
        ),
    }


def _wormlike(chain: WormlikeChain) -> str:
    names = ("contour_length", "persistence_length", "stretch_modulus", "line_density")
    dimensions = ("length", "length", "force", "line_density")
    given = [(getattr(chain, name), dimension) for name, dimension in zip(names, dimensions, strict=True)]
    return _hash([None if value is None else units.number("chain", value, dimension) for value, dimension in given])


def _filament(filament: Filament) -> str:
    parts: list[Any] = [filament.closed]
    for name, dimension in (("rest", "length"), ("masses", "mass")):
        parts.append(units.numbers(name, getattr(filament, name), dimension))
    for interaction in filament.interactions():
        parts += [interaction.term.__qualname__, interaction.term.expression, interaction.beads]
        parts += [part for name in sorted(interaction.parameters) for part in (name, interaction.parameters[name])]
    return _hash(parts)


def _hash(parts: Sequence[Any]) -> str:
    total = hashlib.sha256()
    for part in parts:
        if isinstance(part, np.ndarray):
            total.update(f"{part.dtype.str}{part.shape}".encode() + np.ascontiguousarray(part).tobytes())
        else:
            total.update(repr(part).encode())
        total.update(b";")
    return total.hexdigest()[:16]
