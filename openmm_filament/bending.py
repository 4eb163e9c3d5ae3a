"""Bending between successive segments (equations 1.8, 1.16 and 3.2 of the thesis). Conventions: see `geometry`."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal, final

import numpy as np
import openmm as mm
from openmm import unit

from openmm_filament import _checks as check
from openmm_filament._term import Array, Interaction, Parameters, Term, per_element, read_off
from openmm_filament.geometry import angle, bending_angles, chain_indices, cross, dot

__all__ = ["ArctangentHarmonic", "Cosine", "Harmonic"]

_angle_rule = partial(check.within, low=0.0, high=np.pi, unit="rad")


def _split(x: Array) -> tuple[Array, Array, Array, Array]:
    """Lengths (M,) and directions (M, 3) of the two segments of bead triples (M, 3, 3)."""
    s1, s2 = x[:, 1] - x[:, 0], x[:, 2] - x[:, 1]
    l1, l2 = np.sqrt(dot(s1, s1)), np.sqrt(dot(s2, s2))
    return l1, l2, s1 / l1[:, None], s2 / l2[:, None]


def _rotate(x: Array, torque: Array, l1: Array, l2: Array, x1: Array, x2: Array) -> Array:
    """Gradient (M, 3, 3) from dE/dbeta along the normal: `torque` (M, 3) = dE/dbeta x1 x x2/|x1 x x2|."""
    g1 = -cross(torque, x1) / l1[:, None]
    g2 = cross(torque, x2) / l2[:, None]
    return np.stack([-g1, g1 - g2, g2], axis=1)


@dataclass(frozen=True, eq=False)
class Harmonic(Term):
    """Energy `1/2 sum alpha_i (beta_i - beta_i^eq)^2` over the inner beads (1.8).

    Smooth on a straight chain where `rest_angle` is 0; a rest angle above 0 leaves a cone at beta = 0, where the
    force has no direction and is returned as zero. Joints that rest bent, by however little, turn about their segments at
    no cost unless a torsion holds them: they bend out of their plane without any stiffness, where a straight joint has the
    whole of alpha in every direction. So a rest shape that is straight but for noise is another, softer chain: give
    `rest_angle` 0 if it is meant to be straight.

    Parameters
    ----------
    stiffness : Quantity
        alpha, energy (per rad^2), positive; one number, or one per inner bead (per bead on a closed chain).
    rest_angle : Quantity, optional
        beta^eq in [0, pi], 0 = straight; one number, or one per inner bead. By default from the rest shape.
    form : "arccosine" or "arctangent"
        How OpenMM takes the angle; the energy is the same. "arccosine" is a `CustomAngleForce`, whose force is off by
        2e-8 of itself at beta = 1e-4, by 2e-4 at 1e-6 and is nothing below 1e-7 rad. "arctangent" is a
        `CustomCompoundBondForce` of `beta = atan2(|s1 x s2|, s1 . s2)`: within 1e-10 at 1e-6 and 1e-6 at 1e-10 rad,
        which is the rounding of the coordinates, and 5e-16/sin(beta) up to pi - 1e-6. It takes 0.33 instead of 0.07 us an
        angle and step on Reference, a whole string's step three times as long. Take it for the motion of a nearly
        straight chain whose energy must stay.
    """

    stiffness: unit.Quantity
    rest_angle: unit.Quantity | None = None
    form: Literal["arccosine", "arctangent"] = field(default="arccosine", kw_only=True)

    family = "bending"
    span = 3
    expression = "0.5*alpha*(theta-theta0)^2; theta0=3.141592653589793-beta0"
    dimensions = {"alpha": "energy", "beta0": "angle"}

    def __post_init__(self) -> None:
        check.one_of("form", self.form, ("arccosine", "arctangent"))
        super().__post_init__()

    def bind(self, rest: Array, closed: bool) -> Interaction:
        bound = super().bind(rest, closed)
        return replace(bound, term=ArctangentHarmonic) if self.form == "arctangent" else bound

    def parameters(self, rest: Array, closed: bool) -> dict[str, Array]:
        alpha = per_element("stiffness", self.stiffness, "energy", rest, 3, closed, check.positive)
        if self.rest_angle is None:
            triples = rest[chain_indices(len(rest), 3, closed)]
            shortest = np.linalg.norm(np.diff(triples, axis=1), axis=-1).min()
            beta0 = read_off(bending_angles(triples), rest, 1 / shortest)
        else:
            beta0 = per_element("rest_angle", self.rest_angle, "angle", rest, 3, closed, _angle_rule)
        return {"alpha": alpha, "beta0": beta0}

    @staticmethod
    def energy(x: Array, p: Parameters) -> Array:
        return 0.5 * p["alpha"] * (bending_angles(x) - p["beta0"]) ** 2

    @staticmethod
    def gradient(x: Array, p: Parameters) -> Array:
        l1, l2, x1, x2 = _split(x)
        normal = cross(x1, x2)
        sine = np.sqrt(dot(normal, normal))
        beta = angle(sine, dot(x1, x2))
        slope = p["alpha"] * (beta - p["beta0"])
        straight = sine == 0.0
        factor = np.where(straight, 0.0, slope / np.where(straight, 1.0, sine))
        return _rotate(x, factor[:, None] * normal, l1, l2, x1, x2)


@final
@dataclass(frozen=True, eq=False)
class ArctangentHarmonic(Harmonic):
    """What `Harmonic` is bound to in its form "arctangent": the same potential, another OpenMM force."""

    # 1e-30, nothing beside the square of a bend of 1e-14 rad, gives the root a slope, of zero, where the chain is straight
    expression = (
        "0.5*alpha*(atan2(sqrt((uy*vz-uz*vy)^2+(uz*vx-ux*vz)^2+(ux*vy-uy*vx)^2+1e-30),ux*vx+uy*vy+uz*vz)-beta0)^2;"
        + ";".join(f"{s}{c}={c}{j}-{c}{i}" for s, i, j in (("u", 1, 2), ("v", 2, 3)) for c in "xyz")
    )

    @classmethod
    def openmm_force(cls, expression: str) -> tuple[mm.Force, Any, Any]:
        force = mm.CustomCompoundBondForce(3, expression)

        def add(i: int, j: int, k: int, parameters: Any = ()) -> None:
            force.addBond((i, j, k), parameters)

        return force, force.addPerBondParameter, add


@final
@dataclass(frozen=True, eq=False)
class Cosine(Term):
    """Energy `-sum alpha_i cos(beta_i)` over the inner beads: the Kratky-Porod worm-like chain (3.2).

    Smooth everywhere; its lowest value is -alpha an inner bead, on a straight chain. On a discrete chain
    `alpha l0/(k_B T)` is the persistence length only for fine segments; `WormlikeChain` takes the exact relation.

    Parameters
    ----------
    stiffness : Quantity
        alpha, energy, positive; one number, or one per inner bead (per bead on a closed chain).
    """

    stiffness: unit.Quantity

    family = "bending"
    span = 3
    expression = "alpha*cos(theta)"
    dimensions = {"alpha": "energy"}

    def parameters(self, rest: Array, closed: bool) -> dict[str, Array]:
        return {"alpha": per_element("stiffness", self.stiffness, "energy", rest, 3, closed, check.positive)}

    @staticmethod
    def energy(x: Array, p: Parameters) -> Array:
        _, _, x1, x2 = _split(x)
        return -p["alpha"] * dot(x1, x2)

    @staticmethod
    def gradient(x: Array, p: Parameters) -> Array:
        l1, l2, x1, x2 = _split(x)
        return _rotate(x, p["alpha"][:, None] * cross(x1, x2), l1, l2, x1, x2)
