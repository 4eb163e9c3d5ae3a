"""Thermal motion: deviations of many independent runs from the exact answer, their mean (bias) and their scatter apart.

Replicas in one System are independent chains, each a run with noise of its own; the wall time of one is that of the
System, building and warm-up included, over their number.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial

import numpy as np
from numpy.typing import NDArray
from openmm import unit

import openmm_filament as of
from openmm_filament import wlc
from openmm_filament.blocks import clamped_model
from openmm_filament.discretisation import PN, exact_chain, time_step_bias
from openmm_filament.integrators import FRICTION, internal_langevin, thermal_step
from openmm_filament.planning import Plan, plan_curve
from openmm_filament.rods import Match
from openmm_filament.starts import equilibrium_starts
from openmm_filament.timestep import slow_frequency
from systems.dna_force_extension import curve as dna
from systems.error_vs_runtime.integrators import available, noisy_euler_cromer, opened
from systems.error_vs_runtime.settings import Order, Result, Setting, Study
from systems.helix_force_extension import thermal as helix
from systems.planar_force_extension import hot, warm

__all__ = ["dna_studies", "helix_studies", "planar_studies", "run"]

Array = NDArray[np.float64]

BEADS = 600
"""In one System, about: enough for the cost of a bead and step to be that of long chains."""

_BETWEEN, _WARM_UP = 0.2, 2.5
"""Between samples and before the first, in relaxation times, as the sampler has them."""

SEPARATION = 4
"""Segments apart at which the tangent correlation of the helix is compared."""


def run(
    filament: of.Filament, force: float, kelvin: float, setting: Setting, seed: int, observe: Callable[[Array], Array]
) -> tuple[Array, float]:
    """Averages (R,) of what `observe` makes of replicas (R, N, 3) in nm, one a replica, and the wall time of one.

    `force` is in kJ/mol/nm; `setting.effort` is the length of a run in relaxation times, after the warm-up.
    """
    begun = time.perf_counter()
    replicas = max(4, (BEADS if force else BEADS // 2) // len(filament))
    model = clamped_model(filament, force, 3, replicas) if force else of.build([filament] * replicas)
    heat = kelvin / model.scale.factor("temperature")
    rate = FRICTION * slow_frequency(model, heat)
    limit = of.stable_timestep(model) / unit.picosecond / model.scale.factor("time")
    step = setting.step * float(limit)
    made = noisy_euler_cromer if setting.integrator == THESIS else partial(internal_langevin, model)
    integrator = made(heat, rate, step, 1 + seed % (2**31 - 2))
    context = opened(model, integrator, setting.platform, setting.precision)
    starts = equilibrium_starts(filament, force, kelvin, replicas, np.random.default_rng(seed))
    context.setPositions(starts.reshape(-1, 3) / model.scale.length)
    context.setVelocitiesToTemperature(heat, 1 + seed % (2**31 - 2))
    integrator.step(round(_WARM_UP / (rate * step)))
    stride = max(1, round(_BETWEEN / (rate * step)))
    samples = max(2, round(setting.effort / (rate * step * stride)))
    total = np.zeros(replicas)
    for _ in range(samples):
        integrator.step(stride)
        x = context.getState(positions=True).getPositions(asNumpy=True).value_in_unit(unit.nanometer)
        total += observe(np.asarray(x).reshape(replicas, -1, 3) * model.scale.length)
    if not np.isfinite(total).all():
        raise FloatingPointError("The run diverged.")
    return total / samples, (time.perf_counter() - begun) / replicas


THESIS = "Euler-Cromer"
"""With the noise of a thermostat."""

KNOWN_FROM = 16
"""Segments from which on the bias of a time step is known (`discretisation`): with 12 it is 1.4 times what the law says."""


@cache
def _dna_filament(setting: Setting) -> of.Filament:
    """The DNA cut as the sampler cuts it: softer bonds get the rest length at which their mean length is the chain's own."""
    if setting.form != "arccosine":
        plain = _dna_filament(replace(setting, form="arccosine"))
        exact = [
            of.bending.Harmonic(t.stiffness, form="arctangent") if isinstance(t, of.bending.Harmonic) else t
            for t in plain.terms
        ]
        return of.Filament(plain.rest, plain.masses, tuple(exact))
    whole, temperature = dna.chain(), dna.TEMPERATURE * unit.kelvin
    if setting.softer == 1.0:
        return whole.filament(setting.segments, temperature, match=Match.END_TO_END)
    tension = setting.force * _continuous(setting.force) / dna.CONTOUR
    return whole.filament(
        setting.segments, temperature, match=Match.END_TO_END,
        stretch_modulus=dna.MODULUS / setting.softer * unit.piconewton, tension=tension * unit.piconewton,
    )  # fmt: skip


@cache
def _continuous(force: float) -> float:
    found = wlc.extension_exact(force, dna.PERSISTENCE, dna.CONTOUR, dna.KT, stretch_modulus=dna.MODULUS, finite=True)
    return float(found)


@cache
def _discrete(setting: Setting) -> float:
    chain = exact_chain(_dna_filament(setting), dna.TEMPERATURE * unit.kelvin)
    assert chain is not None
    return float(chain.extension(setting.force))


@cache
def _bias(setting: Setting) -> float:
    """What is known before the run: exact discrete over exact continuous extension, and what the step adds, less 1."""
    chain = exact_chain(_dna_filament(setting), dna.TEMPERATURE * unit.kelvin)
    assert chain is not None
    added = time_step_bias(chain, setting.force, setting.step)
    return _discrete(setting) / _continuous(setting.force) - 1 + added


def _of_step(setting: Setting) -> float:
    """The part of the known bias that the time step adds."""
    return _bias(setting) - (_discrete(setting) / _continuous(setting.force) - 1)


def _envelope(tried: Sequence[Setting], setting: Setting) -> float:
    """The largest known bias of a chain with so many segments or more: a change of sign with few is no convergence.

    Infinite with the thesis's integrator, whose bias is not known.
    """
    if setting.integrator == THESIS:
        return math.inf
    finer = [replace(setting, segments=s.segments, effort=1.0) for s in tried if s.segments >= setting.segments]
    return max((_bias(s) for s in finer), key=abs)


def _pull(setting: Setting, seed: int, *, discrete: bool) -> Result:
    extensions, wall = run(
        _dna_filament(setting), setting.force * PN, dna.TEMPERATURE, setting, seed, lambda x: x[:, -1, 2] - x[:, 0, 2]
    )
    exact = _discrete(replace(setting, effort=1.0)) if discrete else _continuous(setting.force)
    return Result(wall, extensions / exact - 1)


@cache
def _plan(which: int) -> Plan:
    """What `dna_force_extension` runs at one of its forces, by default."""
    wanted = dna.wanted_errors(None, quick=False)[which : which + 1]
    force = dna.FORCES[which : which + 1]
    return plan_curve(dna.chain(), force, dna.TEMPERATURE, wanted, 3, None)[0]


def _chosen(which: int, effort: float) -> Setting:
    plan = _plan(which)
    chain = exact_chain(plan.choice.filament, dna.TEMPERATURE * unit.kelvin)
    assert chain is not None
    softer = dna.MODULUS / (chain.stretching * chain.bond_length)
    return Setting(
        chain.segments,
        plan.choice.step,
        "LangevinMiddle",
        softer=float(f"{softer:.2g}"),
        effort=effort,
        force=plan.force,
    )


def dna_studies(*, quick: bool) -> list[Study]:
    """The DNA at a small and at a middling force, by segments and length of the runs; the time step by itself."""
    out = []
    efforts = (2.0, 6.0) if quick else (5.0, 15.0, 45.0)
    for which, others, seconds in ((1, (12, 32), (2.2, 16.0)), (5, (36, 72), (2.0, 39.0))):
        default = _chosen(which, efforts[-1])
        cuts = [default, *(replace(default, segments=n) for n in (others[:1] if quick else others))]
        settings = [replace(s, effort=e) for s in cuts for e in efforts]
        if which == 1 or not quick:
            settings += [replace(default, step=step) for step in (0.35, 0.7)]
        if which == 1:
            settings += [] if quick else [replace(default, softer=1.0, effort=efforts[0])]
            settings += _variants(default, efforts[0], quick=quick)
        out.append(
            Study(
                "dna_force_extension", f"extension at {dna.FORCES[which]:.2g} pN", "continuous worm-like chain",
                partial(_pull, discrete=False), settings,
                [Order("scatter, length of the run", "effort", -0.5, partial(_alike, default), kind="claim")],
                default, float(dna.wanted_errors(None, quick=False)[which]),
                seconds[not quick], partial(_envelope, cuts),
                partial(_as_long, default),
            )
        )  # fmt: skip
    if not quick:  # nothing less than minutes tells the bias of a step from noise
        small = _chosen(1, 250.0)
        out.append(
            Study(
                "dna_force_extension", f"time step alone, {small.segments} segments", "exact discrete chain",
                partial(_pull, discrete=True), [replace(small, step=step) for step in (0.55, 0.75, 0.95)],
                [Order("bias of LangevinMiddle, time step", "step", 2.0, lambda s: True, kind="claim")],
                seconds=8.0, known=_of_step,
            )
        )  # fmt: skip
    return out


def _variants(default: Setting, short: float, *, quick: bool) -> list[Setting]:
    """The same with the thesis's integrator, the other form of bending, and on other platforms; shorter where that is slow."""
    out = [replace(default, integrator=THESIS)]
    out += [replace(default, platform="CPU")] if "CPU" in available() else []
    if quick:
        return out
    out.append(replace(default, form="arctangent"))
    opencl = replace(default, platform="OpenCL", effort=short)
    return out + [replace(opencl, precision=p) for p in ("single", "mixed") if "OpenCL" in available()]


def _as_long(default: Setting, setting: Setting) -> bool:
    """Runs as long as the default's, of chains for which the bias of a time step is known."""
    return setting.effort == default.effort and setting.segments >= KNOWN_FROM


def _alike(default: Setting, setting: Setting) -> bool:
    return replace(setting, effort=default.effort) == default


def _correlation(x: Array) -> Array:
    tangents = np.diff(x, axis=1)
    tangents /= np.linalg.norm(tangents, axis=-1, keepdims=True)
    return np.asarray((tangents[:, SEPARATION:] * tangents[:, :-SEPARATION]).sum(axis=-1).mean(axis=1))


def _helix(setting: Setting, seed: int) -> Result:
    found, wall = run(helix.filament(), 0.0, helix.KELVIN, setting, seed, _correlation)
    return Result(wall, found / helix.exact()[SEPARATION] - 1)


def helix_studies(*, quick: bool) -> list[Study]:
    """The tangent correlation of the warm helix, by time step and length."""
    model = of.build(helix.filament())
    limit = float(of.stable_timestep(model) / unit.picosecond) / model.scale.factor("time")
    default = Setting(
        helix.SEGMENTS, thermal_step(model, helix.KELVIN) / limit, "LangevinMiddle", effort=3.0 if quick else 16.0
    )
    efforts = (1.0, 3.0) if quick else (2.0, 8.0, 16.0)
    settings = [replace(default, effort=e) for e in efforts]
    settings += [replace(default, step=part * default.step) for part in (() if quick else (0.5, 1.5))]
    order = Order("scatter, length of the run", "effort", -0.5, partial(_alike, default), kind="claim")
    return [
        Study(
            "helix_force_extension", f"tangent correlation {SEPARATION} apart", "product of mean rotations", _helix, settings,
            [order], default, None, 1.5 if quick else 19.0, lambda s: 0.0,
        )
    ]  # fmt: skip


def _planar(runs: int, setting: Setting, seed: int) -> Result:
    """So many runs of the planar chain, each of 16 replicas that mirror moves help over their barriers."""
    job = hot.Job(setting.force, warm.SOFTER * warm.at_ease(setting.force), 0.3, round(setting.effort), 0)
    exact = warm.exact(job)
    begun = time.perf_counter()
    found = [hot.sample(replace(job, seed=1 + (seed * runs + i) % (2**31 - 2))).extension for i in range(runs)]
    wall = (time.perf_counter() - begun) / runs
    return Result(wall, np.array(found) / exact - 1)


def planar_studies(*, quick: bool) -> list[Study]:
    """The planar chain with `k_B T` as large as a joint's bending stiffness, by the samples of a run."""
    efforts = (8.0, 24.0) if quick else (15.0, 60.0, 240.0)
    settings = [Setting(30, math.nan, "LangevinMiddle", effort=e, force=1.0) for e in efforts]
    order = Order("scatter, length of the run", "effort", -0.5, lambda s: True, kind="claim")
    return [
        Study(
            "planar_force_extension", "extension at k_BT = alpha", "exact discrete chain in the plane",
            partial(_planar, 2 if quick else 4), settings, [order], seconds=1.5 if quick else 13.5, known=lambda s: 0.0,
        )
    ]  # fmt: skip
