"""Statics: how far an equilibrium is from the exact one, and the residual it leaves; Newton, minimising, and damped motion."""

from __future__ import annotations

import inspect
import math
import time
from functools import cache, partial

import numpy as np
import openmm as mm
from numpy.typing import NDArray
from openmm import unit

import openmm_filament as of
from systems import helix_force_extension, open_ring, stage
from systems.error_vs_runtime.integrators import made, opened
from systems.error_vs_runtime.settings import Order, Result, Setting, Study
from systems.error_vs_runtime.sweeps.vibrations import Scene, measure
from systems.helix_force_extension import coil
from systems.open_ring import judgement, ring, static
from systems.planar_force_extension import chain, cold, report

__all__ = ["helix_studies", "planar_studies", "ring_studies"]

Array = NDArray[np.float64]

NEWTON, MINIMISER, DAMPED, HESSIAN = "Newton (of.equilibrium)", "L-BFGS (OpenMM)", "damped motion", "Hessian"

_REDUCED = 0.1
"""`F l0/alpha` on the planar chain: large motion, and one minimum."""

SHEAR = min(coil.SHEAR)
"""Of the helix in Pa: the softest torsion of its system, which needs the most segments."""


def _minimised(model: of.Model, tolerance: float) -> tuple[Array, float]:
    """Positions (N, 3) in m by OpenMM's minimiser from the rest shape, and the largest force left, over the load.

    `tolerance` is the root mean square force that it stops at, over the load.
    """
    load = max(float(np.linalg.norm(pull)) for loads in model.loads for pull in loads.pulls.values())
    load /= model.scale.factor("force")
    context = opened(model, made("Verlet", model, _short(model), 0.0), "Reference", "double")
    mm.LocalEnergyMinimizer.minimize(context, tolerance * load, 0)
    state = context.getState(positions=True, forces=True)
    x = model.to_physical(state.getPositions(asNumpy=True), "length").value_in_unit(unit.meter)
    forces = np.asarray(state.getForces(asNumpy=True)._value)
    forces[list(model.held)] = 0.0
    if model.planar:
        forces[:, 2] = 0.0
    return np.asarray(x), float(np.linalg.norm(forces, axis=1).max()) / load


def _short(model: of.Model) -> float:
    return 0.5 * float(of.stable_timestep(model).value_in_unit(unit.second))


@cache
def _planar_exact() -> tuple[float, float]:
    """Force in N, and exact extension over contour: the minimum in headings, which shares no code with the solver."""
    young = chain.YOUNG[-1]
    force = _REDUCED * chain.rigidities(young)[1] / chain.STEP
    point = cold.pulled(young, np.array([force])).points[0]
    return force, cold.by_headings(_REDUCED, point.positions / chain.STEP)[0]


def _planar(setting: Setting, seed: int) -> Result:
    del seed
    force, exact = _planar_exact()
    begun = time.perf_counter()
    model = chain.cold_model(chain.YOUNG[-1], force)
    if setting.method == NEWTON:
        found = of.equilibrium(model, stages=int(setting.effort))
        x, residual = found.positions.value_in_unit(unit.meter), found.residual / (force * stage.NEWTON)
    else:
        x, residual = _minimised(model, setting.effort)
    wall = time.perf_counter() - begun
    return Result(wall, np.array([float(x[-1, 0] - x[0, 0]) / chain.CONTOUR / exact - 1]), residual)


def _default_stages() -> float:
    return float(inspect.signature(of.equilibrium).parameters["stages"].default)


def planar_studies(*, quick: bool) -> list[Study]:
    """The planar chain under a load that opens it."""
    default = Setting(chain.SEGMENTS, method=NEWTON, effort=_default_stages())
    stages = (1.0, 2.0, 4.0, 8.0) if quick else (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
    tolerances = (1e-1, 1e-2) if quick else (1e-1, 1e-2, 1e-3, 1e-4, 1e-5)
    return [
        Study(
            "planar_force_extension", "extension without temperature", "minimum in headings (SciPy)", _planar,
            [Setting(chain.SEGMENTS, method=NEWTON, effort=s) for s in stages]
            + [Setting(chain.SEGMENTS, method=MINIMISER, effort=t) for t in tolerances],
            (), default, report.HEADINGS, seconds=1.4 if quick else 2.5,
        )
    ]  # fmt: skip


def _helix(setting: Setting, seed: int) -> Result:
    """Stiffness from the equilibria under a small force and twice that, as the system's own check has it."""
    del seed
    exact = coil.end_stiffness(SHEAR)
    force = 2e-5 * exact
    begun = time.perf_counter()
    residual = math.nan
    if setting.method == NEWTON:
        found = coil.end_stiffness_found(SHEAR, setting.segments, force)
    else:
        longer = []
        for pull in (force, 2 * force):
            x, residual = _minimised(coil.helix(SHEAR, pull, segments=setting.segments), setting.effort)
            longer.append(float(x[-1, 2] - x[0, 2]) - coil.HEIGHT)
        found = 2 * force / (4 * longer[0] - longer[1])
    wall = time.perf_counter() - begun
    if setting.method == NEWTON:
        model = coil.helix(SHEAR, force, segments=setting.segments)
        residual = of.equilibrium(model).residual / (force * stage.NEWTON)
    return Result(wall, np.array([found / exact - 1]), residual)


def helix_studies(*, quick: bool) -> list[Study]:
    """The small-load stiffness of the helix by segments."""
    default = Setting(helix_force_extension.STIFFNESS_SEGMENTS, method=NEWTON)
    sizes = (20, 28, 40, default.segments) if quick else (15, 20, 28, 40, default.segments, 80, 112)
    tolerances = (1e-3,) if quick else (1e-1, 1e-2, 1e-3, 1e-4)
    settings = [Setting(n, method=NEWTON) for n in sizes]
    return [
        Study(
            "helix_force_extension", f"small-load stiffness, G/E = {SHEAR / coil.YOUNG:g}", "helix formula", _helix,
            settings + [Setting(20 if quick else 40, method=MINIMISER, effort=t) for t in tolerances],
            [Order("segments", "segments", -2.0, lambda s: s.method == NEWTON and s.segments >= 28)],
            default, helix_force_extension.STIFFNESS, seconds=0.8 if quick else 6.5,
        )
    ]  # fmt: skip


@cache
def _ring_force() -> float:
    return float(open_ring.force_for(ring.thesis_ring(gap=True), open_ring.PEAK, samples=100))


def _ring_swing(setting: Setting, seed: int) -> Result:
    """The thesis's run at 45 degrees: kinetic and internal energy less the work done, the largest over the peak."""
    del seed
    body, force = ring.thesis_ring(gap=True), _ring_force()
    begun = time.perf_counter()
    motion = ring.swing(body, force, math.pi / 4, samples=open_ring.SAMPLES, step=setting.step)
    return Result(time.perf_counter() - begun, np.array([motion.imbalance]))


@cache
def _ring_modes() -> tuple[Array, Array]:
    omega, shapes = static.small_modes(ring.thesis_ring(gap=True))
    return omega[:4] / (2 * math.pi), shapes[:4]


def _ring_lines(setting: Setting) -> tuple[Array, Array, Array]:
    lines, shapes = _ring_modes()
    return lines, lines, shapes


def _ring_begin(context: mm.Context, model: of.Model) -> None:
    body = ring.thesis_ring(gap=True)
    moved = body.positions + 1e-6 * _ring_modes()[1].sum(axis=0)
    context.setPositions(model.to_internal(moved * unit.meter))


def _ring_statics(setting: Setting, seed: int) -> Result:
    """The compliance across the ring, radial."""
    del seed
    begun = time.perf_counter()
    if setting.method == HESSIAN:
        found = static.from_hessian(static.of_size(setting.segments + 1))["radial"]
    else:
        found = static.relaxed(setting.segments + 1, "radial")
    wall = time.perf_counter() - begun
    return Result(wall, np.array([found / static.cut_ring("radial") - 1]))


def ring_studies(*, quick: bool) -> list[Study]:
    """The ring's motion under a small load, and its compliance by segments."""
    beads = ring.BEADS - 1
    default = Setting(beads, open_ring.STEP)
    steps = (0.8, 0.4, 0.2) if quick else (0.8, 0.4, 0.2, 0.1, 0.05)
    shorter = (0.8, 0.4, 0.2) if quick else (0.8, 0.4, 0.2, 0.1)
    scene = Scene(lambda s: of.build(ring.thesis_ring(gap=True).filament), _ring_begin, _ring_lines, 2e-3, 0)
    lines = [Setting(beads, step, name) for name in ("Verlet", "Euler-Cromer") for step in shorter]
    lines += [Setting(beads, step, "PEFRL") for step in shorter[:2]]
    sizes = (6, 12, 24, 48, 96) if quick else (6, 12, 24, 48, 96, 192)
    slow = (12, 16) if quick else (12, 16, 24)
    return [
        Study(
            "open_ring", "energy balance of the pull at 45 degrees", "energy kept", _ring_swing,
            [Setting(beads, step) for step in steps],
            [Order("Verlet, time step", "step", 2.0, _verlet, 1e-8)], default, judgement.BALANCE, seconds=0.8 if quick else 3.0,
        ),
        Study(
            "open_ring", "four lowest lines", "modes of its strains", partial(measure, scene),
            [*lines, Setting(beads, 0.8, platform="CPU")],
            [Order("Verlet, time step", "step", 2.0, _verlet, 1e-8)], seconds=1.5 if quick else 2.0,
        ),
        Study(
            "open_ring", "radial compliance", "cut ring", _ring_statics,
            [Setting(n, method=HESSIAN) for n in sizes] + [Setting(n, method=DAMPED) for n in slow],
            [Order("segments", "segments", -2.0, partial(_by, HESSIAN))], seconds=0.4 if quick else 0.5,
        ),
    ]  # fmt: skip


def _verlet(setting: Setting) -> bool:
    return setting.integrator == "Verlet" and setting.platform == "Reference" and setting.step <= 0.4


def _by(method: str, setting: Setting) -> bool:
    return setting.method == method and 12 <= setting.segments <= 96
