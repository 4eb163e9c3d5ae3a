"""What acts on a filament from outside. Bead indices are local to the filament; negative ones count from its end."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, final

import numpy as np
from numpy.typing import NDArray
from openmm import unit

from openmm_filament import _checks as check
from openmm_filament import traps, units
from openmm_filament._term import Interaction, read_off
from openmm_filament.geometry import segments

__all__ = ["Hold", "Load", "Loads", "Plane", "Pluck", "Pull", "Tension", "Trap", "resolve"]


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

    One held bead leaves the chain free to turn about it. Two clamp it: its direction is then fixed half a segment from the
    second of them, so that a rod of length L held at beads 0 and 1 is a cantilever of length `L - l0/2` (to first order).

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


@final
@dataclass(frozen=True, eq=False)
class Pluck(Load):
    """A constant force on beads from the start of a run until it lets go, `duration` later.

    The force is `Pull`'s, times a Context parameter that `record` and `pluck_reporter` set from 1 to 0 at that time. All
    plucks of a model let go together.

    Parameters
    ----------
    beads : int or sequence of int
    force : Quantity
        The force vector, (3,), on each of the beads.
    duration : Quantity
        Time, positive.
    """

    beads: int | Sequence[int]
    force: unit.Quantity
    duration: unit.Quantity

    def __post_init__(self) -> None:
        check.finite("force", check.shape("force", units.numbers("force", self.force, "force"), (3,)))
        check.positive("duration", units.number("duration", self.duration, "time"), unit="ps")
        object.__setattr__(self, "force", units.frozen_copy(self.force))
        object.__setattr__(self, "beads", _own(self.beads))


@final
@dataclass(frozen=True, eq=False)
class Tension(Load):
    """A filament stretched between its held ends: no force is added, its rest lengths become `b - T/k`.

    b are the segment lengths of the rest shape, k the stiffness of the (harmonic) stretching term, so that a straight
    chain carries the same tension T in every segment and is at rest.

    Parameters
    ----------
    tension : Quantity
        T, force, not negative.
    """

    tension: unit.Quantity

    def __post_init__(self) -> None:
        if not 0 <= units.number("tension", self.tension, "force") < math.inf:
            raise check.fail("tension", "be finite and not negative", self.tension)


@final
@dataclass(frozen=True, eq=False)
class Trap(Load):
    """A harmonic trap on a bead: energy `k/2 |r - r0|^2`, the force read from it `k (r0 - r)`.

    It can be moved while it runs, without building again: `move_trap`, or the Context parameters `trap0_x`, `trap0_y`
    and `trap0_z`, its displacement in internal units. Traps of one number move together, also those of several filaments.

    Parameters
    ----------
    bead : int
    stiffness : Quantity
        k, energy/length^2, not negative, one number or (3,) along x, y and z; not zero along all.
    position : Quantity
        r0, the centre of the trap, (3,).
    number : int, optional
        Not negative; by default its place among the traps of its filament.
    """

    bead: int
    stiffness: unit.Quantity
    position: unit.Quantity
    number: int | None = None

    def __post_init__(self) -> None:
        k = check.non_negative("stiffness", units.numbers("stiffness", self.stiffness, "stiffness"))
        if k.ndim:
            check.shape("stiffness", k, (3,))
        if not k.any():
            raise check.fail("stiffness", "be positive along an axis", k)
        check.finite("position", check.shape("position", units.numbers("position", self.position, "length"), (3,)))
        if self.number is not None:
            check.integer("number", self.number, low=0)
        object.__setattr__(self, "stiffness", units.frozen_copy(self.stiffness))
        object.__setattr__(self, "position", units.frozen_copy(self.position))


@dataclass(frozen=True, eq=False)
class Loads:
    """The loads on one filament, resolved, in kJ/mol, nm and ps.

    Attributes
    ----------
    held : list of int
    pulls, plucks : dict of int to (3,) array
        Forces summed by bead; those of `plucks` act until the time `letting_go`.
    plane : bool
    tension : float
        Zero where there is none.
    traps : Interaction
        In the order of the loads, in kJ/mol/nm^2 and nm.
    trap_numbers : tuple of int
        Of each of the traps.
    """

    held: list[int]
    pulls: dict[int, NDArray[np.float64]]
    plane: bool
    plucks: dict[int, NDArray[np.float64]] = field(default_factory=dict)
    letting_go: float = 0.0
    tension: float = 0.0
    traps: Interaction = field(default_factory=lambda: traps.interaction([], [], []))
    trap_numbers: tuple[int, ...] = ()

    def energies(self, positions: NDArray[np.float64]) -> dict[str, float]:
        """Energies of "pull", "pluck" and "trap" in kJ/mol, where there are any, for positions (N, 3) in nm."""
        acting = {"pull": self.pulls, "pluck": self.plucks}
        out = {
            name: -float(sum(force @ positions[i] for i, force in forces.items()))
            for name, forces in acting.items()
            if forces
        }
        return out | ({"trap": self.traps.energy(positions)} if len(self.traps.beads) else {})

    def forces(self, positions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Forces of pulls, plucks and traps (N, 3) in kJ/mol/nm."""
        out = self.traps.forces(positions)
        for forces in (self.pulls, self.plucks):
            for i, force in forces.items():
                out[i] += force
        return out

    def tightened(self, interactions: Sequence[Interaction], rest: NDArray[np.float64]) -> list[Interaction]:
        """The terms of a filament of this rest shape (N, 3), with the rest lengths that the tension asks for.

        Raises ValueError where it cannot: no harmonic stretching term, a free end, or a tension that leaves no length.
        """
        if not self.tension:
            return list(interactions)
        stretched = [i for i in interactions if i.term.family == "stretching"]
        if len(stretched) != 1 or "r0" not in stretched[0].parameters:
            raise ValueError(
                "Argument `loads` must hold Tension only for a filament with one harmonic stretching term."
            )
        if len(stretched[0].beads) == len(rest):
            raise ValueError("Argument `loads` must not hold Tension for a closed filament, which has no ends to hold.")
        if missing := {0, len(rest) - 1} - set(self.held):
            raise ValueError(f"Argument `loads` must hold both ends under Tension, but bead {min(missing)} is free.")
        lengths = np.linalg.norm(segments(rest), axis=-1)
        r0 = lengths - self.tension / stretched[0].parameters["k"]
        if (r0 <= 0).any():
            i = int(np.argmin(r0))
            most = stretched[0].parameters["k"][i] * lengths[i]
            raise ValueError(
                f"Argument `tension` must be below k b = {most:.6g} kJ/mol/nm, at which segment {i} has no rest length, but "
                f"is {self.tension:.6g} kJ/mol/nm."
            )
        tight = replace(stretched[0], parameters={**stretched[0].parameters, "r0": read_off(r0, rest)})
        return [tight if i is stretched[0] else i for i in interactions]


def resolve(loads: Any, beads: int) -> Loads:
    """The loads on a filament of so many beads, checked against it and against one another.

    Raises ValueError for an index out of range, for a held bead that is also pulled, plucked or trapped, and for plucks that
    do not let go together.
    """
    held: dict[int, None] = {}
    pulls: dict[int, NDArray[np.float64]] = {}
    plucks: dict[int, NDArray[np.float64]] = {}
    letting_go: set[float] = set()
    trapped: list[tuple[int, NDArray[np.float64], NDArray[np.float64]]] = []
    numbers: list[int] = []
    plane = False
    tension = 0.0
    if isinstance(loads, Load):
        raise TypeError(
            f"Argument `loads` must be a sequence of loads, but is one {type(loads).__name__}: write [{type(loads).__name__}(...)]."
        )
    for load in loads:
        match load:
            case Hold():
                held.update(dict.fromkeys(_indices(load.beads, beads, "Hold.beads")))
            case Pull() | Pluck():
                force = units.numbers("force", load.force, "force")
                summed = pulls if isinstance(load, Pull) else plucks
                for i in _indices(load.beads, beads, f"{type(load).__name__}.beads"):
                    summed[i] = summed.get(i, np.zeros(3)) + force
                if isinstance(load, Pluck):
                    letting_go.add(units.number("duration", load.duration, "time"))
            case Trap():
                stiffness = np.broadcast_to(units.numbers("stiffness", load.stiffness, "stiffness"), 3)
                centre = units.numbers("position", load.position, "length")
                numbers.append(len(trapped) if load.number is None else load.number)
                trapped.append((check.index("Trap.bead", load.bead, beads), stiffness, centre))
            case Tension():
                tension += units.number("tension", load.tension, "force")
            case Plane():
                plane = True
            case _:
                raise TypeError(f"Argument `loads` must hold loads such as Hold(0), but holds {load!r}.")
    _check_free(held, pull=pulls, pluck=plucks, trap={bead: stiffness for bead, stiffness, _ in trapped})
    if len(letting_go) > 1:
        raise ValueError(f"Argument `loads` must let all plucks go together, but has {sorted(letting_go)} ps.")
    in_traps = traps.interaction(*([row[i] for row in trapped] for i in range(3)))
    return Loads(list(held), pulls, plane, plucks, max(letting_go, default=0.0), tension, in_traps, tuple(numbers))


def _check_free(held: dict[int, None], **acting: dict[int, NDArray[np.float64]]) -> None:
    """Refuse a held bead on which something acts."""
    for verb, beads in acting.items():
        if both := sorted(held.keys() & beads.keys()):
            done = "trapped" if verb == "trap" else f"{verb}ed"
            raise ValueError(
                f"Argument `loads` must not {verb} a held bead, but bead {both[0]} is both held and {done}."
            )
