"""Contact of filaments: beads that are no neighbours along the chain repel where they overlap."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self, final

import numpy as np
import openmm as mm
from numpy.typing import NDArray
from openmm import unit

from openmm_filament import _checks as check
from openmm_filament._term import Array, Interaction, Parameters, Term, per_element
from openmm_filament.geometry import dot, segments

__all__ = ["Crowd", "Overlap", "Repulsion", "crowd_of", "openmm_force", "refuse"]

_HAIRPIN = math.pi / 2
"""Contour distance over the diameter up to which beads of one chain are neighbours: a wire that turns back on itself has
its sides in touch over half a circle of that length."""


class Overlap(Term):
    """Energy `1/2 k (d - r)^2` of two beads nearer than d, and none beyond: the formula of one pair in contact."""

    family = "contact"
    span = 2
    expression = "0.5*k*step(d-r)*(d-r)^2"
    dimensions = {"k": "stiffness", "d": "length"}

    def parameters(self, rest: Array, closed: bool) -> dict[str, Array]:
        raise TypeError("Contact between beads must be given as contact.Repulsion, but is given as single pairs.")

    @staticmethod
    def energy(x: Array, p: Parameters) -> Array:
        return 0.5 * p["k"] * _depth(x, p)[0] ** 2

    @staticmethod
    def gradient(x: Array, p: Parameters) -> Array:
        depth, s, r = _depth(x, p)
        g = (-p["k"] * depth / np.where(r == 0, 1, r))[:, None] * s  # beads in one place have no direction
        return np.stack([-g, g], axis=1)


def _depth(x: Array, p: Parameters) -> tuple[Array, Array, Array]:
    """By how much the beads of each pair overlap, the vector between them and its length."""
    s = x[:, 1] - x[:, 0]
    r = np.sqrt(dot(s, s))
    return np.where(r.real < p["d"], p["d"] - r, 0.0), s, r


@final
@dataclass(frozen=True, eq=False)
class Repulsion(Overlap):
    """Energy `sum 1/2 k (d - r_ij)^2` over the pairs of beads nearer than d: soft spheres, frictionless.

    It acts between all beads whose filaments carry it, of the same filament and of others. Two different beads meet with
    the mean of their diameters and with their springs in series, `k = 2 k_i k_j/(k_i + k_j)`. Beads of one filament that
    are bonded, or nearer along its rest shape than pi/2 diameters, do not repel.

    A stiffness like that of stretching keeps the time step and makes the overlap of thin filaments negligible beside their
    bending. Chains cannot pass through one another where the beads stand closer than the diameter and what drives them is
    weaker than `of.barrier`; `preflight` checks it.

    It becomes a CustomNonbondedForce with a cutoff at d, whose cost grows linearly with the beads. On OpenMM's Reference
    platform a step costs some twenty times one on its CPU platform, so choose with `fastest_platform`. Replicas that shall not
    meet belong far apart.

    Parameters
    ----------
    diameter : Quantity
        d, length, positive; one number for all beads or one per bead. A wire's own diameter.
    stiffness : Quantity
        k, energy/length^2, positive; one number or one per bead.
    """

    diameter: unit.Quantity
    stiffness: unit.Quantity

    span = 1  # any number of beads will do: the pairs are found in space, not along the chain

    def parameters(self, rest: Array, closed: bool) -> dict[str, Array]:
        return {
            "k": per_element("stiffness", self.stiffness, "stiffness", rest, 1, closed, check.positive),
            "d": per_element("diameter", self.diameter, "length", rest, 1, closed, check.positive),
        }

    def bind(self, rest: Array, closed: bool) -> Interaction:
        parameters = self.parameters(rest, closed)
        beads = np.arange(len(rest))[:, None]
        return Crowd(type(self), beads, parameters, _near(rest, parameters["d"], closed))


def _near(rest: Array, diameters: Array, closed: bool) -> NDArray[np.int64]:
    """Pairs (E, 2) of beads that are bonded, or nearer along the chain than a hairpin of their mean diameter."""
    count = len(rest)
    if count < 2:
        return np.empty((0, 2), dtype=np.int64)
    lengths = np.linalg.norm(segments(rest, closed), axis=-1)
    turns = np.concatenate([lengths, lengths]) if closed else lengths
    arc = np.concatenate([[0.0], np.cumsum(turns)])
    found = []
    for apart in range(1, count // 2 + 1 if closed else count):
        first = np.arange(count if closed else count - apart)
        second = (first + apart) % count
        reach = _HAIRPIN * (1 + 1e-9) * (diameters[first] + diameters[second]) / 2
        near = arc[first + apart] - arc[first] <= reach
        if apart > 1 and not near.any():
            break
        keep = near | (apart == 1)
        found.append(np.stack([first[keep], second[keep]], axis=1))
    return np.unique(np.sort(np.concatenate(found), axis=1), axis=0)


@dataclass(frozen=True, eq=False)
class Crowd(Interaction):
    """Beads that repel: `beads` (M, 1), k and d of each, and the pairs `near` (E, 2) along chains that do not."""

    near: NDArray[np.int64]

    def at(self, positions: Array) -> Interaction:
        """The pairs in reach of one another at positions (N, 3), each with its own k and d."""
        members, p = self.beads[:, 0], self.parameters
        if not len(members):
            return Interaction(Overlap, np.empty((0, 2), dtype=np.int64), {"k": np.empty(0), "d": np.empty(0)})
        from scipy.spatial import cKDTree  # takes as long to load as the rest of the package

        tree = cKDTree(positions[members])
        i, j = tree.query_pairs(float(p["d"].max()), output_type="ndarray").T
        pairs = np.sort(np.stack([members[i], members[j]], axis=1), axis=1).astype(np.int64)
        size = len(positions)
        far = ~np.isin(pairs @ [size, 1], self.near @ [size, 1])
        i, j = i[far], j[far]
        stiffness = 2 * p["k"][i] * p["k"][j] / (p["k"][i] + p["k"][j])
        return Interaction(Overlap, pairs[far], {"k": stiffness, "d": (p["d"][i] + p["d"][j]) / 2})

    def shifted(self, start: int) -> Self:
        return replace(self, beads=self.beads + start, near=self.near + start) if start else self

    @staticmethod
    def joined(parts: Sequence[Interaction]) -> Interaction:
        whole = Interaction.joined(parts)
        near = np.concatenate([part.near for part in parts if isinstance(part, Crowd)])
        return replace(whole, near=near)  # type: ignore[call-arg]


def crowd_of(interactions: Sequence[Interaction]) -> Crowd | None:
    """The beads of a filament or model that repel; there is one crowd at most."""
    return next((interaction for interaction in interactions if isinstance(interaction, Crowd)), None)


def refuse(name: str, interactions: Sequence[Interaction], where: str) -> None:
    """ValueError where replicas that lie in one place, in one System, would repel one another."""
    if crowd_of(interactions) is not None:
        raise ValueError(
            f"Argument `{name}` must have no contact.Repulsion {where}, whose replicas share one place in one System, "
            "but has: build a model of your own, its replicas apart."
        )


def openmm_force(crowd: Crowd, beads: int) -> mm.CustomNonbondedForce:
    """The force for a System of so many beads; numbers that all of them share stand in its expression."""
    members, p = crowd.beads[:, 0], crowd.parameters
    alike = len(members) == beads and all((values == values[0]).all() for values in p.values())
    if alike:
        k, d = (float(p[name][0]) for name in ("k", "d"))
        force = mm.CustomNonbondedForce(f"0.5*k*(d-r)^2;k={k!r};d={d!r}")  # the cutoff is d: no step is needed
        deque(map(force.addParticle, [()] * beads), maxlen=0)
    else:
        mixed = "k=2*k1*k2/max(k1+k2,1e-30);d=0.5*(d1+d2)"  # beads of filaments without contact have k = 0
        force = mm.CustomNonbondedForce(f"{Overlap.expression};{mixed}")
        values = np.zeros((beads, 2))
        for column, name in enumerate(("k", "d")):
            force.addPerParticleParameter(name)
            values[members, column] = p[name]
        deque(map(force.addParticle, values.tolist()), maxlen=0)
    force.setNonbondedMethod(mm.CustomNonbondedForce.CutoffNonPeriodic)
    force.setCutoffDistance(float(p["d"].max()))
    deque(map(force.addExclusion, *crowd.near.T.tolist()), maxlen=0)
    return force
