"""Integrators: the scheme they run, what they leave still, and the time steps, damping and seeds they take."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import openmm as mm
import pytest
import tolerances as tol
from conftest import KJ, NM, Array, random_chain
from openmm import unit

import openmm_filament as of
from openmm_filament import bending, stretching, torsion
from openmm_filament.loads import Hold, Load, Plane, Pull
from openmm_filament.trial import energy_gain

PS = unit.picosecond
KELVIN = unit.kelvin
WARM = 298 * KELVIN
REFERENCE = mm.Platform.getPlatformByName("Reference")
TERMS = (stretching.Harmonic(200 * KJ / NM**2), bending.Harmonic(200 * KJ), torsion.Harmonic(3 * KJ))
PULL = Pull(-1, (2, -1, 3) * unit.piconewton)

INTEGRATORS: dict[str, Callable[[of.Model], Any]] = {
    "langevin": lambda model: of.langevin(model, WARM, seed=3),
    "verlet": of.verlet,
    "euler_cromer": of.euler_cromer,
}
each_integrator = pytest.mark.parametrize("make", INTEGRATORS.values(), ids=INTEGRATORS)


def helix(damping: Any = None, beads: int = 12, masses: Any = 10 * unit.dalton) -> of.Filament:
    rest = of.shapes.helix(beads - 1, radius=2 * NM, pitch=3 * NM, turns=1.3)
    return of.Filament(rest, masses, TERMS, damping=damping)


def context(
    model: of.Model, integrator: mm.Integrator, positions: Array, velocities: Array | None = None
) -> mm.Context:
    made = mm.Context(model.system, integrator, REFERENCE)
    made.setPositions(positions * NM)
    if velocities is not None:
        made.setVelocities(velocities * NM / PS)
    return made


def positions(made: mm.Context) -> Array:
    return made.getState(positions=True).getPositions(asNumpy=True).value_in_unit(NM)


def velocities(made: mm.Context) -> Array:
    return made.getState(velocities=True).getVelocities(asNumpy=True).value_in_unit(NM / PS)


def perturbed(model: of.Model, rng: np.random.Generator) -> tuple[Array, Array]:
    x = model.positions.value_in_unit(NM)
    return x + 0.05 * rng.normal(size=x.shape), 0.3 * rng.normal(size=x.shape)


def thesis_steps(
    filament: of.Filament, loads: Sequence[Load], x: Array, v: Array, dt: float, steps: int, held: Sequence[int] = ()
) -> tuple[Array, Array]:
    """`v += (F/m - gamma v) dt`, then `x += v dt`, in NumPy with the NumPy forces."""
    x, v = x.copy(), v.copy()
    masses = filament.masses.value_in_unit(unit.dalton)[:, None]
    gamma = 0.0 if filament.damping is None else filament.damping.value_in_unit(PS**-1)[:, None]
    free = np.ones((len(x), 1))
    free[list(held)] = 0
    for _ in range(steps):
        v += free * (of.reference.forces(filament, x * NM, loads) / masses - gamma * v) * dt
        x += free * v * dt
    return x, v


# The scheme ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("damping", [None, 0.3, "per bead"])
@pytest.mark.parametrize("loads", [(), (PULL,), (PULL, Hold([0, 5]))], ids=["free", "pulled", "held"])
def test_euler_cromer_is_the_scheme_of_the_thesis(damping: Any, loads: Any, rng: np.random.Generator) -> None:
    gamma = rng.uniform(0, 2, 12) if damping == "per bead" else damping
    filament = helix(None if gamma is None else gamma / PS, masses=rng.uniform(5, 20, 12) * unit.dalton)
    model = of.build(filament, loads)
    x, v = perturbed(model, rng)
    v[model.held] = 0
    integrator = of.euler_cromer(model, timestep=0.01 * PS)
    run = context(model, integrator, x, v)
    integrator.step(50)
    expected, speeds = thesis_steps(filament, loads, x, v, 0.01, 50, model.held)
    assert np.abs(expected - x).max() > 0.1  # it moved
    np.testing.assert_allclose(positions(run), expected, rtol=0, atol=tol.TRAJECTORY)
    np.testing.assert_allclose(velocities(run), speeds, rtol=0, atol=tol.TRAJECTORY * 10)


def test_damping_of_several_filaments_stays_with_its_beads(rng: np.random.Generator) -> None:
    damped, free = helix(rng.uniform(0, 2, 12) / PS), helix()
    model = of.build([free, damped])
    x, v = perturbed(model, rng)
    integrator = of.euler_cromer(model, timestep=0.01 * PS)
    run = context(model, integrator, x, v)
    integrator.step(50)
    for filament, part in ((free, slice(0, 12)), (damped, slice(12, 24))):
        expected, _ = thesis_steps(filament, (), x[part], v[part], 0.01, 50)
        np.testing.assert_allclose(positions(run)[part], expected, rtol=0, atol=tol.TRAJECTORY)


def test_a_wrong_scheme_would_be_noticed(rng: np.random.Generator) -> None:
    """Damping off by 1 % moves the beads a million times the tolerance."""
    model = of.build(helix(1.0 / PS))
    x, v = perturbed(model, rng)
    right, wrong = (thesis_steps(helix(gamma / PS), (), x, v, 0.01, 50)[0] for gamma in (1.0, 1.01))
    assert np.abs(right - wrong).max() > 1e6 * tol.TRAJECTORY


@pytest.mark.parametrize("loads", [(), (Plane(), Hold(0))], ids=["3D", "planar"])
def test_verlet_is_euler_cromer_without_damping(loads: Any, rng: np.random.Generator) -> None:
    """Where the velocities at the start mean the same: half a step before, as a leapfrog keeps them."""
    terms = TERMS[:2]
    filament = of.Filament(random_chain(rng, 10) * [1, 1, 0] * NM, 10 * unit.dalton, terms)
    model = of.build(filament, loads)
    x = model.positions.value_in_unit(NM) + 0.05 * rng.normal(size=(10, 3)) * [1, 1, 0]
    ends = []
    for make in (of.verlet, of.euler_cromer):
        integrator = make(model, timestep=0.01 * PS)
        run = context(model, integrator, x, np.zeros((10, 3)))
        integrator.step(200)
        ends.append((positions(run), velocities(run)))
    assert np.abs(ends[0][0] - x).max() > 0.05
    for mine, other in zip(*ends, strict=True):
        np.testing.assert_allclose(mine, other, rtol=0, atol=tol.TRAJECTORY * 10)


def test_verlet_keeps_the_energy(rng: np.random.Generator) -> None:
    model = of.build(helix())
    x, v = perturbed(model, rng)
    integrator = of.verlet(model)
    run = context(model, integrator, x, v)
    energies = []
    for _ in range(200):
        integrator.step(10)
        state = run.getState(energy=True)
        energies.append((state.getKineticEnergy() + state.getPotentialEnergy()).value_in_unit(KJ))
    assert np.ptp(energies) < tol.ENERGY_DRIFT * np.mean(energies)


@pytest.mark.filterwarnings("ignore:Verlet leaves out")
@each_integrator
def test_energy_is_taken_by_damping_alone(make: Callable[[of.Model], Any], rng: np.random.Generator) -> None:
    """Only `euler_cromer` reads the damping of the filaments."""
    ends = []
    for damping in (None, 1.0 / PS):
        model = of.build(helix(damping))
        x, v = perturbed(model, np.random.default_rng(0))
        integrator = make(model)
        run = context(model, integrator, x, v)
        integrator.step(100)
        ends.append(positions(run))
    assert (np.abs(ends[0] - ends[1]).max() > 0) == (make is of.euler_cromer)


# What stays still ---------------------------------------------------------------------------------------------------


@each_integrator
def test_the_third_coordinate_is_strictly_constant_in_a_plane(
    make: Callable[[of.Model], Any], rng: np.random.Generator
) -> None:
    """Even where forces out of the plane act: the beads lie at different heights."""
    filament = of.Filament(random_chain(rng, 10) * NM, 10 * unit.dalton, TERMS)
    model = of.build(filament, [Plane(), Hold(0), Pull(-1, (1, 0, 5) * unit.piconewton)])
    x = model.positions.value_in_unit(NM)
    integrator = make(model)
    run = context(model, integrator, x, 0.1 * rng.normal(size=x.shape) * [1, 1, 0])
    integrator.step(500)
    np.testing.assert_array_equal(positions(run)[:, 2], x[:, 2])
    assert np.abs(positions(run) - x)[1:, :2].max(axis=1).min() > 1e-3
    assert not velocities(run)[:, 2].any()


@pytest.mark.parametrize("make", [INTEGRATORS["verlet"], INTEGRATORS["euler_cromer"]], ids=["verlet", "euler_cromer"])
def test_velocities_out_of_the_plane_do_not_move_the_beads(make: Callable[[of.Model], Any]) -> None:
    """As a Context has them after `setVelocitiesToTemperature`."""
    model = of.build(of.Filament(of.shapes.ring(8, 1 * NM), 10 * unit.dalton, TERMS[:2]), [Plane()])
    integrator = make(model)
    run = context(model, integrator, model.positions.value_in_unit(NM), np.full((8, 3), 0.5))
    integrator.step(100)
    assert not positions(run)[:, 2].any()


def test_velocities_out_of_the_plane_do_not_move_the_beads_under_langevin() -> None:
    model = of.build(of.Filament(of.shapes.ring(8, 1 * NM), 10 * unit.dalton, TERMS[:2]), [Plane()])
    integrator = of.langevin(model, WARM, seed=1)
    run = context(model, integrator, model.positions.value_in_unit(NM))
    run.setVelocitiesToTemperature(298, 1)
    integrator.step(100)
    assert not positions(run)[:, 2].any()


@pytest.mark.filterwarnings("ignore:Verlet leaves out")
@each_integrator
@pytest.mark.parametrize("plane", [False, True])
def test_held_beads_do_not_move(make: Callable[[of.Model], Any], plane: bool, rng: np.random.Generator) -> None:
    filament = of.Filament(random_chain(rng, 9) * NM, 10 * unit.dalton, TERMS, damping=0.1 / PS)
    model = of.build(filament, [Hold([0, 4, 5]), Pull(-1, (9, 9, 9) * unit.piconewton), *([Plane()] if plane else [])])
    x = model.positions.value_in_unit(NM)
    integrator = make(model)
    run = context(model, integrator, x)
    integrator.step(300)
    moved = np.abs(positions(run) - x).max(axis=1)
    np.testing.assert_array_equal(moved == 0, np.isin(np.arange(9), [0, 4, 5]))


# Temperature --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("plane", [False, True])
def test_langevin_has_the_temperature_asked_for(plane: bool) -> None:
    """Mean square stretch of 400 free springs, `k_B T/k` but for the d - 1 directions across; seeded, |z| <= 4."""
    spring = of.Filament(
        of.shapes.ring(3, 50 * NM).in_units_of(NM)[:2], 10 * unit.dalton, (stretching.Harmonic(40 * KJ / NM**2),)
    )
    loads = [[Plane()] if plane else []] * 400
    model = of.build([spring] * 400, loads)
    integrator = of.langevin(model, WARM, friction=3 / PS, seed=5)
    run = context(model, integrator, model.positions.value_in_unit(NM))
    integrator.step(200)
    squares = []
    for _ in range(40):
        integrator.step(20)
        pairs = positions(run).reshape(-1, 2, 3)
        squares.append((np.linalg.norm(pairs[:, 1] - pairs[:, 0], axis=-1) - 50) ** 2)
    means = np.mean(squares, axis=0)  # of each spring: independent of one another
    kt = of.units.BOLTZMANN * 298
    z = (means.mean() - kt / 40) / (means.std(ddof=1) / math.sqrt(len(means)))
    assert abs(z) <= tol.SIGMAS
    assert means.std(ddof=1) / math.sqrt(len(means)) < 0.05 * kt / 40


@pytest.mark.parametrize("stiffness", [0.1, 4.0, 300.0])
def test_default_options_of_langevin_are_sane(stiffness: float) -> None:
    """The time step is a fraction of the limit; friction is that of a slow mode."""
    terms = (TERMS[0], bending.Harmonic(stiffness * KJ))
    model = of.build(of.Filament(of.shapes.line(30, 1 * NM), 10 * unit.dalton, terms), [Hold(0)])
    limit = of.stable_timestep(model).value_in_unit(PS)
    integrator = of.langevin(model, WARM)
    dt = integrator.getStepSize().value_in_unit(PS)
    assert 0.2 <= dt / limit <= 0.8
    assert integrator.getTemperature().value_in_unit(KELVIN) == pytest.approx(298)
    friction = integrator.getFriction().value_in_unit(PS**-1)
    stretching_frequency = math.sqrt(200 / 10)
    assert 1e-4 * stretching_frequency < friction < 0.1 * stretching_frequency


@each_integrator
def test_default_time_steps_are_stable_and_below_the_limit(make: Callable[[of.Model], Any]) -> None:
    model = of.build(helix())
    assert 0 < make(model).getStepSize() / of.stable_timestep(model) < 0.9


def test_given_options_are_kept_and_converted_for_a_scaled_model() -> None:
    """A chain of centimetres: internal units hold what was given physically."""
    terms = of.rod_terms(1e9 * unit.pascal, None, 1 * unit.millimeter, 1 * unit.centimeter)
    filament = of.Filament(of.shapes.line(10, 1 * unit.centimeter), 1 * unit.gram, terms)
    model = of.build(filament, [Hold(0)])
    dt = of.stable_timestep(model) / 4
    integrator = of.langevin(model, WARM, timestep=dt, friction=7 / unit.second, seed=9)
    assert model.to_physical(integrator.getStepSize(), "time") / dt == pytest.approx(1)
    assert model.to_physical(integrator.getTemperature(), "temperature") / WARM == pytest.approx(1)
    assert model.to_physical(integrator.getFriction(), "rate").value_in_unit(unit.second**-1) == pytest.approx(7)
    assert integrator.getRandomNumberSeed() == 9
    for make in (of.verlet, of.euler_cromer):
        assert model.to_physical(make(model, timestep=dt).getStepSize(), "time") / dt == pytest.approx(1)


@pytest.mark.parametrize("plane", [False, True])
def test_seeds_repeat(plane: bool) -> None:
    model = of.build(helix(), [Plane()] if plane else [])
    ends = []
    for seed in (7, 7, 8):
        integrator = of.langevin(model, WARM, seed=seed)
        run = context(model, integrator, model.positions.value_in_unit(NM))
        integrator.step(50)
        ends.append(positions(run))
        del run
    np.testing.assert_array_equal(ends[0], ends[1])
    assert np.abs(ends[0] - ends[2]).max() > 1e-3


# Trials -------------------------------------------------------------------------------------------------------------


def pulled(piconewton: float, bending_energy: float, torsion_energy: float, kind: Any = torsion.Harmonic) -> of.Model:
    """The README's helix under a dihedral, one end held."""
    terms = (stretching.Harmonic(500 * KJ / NM**2), bending.Harmonic(bending_energy * KJ), kind(torsion_energy * KJ))
    rest = of.shapes.helix(40, radius=3 * NM, pitch=5 * NM, turns=4)
    chain = of.Filament(rest, 300 * unit.dalton, terms)
    return of.build(chain, [Hold(0), Pull(-1, (0, 0, piconewton) * unit.piconewton)])


@pytest.mark.parametrize("case", [(30, 200, 100), (60, 200, 100), (500, 2000, 2000)])
def test_a_helix_whose_joints_line_up_is_warned_of(case: tuple[float, ...]) -> None:
    """Long runs of these heat up to 1e5 K."""
    model = pulled(*case)
    steps = (None, 0.2 * of.stable_timestep(model))  # the second is short enough for a second's trial at 30 pN
    for timestep in steps[: 1 if case[0] == 30 else 2]:
        with pytest.warns(
            UserWarning, match=r"the energy rose to .* no time step is short enough .* torsion\.Weighted"
        ):
            of.langevin(model, 300 * KELVIN, timestep=timestep)


def test_a_helix_of_soft_joints_is_warned_of() -> None:
    """Its joints come into line unpulled; at 298 K its mean kinetic temperature was 750 K in 8e5 steps."""
    terms = (TERMS[0], bending.Harmonic(20 * KJ), TERMS[2])
    chain = of.Filament(helix().rest, 10 * unit.dalton, terms)
    with pytest.warns(UserWarning, match="the energy rose to"):
        of.langevin(of.build(chain), WARM)


@pytest.mark.parametrize(
    "case", [(1, 200, 100), (5, 200, 100), (10, 2000, 2000), (100, 2000, 2000), (60, 200, 100, torsion.Weighted)]
)
def test_one_that_keeps_its_temperature_is_not(case: Any) -> None:
    """Warnings are errors here."""
    of.langevin(pulled(*case), 300 * KELVIN)


def test_a_trial_does_not_disturb_a_run_in_progress() -> None:
    """On Reference all Contexts of a process share one random stream."""
    model = of.build(helix())
    ends = []
    for tried in (True, False):
        integrator = of.langevin(model, WARM, seed=4)
        run = context(model, integrator, model.positions.value_in_unit(NM))
        integrator.step(50)
        if tried:
            energy_gain(model, 298, 0.02)
        integrator.step(50)
        ends.append(positions(run))
        del run
    np.testing.assert_array_equal(*ends)


# Refused ------------------------------------------------------------------------------------------------------------


MAKERS = {
    "langevin": lambda model, **options: of.langevin(model, WARM, **options),
    "verlet": of.verlet,
    "euler_cromer": of.euler_cromer,
}


@pytest.mark.filterwarnings("ignore:In a trial")  # rightly: 0.999 of the limit is too long for a torsion
@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
def test_a_time_step_above_the_limit_is_refused(make: Callable[..., Any]) -> None:
    model = of.build(helix())
    limit = of.stable_timestep(model)
    assert make(model, timestep=0.999 * limit).getStepSize() / limit == pytest.approx(0.999)
    with pytest.raises(
        ValueError, match=r"`timestep` must be at most the stability limit of \S+ ps, but is \S+ ps\."
    ) as caught:
        make(model, timestep=1.01 * limit)
    said = [
        float(word)
        for word in str(caught.value).replace(" ps", "").rstrip(".").replace(",", "").split()
        if word[0].isdigit()
    ]
    np.testing.assert_allclose(said, [limit.value_in_unit(PS), 1.01 * limit.value_in_unit(PS)], rtol=1e-5)


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
@pytest.mark.parametrize(
    ("timestep", "error", "message"),
    [
        (0 * PS, ValueError, r"`timestep` must be positive, but is 0\.0"),
        (-1e-3 * PS, ValueError, "`timestep` must be positive, but is -"),
        (math.nan * PS, ValueError, "`timestep` must be finite, but is nan"),
        (0.001, TypeError, "`timestep` must be a Quantity of time"),
        (1 * NM, TypeError, "`timestep` must have a unit of time"),
    ],
)
def test_bad_time_steps_are_refused(
    make: Callable[..., Any], timestep: Any, error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        make(of.build(helix()), timestep=timestep)


def test_damping_too_large_for_the_step_is_refused() -> None:
    gamma = np.full(12, 0.1)
    gamma[7] = 250.0
    model = of.build(helix(gamma / PS))
    with pytest.raises(ValueError, match=r"`damping` must keep 2 gamma dt below .* bead 7 has 2 gamma dt = 5"):
        of.euler_cromer(model, timestep=0.01 * PS)
    of.euler_cromer(model, timestep=0.007 * PS)


@pytest.mark.parametrize("damping", [1.9, 30.0])
def test_a_damping_that_is_accepted_does_not_blow_up(damping: float, rng: np.random.Generator) -> None:
    """At the time step chosen by default, from a small push."""
    model = of.build(helix(damping / PS))
    try:
        integrator = of.euler_cromer(model)
    except ValueError:
        return
    x = model.positions.value_in_unit(NM)
    run = context(model, integrator, x + 1e-3 * rng.normal(size=x.shape))
    integrator.step(2000)
    assert np.abs(positions(run) - x).max() < 0.1


def test_a_damped_step_beyond_its_limit_is_refused() -> None:
    """With damping Euler-Cromer is stable for `omega^2 dt^2 < 4 - 2 gamma dt`, which is shorter than 2/omega."""
    undamped = of.stable_timestep(of.build(helix()))
    gamma = 1 / undamped  # gamma dt = 0.9 there: omega^2 dt^2 = 3.24 > 4 - 1.8
    model = of.build(helix(gamma))
    with pytest.raises(ValueError, match=r"time ?step|damping"):
        of.euler_cromer(model, timestep=0.9 * undamped)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"temperature": 0 * KELVIN}, ValueError, r"`temperature` must be positive, but is 0\.0"),
        ({"temperature": 298}, TypeError, "`temperature` must be a Quantity of temperature"),
        ({"friction": 0 / PS}, ValueError, r"`friction` must be positive, but is 0\.0"),
        ({"friction": 1 * PS}, TypeError, "`friction` must have a unit of rate"),
        ({"seed": 0}, ValueError, "`seed` must be at least 1, but is 0"),
        ({"seed": 1.5}, TypeError, r"`seed` must be a whole number, but is 1\.5"),
        ({"seed": 2**31}, ValueError, "`seed` must be at most 2147483647, but is 2147483648"),
    ],
)
def test_bad_langevin_options_are_refused(options: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        of.langevin(of.build(helix()), **{"temperature": WARM, **options})


def test_verlet_says_that_it_leaves_out_damping() -> None:
    terms = (of.stretching.Harmonic(1 * KJ / NM**2),)
    model = of.build(of.Filament(of.shapes.line(2, 1 * NM), 1 * unit.dalton, terms, damping=1 / unit.picosecond))
    with pytest.warns(UserWarning, match="Verlet leaves out the filaments' damping"):
        of.verlet(model, timestep=1 * unit.femtosecond)
