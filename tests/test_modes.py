"""The Hessian against differences of OpenMM's forces; normal modes against closed forms and against what a run does."""

from __future__ import annotations

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
from openmm_filament.hessian import hessian
from openmm_filament.loads import Hold, Plane, Tension

REFERENCE = mm.Platform.getPlatformByName("Reference")
TERMS: tuple[Any, ...] = (
    stretching.Harmonic(500 * KJ / NM**2),
    bending.Harmonic(200 * KJ),
    bending.Cosine(200 * KJ),
    bending.Harmonic(200 * KJ, form="arctangent"),
    torsion.Harmonic(100 * KJ),
    torsion.Periodic(100 * KJ, 3),
    torsion.Weighted(100 * KJ),
    electrostatics.Neighbour(np.array([1.0, -1, 2, 1, 1, -3, 1, 1]) * unit.elementary_charge),
)

# A string of steel: 0.71 m, 20 N, 1.55e-3 kg/m, radius 0.25 mm, in SI units.
LENGTH, TENSION, DENSITY = 0.71, 20.0, 1.55e-3
STRETCHING, BENDING = 190e9 * np.pi * 0.25e-3**2, 190e9 * np.pi * 0.25e-3**4 / 4  # E S in N and E I in N m^2


def string(
    segments: int, *, bent: bool = True, loads: Sequence[Any] = (), along_x: bool = False, **more: Any
) -> of.Model:
    a = LENGTH / segments
    rest = of.shapes.line(segments, a * unit.meter)
    terms: tuple[Any, ...] = (stretching.Harmonic(STRETCHING / a * unit.newton / unit.meter),)
    if bent:
        terms += (bending.Harmonic(BENDING / a * unit.joule),)
    if along_x:
        rest = rest[:, ::-1]
    chain = of.Filament(rest, more.pop("masses", DENSITY * a) * unit.kilogram, terms, **more)
    return of.build(chain, [Hold([0, -1]), Tension(TENSION * unit.newton), *loads])


def transverse(segments: int, n: Array) -> Array:
    """Frequencies in Hz of the discrete stiff string with hinged ends."""
    a = LENGTH / segments
    mass, half = DENSITY * a, n * np.pi / segments / 2
    squared = 4 * TENSION / (mass * a) * np.sin(half) ** 2 + 16 * BENDING / a / (mass * a**2) * np.sin(half) ** 4
    return np.asarray(np.sqrt(squared) / (2 * np.pi))


def longitudinal(segments: int, n: Array) -> Array:
    a = LENGTH / segments
    return np.asarray(np.sqrt(STRETCHING / a / (DENSITY * a)) * np.sin(n * np.pi / segments / 2) / np.pi)


@pytest.mark.parametrize("term", TERMS, ids=lambda t: f"{t.family}.{type(t).__name__}")
@pytest.mark.parametrize("closed", [False, True])
def test_the_hessian_is_the_difference_of_openmm_forces(term: Any, closed: bool) -> None:
    rng = np.random.default_rng(2)
    model = of.build(of.Filament(random_chain(rng, 8) * NM, 1 * unit.dalton, (term,), closed=closed))
    x = random_chain(rng, 8)
    context = mm.Context(model.system, mm.VerletIntegrator(1e-6), REFERENCE)

    def forces(moved: Array) -> Array:
        context.setPositions(moved * NM)
        found = context.getState(forces=True).getForces(asNumpy=True).value_in_unit(KJ / NM)
        return np.asarray(found).ravel()

    step = 1e-5 * np.eye(24).reshape(24, 8, 3)
    expected = np.array([-(forces(x + d) - forces(x - d)) / 2e-5 for d in step])
    found = hessian(model, x).toarray()
    np.testing.assert_allclose(found, expected, rtol=0, atol=tol.HESSIAN * np.abs(expected).max())
    np.testing.assert_allclose(found.reshape(24, 8, 3).sum(1), 0, atol=1e-11 * np.abs(found).max())
    broken = of.build(of.Filament(model.filaments[0].rest, 1 * unit.dalton, (stretching.Harmonic(505 * KJ / NM**2),)))
    if term is TERMS[0] and not closed:
        assert np.abs(hessian(broken, x).toarray() - expected).max() > 1e-3 * np.abs(expected).max()


@pytest.mark.parametrize("segments", [2, 5, 60])
def test_a_stiff_string_has_the_lines_of_the_closed_form(segments: int) -> None:
    modes = of.normal_modes(string(segments))
    n = np.arange(1, segments)
    expected = np.sort(np.concatenate([np.repeat(transverse(segments, n), 2), longitudinal(segments, n)]))
    np.testing.assert_allclose(modes.frequencies, expected, rtol=tol.MODES)
    assert modes.shapes.shape == (3 * (segments - 1), segments + 1, 3)


def test_shapes_of_a_string_are_sines_orthogonal_in_the_masses() -> None:
    masses = DENSITY * LENGTH / 30 * np.where(np.arange(31) == 15, 40.0, 1.0)
    planar = string(30, along_x=True, loads=[Plane()])
    lowest = of.normal_modes(planar, 3)
    np.testing.assert_allclose(lowest.frequencies, transverse(30, np.arange(1, 4)), rtol=tol.MODES)
    for n, shape in enumerate(lowest.shapes, 1):
        sine = np.sin(n * np.pi * np.arange(31) / 30)
        np.testing.assert_allclose(np.abs(shape[:, 1]), np.abs(sine) / np.abs(sine).max(), atol=1e-6)
        assert np.abs(shape).max() == 1
        assert not shape[:, 2].any()
    loaded = of.normal_modes(string(30, masses=masses)).shapes
    overlap = np.einsum("kia,i,lia->kl", loaded, masses, loaded)
    overlap /= np.sqrt(np.outer(np.diag(overlap), np.diag(overlap)))
    np.testing.assert_allclose(overlap, np.eye(len(overlap)), atol=1e-9)


def test_a_long_chain_has_the_same_modes_by_iteration() -> None:
    segments = 700  # 2097 free coordinates: above the size that is diagonalised whole
    low, high = of.normal_modes(string(segments), 6), of.normal_modes(string(segments), 3, highest=True)
    n = np.repeat(np.arange(1, 4), 2)
    np.testing.assert_allclose(low.frequencies, transverse(segments, n), rtol=tol.MODES_LONG)
    np.testing.assert_allclose(high.frequencies, longitudinal(segments, segments - np.arange(3, 0, -1)), rtol=1e-12)
    sine = np.sin(np.pi * np.arange(segments + 1) / segments)
    np.testing.assert_allclose(np.abs(high.shapes[-1, :, 2]), sine, atol=1e-6)
    with pytest.raises(ValueError, match=r"`count` must be at most 524 for a chain of 2097 free coordinates"):
        of.normal_modes(string(segments))


def test_a_free_bar_moves_rigidly_and_rings_as_euler_and_bernoulli_say() -> None:
    deviations = []
    for segments in (40, 80):
        a = LENGTH / segments
        mass = np.full(segments + 1, DENSITY * a)
        mass[[0, -1]] /= 2
        terms = (
            stretching.Harmonic(STRETCHING / a * unit.newton / unit.meter),
            bending.Harmonic(BENDING / a * unit.joule),
        )
        bar = of.build(of.Filament(of.shapes.line(segments, a * unit.meter), mass * unit.kilogram, terms))
        found = of.normal_modes(bar, 9).frequencies
        assert np.abs(found[:5]).max() < 1e-3 * found[5]
        np.testing.assert_allclose(found[5:7], found[5], rtol=1e-6)  # either way across
        exact = 4.7300407448627040**2 / (2 * np.pi * LENGTH**2) * np.sqrt(BENDING / DENSITY)
        deviations.append(abs(found[5] / exact - 1))
    assert deviations[1] < 2e-3
    assert 3 < deviations[0] / deviations[1] < 5  # second order in the segment length


def arc(bend: float, *more: Any, count: int = 8, loads: Sequence[Any] = ()) -> of.Model:
    """A chain whose joints rest bent in the xz plane."""
    heading = bend * np.arange(count)
    steps = 4 * np.stack([np.sin(heading), 0 * heading, np.cos(heading)], axis=-1)
    rest = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])[:, [0, 2, 1]]
    terms = (stretching.Harmonic(500 * KJ / NM**2), bending.Harmonic(200 * KJ), *more)
    return of.build(of.Filament(rest * NM, 100 * unit.dalton, terms), loads)


@pytest.mark.parametrize("bend", [1e-4, 0.05])
def test_joints_that_rest_slightly_bent_are_soft_out_of_their_plane_and_told_of(bend: float) -> None:
    """A straight chain's bending modes come in pairs; of a bent one's, the six out of the plane have no stiffness."""
    straight = of.normal_modes(arc(0.0)).frequencies
    assert (np.abs(straight) < 1e-6 * straight.max()).sum() == 5
    np.testing.assert_allclose(straight[5:9:2], straight[6:10:2], rtol=1e-6)
    told = rf"7 joints rest bent, by at most {bend:g} rad, and no torsion holds them"
    with pytest.warns(UserWarning, match=told):
        found = of.normal_modes(arc(bend)).frequencies
    assert (np.abs(found) < 1e-6 * found.max()).sum() == 6 + 6
    with pytest.warns(UserWarning, match=told):
        assert (of.damped_modes(arc(bend)).frequencies == 0).sum() >= 12
    assert of.stable_timestep(arc(bend)) / of.stable_timestep(arc(0.0)) == pytest.approx(1, rel=0.02)


def test_bent_joints_that_are_held_are_not_told_of() -> None:
    for model in (
        arc(0.05, torsion.Weighted(200 * KJ)),
        arc(0.05, torsion.Harmonic(200 * KJ)),
        arc(0.05, bending.Cosine(1 * KJ)),
        arc(0.05, loads=[Plane()]),
        arc(0.05, count=2),
        arc(0.4),  # nobody takes that for straight
    ):
        of.normal_modes(model)


def test_a_direction_in_which_the_energy_falls_has_a_negative_frequency() -> None:
    rest = np.array([[0, 0, 0], [0, 0, 1.0], [0, 0, 2.0]])
    compressed = of.Filament(rest * NM, 1 * unit.dalton, (stretching.Harmonic(100 * KJ / NM**2, 1.1 * NM),))
    found = of.normal_modes(of.build(compressed, [Hold([0, -1])])).frequencies
    # transverse stiffness 2 k (b - b0)/b = -20, longitudinal 2 k = 200, in kJ/mol/nm^2
    np.testing.assert_allclose(
        found, 1e12 / (2 * np.pi) * np.array([-np.sqrt(20), -np.sqrt(20), np.sqrt(200)]), rtol=1e-9
    )


def test_a_run_started_in_a_mode_stays_in_it_at_its_frequency() -> None:
    model = string(12)
    modes = of.normal_modes(model)
    small = 1e-5 * LENGTH * 1e9  # nm; OpenMM's bending force is lost below 1e-6 rad
    for k in (0, 7, 15):
        integrator = of.verlet(model)
        context = mm.Context(model.system, integrator, REFERENCE)
        context.setPositions(model.to_internal((model.filaments[0].rest._value + small * modes.shapes[k]) * NM))
        dt = model.to_physical(integrator.getStepSize(), "time").value_in_unit(unit.second)
        # leapfrog shows 2 arcsin(w dt/2) a step; from three samples, since it starts half a step after rest
        every = round(1 / (2 * np.pi * modes.frequencies[k] * dt))
        motion = of.record(model, context, 100, every, observe=lambda x: x - model.filaments[0].rest._value)
        amplitude = np.einsum("tia,ia->t", motion.values, modes.shapes[k])
        cosine = (amplitude[2:] + amplitude[:-2]) @ amplitude[1:-1] / (2 * amplitude[1:-1] @ amplitude[1:-1])
        expected = every * 2 * np.arcsin(np.pi * modes.frequencies[k] * dt)
        assert np.arccos(cosine) == pytest.approx(expected, rel=tol.SMALL_MOTION)
        out = motion.values - amplitude[:, None, None] * modes.shapes[k] / np.sum(modes.shapes[k] ** 2)
        assert np.abs(out).max() < 1e-3 * small


def test_uniform_damping_moves_every_line_as_that_of_an_oscillator() -> None:
    free, damped = string(15), of.damped_modes(string(15, damping=300 / unit.second))
    bare = of.normal_modes(free).frequencies
    np.testing.assert_allclose(damped.decay_rates, 150.0, rtol=1e-6)
    np.testing.assert_allclose(damped.frequencies, np.sqrt(bare**2 - (150 / (2 * np.pi)) ** 2), rtol=1e-8)


def test_damping_of_single_beads_decays_as_a_run_does() -> None:
    rates = np.where(np.arange(16) % 5 == 3, 900.0, 20.0)
    model = string(15, damping=rates / unit.second)
    modes = of.damped_modes(model)
    k = 0
    integrator = of.euler_cromer(model)
    context = mm.Context(model.system, integrator, REFERENCE)
    shape = modes.shapes[k]
    rest = model.filaments[0].rest._value
    small = 1e-6 * LENGTH * 1e9
    rate = -modes.decay_rates[k] + 2j * np.pi * modes.frequencies[k]
    dt = model.to_physical(integrator.getStepSize(), "time").value_in_unit(unit.second)
    context.setPositions(model.to_internal((rest + small * shape.real) * NM))
    velocity = small * (shape * rate).real * 1e-12  # nm/ps
    context.setVelocities(model.to_internal(velocity * NM / unit.picosecond))
    steps = round(1 / modes.frequencies[k] / dt)
    end = of.record(model, context, 2, steps, observe=lambda x: x - rest).values[-1]
    expected = small * (shape * np.exp(rate * 2 * steps * dt)).real
    np.testing.assert_allclose(end, expected, atol=tol.DAMPED_RUN * small)
    assert not np.allclose(modes.decay_rates, modes.decay_rates[0], rtol=0.05)


def test_a_chain_too_long_for_its_rounding_is_warned_of() -> None:
    with pytest.warns(UserWarning, match="lowest modes of this chain .* where rounding leaves few digits"):
        of.normal_modes(string(20_000), 2)


def test_the_lowest_damped_modes_are_the_first_of_all() -> None:
    model = string(15, damping=300 / unit.second)
    few, whole = of.damped_modes(model, 4), of.damped_modes(model)
    np.testing.assert_array_equal(few.frequencies, whole.frequencies[:4])
    np.testing.assert_array_equal(few.shapes, whole.shapes[:4])
    with pytest.raises(ValueError, match="`count` must be .*, but is 0"):
        of.damped_modes(model, 0)


def test_rigid_motions_are_damped_modes_without_frequency_and_decay() -> None:
    bar = of.Filament(
        of.shapes.line(4, 1 * NM), 1 * unit.dalton, (stretching.Harmonic(9 * KJ / NM**2), bending.Harmonic(5 * KJ))
    )
    model = of.build(bar)
    modes = of.damped_modes(model)
    assert len(modes.frequencies) == 15
    np.testing.assert_array_equal(modes.frequencies[:5], 0)
    np.testing.assert_array_equal(modes.decay_rates[:5], 0)
    np.testing.assert_allclose(modes.frequencies[5:], of.normal_modes(model).frequencies[5:], rtol=1e-9)


def test_what_has_no_modes_is_refused() -> None:
    pair = of.Filament(of.shapes.line(1, 1 * NM), 1 * unit.dalton, (stretching.Harmonic(1 * KJ / NM**2),))
    with pytest.raises(ValueError, match="`model` must have a free bead to have modes"):
        of.normal_modes(of.build(pair, [Hold([0, 1])]))
    for bad in (0, 7):
        with pytest.raises(ValueError, match="`count` must be at (least 1|most 6), but is"):
            of.normal_modes(of.build(pair), bad)
    with pytest.raises(ValueError, match="`model` must have at most 750 free coordinates"):
        of.damped_modes(string(260))
