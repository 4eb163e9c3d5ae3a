"""Large and small: stiffness ratios, masses, sizes of beads, numbers of beads, amplitudes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial

import numpy as np
import openmm as mm
from numpy.typing import NDArray
from openmm import app, unit

import openmm_filament as of
from openmm_filament._term import Term
from systems.stability import exact
from systems.stability.cells import Cell, judged, reference
from systems.stability.shapes import bent

__all__ = ["amplitudes", "counts", "masses", "ratios", "sizes"]

Array = NDArray[np.float64]

KJ, NM, PS, DALTON = unit.kilojoule_per_mole, unit.nanometer, unit.picosecond, unit.dalton
_TINY = 1e-12

_LENGTHS, _BENDS, _TORSIONS = (1.0, 0.9, 1.1, 1.0, 1.2), (0.5, 0.7, 0.4, 0.6), (0.8, -1.1, 2.0)

_KEPT = 0.1
"""Change of the energy of a run over its largest kinetic energy that counts as right; `of.watch` stops at a larger rise."""


def _terms(k: float, alpha: float, torsion: float) -> tuple[Term, ...]:
    return (
        of.stretching.Harmonic(k * KJ / NM**2),
        of.bending.Harmonic(alpha * KJ),
        of.torsion.Harmonic(torsion * KJ),
    )


def _chain(*terms: Term, mass: float | Array = 10.0) -> of.Filament:
    return of.Filament(bent(_LENGTHS, _BENDS, _TORSIONS) * NM, mass * DALTON, terms)


def _forces(context: mm.Context, groups: int = -1) -> Array:
    state = context.getState(forces=True, groups=groups)
    return np.asarray(state.getForces(asNumpy=True).value_in_unit(KJ / NM))


def _worst_error(model: of.Model, context: mm.Context, x: Array) -> float:
    """The largest error among the terms, each over its own largest force, at internal positions."""
    context.setPositions(x)
    of.preflight(model, context)
    errors = [
        exact.error(_forces(context, 1 << model.groups[i.term.family]), [i], x)
        for i in model.interactions
        if len(i.beads)
    ]
    return float(np.max(errors))  # of a NaN, unlike `max`, a NaN


def ratios(*, quick: bool) -> Iterator[Cell]:
    """Stretching to bending stiffness (k b^2/alpha) and the other way round, from 1 to 10^12."""
    shift = 0.01 * np.random.default_rng(3).normal(size=(6, 3))
    for power in range(0, 13, 3 if quick else 1):
        ratio, label = 10.0**power, f"1e{power}"
        for name, k, alpha in (("bending softer", 10 * ratio, 10.0), ("stretching softer", 10.0, 10 * ratio)):
            model = of.build(_chain(*_terms(k, alpha, 10.0)))
            context = reference(model, mm.VerletIntegrator(_TINY))
            yield judged(
                ("stiffness ratio", f"forces, {name}", label, ratio),
                "forces of each term",
                partial(_worst_error, model, context, model.positions.value_in_unit(NM) + shift),
            )
        yield judged(
            ("stiffness ratio", "lowest mode, bending softer", label, ratio), "normal modes", partial(_lowest, ratio)
        )
        yield judged(
            ("stiffness ratio", "cantilever, bending softer", label, ratio),
            "static equilibrium",
            partial(_cantilever, ratio),
        )


def _lowest(ratio: float) -> float:
    """Error of the lowest frequency of a straight free chain of 10 beads, which its bonds do not change."""
    terms = _terms(10 * ratio, 10.0, 1.0)[:2]
    model = of.build(of.Filament(of.shapes.line(9, 1 * NM), 10 * DALTON, terms))
    curvature = np.diff(np.eye(10), 2, axis=0)  # of unit masses and bending stiffness
    right = math.sqrt(np.linalg.eigvalsh(curvature.T @ curvature)[2]) / (2 * math.pi) * 1e12
    return abs(float(of.normal_modes(model, 12).frequencies[5]) / right - 1)


def _cantilever(ratio: float) -> float:
    """Error of the small deflection of a clamped chain under a force across it at its end: F sum (lever)^2/alpha."""
    terms = _terms(10 * ratio, 10.0, 1.0)[:2]
    filament = of.Filament(of.shapes.line(5, 1 * NM), 10 * DALTON, terms)
    model = of.build(filament, [of.loads.Hold([0, 1]), of.loads.Pull(-1, (1e-3, 0, 0) * KJ / NM)])
    rest = of.equilibrium(model, most_steps=60)
    if not rest.converged:
        raise ValueError(rest.message)
    right = 1e-3 * sum(lever**2 for lever in range(1, 5)) / 10.0
    return abs(float(rest.positions.value_in_unit(NM)[-1, 0]) / right - 1)


def masses(*, quick: bool) -> Iterator[Cell]:
    """Two beads of unlike mass on a spring, by normal modes and by the period of a run."""
    for power in range(0, 7, 3 if quick else 1):
        heavy = 10.0**power
        spring = of.stretching.Harmonic(500 * KJ / NM**2)
        model = of.build(of.Filament(of.shapes.line(1, 1 * NM), np.array([1.0, heavy]) * DALTON, (spring,)))
        omega = math.sqrt(500 * (1 + 1 / heavy))  # 1/ps

        def mode(model: of.Model = model, omega: float = omega) -> float:
            return abs(float(of.normal_modes(model).frequencies[-1]) * 2 * math.pi * 1e-12 / omega - 1)

        yield judged(("mass ratio", "frequency of a pair, modes", f"1e{power}", heavy), "normal modes", mode)
        yield judged(
            ("mass ratio", "frequency of a pair, run", f"1e{power}", heavy),
            "200 Verlet steps",
            partial(_ringing, model, omega),
        )
        mixed = np.where(np.arange(6) % 2, heavy, 1.0)
        chain = of.build(_chain(*_terms(500.0, 50.0, 10.0), mass=mixed))
        yield judged(
            ("mass ratio", "energy, light and heavy in turn", f"1e{power}", heavy),
            "1000 Verlet steps: energy",
            partial(_kept, chain, 0.02, 1000),
            _KEPT,
        )


def _ringing(model: of.Model, omega: float) -> float:
    """Largest deviation of the length of a stretched pair from a cosine at the leapfrog's frequency, over the amplitude."""
    integrator = of.verlet(model)
    context = reference(model, integrator)
    x = model.positions.value_in_unit(NM).copy()
    x[1, 2] += 1e-3
    context.setPositions(x)
    of.preflight(model, context)
    dt = integrator.getStepSize().value_in_unit(PS)
    seen = 2 * math.asin(omega * dt / 2) / dt
    off = []
    for i in range(1, 201):
        integrator.step(1)
        at = context.getState(positions=True).getPositions(asNumpy=True).value_in_unit(NM)
        phase = seen * dt * i  # velocities stand half a step before positions: at rest half a step before the start
        right = 1e-3 * (math.cos(phase) - math.tan(seen * dt / 2) * math.sin(phase))
        off.append(abs(float(at[1, 2] - at[0, 2]) - 1 - right))
    return float(np.max(off)) / 1e-3  # of a NaN, unlike `max`, a NaN


def _kept(model: of.Model, amplitude: float, steps: int) -> float:
    """Largest change of the energy of a Verlet run from displaced positions, over the largest kinetic energy."""
    x = model.positions.value_in_unit(NM)
    shortest = np.linalg.norm(np.diff(x, axis=0), axis=-1).min()
    where = mm.Platform.getPlatformByName("Reference")
    simulation = app.Simulation(model.topology, model.system, of.verlet(model), where)
    simulation.context.setPositions(x + amplitude * shortest * np.random.default_rng(5).normal(size=x.shape))
    of.preflight(model, simulation.context)
    simulation.reporters.append(of.watch(model, max(steps // 20, 1)))
    total, kinetic = [], []
    for _ in range(100):
        simulation.step(steps // 100)
        state = simulation.context.getState(energy=True)
        kinetic.append(state.getKineticEnergy().value_in_unit(KJ))
        total.append(kinetic[-1] + state.getPotentialEnergy().value_in_unit(KJ))
    return float(np.abs(np.array(total) - total[0]).max() / max(kinetic))


def sizes(*, quick: bool) -> Iterator[Cell]:
    """One chain from segments of 1e-10 m to 1 m, all stiffnesses scaled alike: forces, and a run, which must look the same."""
    shape = bent(_LENGTHS, _BENDS, _TORSIONS)
    shift = 0.02 * np.random.default_rng(3).normal(size=(6, 3))
    ran: dict[int, Array] = {}

    def build(power: int) -> of.Model:
        b = 10.0**power  # m; stiffness and density of the material are those of the chain of 1 nm
        scale = (b / 1e-9) ** 3
        terms = (
            of.stretching.Harmonic(500 * scale / (b * 1e9) ** 2 * KJ / NM**2),
            of.bending.Harmonic(50 * scale * KJ),
            of.torsion.Harmonic(10 * scale * KJ),
        )
        return of.build(of.Filament(shape * b * unit.meter, 10 * scale * DALTON, terms))

    def forces(power: int) -> float:
        model = build(power)
        length = 10.0**power * 1e9
        x = (shape + shift) * length  # nm
        context = reference(model, of.verlet(model), x / model.scale.length)
        of.preflight(model, context)
        right = exact.forces(model.filaments[0].interactions(), x)
        return float(np.abs(of.forces(model, x * NM) - right).max() / np.abs(right).max())

    def motion(power: int) -> float:
        if -9 not in ran:
            ran[-9] = _moved(build(-9), shape + shift, 1.0)
        return float(
            np.abs(_moved(build(power), shape + shift, 10.0**power * 1e9) - ran[-9]).max() / np.abs(shift).max()
        )

    for power in range(-10, 1, 2 if quick else 1):
        label, value = f"1e{power} m", 10.0**power
        yield judged(("bead size", "forces", label, value), "forces in 50 digits", partial(forces, power))
        yield judged(("bead size", "motion as at 1 nm", label, value), "300 Verlet steps", partial(motion, power))


def _moved(model: of.Model, x: Array, length: float) -> Array:
    """Positions over the length unit (nm) after 300 Verlet steps at a tenth of the limit, from x times that unit."""
    integrator = of.verlet(model)
    context = reference(model, integrator, x * length / model.scale.length)
    of.preflight(model, context)
    integrator.step(300)
    at = context.getState(positions=True).getPositions(asNumpy=True).value_in_unit(NM)
    return np.asarray(at * model.scale.length / length)


def counts(*, quick: bool) -> Iterator[Cell]:
    """One bead to 10^5: refused where a term needs more, else forces against NumPy after 20 steps."""
    everything = dict(zip(("stretching", "bending", "torsion"), _terms(500.0, 50.0, 10.0), strict=True))

    def run(beads: int, names: tuple[str, ...]) -> float:
        if beads < 4:
            rest = bent((1.0,) * (beads - 1), (0.5,) * (beads - 2)) if beads > 1 else np.zeros((1, 3))
        else:
            rest = of.shapes.helix(beads - 1, radius=2 * NM, pitch=3 * NM, turns=(beads - 1) / 12).value_in_unit(NM)
        filament = of.Filament(rest * NM, 10 * DALTON, tuple(everything[name] for name in names))
        model = of.build(filament)
        integrator = of.verlet(model)
        x = rest + 0.01 * np.random.default_rng(1).normal(size=rest.shape)
        context = reference(model, integrator, x)
        of.preflight(model, context)
        integrator.step(20)
        moved = context.getState(positions=True).getPositions(asNumpy=True).value_in_unit(NM)
        right = of.reference.forces(filament, moved * NM)
        return float(np.abs(_forces(context) - right).max() / np.abs(right).max())

    for names in (("stretching",), ("stretching", "bending"), ("stretching", "bending", "torsion")):
        for beads in (1, 2, 3, 4, 10, 1000, 100_000):
            if beads > 10_000 and quick and len(names) != 2:
                continue
            yield judged(
                ("number of beads", " + ".join(names), f"{beads:g}", beads),
                "20 Verlet steps, forces",
                partial(run, beads, names),
            )


def amplitudes(*, quick: bool) -> Iterator[Cell]:
    """Random displacements from 1e-12 to 100 segment lengths: forces there, and the energy of a run from there."""
    torsions = {"dihedral": of.torsion.Harmonic(10 * KJ), "weighted": of.torsion.Weighted(10 * KJ)}
    for name, torsion in torsions.items():
        model = of.build(_chain(*_terms(500.0, 50.0, 10.0)[:2], torsion))
        rest = model.positions.value_in_unit(NM)
        context = reference(model, mm.VerletIntegrator(_TINY))
        shift = np.random.default_rng(4).normal(size=rest.shape)
        for power in [*range(-12, -1, 4 if quick else 2), -1.5, -1, -0.5, 0, 0.5, 1, 2]:
            size = 10.0**power
            label = f"{size:.1g}"
            yield judged(
                ("amplitude", f"forces, torsion {name}", label, size),
                "forces of each term",
                partial(_worst_error, model, context, rest + size * shift),
            )
            yield judged(
                ("amplitude", f"energy, torsion {name}", label, size),
                "1000 Verlet steps: energy",
                partial(_kept, model, size, 1000),
                _KEPT,
            )
