"""Small-load deflections of a cut ring: closed forms, statics of the bead chain, its Hessian, and a damped OpenMM run.

Opposite unit forces act on the two ends, which meet. Three directions: along the tangents, along the radius, and normal
to the plane. The compliance is how far the ends part along the forces, in m/N.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from openmm import unit

import openmm_filament as of
from openmm_filament.hessian import hessian
from systems import stage
from systems.open_ring.ring import BEADS, BENDING, DENSITY, SEGMENT, STRETCHING, TORSION, Ring, loaded, ring

__all__ = [
    "CUT",
    "DIRECTIONS",
    "cut_ring",
    "extrapolated",
    "from_hessian",
    "from_statics",
    "modal_opening",
    "of_size",
    "relaxed",
    "small_modes",
]

Array = NDArray[np.float64]

DIRECTIONS = ("tangential", "radial", "normal")

CUT = SEGMENT / (2 * math.sin(math.pi / (BEADS - 1)))
"""Radius of the ring in m."""

_RELAXATION = 25.0
"""Length of a damped run over the time constant of its slowest mode, at critical damping: (1 + 25) e^-25 = 4e-10 is left."""


def of_size(beads: int, *, damping: float | None = None, gap: bool = False) -> Ring:
    """A ring of radius `CUT` cut into so many beads."""
    return ring(beads, 2 * CUT * math.sin(math.pi / (beads if gap else beads - 1)), gap=gap, damping=damping)


def direction(body: Ring, name: str) -> Array:
    """The unit vector of the force on bead 0."""
    radial = np.cross(body.opening, [0.0, 0.0, 1.0])
    return {"tangential": body.opening, "radial": radial, "normal": np.array([0.0, 0.0, 1.0])}[name]


def cut_ring(name: str) -> float:
    """The continuous ring: 3 pi R^3/EI, pi R^3/EI (each with pi R/ES for the stretch) and 3 pi R^3/GJ.

    The last is that of a torsion that belongs to the centre line. A rod with material twist has pi R^3/EI besides, for it
    also bends about the normal of its curve, which costs the bead chain nothing.
    """
    bend, stretch = math.pi * CUT**3 / BENDING, math.pi * CUT / STRETCHING
    twist = 3 * math.pi * CUT**3 / TORSION
    return {"tangential": 3 * bend + stretch, "radial": bend + stretch, "normal": twist}[name]


def from_statics(body: Ring, name: str) -> float:
    """The exact bead chain: `sum M_i^2/alpha + sum N_i^2/k + sum T_i^2/C`, from balance alone.

    M_i is the moment of the end force about joint i along the normal of the plane, T_i that about the line of segment i,
    N_i its component along segment i. No stiffness matrix enters. For ends apart it holds along the gap alone.
    """
    x, force = body.positions, direction(body, name)
    along = np.diff(x, axis=0) / body.segment
    moments = np.cross(x[0] - x[1:-1], force)[:, 2]
    torques = np.einsum("ij,ij->i", along[1:-1], np.cross(x[0] - x[1:-2], force))
    return float(
        body.segment * (moments @ moments / BENDING + (along @ force) @ (along @ force) / STRETCHING)
        + body.segment * (torques @ torques) / TORSION
    )


def from_hessian(body: Ring) -> dict[str, float]:
    """`f.H^-1.f` by direction, with the second derivatives of the model's energy, rigid motions made stiff.

    The load does no work on those.
    """
    model = of.build(body.filament)
    x = np.asarray(model.positions.value_in_unit(unit.nanometer))
    matrix = hessian(model, x).toarray()
    rigid = [np.broadcast_to(axis, x.shape).ravel() for axis in np.eye(3)]
    rigid += [np.cross(axis, x - x.mean(axis=0)).ravel() for axis in np.eye(3)]
    basis = np.linalg.qr(np.array(rigid).T)[0]
    forces = np.zeros((len(DIRECTIONS), *x.shape))
    for force, name in zip(forces, DIRECTIONS, strict=True):
        force[0], force[-1] = direction(body, name), -direction(body, name)
    columns = forces.reshape(len(DIRECTIONS), -1).T
    moved = np.linalg.solve(matrix + np.abs(matrix).max() * basis @ basis.T, columns)
    unit_of = model.scale.length * 1e-9 * stage.NEWTON / model.scale.factor("force")
    return dict(zip(DIRECTIONS, np.sum(moved * columns, axis=0) * unit_of, strict=True))


def relaxed(beads: int, name: str, *, strain: float = 1e-5) -> float:
    """The compliance from an OpenMM run: a small load on a free ring, Euler-Cromer with critical damping, until it is at rest.

    `strain` is the deflection aimed at over the radius: what is not linear is of this order.
    """
    force = strain * CUT / cut_ring(name)
    free = of.build(of_size(beads).filament)
    slowest = 2 * math.pi * float(of.normal_modes(free, 7).frequencies[6])
    body = of_size(beads, damping=2 * slowest)
    model = loaded(body, force * direction(body, name))
    step = 0.5 * of.stable_timestep(model)
    context = stage.context(model, of.euler_cromer(model, timestep=step), "Reference")
    steps = math.ceil(_RELAXATION / slowest / step.value_in_unit(unit.second))
    motion = of.record(model, context, 1, steps, observe=lambda x: x[0] - x[-1])
    parted = stage.metres(motion.values[-1]) - (body.positions[0] - body.positions[-1])
    return float(parted @ direction(body, name)) / force


def extrapolated(beads: list[int], values: list[float]) -> float:
    """The limit of no segment length: the polynomial in its square through all the values, at zero."""
    squared = np.array([(1 / (n - 1)) ** 2 for n in beads])
    weights = [np.prod([b / (b - a) for b in squared if b != a]) for a in squared]
    return float(np.dot(weights, values))


def strains(x: Array) -> Array:
    """Lengths, bending angles and torsions of a chain (N, 3), by school geometry: none of the package's formulas enters."""
    s = np.diff(x, axis=0)
    lengths = np.sqrt((s**2).sum(axis=1))
    cosines = (s[:-1] * s[1:]).sum(axis=1) / (lengths[:-1] * lengths[1:])
    normals = np.cross(s[:-1], s[1:])
    turns = np.cross(normals[:-1], normals[1:])
    sines = np.sign((turns * s[1:-1]).sum(axis=1)) * np.sqrt((turns**2).sum(axis=1))
    return np.concatenate([lengths, np.arccos(cosines), np.arctan2(sines, (normals[:-1] * normals[1:]).sum(axis=1))])


def small_modes(body: Ring) -> tuple[Array, Array]:
    """Angular frequencies (K,) in 1/s and shapes (K, N, 3) of a free ring about rest, rigid motions left out.

    The energy is a sum over squared strains: `K = B^T diag(ES/l, EI/l, GJ/l) B`, B their derivatives at rest, by central
    differences. No force, energy or Hessian of the package enters.
    """
    x = body.positions
    step, size = 1e-6 * body.segment, x.size
    moves = step * np.eye(size).reshape(size, *x.shape)
    slopes = np.array([strains(x + move) - strains(x - move) for move in moves]).T / (2 * step)
    n = len(x)
    moduli = np.repeat([STRETCHING, BENDING, TORSION], [n - 1, n - 2, n - 3]) / body.segment
    squared, vectors = np.linalg.eigh(slopes.T * moduli @ slopes / (DENSITY * body.segment))
    return np.sqrt(squared[6:]), vectors.T[6:].reshape(-1, *x.shape)


def modal_opening(body: Ring, force: Array, times: Array) -> Array:
    """How the ends part (T, 3) in m when `force` (3,) in N begins to act on a ring at rest: the sum over its normal modes.

    Exact in the limit of a small load. The load must not act on rigid motions. OpenMM's velocities are those of half a
    step earlier: a run that begins with none was at rest half a step before its time zero.
    """
    omega, shapes = small_modes(body)
    mass = DENSITY * body.segment
    parting = shapes[:, 0] - shapes[:, -1]
    stiffness = omega**2 * mass * np.sum(shapes**2, axis=(1, 2))
    grown = (1 - np.cos(times[:, None] * omega)) * (parting @ force / stiffness)
    return np.asarray(grown @ parting)
