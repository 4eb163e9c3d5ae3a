"""What every energy term of a chain offers: parameters from a rest shape, NumPy energy and gradient, an OpenMM force.

A term is one formula over runs of `span` successive beads. It states the formula twice: as the NumPy functions
`energy` and `gradient`, and as the `expression` that OpenMM differentiates itself; a contract test holds one against
the other. `Interaction` is a term bound to the beads and numbers of a chain.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, Self

import numpy as np
import openmm as mm
from numpy.typing import NDArray

from openmm_filament import _checks as check
from openmm_filament import units
from openmm_filament.geometry import chain_indices

__all__ = ["Interaction", "Parameters", "Term", "per_element", "read_off"]

Array = NDArray[np.float64]
Parameters = Mapping[str, Array]


class Term(ABC):
    """One energy term along a chain; subclasses are frozen dataclasses, final, whose fields are Quantities."""

    family: ClassVar[str]
    """Key of the term in energies, forces and force groups: "stretching", "bending", ..."""
    span: ClassVar[int]
    """Number of successive beads that one element of the term couples; a chain needs at least as many."""
    expression: ClassVar[str]
    """The energy of one element, in OpenMM's grammar."""
    dimensions: ClassVar[Mapping[str, str]]
    """The parameters of `expression` and the dimension of each, in the order they are added."""
    needs_bends: ClassVar[bool] = False
    """Whether the term is undefined where three successive beads are collinear."""

    def __post_init__(self) -> None:
        """Keep copies, so that arrays changed later by their owner do not change the term."""
        for field in fields(self):  # type: ignore[arg-type]
            object.__setattr__(self, field.name, units.frozen_copy(getattr(self, field.name)))

    @abstractmethod
    def parameters(self, rest: Array, closed: bool) -> dict[str, Array]:
        """Parameters, one number an element, for the rest shape (N, 3) in nm; checked."""

    @staticmethod
    @abstractmethod
    def energy(x: Array, p: Parameters) -> Array:
        """Energies (M,) of the elements x (M, span, 3)."""

    @staticmethod
    @abstractmethod
    def gradient(x: Array, p: Parameters) -> Array:
        """Gradients (M, span, 3) of the energies of the elements x (M, span, 3)."""

    @classmethod
    def openmm_force(cls, expression: str) -> tuple[mm.Force, Any, Any]:
        """An empty OpenMM force, its method that adds a parameter, and the one that adds an element."""
        if cls.span == 2:
            bond = mm.CustomBondForce(expression)
            return bond, bond.addPerBondParameter, bond.addBond
        if cls.span == 3:
            angle = mm.CustomAngleForce(expression)
            return angle, angle.addPerAngleParameter, angle.addAngle
        torsion = mm.CustomTorsionForce(expression)
        return torsion, torsion.addPerTorsionParameter, torsion.addTorsion

    def bind(self, rest: Array, closed: bool) -> Interaction:
        """The term on a chain of this rest shape (N, 3), in nm and kJ/mol."""
        beads = chain_indices(len(rest), self.span, closed)
        return Interaction(type(self), beads, self.parameters(rest, closed))


_LENGTH_POWER = {"stiffness": 2, "energy": 0, "energy_length": -1}
"""Power of the length that turns a parameter into an energy."""


@dataclass(frozen=True, eq=False)
class Interaction:
    """A term bound to beads: `beads` (M, span) indices, `parameters` M numbers each, in one consistent set of units."""

    term: type[Term]
    beads: NDArray[np.int64]
    parameters: dict[str, Array]

    def at(self, positions: Array) -> Interaction:
        """The elements at positions (N, 3): the same everywhere but for contact, whose pairs come and go."""
        return self

    def energy(self, positions: Array) -> float:
        """The sum of the elements' energies for positions (N, 3)."""
        here = self.at(positions)
        return float(here.term.energy(positions[here.beads], here.parameters).sum())

    def forces(self, positions: Array) -> Array:
        """Forces (N, 3) on all beads."""
        here = self.at(positions)
        return here.summed(-here.term.gradient(positions[here.beads], here.parameters), len(positions))

    def summed(self, vectors: Array, count: int) -> Array:
        """Vectors (M, span, 3) of the elements' beads, summed by bead: (count, 3)."""
        flat = self.beads.ravel()
        columns = [np.bincount(flat, vectors[..., k].ravel(), count) for k in range(3)]
        return np.stack(columns, axis=-1).astype(np.float64, copy=False)

    def stored_energy(self, length: float) -> float:
        """The energy that a change of order one (a strain, a radian) stores in segments of this length."""
        dimensions = self.term.dimensions
        sizes = ((dimensions[name], np.abs(values).max(initial=0.0)) for name, values in self.parameters.items())
        return max(float(size) * length ** _LENGTH_POWER[d] for d, size in sizes if d in _LENGTH_POWER)

    def scaled(self, scale: units.Scale) -> Interaction:
        """The same interaction in the internal units of `scale`."""
        if scale.is_identity:
            return self
        dimensions = self.term.dimensions
        converted = {name: values / scale.factor(dimensions[name]) for name, values in self.parameters.items()}
        return replace(self, parameters=converted)

    def shifted(self, start: int) -> Self:
        """The same interaction of beads that stand `start` places further in the whole model."""
        return replace(self, beads=self.beads + start) if start else self

    @staticmethod
    def joined(parts: Sequence[Interaction]) -> Interaction:
        """Interactions of one term and one class as one."""
        if len(parts) == 1:
            return parts[0]
        names = parts[0].parameters
        return replace(
            parts[0],
            beads=np.concatenate([part.beads for part in parts]),
            parameters={name: np.concatenate([part.parameters[name] for part in parts]) for name in names},
        )


def per_element(
    name: str, value: Any, dimension: str, rest: Array, span: int, closed: bool, rule: Any = check.finite
) -> Array:
    """A Quantity, scalar or one per element, as an array of one number an element of the chain."""
    numbers = rule(name, units.numbers(name, value, dimension))
    count = len(chain_indices(len(rest), span, closed))
    if numbers.ndim:
        check.shape(name, numbers, (count,))
    return np.array(np.broadcast_to(numbers, (count,)))


def read_off(values: Array, rest: Array, lever: float = 1.0) -> Array:
    """Lengths or angles read off a rest shape, made equal where they differ by the rounding of its coordinates alone.

    `lever` turns a displacement into a change of the values: 1 for lengths, 1/length for angles. A uniform shape so
    gives one number, however long it is and wherever it lies.
    """
    resolution = 64 * np.finfo(float).eps * np.abs(rest).max() * lever
    if len(values) and np.ptp(values) <= resolution:
        return np.full_like(values, np.median(values))
    return values
