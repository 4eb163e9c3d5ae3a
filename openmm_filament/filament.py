"""The filament: rest shape, masses and the terms that hold it together."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from openmm import unit

from openmm_filament import _checks as check
from openmm_filament import units
from openmm_filament._term import Interaction, Term
from openmm_filament.geometry import chain_indices, cross, dot, segments, unit_vectors

__all__ = ["COLLINEAR", "Filament", "sines"]

COLLINEAR = 1e-6
"""sin(beta) below which a dihedral is refused: its force, growing as 1/sin(beta), has lost ten of sixteen digits."""


def sines(positions: NDArray[np.float64], closed: bool = False) -> NDArray[np.float64]:
    """sin(beta) at each triple of successive beads."""
    triples = positions[chain_indices(len(positions), 3, closed)]
    first, second = (unit_vectors(triples[:, i + 1] - triples[:, i]) for i in range(2))
    normal = cross(first, second)
    return np.sqrt(dot(normal, normal))


def _frozen(values: NDArray[np.float64], dimension: str) -> unit.Quantity:
    values.flags.writeable = False
    return units.quantity(values, dimension)


@dataclass(frozen=True, eq=False, repr=False)
class Filament:
    """A chain of beads held by exactly the terms given, and by nothing else.

    Parameters
    ----------
    rest : Quantity
        Rest shape, length, (N, 3). Rest lengths and angles that a term is not given are read from it.
    masses : Quantity
        Bead masses, (N,) or one number for all; positive.
    terms : tuple of Term
        Such as `(stretching.Harmonic(k), bending.Harmonic(alpha))`.
    damping : Quantity, optional
        Damping rates, 1/time, (N,) or one number; not negative. Used by `euler_cromer` alone.
    closed : bool
        Whether the last bead is joined to the first (a ring).

    Raises
    ------
    ValueError
        For fewer beads than a term needs, coincident or non-finite beads, shapes that do not match, a mass or
        stiffness that is not positive, and a dihedral term on a rest shape with three collinear beads.
    TypeError
        For a number without a unit or with one of another dimension.
    """

    rest: unit.Quantity
    masses: unit.Quantity
    terms: tuple[Term, ...]
    damping: unit.Quantity | None = None
    closed: bool = False
    _bound: list[Interaction] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        rest = check.finite("rest", check.shape("rest", units.numbers("rest", self.rest, "length"), (None, 3)))
        terms = self._checked_terms(len(rest))
        self._check_shape(rest, terms)
        object.__setattr__(self, "rest", _frozen(rest, "length"))
        object.__setattr__(self, "terms", terms)
        masses = self._per_bead("masses", self.masses, "mass", check.positive)
        object.__setattr__(self, "masses", _frozen(masses, "mass"))
        if self.damping is not None:
            damping = self._per_bead("damping", self.damping, "rate", check.non_negative)
            object.__setattr__(self, "damping", _frozen(damping, "rate"))
        bound = [term.bind(rest, self.closed) for term in terms]  # a bad stiffness or rest value is refused here
        object.__setattr__(self, "_bound", bound)

    def _checked_terms(self, beads: int) -> tuple[Term, ...]:
        terms = self.terms
        if isinstance(terms, Term):
            raise TypeError(
                f"Argument `terms` must be a tuple of terms, but is one {_name(terms)}: write ({_name(terms)}(...),)."
            )
        if not isinstance(terms, Iterable):
            raise TypeError(f"Argument `terms` must be a tuple of terms, but is {terms!r}.")
        for term in (terms := tuple(terms)):
            if not isinstance(term, Term):
                raise TypeError(
                    f"Argument `terms` must hold terms such as stretching.Harmonic(...), but holds {term!r}."
                )
            needed = 3 if self.closed and term.span == 2 else term.span
            if beads < needed:
                raise ValueError(
                    f"Argument `rest` must have at least {needed} beads for {_name(term)}, but has {beads}."
                )
        if sum(term.family == "contact" for term in terms) > 1:
            raise ValueError("Argument `terms` must hold one contact.Repulsion at most, but holds several.")
        if beads < 1:
            raise ValueError("Argument `rest` must have at least one bead, but has 0.")
        return terms

    def _check_shape(self, rest: NDArray[np.float64], terms: tuple[Term, ...]) -> None:
        lengths = np.linalg.norm(segments(rest, self.closed), axis=-1)
        if (lengths == 0).any():
            first = int(np.argmin(lengths))
            raise ValueError(
                f"Argument `rest` must not have coincident beads, but beads {first} and {(first + 1) % len(rest)} "
                f"are both at {rest[first].tolist()} nm."
            )
        for term in terms:
            if term.needs_bends and (straight := sines(rest, self.closed) < COLLINEAR).any():
                i = int(np.argmax(straight))
                raise ValueError(
                    f"Argument `rest` must be bent at every inner bead for {_name(term)}, but beads "
                    f"{', '.join(str(j % len(rest)) for j in range(i, i + 3))} are collinear, where a dihedral angle does "
                    "not exist: use torsion.Weighted, which is smooth there, or leave torsion out."
                )

    def _per_bead(self, name: str, value: Any, dimension: str, rule: Any) -> NDArray[np.float64]:
        values = rule(name, units.numbers(name, value, dimension))
        if values.ndim:
            check.shape(name, values, (len(self),))
        return np.array(np.broadcast_to(values, (len(self),)))

    def __repr__(self) -> str:
        """One line: beads, terms, and whether it is a ring."""
        words = [f"{len(self)} beads", ", ".join(_name(term) for term in self.terms) or "no terms"]
        words += ["closed"] * self.closed + ["damped"] * (self.damping is not None)
        return f"<Filament: {'; '.join(words)}>"

    def __len__(self) -> int:
        """Number of beads."""
        return len(self.rest._value)

    def interactions(self) -> list[Interaction]:
        """The terms bound to the beads, in nm and kJ/mol, as they were when the filament was made."""
        return list(self._bound)


def _name(term: Term) -> str:
    return f"{term.family}.{type(term).__name__}"
