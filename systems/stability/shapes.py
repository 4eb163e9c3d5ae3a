"""Bending angles from straight to folded back, coincident beads, dihedrals across +-pi: OpenMM's forces against 50 digits."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
import openmm as mm
from numpy.typing import NDArray
from openmm import unit

import openmm_filament as of
from openmm_filament._term import Term
from openmm_filament.geometry import dihedrals as torsions
from systems.stability import exact
from systems.stability.cells import TOLERANCE, Cell, judged, reference

__all__ = ["Probe", "angles", "bent", "coincident", "dihedrals"]

Array = NDArray[np.float64]

KJ, NM, RAD = unit.kilojoule_per_mole, unit.nanometer, unit.radian
STIFFNESS = 30.0 * KJ
_LENGTHS = (0.8, 1.3, 0.6)
_NEAR = tuple(10.0**e for e in range(-12, 0))
_TINY = 1e-9
"""A time step, ps, at which nothing moves: forces alone are looked at."""


def bent(lengths: tuple[float, ...], bends: tuple[float, ...], torsions: tuple[float, ...] = ()) -> Array:
    """The chain with these lengths, bending angles and torsions; exactly in line where a bend is 0 or pi."""
    tangent, binormal = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
    beads = [np.zeros(3), lengths[0] * tangent]
    for i, bend in enumerate(bends):
        if i:
            binormal = _turned(binormal, tangent, torsions[i - 1])
        tangent = _turned(tangent, binormal, bend)
        beads.append(beads[-1] + lengths[i + 1] * tangent)
    return np.array(beads)


def _turned(vector: Array, axis: Array, angle: float) -> Array:
    sine = 0.0 if angle in (0.0, math.pi) else math.sin(angle)
    along = axis * (axis @ vector)
    return np.asarray(along + math.cos(angle) * (vector - along) + sine * np.cross(axis, vector))


class Probe:
    """One term on three or four beads, in one Context, to be looked at in many shapes."""

    def __init__(self, *terms: Term, beads: int) -> None:
        rest = bent(_LENGTHS[: beads - 1], (1.0,) * (beads - 2), (1.0,) * (beads - 3))
        self.model = of.build(of.Filament(rest * NM, 10 * unit.dalton, terms))
        self.context = reference(self.model, mm.VerletIntegrator(_TINY))

    def error(self, x: Array, beside: Array | None = None) -> float:
        """Preflight at positions (N, 3) in nm, then the error of the forces on Reference.

        With `beside`, against the exact forces there, with the sign that fits better.
        """
        self.context.setPositions(x)
        of.preflight(self.model, self.context)
        found = self.context.getState(forces=True).getForces(asNumpy=True).value_in_unit(KJ / NM)
        if beside is None:
            return exact.error(found, self.model.interactions, x)
        return min(exact.error(sign * found, self.model.interactions, beside) for sign in (1.0, -1.0))


def angles() -> Iterator[Cell]:
    """One bending angle from 0 to pi, under each form of bending and of torsion."""
    bendings: dict[str, Term] = {
        "bending, arccosine, rest 0": of.bending.Harmonic(STIFFNESS, 0 * RAD),
        "bending, arccosine, rest 0.4": of.bending.Harmonic(STIFFNESS, 0.4 * RAD),
        "bending, arctangent, rest 0": of.bending.Harmonic(STIFFNESS, 0 * RAD, form="arctangent"),
        "bending, arctangent, rest 0.4": of.bending.Harmonic(STIFFNESS, 0.4 * RAD, form="arctangent"),
        "bending, cosine": of.bending.Cosine(STIFFNESS),
    }
    torsions: dict[str, Term] = {
        "torsion, harmonic": of.torsion.Harmonic(STIFFNESS, 0.3 * RAD),
        "torsion, periodic": of.torsion.Periodic(STIFFNESS, 3, 0.3 * RAD),
        "torsion, weighted": of.torsion.Weighted(STIFFNESS, 0.3 * RAD),
    }
    values = [("0", 0.0), *((f"1e{round(math.log10(v))}", v) for v in _NEAR), ("1", 1.0)]
    values += [(f"pi-1e{round(math.log10(v))}", math.pi - v) for v in reversed(_NEAR)] + [("pi", math.pi)]
    for name, term in (bendings | torsions).items():
        probe = Probe(term, beads=term.span)
        for label, bend in values:
            x = bent(_LENGTHS[:2], (bend,)) if term.span == 3 else bent(_LENGTHS, (bend, 1.2), (0.9,))
            yield judged(("bending angle", name, label, bend), "forces", partial(probe.error, x))


def coincident() -> Iterator[Cell]:
    """Two neighbours of a chain closer and closer."""
    terms = (of.stretching.Harmonic(500 * KJ / NM**2), of.bending.Harmonic(STIFFNESS, form="arctangent"))
    rest = bent(_LENGTHS, (1.0, 1.0), (1.0,))
    probe = Probe(*terms, beads=4)
    for label, gap in [("0", 0.0), *((f"1e{e}", 10.0**e) for e in range(-15, 0, 2))]:
        x = rest.copy()
        x[2] = x[1] + gap * (rest[2] - rest[1])
        yield judged(("coincident", "neighbours in a run", label, gap), "forces", partial(probe.error, x))
        yield judged(
            ("coincident", "neighbours at rest", label, gap), "rest shape: forces", partial(_displaced, x, terms)
        )


def _displaced(rest: Array, terms: tuple[Term, ...]) -> float:
    """The error of the forces on a chain of this rest shape whose last bead is moved by a hundredth of the last segment."""
    model = of.build(of.Filament(rest * NM, 10 * unit.dalton, terms))
    x = model.positions.value_in_unit(NM)
    x[-1] += 0.01 * (x[-1] - x[-2])[[1, 2, 0]]
    context = reference(model, mm.VerletIntegrator(_TINY), x)
    of.preflight(model, context)
    found = context.getState(forces=True).getForces(asNumpy=True).value_in_unit(KJ / NM)
    return exact.error(found, model.interactions, x)


def dihedrals() -> Iterator[Cell]:
    """A torsion across +-pi, for rest angles on both sides of the seam and opposite to it, and a swing across it."""
    rests = {"pi": math.pi, "-pi": -math.pi, "3": 3.0, "0": 0.0}
    makers: dict[str, Callable[[float], Term]] = {
        "harmonic": lambda rest: of.torsion.Harmonic(STIFFNESS, rest * RAD),
        "periodic": lambda rest: of.torsion.Periodic(STIFFNESS, 3, rest * RAD),
        "weighted": lambda rest: of.torsion.Weighted(STIFFNESS, rest * RAD),
    }
    near = [10.0**e for e in (-1, -3, -6, -9, -12)]
    values = [(f"pi-1e{round(math.log10(v))}", math.pi - v) for v in near] + [("pi", math.pi), ("-pi", -math.pi)]
    values += [(f"-pi+1e{round(math.log10(v))}", v - math.pi) for v in reversed(near)]
    for name, make in makers.items():
        for said, rest in rests.items():
            probe = Probe(make(rest), beads=4)
            for label, tau in values:
                x = bent(_LENGTHS, (1.0, 1.2), (tau,))
                # opposite to its rest angle a harmonic dihedral has a kink, and which way is shorter is rounding
                kink = name == "harmonic" and rest == 0 and abs(tau) == math.pi
                beside = bent(_LENGTHS, (1.0, 1.2), (tau * (1 - 1e-9),)) if kink else None
                yield judged(
                    ("dihedral", f"torsion, {name}, rest {said}", label, tau),
                    "forces, either way at the kink" if kink else "forces",
                    partial(probe.error, x, beside),
                )
        yield judged(
            ("dihedral", f"torsion, {name}, rest pi", "swing", 0.2),
            "2000 Verlet steps: energy",
            partial(_swing, make(math.pi)),
            tolerance=10 * TOLERANCE,
        )


def _swing(term: Term) -> float:
    """The largest change of the energy of a dihedral that swings by 0.2 across +-pi, over the energy of the swing."""
    rest = bent((1.0, 1.0, 1.0), (1.2, 1.2), (math.pi,))
    holding = (of.stretching.Harmonic(1e4 * KJ / NM**2), of.bending.Harmonic(3e3 * KJ))
    model = of.build(of.Filament(rest * NM, 10 * unit.dalton, (*holding, term)))
    integrator = of.verlet(model)
    context = reference(model, integrator, rest)
    bottom = context.getState(energy=True).getPotentialEnergy()
    context.setPositions(bent((1.0, 1.0, 1.0), (1.2, 1.2), (math.pi - 0.2,)))
    of.preflight(model, context)
    energies, turns = [], set()
    for _ in range(200):
        integrator.step(10)
        state = context.getState(energy=True, positions=True)
        energies.append((state.getPotentialEnergy() + state.getKineticEnergy() - bottom).value_in_unit(KJ))
        x = state.getPositions(asNumpy=True).value_in_unit(NM)
        turns.add(float(np.sign(torsions(x))))
    if turns != {1.0, -1.0}:
        raise RuntimeError("the dihedral did not cross the seam")
    return float(np.ptp(energies) / np.mean(energies))
