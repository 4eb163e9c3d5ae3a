"""Torsion about the segments (equations 1.17, 1.20 and 1.24 of the thesis). Conventions: see `geometry`.

The thesis takes tau = arccos(...), which gives the two hands of a helix the same energy and puts a kink at tau = 0;
here tau is the signed dihedral and `Harmonic` takes the shorter way round. `Harmonic` and `Periodic` do not exist
where three successive beads are collinear, and their forces grow as 1/sin(beta) near there; `Weighted` is smooth.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, final

import numpy as np
import openmm as mm
from openmm import unit

from openmm_filament import _checks as check
from openmm_filament._term import Array, Parameters, Term, per_element, read_off
from openmm_filament.geometry import chain_indices, cross, dihedrals, dot, unit_vectors

__all__ = ["Harmonic", "Periodic", "Weighted"]

_angle_rule = partial(check.within, low=-np.pi, high=np.pi, unit="rad")


def _rest_angles(given: unit.Quantity | None, rest: Array, closed: bool) -> Array:
    """tau^eq in [-pi, pi], one a dihedral: as given, or from the rest shape."""
    if given is not None:
        return per_element("rest_angle", given, "angle", rest, 4, closed, _angle_rule)
    x = rest[chain_indices(len(rest), 4, closed)]
    s1, s2, s3 = (x[:, i + 1] - x[:, i] for i in range(3))
    areas = np.sqrt(np.minimum(dot(cross(s1, s2), cross(s1, s2)), dot(cross(s2, s3), cross(s2, s3))))
    lever = (np.sqrt(dot(s2, s2)) / areas).max() if len(x) and areas.all() else 0.0
    return read_off(dihedrals(x), rest, lever)


def _spread(g1: Array, g2: Array, g3: Array) -> Array:
    """Gradients with respect to the three segments (M, 3) as gradients with respect to the four beads (M, 4, 3)."""
    return np.stack([-g1, g1 - g2, g2 - g3, g3], axis=1)


def _dihedral_gradient(x: Array, slope: Array) -> Array:
    """`slope` (M,) times the gradient (M, 4, 3) of the signed dihedral (Blondel and Karplus, J. Comput. Chem. 1996)."""
    s1, s2, s3 = (x[:, i + 1] - x[:, i] for i in range(3))
    p1, p2 = cross(s1, s2), cross(s2, s3)
    axis = np.sqrt(dot(s2, s2))
    y1 = p1 * (slope / dot(p1, p1))[:, None]
    y2 = p2 * (slope / dot(p2, p2))[:, None]
    inner = -(dot(s1, s2) / axis)[:, None] * y1 - (dot(s3, s2) / axis)[:, None] * y2
    return _spread(axis[:, None] * y1, inner, axis[:, None] * y2)


def _shorter_way(difference: Array) -> Array:
    """An angle difference brought into [-pi, pi)."""
    turns: Array = np.floor(difference.real / (2 * np.pi) + 0.5)
    return difference - 2 * np.pi * turns


@final
@dataclass(frozen=True, eq=False)
class Harmonic(Term):
    """Energy `1/2 sum C_i d_i^2`, d = tau - tau^eq brought into [-pi, pi] (1.17).

    Parameters
    ----------
    stiffness : Quantity
        C, energy (per rad^2), positive; one number, or one per dihedral.
    rest_angle : Quantity, optional
        tau^eq in [-pi, pi]; one number, or one per dihedral. By default from the rest shape.
    """

    stiffness: unit.Quantity
    rest_angle: unit.Quantity | None = None

    family = "torsion"
    span = 4
    expression = "0.5*c*(d-6.283185307179586*floor(d/6.283185307179586+0.5))^2; d=theta-tau0"
    dimensions = {"c": "energy", "tau0": "angle"}
    needs_bends = True

    def parameters(self, rest: Array, closed: bool) -> dict[str, Array]:
        c = per_element("stiffness", self.stiffness, "energy", rest, 4, closed, check.positive)
        return {"c": c, "tau0": _rest_angles(self.rest_angle, rest, closed)}

    @staticmethod
    def energy(x: Array, p: Parameters) -> Array:
        return 0.5 * p["c"] * _shorter_way(dihedrals(x) - p["tau0"]) ** 2

    @staticmethod
    def gradient(x: Array, p: Parameters) -> Array:
        return _dihedral_gradient(x, p["c"] * _shorter_way(dihedrals(x) - p["tau0"]))


@final
@dataclass(frozen=True, eq=False)
class Periodic(Term):
    """Energy `sum K_i (1 - cos(a (tau_i - tau_i^eq)))` (1.24, with its printed `1 - a cos` mended).

    Parameters
    ----------
    stiffness : Quantity
        K, energy, positive; one number, or one per dihedral. Near rest it acts like `Harmonic` with C = K a^2.
    multiplicity : int
        a, the number of minima in a turn, at least 1.
    rest_angle : Quantity, optional
        tau^eq in [-pi, pi]; one number, or one per dihedral. By default from the rest shape.
    """

    stiffness: unit.Quantity
    multiplicity: int = 1
    rest_angle: unit.Quantity | None = None

    family = "torsion"
    span = 4
    expression = "k*(1-cos(n*(theta-tau0)))"
    dimensions = {"k": "energy", "n": "pure", "tau0": "angle"}
    needs_bends = True

    def parameters(self, rest: Array, closed: bool) -> dict[str, Array]:
        k = per_element("stiffness", self.stiffness, "energy", rest, 4, closed, check.positive)
        n = np.full_like(k, check.integer("multiplicity", self.multiplicity, low=1))
        return {"k": k, "n": n, "tau0": _rest_angles(self.rest_angle, rest, closed)}

    @staticmethod
    def energy(x: Array, p: Parameters) -> Array:
        half: Array = np.sin(0.5 * p["n"] * (dihedrals(x) - p["tau0"]))
        return 2 * p["k"] * half**2

    @staticmethod
    def gradient(x: Array, p: Parameters) -> Array:
        return _dihedral_gradient(x, p["k"] * p["n"] * np.sin(p["n"] * (dihedrals(x) - p["tau0"])))


@final
@dataclass(frozen=True, eq=False)
class Weighted(Term):
    """Energy `sum K_i (-a.b cos tau0 - x_i.(a x b) sin tau0)`, a = x_{i-1} x x_i, b = x_i x x_{i+1}.

    It equals `-K sin(beta_1) sin(beta_2) cos(tau - tau0)`, with beta_1 and beta_2 the bending angles at the two inner
    beads: smooth on straight stretches, where it vanishes, and of local stiffness `K sin(beta_1) sin(beta_2)`. Its
    lowest value is not zero, and at the rest torsion it still pushes the bending angles towards a right angle.

    Parameters
    ----------
    stiffness : Quantity
        K, energy, positive; one number, or one per dihedral.
    rest_angle : Quantity, optional
        tau0 in [-pi, pi]; one number, or one per dihedral. By default from the rest shape (0 where it is straight).
    """

    stiffness: unit.Quantity
    rest_angle: unit.Quantity | None = None

    family = "torsion"
    span = 4
    expression = (
        "-k*(cos(tau0)*(uv*vw-uw)+sin(tau0)*(ux*(vy*wz-vz*wy)+uy*(vz*wx-vx*wz)+uz*(vx*wy-vy*wx)));"
        "uv=ux*vx+uy*vy+uz*vz; vw=vx*wx+vy*wy+vz*wz; uw=ux*wx+uy*wy+uz*wz;"
        + "".join(
            f"{name}{c}=({c}{second}-{c}{first})/l{name};"
            for name, first, second in (("u", 1, 2), ("v", 2, 3), ("w", 3, 4))
            for c in "xyz"
        )
        + "lu=distance(p1,p2); lv=distance(p2,p3); lw=distance(p3,p4)"
    )
    dimensions = {"k": "energy", "tau0": "angle"}

    def parameters(self, rest: Array, closed: bool) -> dict[str, Array]:
        k = per_element("stiffness", self.stiffness, "energy", rest, 4, closed, check.positive)
        return {"k": k, "tau0": _rest_angles(self.rest_angle, rest, closed)}

    @staticmethod
    def energy(x: Array, p: Parameters) -> Array:
        u, v, w = (unit_vectors(x[:, i + 1] - x[:, i]) for i in range(3))
        a, b = cross(u, v), cross(v, w)
        return -p["k"] * (np.cos(p["tau0"]) * dot(a, b) + np.sin(p["tau0"]) * dot(u, b))

    @staticmethod
    def gradient(x: Array, p: Parameters) -> Array:
        s = [x[:, i + 1] - x[:, i] for i in range(3)]
        u, v, w = (unit_vectors(vector) for vector in s)
        a, b = cross(u, v), cross(v, w)
        cosine, sine = np.cos(p["tau0"])[:, None], np.sin(p["tau0"])[:, None]
        by_direction = (
            cosine * cross(v, b) + sine * b,
            cosine * (dot(v, w)[:, None] * u + dot(u, v)[:, None] * w) + sine * cross(w, u),
            -cosine * cross(v, a) + sine * a,
        )
        # a change of s turns its unit vector x by (ds - x (x.ds))/|s|
        by_segment = [
            -p["k"][:, None] * (g - x_ * dot(g, x_)[:, None]) / np.sqrt(dot(s_, s_))[:, None]
            for g, x_, s_ in zip(by_direction, (u, v, w), s, strict=True)
        ]
        return _spread(by_segment[0], by_segment[1], by_segment[2])

    @classmethod
    def openmm_force(cls, expression: str) -> tuple[mm.Force, Any, Any]:
        force = mm.CustomCompoundBondForce(4, expression)

        def add(i: int, j: int, k: int, m: int, parameters: Any = ()) -> None:
            force.addBond((i, j, k, m), parameters)

        return force, force.addPerBondParameter, add
