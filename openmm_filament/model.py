"""From filaments and loads to an OpenMM System: one OpenMM force per term that is present, and no others."""

from __future__ import annotations

import gc
import math
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import openmm as mm
from numpy.typing import NDArray
from openmm import app, unit

from openmm_filament import _checks as check
from openmm_filament import contact, traps, units
from openmm_filament._term import Interaction
from openmm_filament.binding import bound_together, checked
from openmm_filament.filament import Filament
from openmm_filament.geometry import segments
from openmm_filament.loads import Loads

__all__ = ["Model", "build"]

Array = NDArray[np.float64]

# Lengths, in nm, between which a filament runs in OpenMM's own units. Below, CustomAngleForce's floor of 1e-6 nm^2 on
# |s1 x s2| bites (with 0.01 nm segments at 1e-3 rad); above, coordinates lose digits in a PDB file.
_SHORTEST_SEGMENT, _LARGEST_EXTENT = 0.3, 1e6


@dataclass(frozen=True, eq=False, repr=False)
class Model:
    """Filaments as an OpenMM System.

    Attributes
    ----------
    system : openmm.System
        In internal units: nm, ps, Da and kJ/mol unless `scale` says otherwise. Held beads have mass zero.
    positions : Quantity
        Rest positions (N, 3) in internal units, ready for `Context.setPositions`; filaments follow one another.
    scale : Scale
        Physical units in one internal unit.
    groups : dict of str to int
        Force group of each term ("stretching", "bending", "torsion", "electrostatics", "contact") and of
        "pull", "pluck" and "trap".
    filaments, loads : tuple
        What the model was built from, one entry a filament; `loads` resolved, bead indices local to the filament.
    interactions : tuple of Interaction
        The terms and traps (where first built) in internal units with indices of the whole model: what the System's forces
        were made from, but for constant ones.
    planar : bool
        Whether the third coordinate is frozen (by the integrators of this package).
    """

    system: mm.System
    positions: unit.Quantity
    scale: units.Scale
    groups: dict[str, int]
    filaments: tuple[Filament, ...]
    loads: tuple[Loads, ...]
    interactions: tuple[Interaction, ...]
    planar: bool

    def __repr__(self) -> str:
        """One line: beads, filaments, terms, scale and plane."""
        kinds = ", ".join(dict.fromkeys(f"{i.term.family}.{i.term.__name__}" for i in self.interactions)) or "no terms"
        words = [f"{self.starts[-1]} beads", f"{len(self.filaments)} filaments", kinds]
        words += ["scaled"] * (not self.scale.is_identity) + ["planar"] * self.planar
        return f"<Model: {'; '.join(words)}>"

    @cached_property
    def topology(self) -> app.Topology:
        """One chain per filament, one residue with one atom per bead, bonds along the chain; made when first used."""
        with _collector_paused():
            return _topology(self.filaments)

    @cached_property
    def starts(self) -> NDArray[np.int64]:
        """Index of the first bead of each filament, and the number of all beads at the end: (filaments + 1,)."""
        return np.cumsum([0, *(len(filament) for filament in self.filaments)])

    @cached_property
    def held(self) -> NDArray[np.int64]:
        """Indices of the held beads in the whole model."""
        pairs = zip(self.starts, self.loads, strict=False)
        return np.array([start + i for start, load in pairs for i in load.held], dtype=np.int64)

    @cached_property
    def masses(self) -> Array:
        """Bead masses (N,) in internal units, held beads with the mass of their filament."""
        physical = [units.numbers("masses", filament.masses, "mass") for filament in self.filaments]
        return np.concatenate(physical) / self.scale.factor("mass")

    @cached_property
    def damping(self) -> Array:
        """Damping rates (N,) of the beads in internal units, zero where a filament has none."""
        physical = [
            np.zeros(len(filament)) if filament.damping is None else units.numbers("damping", filament.damping, "rate")
            for filament in self.filaments
        ]
        return np.concatenate(physical) / self.scale.factor("rate")

    @cached_property
    def pulls(self) -> Array:
        """Constant external forces (N, 3) on the beads in internal units."""
        return self._external("pulls")

    @cached_property
    def plucks(self) -> Array:
        """External forces (N, 3) on the beads until the plucks let go, in internal units."""
        return self._external("plucks")

    @cached_property
    def trap_numbers(self) -> NDArray[np.int64]:
        """The number of each of the model's traps, filament by filament: those of one number move together."""
        return np.array([number for load in self.loads for number in load.trap_numbers], dtype=np.int64)

    @property
    def letting_go(self) -> float:
        """Internal time at which the plucks let go; zero without any."""
        return max(load.letting_go for load in self.loads) / self.scale.factor("time")

    def _external(self, kind: str) -> Array:
        out = np.zeros((self.starts[-1], 3))
        for start, load in zip(self.starts, self.loads, strict=False):
            for i, force in getattr(load, kind).items():
                out[start + i] += force / self.scale.factor("force")
        return out

    def to_internal(self, value: unit.Quantity) -> unit.Quantity:
        """A physical Quantity (positions, time, temperature, force, energy, ...) in the units OpenMM runs with."""
        dimension = units.dimension_of("value", value)
        return units.quantity(
            _plain(units.numbers("value", value, dimension) / self.scale.factor(dimension)), dimension
        )

    def to_physical(self, value: Any, dimension: str) -> unit.Quantity:
        """An internal number, array or Quantity of "length", "time", "force", "energy", ... as a physical Quantity."""
        if isinstance(value, unit.Quantity):
            value = units.numbers("value", value, dimension)
        return units.quantity(_plain(check.array("value", value) * self.scale.factor(dimension)), dimension)

    def split(self, values: Array) -> list[Array]:
        """An array over all beads (N, ...) as one array a filament."""
        return np.split(values, self.starts[1:-1])


def _plain(values: Array) -> Any:
    return float(values) if np.ndim(values) == 0 else values


def build(filaments: Filament | Sequence[Filament], loads: Sequence[Any] = ()) -> Model:
    """An OpenMM System of one filament or several, with exactly one force per term present.

    Parameters
    ----------
    filaments : Filament or sequence of Filament
        Replicas are the same filament several times over. Filaments interact only where both have `contact.Repulsion`.
    loads : sequence
        For one filament its loads, such as `[Hold(0), Pull(-1, f)]`. For several, one such sequence a filament; bead
        indices are local to the filament.

    Raises
    ------
    ValueError, TypeError
        For loads that do not match the filaments, an index out of range, and a held bead that is also pulled or trapped.
    """
    chains, resolved = checked(filaments, loads)
    if len(planes := {entry.plane for entry in resolved}) > 1:
        raise ValueError(
            "Argument `loads` must put all filaments in the plane or none, but some have Plane() and some not."
        )

    with _collector_paused():
        bound = bound_together(chains, resolved)
        rest = np.concatenate([units.numbers("rest", chain.rest, "length") for chain in chains])
        scale = _choose_scale(chains, rest, bound)
        interactions = tuple(interaction.scaled(scale) for interaction in bound)
        system = mm.System()
        for chain, load in zip(chains, resolved, strict=True):
            masses = units.numbers("masses", chain.masses, "mass") / scale.factor("mass")
            masses[load.held] = 0.0
            deque(map(system.addParticle, masses.tolist()), maxlen=0)
        groups: dict[str, int] = {}
        for interaction in interactions:
            if interaction.term is traps.Harmonic:
                continue
            force = (
                contact.openmm_force(interaction, len(rest))
                if isinstance(interaction, contact.Crowd)
                else _openmm_force(interaction)
            )
            force.setForceGroup(groups.setdefault(interaction.term.family, len(groups)))
            force.setName(f"{interaction.term.family}.{interaction.term.__name__}")
            system.addForce(force)
        positions = units.quantity(rest / scale.length, "length")
        model = Model(system, positions, scale, groups, chains, resolved, interactions, planes == {True})
        _add_external(model)
    return model


def _add_external(model: Model) -> None:
    """Put the forces of pulls, plucks and traps into the System of a model, each with its group."""
    if len({load.letting_go for load in model.loads if load.plucks}) > 1:
        raise ValueError("Argument `loads` must let all plucks go together, but durations differ between filaments.")
    external: list[tuple[str, mm.CustomExternalForce]] = []
    for name, forces in (("pull", model.pulls), ("pluck", model.plucks)):
        if any(getattr(load, f"{name}s") for load in model.loads):
            external.append((name, _external_force(model, name, forces)))
    for interaction in model.interactions:
        if interaction.term is traps.Harmonic:
            external += [("trap", force) for force in traps.openmm_forces(interaction, model.trap_numbers)]
    for name, force in external:
        force.setForceGroup(model.groups.setdefault(name, len(model.groups)))
        model.system.addForce(force)


@contextmanager
def _collector_paused() -> Iterator[None]:
    """Without the cyclic garbage collector, which costs more than building a million bonds does."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


def _choose_scale(chains: Sequence[Filament], rest: Array, bound: Sequence[Interaction]) -> units.Scale:
    """OpenMM's own units where they serve; else the shortest segment, mean bead mass and largest energy become 1."""
    lengths = np.concatenate(
        [
            np.linalg.norm(segments(units.numbers("rest", c.rest, "length"), c.closed), axis=-1)
            for c in dict.fromkeys(chains)
        ]
    )
    if not len(lengths) or (lengths.min() >= _SHORTEST_SEGMENT and np.ptp(rest, axis=0).max() <= _LARGEST_EXTENT):
        return units.NANOMETER_SCALE
    length = float(lengths.min())
    mass = math.exp(np.mean([np.log(units.numbers("masses", c.masses, "mass")).mean() for c in chains]))
    energies = [interaction.stored_energy(length) for interaction in bound]
    return units.Scale(length, mass, max(energies, default=0.0) or 1.0)


def _openmm_force(interaction: Interaction) -> mm.Force:
    """The OpenMM force: numbers that all elements share stand in the expression, the others are per element.

    Numbers in the expression save a fifth of the time to build and a tenth of the time of a step.
    """
    shared = {n: v[0] for n, v in interaction.parameters.items() if len(v) and (v == v[0]).all()}
    expression = ";".join([interaction.term.expression, *(f"{n}={float(v)!r}" for n, v in shared.items())])
    force, add_parameter, add = interaction.term.openmm_force(expression)
    varying = [name for name in interaction.parameters if name not in shared]
    for name in varying:
        add_parameter(name)
    columns = interaction.beads.T.tolist()
    if varying:
        columns.append(np.stack([interaction.parameters[name] for name in varying], axis=1).tolist())
    deque(map(add, *columns), maxlen=0)  # calls `add` a million times without a Python loop
    return force


def _external_force(model: Model, name: str, forces: Array) -> mm.CustomExternalForce:
    """Constant forces on beads; those of "pluck" times a Context parameter of that name, 1 until they let go."""
    force = mm.CustomExternalForce("-(fx*x+fy*y+fz*z)" if name == "pull" else f"-{name}*(fx*x+fy*y+fz*z)")
    if name != "pull":
        force.addGlobalParameter(name, 1.0)
    for axis in ("fx", "fy", "fz"):
        force.addPerParticleParameter(axis)
    for start, load in zip(model.starts, model.loads, strict=False):
        for bead in getattr(load, f"{name}s"):
            force.addParticle(int(start + bead), forces[start + bead].tolist())
    force.setName(name)
    return force


def _topology(filaments: Sequence[Filament]) -> app.Topology:
    topology = app.Topology()
    for filament in filaments:
        chain = topology.addChain()
        atoms = [topology.addAtom("B", None, topology.addResidue("BEA", chain)) for _ in range(len(filament))]
        for first, second in pairwise(atoms):
            topology.addBond(first, second)
        if filament.closed:
            topology.addBond(atoms[-1], atoms[0])
    return topology
