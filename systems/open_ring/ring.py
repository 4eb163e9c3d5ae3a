"""The open ring and its motion under opposite forces on its two ends (thesis 2.5). SI units throughout.

Two shapes have "N beads on a circle, open": with a gap of one segment between the ends, and with N - 1 segments all the
way round, so that the ends meet. They differ in one thing: forces normal to the plane on ends that are a segment apart
are a couple, which swings the free ring round.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from openmm import unit
from scipy.spatial.transform import Rotation

import openmm_filament as of
from openmm_filament.geometry import bending_angles, chain_indices
from systems import conservation, stage
from systems.conservation import Drift

__all__ = [
    "BEADS",
    "BENDING",
    "DENSITY",
    "PARTS",
    "RADIUS",
    "SEGMENT",
    "SHEAR",
    "STRETCHING",
    "TORSION",
    "YOUNG",
    "Ring",
    "Swing",
    "loaded",
    "ring",
    "swing",
    "thesis_ring",
    "turned",
]

Array = NDArray[np.float64]

BEADS, SEGMENT, RADIUS = 13, 0.01, 1e-3  # m
YOUNG, SHEAR, DENSITY = 200e9, 80e9, 1.55e-3  # Pa, Pa, kg/m

STRETCHING = YOUNG * math.pi * RADIUS**2
"""E S in N."""
BENDING = YOUNG * math.pi * RADIUS**4 / 4
"""E I in N m^2."""
TORSION = SHEAR * math.pi * RADIUS**4 / 2
"""G J in N m^2."""

PARTS = ("stretching", "bending", "torsion")


@dataclass(frozen=True, eq=False)
class Ring:
    """An open ring in the xy plane.

    Attributes
    ----------
    filament : Filament
    positions : (N, 3) array
        At rest, in m.
    opening : (3,) array
        Unit vector along the tangent at the cut, on bead 0, that opens the ring.
    segment : float
        Segment length in m.
    """

    filament: of.Filament
    positions: Array
    opening: Array
    segment: float


@dataclass(frozen=True, eq=False)
class Swing:
    """Motion from rest under a load.

    Attributes
    ----------
    model : Model
    times : (T,) array
        s.
    positions : (T, N, 3) array
        m.
    energies : dict of str to (T,) array
        J: "stretching", "bending", "torsion", "internal" (their sum), "kinetic" and "work" (done by the load).
    timestep : float
        s.
    """

    model: of.Model
    times: Array
    positions: Array
    energies: dict[str, Array]
    timestep: float

    @property
    def peak(self) -> float:
        """The largest internal energy in J."""
        return float(self.energies["internal"].max())

    @property
    def imbalance(self) -> float:
        """Kinetic and internal energy less the work of the load, the largest over the peak of the internal energy."""
        left = self.energies["kinetic"] + self.energies["internal"] - self.energies["work"]
        return float(np.abs(left - left[0]).max()) / self.peak

    @property
    def drift(self) -> Drift:
        """The line through kinetic and internal energy less the work of the load, over the peak of the internal energy."""
        left = self.energies["kinetic"] + self.energies["internal"] - self.energies["work"]
        every = round((self.times[1] - self.times[0]) / self.timestep)
        return conservation.through(left - left[0] + self.peak, every)

    @property
    def sines(self) -> tuple[float, float]:
        """The smallest and the largest sin(beta) of the run: dihedral torsion grows as one over it."""
        sines = np.sin(bending_angles(self.positions[:, chain_indices(self.positions.shape[1], 3)]))
        return float(sines.min()), float(sines.max())

    def share(self, part: str) -> float:
        """The part of the time integral of the internal energy that is stored in a term."""
        return float(self.energies[part].sum() / self.energies["internal"].sum())

    def peak_share(self, part: str) -> float:
        """The largest energy of a term over the peak of the internal energy."""
        return float(self.energies[part].max() / self.peak)

    @property
    def turn(self) -> float:
        """Angle in rad between the line from the last bead to the first at the beginning and at the end."""
        lines = self.positions[[0, -1], 0] - self.positions[[0, -1], -1]
        cosine = lines[0] @ lines[1] / np.prod(np.linalg.norm(lines, axis=1))
        return float(np.arccos(np.clip(cosine, -1, 1)))


def ring(beads: int, segment: float, *, gap: bool, damping: float | None = None) -> Ring:
    """A ring of the thesis's wire, open, at rest: with a gap of one segment, or with ends that meet.

    `damping` is the rate of every bead in 1/s.
    """
    if gap:
        rest = of.shapes.ring(beads, segment * unit.meter)
    else:
        angle = 2 * np.pi * np.arange(beads) / (beads - 1)
        radius = segment / (2 * math.sin(math.pi / (beads - 1)))
        rest = radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1) * unit.meter
    positions = np.asarray(rest.value_in_unit(unit.meter))
    opening = positions[0] - positions[-1] if gap else np.array([0.0, 1.0, 0.0])
    terms = of.rod_terms(YOUNG * unit.pascal, SHEAR * unit.pascal, RADIUS * unit.meter, segment * unit.meter)
    mass = DENSITY * segment * unit.kilogram
    filament = of.Filament(rest, mass, terms, damping=None if damping is None else damping / unit.second)
    return Ring(filament, positions, opening / np.linalg.norm(opening), segment)


def thesis_ring(*, gap: bool) -> Ring:
    """13 beads with segments of 10 mm."""
    return ring(BEADS, SEGMENT, gap=gap)


def turned(body: Ring) -> Ring:
    """The ring in a plane in which no bead has a coordinate that stays zero, for motion in that plane (phi = 0).

    At z = 0 torsion vanishes bit by bit, whatever the terms do.
    """
    turn = Rotation.from_rotvec([0.5, 0.8, -0.3]).as_matrix().T
    positions = body.positions @ turn
    return Ring(replace(body.filament, rest=positions * unit.meter), positions, body.opening @ turn, body.segment)


def loaded(body: Ring, force: Array) -> of.Model:
    """The ring with `force` (3,) in N on bead 0 and the opposite one on the last bead."""
    pull = force * unit.newton
    return of.build(body.filament, [of.loads.Pull(0, pull), of.loads.Pull(-1, -1 * pull)])


def swing(
    body: Ring, force: float, phi: float, *, duration: float = 5e-3, samples: int = 500, step: float = 0.1
) -> Swing:
    """Let opposite constant forces act on the ends of a free ring at rest, undamped (`of.verlet`).

    Parameters
    ----------
    force : float
        Magnitude in N.
    phi : float
        Angle in rad from the tangent at the cut towards the normal of the plane.
    duration : float
        s.
    step : float
        Time step over the stability limit, at most; a sample falls on a whole number of steps.
    """
    vector = force * (math.cos(phi) * body.opening + math.sin(phi) * np.array([0.0, 0.0, 1.0]))
    model = loaded(body, vector)
    limit = of.stable_timestep(model).value_in_unit(unit.second)
    every = math.ceil(duration / samples / (step * limit))
    timestep = duration / samples / every
    context = stage.context(model, of.verlet(model, timestep=timestep * unit.second), "Reference")
    motion = of.record(model, context, samples, every, energies=True)
    energies = {name: values / stage.JOULE for name, values in motion.energies.items()}
    del energies["pull"]
    energies["internal"] = np.sum([energies[part] for part in PARTS], axis=0)
    positions = stage.metres(motion.values)
    opening = positions[:, 0] - positions[:, -1]
    energies["work"] = (opening - opening[0]) @ vector
    return Swing(model, stage.seconds(motion), positions, energies, timestep)
