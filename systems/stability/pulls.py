"""Forces up to 10^6 times the stretch modulus: a chain of harmonic bonds becomes `1 + F/(k b)` times as long."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import openmm as mm
from openmm import app, unit

import openmm_filament as of
from systems.stability.cells import Cell, judged

__all__ = ["forces"]

KJ, NM, PS, DALTON = unit.kilojoule_per_mole, unit.nanometer, unit.picosecond, unit.dalton

_SEGMENTS, _K = 4, 500.0


def _model(ratio: float) -> of.Model:
    """A straight chain of 1 nm segments, held at bead 0 and pulled along itself by `ratio` times its stretch modulus k b."""
    terms = (of.stretching.Harmonic(_K * KJ / NM**2), of.bending.Harmonic(100 * KJ))
    filament = of.Filament(of.shapes.line(_SEGMENTS, 1 * NM), 10 * DALTON, terms, damping=5 / PS)
    return of.build(filament, [of.loads.Hold(0), of.loads.Pull(-1, (0, 0, ratio * _K) * KJ / NM)])


def _off(length: float, ratio: float) -> float:
    return abs(length / (_SEGMENTS * (1 + ratio)) - 1)


def _at_rest(ratio: float) -> float:
    found = of.equilibrium(_model(ratio), most_steps=150)
    if not found.converged:
        raise ValueError(found.message)
    return _off(float(found.positions.value_in_unit(NM)[-1, 2]), ratio)


def _run(ratio: float) -> float:
    model = _model(ratio)
    where = mm.Platform.getPlatformByName("Reference")
    simulation = app.Simulation(model.topology, model.system, of.euler_cromer(model), where)
    simulation.context.setPositions(model.positions)
    of.preflight(model, simulation.context)
    simulation.reporters.append(of.watch(model, 50))
    simulation.step(4000)
    x = simulation.context.getState(positions=True).getPositions(asNumpy=True).value_in_unit(NM)
    return _off(float(x[-1, 2]), ratio)


def forces(*, quick: bool) -> Iterator[Cell]:
    """From 1e-6 to 1e6 of the modulus, as a damped run and as a static equilibrium."""
    for power in range(-6, 7, 3 if quick else 1):
        ratio, label = 10.0**power, f"1e{power}"
        yield judged(
            ("force over modulus", "damped run", label, ratio), "4000 Euler-Cromer steps: length", partial(_run, ratio)
        )
        yield judged(
            ("force over modulus", "equilibrium", label, ratio), "static equilibrium: length", partial(_at_rest, ratio)
        )
