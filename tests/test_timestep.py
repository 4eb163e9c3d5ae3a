"""The stability limit: the one found by running, the eigenvalue of the Hessian, and what holds and scales it."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import openmm as mm
import pytest
import tolerances as tol
from conftest import KJ, NM, Array, random_chain
from openmm import unit

import openmm_filament as of
from openmm_filament import bending, electrostatics, stretching, torsion
from openmm_filament.loads import Hold, Plane, Pull
from openmm_filament.timestep import highest_frequency

STIFFNESS = KJ / NM**2
PS = unit.picosecond
REFERENCE = mm.Platform.getPlatformByName("Reference")


def helix(*terms: Any, beads: int = 30, masses: Any = 10 * unit.dalton) -> of.Filament:
    rest = of.shapes.helix(beads - 1, radius=2 * NM, pitch=3 * NM, turns=(beads - 1) / 8)
    return of.Filament(rest, masses, terms)


def stretch(k: float) -> stretching.Harmonic:
    return stretching.Harmonic(k * STIFFNESS)


MODELS: dict[str, tuple[of.Filament, Sequence[Any]]] = {
    "stretching": (helix(stretch(500)), ()),
    "stretching, open masses": (helix(stretch(500), masses=np.linspace(4, 40, 30) * unit.dalton), ()),
    "bending": (helix(stretch(1), bending.Harmonic(300 * KJ)), ()),
    "bending, cosine, straight": (
        of.Filament(of.shapes.line(30, 1 * NM), 10 * unit.dalton, (stretch(1), bending.Cosine(300 * KJ))), (),
    ),
    "torsion": (helix(stretch(1), bending.Harmonic(1 * KJ), torsion.Harmonic(300 * KJ)), ()),
    "torsion, periodic": (helix(stretch(1), bending.Harmonic(1 * KJ), torsion.Periodic(100 * KJ, 1)), ()),
    "torsion, weighted, straight": (  # on a bent chain it also pulls the bends open: its rest shape is no equilibrium
        of.Filament(of.shapes.line(30, 1 * NM), 10 * unit.dalton,
                    (stretch(1), bending.Harmonic(100 * KJ), torsion.Weighted(40 * KJ, 0 * unit.radian))), (),
    ),
    "held": (helix(stretch(500), bending.Harmonic(50 * KJ)), [Hold([0, 7, -1])]),
    "planar": (
        of.Filament(of.shapes.planar_walk(30, 1 * NM, bend=0.5 * unit.radian, seed=4), 10 * unit.dalton,
                    (stretch(50), bending.Harmonic(200 * KJ))), [Plane()],
    ),
    "ring": (
        of.Filament(of.shapes.ring(20, 1 * NM), 5 * unit.dalton, (stretch(50), bending.Harmonic(200 * KJ)), closed=True), (),
    ),
}  # fmt: skip


def hessian(model: of.Model) -> Array:
    """The mass-weighted Hessian of the free degrees of freedom, by central differences of OpenMM's forces."""
    size = int(model.starts[-1])
    context = mm.Context(model.system, mm.VerletIntegrator(1e-6), REFERENCE)
    x = model.positions.value_in_unit(NM)
    free = np.ones((size, 3), dtype=bool)
    free[model.held] = False
    free[:, 2] &= not model.planar
    h, rows = 1e-5, []
    for i, k in np.argwhere(free):
        sides = []
        for sign in (1, -1):
            moved = x.copy()
            moved[i, k] += sign * h
            context.setPositions(moved * NM)
            sides.append(context.getState(forces=True).getForces(asNumpy=True).value_in_unit(KJ / NM)[free])
        rows.append(-(sides[0] - sides[1]) / (2 * h))
    weights = 1 / np.sqrt(np.repeat(model.masses[:, None], 3, axis=1)[free])
    matrix = weights[:, None] * np.array(rows) * weights
    return (matrix + matrix.T) / 2


def growth(model: of.Model, dt: float, steps: int = 2500) -> float:
    """How much larger than at the start a tiny random displacement has become after Verlet steps of dt (internal)."""
    integrator = of.verlet(model)
    integrator.setStepSize(dt)
    context = mm.Context(model.system, integrator, REFERENCE)
    x = model.positions.value_in_unit(NM)
    push = 1e-7 * np.random.default_rng(1).normal(size=x.shape)
    push[model.held] = 0
    push[:, 2] *= not model.planar
    context.setPositions((x + push) * NM)
    largest = 0.0
    for _ in range(steps // 50):
        integrator.step(50)
        moved = context.getState(positions=True).getPositions(asNumpy=True).value_in_unit(NM) - x
        largest = max(largest, float(np.abs(moved - moved.mean(axis=0) * (not len(model.held))).max()))
        if not largest < 1e-2:  # NaN too
            return math.inf
    return largest / float(np.abs(push).max())


@pytest.mark.parametrize("name", MODELS)
def test_the_limit_is_where_a_run_blows_up(name: str) -> None:
    """2/omega_max to 5 %: a tiny push stays one below it and grows without end above it."""
    model = of.build(*MODELS[name])
    limit = model.to_internal(of.stable_timestep(model)).value_in_unit(PS)
    assert growth(model, (1 - tol.LIMIT) * limit) < tol.STAYS_SMALL
    assert growth(model, (1 + tol.LIMIT) * limit) == math.inf


@pytest.mark.parametrize("name", MODELS)
def test_the_limit_is_the_largest_eigenvalue_of_the_hessian(name: str) -> None:
    model = of.build(*MODELS[name])
    largest = np.linalg.eigvalsh(hessian(model))[-1]
    limit = model.to_internal(of.stable_timestep(model)).value_in_unit(PS)
    assert limit == pytest.approx(2 / math.sqrt(largest), rel=tol.LANCZOS)
    assert limit >= 2 / math.sqrt(largest) * (1 - tol.EIGENVALUE)  # Lanczos approaches from below


@pytest.mark.parametrize("seed", range(4))
def test_a_small_chain_has_the_dense_eigenvalue(seed: int) -> None:
    rng = np.random.default_rng(seed)
    terms = (stretch(100), bending.Harmonic(20 * KJ), torsion.Weighted(5 * KJ),
             electrostatics.Neighbour(0.5 * unit.elementary_charge))  # fmt: skip
    filament = of.Filament(random_chain(rng, 7) * NM, rng.uniform(1, 20, 7) * unit.dalton, terms)
    model = of.build(filament, [Hold(2), Pull(0, (1, 2, 3) * unit.piconewton)])
    limit = of.stable_timestep(model).value_in_unit(PS)
    assert limit == pytest.approx(2 / math.sqrt(np.linalg.eigvalsh(hessian(model))[-1]), rel=tol.EIGENVALUE)


def test_two_beads_and_a_spring_by_hand() -> None:
    """omega^2 = k (1/m1 + 1/m2), or k/m2 with the first held."""
    filament = of.Filament(of.shapes.line(1, 1 * NM), [2.0, 8.0] * unit.dalton, (stretch(50),))
    for loads, inverse in (((), 1 / 2 + 1 / 8), ([Hold(0)], 1 / 8), ([Hold(1)], 1 / 2)):
        limit = of.stable_timestep(of.build(filament, loads)).value_in_unit(PS)
        assert limit == pytest.approx(2 / math.sqrt(50 * inverse), rel=tol.EIGENVALUE)


def test_a_long_chain_of_springs_by_hand() -> None:
    """omega_max = 2 sqrt(k/m) cos(pi/2N) along a free chain of N beads."""
    filament = of.Filament(of.shapes.line(499, 1 * NM), 4 * unit.dalton, (stretch(900),))
    limit = of.stable_timestep(of.build(filament)).value_in_unit(PS)
    assert limit == pytest.approx(1 / math.sqrt(900 / 4), rel=tol.LANCZOS)


def test_the_limit_is_taken_at_the_positions_given() -> None:
    """Pure bending of a free trimer: omega^2 grows as the segments shorten, like 1/s^2."""
    terms = (stretch(1e-3), bending.Cosine(100 * KJ))
    model = of.build(of.Filament(of.shapes.line(10, 1 * NM), 1 * unit.dalton, terms))
    limits = [of.stable_timestep(model, of.shapes.line(10, s * NM)).value_in_unit(PS) for s in (1.0, 0.5)]
    assert limits[0] == pytest.approx(2 * limits[1], rel=tol.LANCZOS)
    assert limits[0] == of.stable_timestep(model).value_in_unit(PS)


def test_replicas_have_the_limit_of_one() -> None:
    filament = MODELS["bending"][0]
    one, three = (of.stable_timestep(of.build([filament] * n)).value_in_unit(PS) for n in (1, 3))
    assert three == pytest.approx(one, rel=tol.LANCZOS)


def test_a_macroscopic_model_has_its_physical_time_step() -> None:
    """Beads of 1 g on springs of 4000 N/m, 1 cm apart: omega_max = 2 sqrt(k/m), dt = sqrt(m/k) = 0.5 ms."""
    newton_per_metre = unit.newton / unit.meter * unit.AVOGADRO_CONSTANT_NA
    gram = 1 * unit.gram
    spring = stretching.Harmonic(4000 * newton_per_metre)
    model = of.build(of.Filament(of.shapes.line(100, 1 * unit.centimeter), gram, (spring,)))
    assert not model.scale.is_identity
    limit = of.stable_timestep(model)
    assert limit.value_in_unit(unit.millisecond) == pytest.approx(0.5, rel=tol.LANCZOS)
    internal = model.to_internal(limit).value_in_unit(PS)
    assert internal == pytest.approx(2 / highest_frequency(model, model.positions.value_in_unit(NM)), rel=1e-12)
    assert growth(model, 0.95 * internal) < tol.STAYS_SMALL
    assert growth(model, 1.05 * internal) == math.inf


@pytest.mark.parametrize(
    ("terms", "loads"), [((), ()), ((stretch(1),), [Hold([0, 1, 2])])], ids=["no terms", "all beads held"]
)
def test_without_a_stiffness_there_is_no_limit(terms: Any, loads: Any) -> None:
    model = of.build(of.Filament(of.shapes.line(2, 1 * NM), 1 * unit.dalton, terms), loads)
    with pytest.raises(ValueError, match="`model` must have a free bead and a term"):
        of.stable_timestep(model)


def test_positions_of_another_shape_are_refused() -> None:
    model = of.build(MODELS["stretching"][0])
    with pytest.raises(ValueError, match=r"`positions` must have shape \(30, 3\), but has shape \(4, 3\)"):
        of.stable_timestep(model, np.zeros((4, 3)) * NM)


@pytest.mark.slow
def test_a_hundred_thousand_beads_take_seconds() -> None:
    filament = helix(stretch(500), bending.Harmonic(50 * KJ), torsion.Harmonic(20 * KJ), beads=100_000)
    model = of.build(filament)
    begun = time.perf_counter()
    large = of.stable_timestep(model).value_in_unit(PS)
    assert time.perf_counter() - begun < 120
    small = of.build(helix(stretch(500), bending.Harmonic(50 * KJ), torsion.Harmonic(20 * KJ), beads=40))
    assert large == pytest.approx(of.stable_timestep(small).value_in_unit(PS), rel=2 * tol.LANCZOS)
