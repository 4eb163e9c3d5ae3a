"""What acts on a filament from outside. Bead indices are local to the filament; negative ones count from its end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from numpy.typing import NDArray
from openmm import unit

from openmm_filament import _checks as check
from openmm_filament import units

__all__ = ["Hold", "Load", "Loads", "Plane", "Pull", "resolve"]


class Load:
    """Base of everything that acts from outside; the final classes below say what they do."""


def _own(beads: int | Sequence[int]) -> int | Sequence[int]:
    """The indices, copied where they are several, so that they stay what they are."""
    return tuple(beads) if isinstance(beads, (Sequence, np.ndarray)) else beads


def _indices(beads: int | Sequence[int], length: int, name: str) -> list[int]:
    """Bead indices counted from the front, each once."""
    listed = list(beads) if isinstance(beads, (Sequence, np.ndarray)) else [beads]
    return list(dict.fromkeys(check.index(name, i, length) for i in listed))


@final
@dataclass(frozen=True, eq=False)
class Hold(Load):
    """Beads held where they are: their mass in the System is zero, so that no integrator moves them.

    Parameters
    ----------
    beads : int or sequence of int
    """

    beads: int | Sequence[int]

    def __post_init__(self) -> None:
        object.__setattr__(self, "beads", _own(self.beads))


@final
@dataclass(frozen=True, eq=False)
class Pull(Load):
    """A constant force on beads: energy `-sum F.r` (a force clamp).

    Parameters
    ----------
    beads : int or sequence of int
    force : Quantity
        The force vector, (3,), on each of the beads.
    """

    beads: int | Sequence[int]
    force: unit.Quantity

    def __post_init__(self) -> None:
        check.finite("force", check.shape("force", units.numbers("force", self.force, "force"), (3,)))
        object.__setattr__(self, "force", units.frozen_copy(self.force))
        object.__setattr__(self, "beads", _own(self.beads))


@final
@dataclass(frozen=True)
class Plane(Load):
    """Strict confinement to the plane of the first two coordinates.

    No force is added: the integrators of this package leave the third coordinate and velocity as they are.
    """


@dataclass(frozen=True, eq=False)
class Loads:
    """The loads on one filament, resolved: `held` bead indices, summed `pulls` by bead in kJ/mol/nm, `plane`."""

    held: list[int]
    pulls: dict[int, NDArray[np.float64]]
    plane: bool

    def energy(self, positions: NDArray[np.float64]) -> float:
        """Energy of the pulls in kJ/mol for positions (N, 3) in nm."""
        return -float(sum(force @ positions[i] for i, force in self.pulls.items()))

    def forces(self, positions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Forces of the pulls (N, 3) in kJ/mol/nm."""
        out = np.zeros_like(positions)
        for i, force in self.pulls.items():
            out[i] += force
        return out


def resolve(loads: Any, beads: int) -> Loads:
    """The loads on a filament of so many beads, checked against it and against one another.

    Raises ValueError for an index out of range and for a held bead that is also pulled.
    """
    held: dict[int, None] = {}
    pulls: dict[int, NDArray[np.float64]] = {}
    plane = False
    if isinstance(loads, Load):
        raise TypeError(
            f"Argument `loads` must be a sequence of loads, but is one {type(loads).__name__}: write [{type(loads).__name__}(...)]."
        )
    for load in loads:
        match load:
            case Hold():
                held.update(dict.fromkeys(_indices(load.beads, beads, "Hold.beads")))
            case Pull():
                force = units.numbers("force", load.force, "force")
                for i in _indices(load.beads, beads, "Pull.beads"):
                    pulls[i] = pulls.get(i, np.zeros(3)) + force
            case Plane():
                plane = True
            case _:
                raise TypeError(f"Argument `loads` must hold loads such as Hold(0), but holds {load!r}.")
    if both := sorted(held.keys() & pulls.keys()):
        raise ValueError(f"Argument `loads` must not pull a held bead, but bead {both[0]} is both held and pulled.")
    return Loads(list(held), pulls, plane)
