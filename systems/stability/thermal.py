"""Temperatures from 0 to 10^6 K: mean energies of bonds, joints and dihedrals against their exact averages."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np
import openmm as mm
from numpy.typing import NDArray
from openmm import app, unit
from scipy.integrate import quad

import openmm_filament as of
from openmm_filament._term import Term
from openmm_filament.starts import equilibrium_starts
from openmm_filament.units import BOLTZMANN
from systems.stability.cells import Cell, judged
from systems.stability.shapes import bent as shape

__all__ = ["exact_energies", "temperatures"]

Array = NDArray[np.float64]

KJ, NM, PS, DALTON = unit.kilojoule_per_mole, unit.nanometer, unit.picosecond, unit.dalton

STRETCH, BEND, TWIST = 2000.0, 100.0, 20.0
"""kJ/mol/nm^2, kJ/mol, kJ/mol; segments of 1 nm."""

REST_BEND, REST_TWIST = 0.8, 1.0

_REPLICAS, _SEGMENTS, _BLOCKS = 24, 6, 12

_SIGMAS, _BIAS = 4.5, 0.03
"""Standard errors, and the relative bias of the time step, within which a mean energy counts as right."""


def _mean(
    energy: Callable[[float], float], weight: Callable[[float], float], low: float, high: float, kt: float
) -> float:
    """The Boltzmann average of an energy of one coordinate with this volume element."""
    points = np.linspace(low, high, 9)[1:-1]

    def integral(part: Callable[[float], float]) -> float:
        return float(
            quad(lambda u: part(u) * weight(u) * math.exp(-energy(u) / kt), low, high, points=points, limit=400)[0]
        )

    return integral(energy) / integral(lambda _: 1.0)


def exact_energies(kelvin: float, *, bent: bool) -> dict[str, float]:
    """Mean energy, kJ/mol, of a bond, a joint and a dihedral: each is independent in an open chain with these volume elements."""
    kt = BOLTZMANN * kelvin
    rest = REST_BEND if bent else 0.0
    reach = 12 * math.sqrt(kt / STRETCH)
    turn = 12 * math.sqrt(kt / BEND)
    out = {
        "stretching": _mean(lambda r: STRETCH / 2 * (r - 1) ** 2, lambda r: r * r, max(0.0, 1 - reach), 1 + reach, kt),
        "bending": _mean(
            lambda b: BEND / 2 * (b - rest) ** 2, math.sin, max(0.0, rest - turn), min(math.pi, rest + turn), kt
        ),
    }
    if bent:
        twist = min(math.pi, 12 * math.sqrt(kt / TWIST))
        out["torsion"] = _mean(lambda d: TWIST / 2 * d * d, lambda _: 1.0, -twist, twist, kt)
    return out


def _filament(*, bent: bool) -> of.Filament:
    rest = of.shapes.line(_SEGMENTS, 1 * NM)
    terms: tuple[Term, ...] = (of.stretching.Harmonic(STRETCH * KJ / NM**2), of.bending.Harmonic(BEND * KJ))
    if bent:
        rest = shape((1.0,) * _SEGMENTS, (REST_BEND,) * (_SEGMENTS - 1), (REST_TWIST,) * (_SEGMENTS - 2)) * NM
        terms = (*terms, of.torsion.Harmonic(TWIST * KJ))
    return of.Filament(rest, 10 * DALTON, terms)


def _error(kelvin: float, steps: int, *, bent: bool) -> tuple[float, float]:
    """The largest relative error of a mean energy, and what it may be: standard errors and the bias of the step."""
    filament = _filament(bent=bent)
    warm = kelvin * unit.kelvin
    model = of.build([filament] * _REPLICAS)
    limit = model.to_internal(of.stable_timestep(model)).value_in_unit(PS)
    integrator = of.langevin(model, warm, friction=0.1 / (limit * PS), seed=7)
    simulation = app.Simulation(model.topology, model.system, integrator, mm.Platform.getPlatformByName("Reference"))
    starts = equilibrium_starts(filament, 0.0, kelvin, _REPLICAS, np.random.default_rng(3))
    simulation.context.setPositions(np.concatenate(list(starts)))
    simulation.context.setVelocitiesToTemperature(warm, 5)
    of.preflight(model, simulation.context)
    simulation.reporters.append(of.watch(model, 100))
    simulation.step(steps // 4)
    counts = {i.term.family: len(i.beads) for i in model.interactions}
    blocks = []
    for _ in range(_BLOCKS):
        sums = dict.fromkeys(counts, 0.0)
        samples = steps // _BLOCKS // 10
        for _ in range(samples):
            simulation.step(10)
            for family, group in model.groups.items():
                energy = simulation.context.getState(energy=True, groups=1 << group).getPotentialEnergy()
                sums[family] += energy.value_in_unit(KJ) / counts[family] / samples
        blocks.append(sums)
    found = []
    for family, right in exact_energies(kelvin, bent=bent).items():
        values = np.array([block[family] for block in blocks])
        spread = float(values.std(ddof=1)) / math.sqrt(_BLOCKS)
        found.append((abs(float(values.mean()) / right - 1), _BIAS + _SIGMAS * spread / right))
    return _worst(found)


def _worst(found: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Of errors and what they may be the pair with the largest ratio; the first with a NaN if there is one."""
    return found[int(np.argmax([error / allowed for error, allowed in found]))]


def temperatures(*, quick: bool) -> Iterator[Cell]:
    """Free chains, straight and bent at rest, the second under dihedrals too."""
    for kelvin in (0.0, 1e-6, 1e-3, 1.0, 300.0, 1e4, 1e5, 1e6):
        for name, bent in (("straight: bonds, joints", False), ("bent: dihedrals too", True)):
            if quick and bent and kelvin in (1e-6, 1e-3, 1e4, 1e5):  # a trial of a second each
                continue
            label = "0 K" if not kelvin else f"1e{round(math.log10(kelvin))} K" if kelvin != 300 else "300 K"
            yield judged(
                ("temperature", name, label, kelvin),
                "LangevinMiddle: mean energies",
                partial(_error, kelvin, 1_200 if quick else 12_000, bent=bent),
            )
