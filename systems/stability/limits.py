"""The stability limit predicted by `of.stable_timestep` against the one found by running, and energy drift below it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from openmm import unit

import openmm_filament as of
from openmm_filament._term import Term
from systems import conservation
from systems.stability.cells import Cell, judged, reference

__all__ = ["LIMIT", "Limit", "chains", "drifts", "found", "limits"]

KJ, NM, PS, DALTON = unit.kilojoule_per_mole, unit.nanometer, unit.picosecond, unit.dalton

LIMIT = 0.05
"""What is asked of a predicted limit, relative to the one found."""

_STEPS = 400
"""Steps in which a push grows by e^80 where the time step is 0.5 % above the limit."""

_PUSH, _GROWN = 1e-5, 1e3
"""A random push over the shortest segment, and its growth that only an unstable run makes."""

_HALVINGS = 8


@dataclass(frozen=True)
class Limit:
    """A chain whose limit was predicted and found, both in internal units over the time unit of its stiffest term."""

    case: str
    label: str
    predicted: float
    found: float


def grows(model: of.Model, timestep: float) -> bool:
    """Whether a tiny random push grows without end under Verlet steps of this length (internal)."""
    integrator = of.verlet(model)
    integrator.setStepSize(timestep)
    x = model.positions.value_in_unit(NM)
    push = np.random.default_rng(1).normal(size=x.shape)
    push[model.held] = 0
    push *= _PUSH * np.linalg.norm(np.diff(x, axis=0), axis=-1).min()
    context = reference(model, integrator, x + push)
    for _ in range(4):
        integrator.step(_STEPS // 4)
        moved = context.getState(positions=True).getPositions(asNumpy=True).value_in_unit(NM) - x
        if not np.abs(moved).max() < _GROWN * np.abs(push).max():  # NaN too
            return True
    return False


def found(model: of.Model, predicted: float) -> float:
    """The limit found by halving between 0.6 and 1.9 of the predicted one, to 0.3 %; infinite or zero outside."""
    low, high = 0.6 * predicted, 1.9 * predicted
    if grows(model, low):
        return 0.0
    if not grows(model, high):
        return math.inf
    for _ in range(_HALVINGS):
        middle = math.sqrt(low * high)
        low, high = (low, middle) if grows(model, middle) else (middle, high)
    return math.sqrt(low * high)


def _stretch(k: float) -> Term:
    return of.stretching.Harmonic(k * KJ / NM**2)


def _helix(beads: int, *terms: Term, masses: Any = 10.0) -> of.Filament:
    rest = of.shapes.helix(beads - 1, radius=2 * NM, pitch=3 * NM, turns=(beads - 1) / 8)
    return of.Filament(rest, masses * DALTON, terms)


def chains(*, quick: bool) -> Iterator[tuple[str, str, float, Callable[[], of.Model]]]:
    """Name, setting, value and maker of each chain whose limit is looked for."""
    for beads in (5, 30) if quick else (5, 30, 300):
        stiff: dict[str, tuple[Term, ...]] = {
            "stretch": (_stretch(500), of.bending.Harmonic(1 * KJ)),
            "bend": (_stretch(1), of.bending.Harmonic(300 * KJ)),
            "bend, cosine": (_stretch(1), of.bending.Cosine(300 * KJ)),
            "torsion": (_stretch(1), of.bending.Harmonic(1 * KJ), of.torsion.Harmonic(300 * KJ)),
            "torsion, periodic": (_stretch(1), of.bending.Harmonic(1 * KJ), of.torsion.Periodic(100 * KJ, 2)),
        }
        for name, terms in stiff.items():
            if name == "bend, cosine":  # its rest shape is straight
                filament = of.Filament(of.shapes.line(beads - 1, 1 * NM), 10 * DALTON, terms)
            else:
                filament = _helix(beads, *terms)
            yield f"limited by {name}", f"{beads} beads", beads, partial(of.build, filament)


def limits(*, quick: bool, into: list[Limit]) -> Iterator[Cell]:
    """Predicted and found limits; each pair is put into `into` too."""

    def compare(case: str, label: str, make: Callable[[], of.Model]) -> float:
        model = make()
        predicted = model.to_internal(of.stable_timestep(model)).value_in_unit(PS)
        seen = found(model, predicted)
        into.append(Limit(case, label, predicted, seen))
        return abs(predicted / seen - 1) if seen else math.inf

    for case, label, value, make in chains(quick=quick):
        yield judged(
            ("time step limit", case, label, value),
            "Verlet steps, by halving",
            partial(compare, case, label, make),
            LIMIT,
        )
    for power in range(0, 13, 3 if quick else 2):
        for soft, k, alpha in (("bending", 10.0 * 10.0**power, 10.0), ("stretching", 10.0, 10.0 * 10.0**power)):
            filament = _helix(8, _stretch(k), of.bending.Harmonic(alpha * KJ))
            yield judged(
                ("stiffness ratio", f"time step limit, {soft} softer", f"1e{power}", 10.0**power),
                "Verlet steps, by halving",
                partial(compare, f"{soft} softer", f"1e{power}", partial(of.build, filament)),
                LIMIT,
            )
    for power in range(0, 7, 3 if quick else 1):
        for what in ("one light", "one heavy"):
            masses = np.full(8, 10.0)
            masses[3] *= 10.0 ** (power if what == "one heavy" else -power)
            filament = _helix(8, _stretch(500), of.bending.Harmonic(50 * KJ), masses=masses)
            yield judged(
                ("mass ratio", f"time step limit, {what} bead", f"1e{power}", 10.0**power),
                "Verlet steps, by halving",
                partial(compare, what, f"1e{power}", partial(of.build, filament)),
                LIMIT,
            )


def drifts(*, quick: bool, into: list[tuple[float, float, float]]) -> Iterator[Cell]:
    """Energy drift of a small warm motion against the time step; step over limit, slope and spread are put into `into`."""
    filament = _helix(12, _stretch(500), of.bending.Harmonic(100 * KJ), of.torsion.Harmonic(50 * KJ))
    model = of.build(filament)
    limit = model.to_internal(of.stable_timestep(model)).value_in_unit(PS)
    resting = reference(model, of.verlet(model)).getState(energy=True).getPotentialEnergy()

    def run(part: float) -> float:
        integrator = of.verlet(model, timestep=part * limit * PS)
        context = reference(model, integrator)
        context.setVelocitiesToTemperature(0.1 * unit.kelvin, 1)
        of.preflight(model, context)
        kept = conservation.drift(context, 8_000 if quick else 80_000, resting=resting, every=2)
        into.append((part, abs(kept.slope) + 2 * kept.error, kept.spread))
        return (abs(kept.slope) + 2 * kept.error) / 100  # per 10^4 steps

    for part in (0.01, 0.03, 0.1, 0.2, 0.35, 0.5, 0.7, 0.9, 0.95, 0.99, 1.01, 1.5):
        yield judged(
            ("step over limit", "energy drift in 10^4 steps", f"{part:g}", part),
            "Verlet steps",
            partial(run, part),
            0.02,
        )
