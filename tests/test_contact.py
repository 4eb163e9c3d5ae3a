"""Contact: forces by two routes, exact collisions and exact thermal chains, and filaments that do not pass through others."""

from __future__ import annotations

import itertools
import time
import warnings

import numpy as np
import openmm as mm
import pytest
import tolerances as tol
from conftest import KJ, NM, Array, random_chain
from openmm import unit
from scipy import integrate

import openmm_filament as of
from openmm_filament import bending, contact, passage, stretching
from openmm_filament.falling import energy_of_falling
from openmm_filament.inspection import PreflightError, PreflightWarning

CPU = {"Threads": "1"}
KELVIN = unit.kelvin
STIFF = KJ / NM**2


def crowd(rng: np.random.Generator, beads: int, *, alike: bool = True, closed: bool = False) -> of.Filament:
    """A random chain with nothing but contact; its beads of one size, or each of its own."""
    shape = None if alike else beads
    d, k = (2.0, 70.0) if alike else (rng.uniform(1, 3, shape), rng.uniform(10, 100, shape))
    return of.Filament(
        random_chain(rng, beads) * NM, 1 * unit.dalton, (contact.Repulsion(d * NM, k * STIFF),), None, closed
    )


def rod(beads: int, spacing: float, axis: Array, middle: Array, *, bend: float = 50.0, k: float = 100.0) -> of.Filament:
    """A straight filament of beads of diameter 1 nm."""
    x = np.outer(np.arange(beads) - (beads - 1) / 2, axis) * spacing + middle
    terms = (stretching.Harmonic(100 * STIFF), bending.Harmonic(bend * KJ), contact.Repulsion(1 * NM, k * STIFF))
    return of.Filament(x * NM, 1 * unit.dalton, terms)


def crossed(
    spacing: float, *, beads: int = 16, apart: float = 1.4, bend: float = 50.0, shift: float = 0.0
) -> list[of.Filament]:
    """Two rods at a right angle, one above the other, crossing at the middle or `shift` spacings from there."""
    x, y = np.eye(3)[:2]
    along = shift * spacing
    return [
        rod(beads, spacing, x, np.array([along, 0, -apart / 2]), bend=bend),
        rod(beads, spacing, y, np.array([0, along, apart / 2]), bend=bend),
    ]


def by_definition(filaments: list[of.Filament], x: Array) -> tuple[float, Array]:
    """Energy and forces by a loop over all pairs of beads, contour lengths summed bond by bond."""
    whose = np.concatenate([np.full(len(f), n) for n, f in enumerate(filaments)])
    starts = np.cumsum([0, *(len(f) for f in filaments)])
    energy, forces = 0.0, np.zeros_like(x)
    numbers = [f.interactions()[-1].parameters if f.terms else None for f in filaments]
    for i, j in itertools.combinations(range(len(x)), 2):
        a, b = whose[i], whose[j]
        if numbers[a] is None or numbers[b] is None:
            continue
        p, q = ({n: v[m - starts[w]] for n, v in numbers[w].items()} for m, w in ((i, a), (j, b)))
        d, k = (p["d"] + q["d"]) / 2, 2 / (1 / p["k"] + 1 / q["k"])
        if a == b:
            rest = filaments[a].rest._value
            ring = [np.linalg.norm(rest[(n + 1) % len(rest)] - rest[n]) for n in range(len(rest))]
            first, last = i - starts[a], j - starts[a]
            ways = [sum(ring[first:last])]
            bonds = [last - first]
            if filaments[a].closed:
                ways.append(sum(ring) - ways[0])
                bonds.append(len(rest) - bonds[0])
            if min(ways) <= np.pi / 2 * d or min(bonds) == 1:
                continue
        r = np.linalg.norm(x[j] - x[i])
        if r < d:
            energy += k / 2 * (d - r) ** 2
            push = k * (d - r) * (x[j] - x[i]) / r
            forces[j] += push
            forces[i] -= push
    return energy, forces


@pytest.mark.parametrize("alike", [True, False])
@pytest.mark.parametrize("platform", ["Reference", "CPU"])
def test_openmm_numpy_and_the_definition_agree(alike: bool, platform: str) -> None:
    rng = np.random.default_rng(7)
    several = 0
    for _ in range(12):
        filaments = [crowd(rng, int(rng.integers(1, 14)), alike=alike) for _ in range(3)]
        filaments.append(crowd(rng, 9, alike=alike, closed=True))
        if not alike:
            filaments.append(of.Filament(random_chain(rng, 4) * NM, 1 * unit.dalton, ()))
        model = of.build(filaments)
        x = model.positions._value * 0.4 + rng.normal(scale=0.3, size=model.positions._value.shape)
        energy, forces = by_definition(filaments, x)
        several += energy > 0
        (interaction,) = model.interactions
        assert interaction.energy(x) == pytest.approx(energy, rel=tol.ROUNDING)
        np.testing.assert_allclose(interaction.forces(x), forces, atol=tol.ROUNDING * (1 + np.abs(forces).max()))
        name = mm.Platform.getPlatformByName(platform)
        relative = tol.OPENMM_FORCES if platform == "Reference" else tol.CONTACT_SINGLE
        found = of.forces(model, x * NM, platform=name)
        np.testing.assert_allclose(found, forces, atol=relative * (1 + np.abs(forces).max()))
        assert of.energies(model, x * NM, platform=name)["contact"] == pytest.approx(energy, rel=relative)
    assert several > 9


def test_forces_are_the_gradient_and_the_hessian_its_slope() -> None:
    rng = np.random.default_rng(3)
    model = of.build([crowd(rng, 12), crowd(rng, 9)])
    (interaction,) = model.interactions
    x = model.positions._value * 0.5
    step = rng.normal(size=x.shape)
    h = 1e-5
    slope = (interaction.energy(x + h * step) - interaction.energy(x - h * step)) / (2 * h)
    assert -np.sum(interaction.forces(x) * step) == pytest.approx(slope, rel=tol.HESSIAN)
    turned = (interaction.forces(x - h * step) - interaction.forces(x + h * step)) / (2 * h)
    exact = (of.hessian.hessian(model, x) @ step.ravel()).reshape(x.shape)
    np.testing.assert_allclose(turned, exact, atol=tol.HESSIAN * np.abs(exact).max())


def test_a_filament_alone_repels_itself_in_the_reference_too() -> None:
    filament = crowd(np.random.default_rng(5), 20)
    x = filament.rest._value * 0.4
    energy, forces = by_definition([filament], x)
    assert energy > 0
    assert of.reference.energies(filament, x * NM) == {"contact": pytest.approx(energy)}
    np.testing.assert_allclose(of.reference.forces(filament, x * NM), forces, atol=tol.ROUNDING * np.abs(forces).max())


def test_several_filaments_and_their_loads_in_the_reference() -> None:
    pair = crossed(0.5, apart=0.8)
    trap, pull = of.loads.Trap(0, 5 * STIFF, (0, 0, 1) * NM), of.loads.Pull(3, (1, 2, 3) * KJ / NM)
    loads = [[of.loads.Hold(-1), trap], [pull]]
    model = of.build(pair, loads)
    assert of.reference.energies(pair, model.positions, loads) == pytest.approx(
        of.energies(model), rel=tol.OPENMM_ENERGIES
    )
    exact = of.reference.forces(pair, model.positions, loads)
    np.testing.assert_allclose(of.forces(model)[:15], exact[:15], atol=tol.OPENMM_FORCES * np.abs(exact).max())
    np.testing.assert_allclose(of.forces(model)[16:], exact[16:], atol=tol.OPENMM_FORCES * np.abs(exact).max())


def test_rods_in_contact_have_the_diameter_of_their_section() -> None:
    terms = of.rod_terms(
        1e9 * unit.pascal, 4e8 * unit.pascal, 0.5 * unit.millimeter, 0.7 * unit.millimeter, contact=True
    )
    stretch, _, twist, touch = terms
    assert isinstance(twist, of.torsion.Harmonic)
    assert touch.diameter.value_in_unit(unit.millimeter) == pytest.approx(1.0)
    assert touch.stiffness is not None
    assert touch.stiffness.value_in_unit(stretch.stiffness.unit) == pytest.approx(stretch.stiffness._value)


def test_the_same_in_metres() -> None:
    """A scaled model: energies and forces come back in physical units."""
    nano, macro = (
        of.Filament(
            np.array([[0, 0, 0], [1.0, 0, 0], [1.5, 1, 0], [0.7, 1.2, 0.3], [0.3, 0.5, 0.4]]) * length,
            1 * unit.dalton,
            (stretching.Harmonic(100 * KJ / length**2), contact.Repulsion(0.9 * length, 50 * KJ / length**2)),
        )
        for length in (NM, 1e6 * NM)
    )
    assert of.build(nano).scale.is_identity
    assert not of.build(macro).scale.is_identity
    assert of.energies(of.build(macro)) == pytest.approx(of.energies(of.build(nano)), rel=tol.SI)
    assert of.energies(of.build(macro))["contact"] > 0.5


def test_two_beads_collide_as_a_spring_between_them_says() -> None:
    """In touch for half a period of their spring, and off again with the speed they came with."""
    lone = [
        of.Filament([[x, 0, 0]] * NM, 2 * unit.dalton, (contact.Repulsion(1 * NM, 50 * STIFF),)) for x in (0.0, 1.0)
    ]
    model = of.build(lone)
    integrator = of.verlet(model, timestep=0.0005 * unit.picosecond)
    context = mm.Context(model.system, integrator, mm.Platform.getPlatformByName("Reference"))
    context.setPositions(model.positions)
    context.setVelocities(np.array([[1.0, 0, 0], [-1.0, 0, 0]]))
    distances = []
    for _ in range(2000):
        integrator.step(1)
        x = context.getState(positions=True).getPositions(asNumpy=True)._value
        distances.append(x[1, 0] - x[0, 0])
    inside = np.array(distances) < 1
    rate = np.sqrt(50 / 1.0)  # the reduced mass is 1
    assert inside.sum() * 0.0005 == pytest.approx(np.pi / rate, abs=0.001)
    assert 1 - min(distances) == pytest.approx(2 / rate, rel=tol.COLLISION)
    velocities = context.getState(velocities=True).getVelocities(asNumpy=True)._value
    np.testing.assert_allclose(velocities, [[-1, 0, 0], [1, 0, 0]], atol=tol.COLLISION)


def elbow(corner: Array, k: float) -> of.Filament:
    """Two stiff bonds of 0.9 nm, free to turn, whose ends repel below 1 nm."""
    x = corner + np.array([[0, 0, 0], [0, 0, 0.9], [0, 0.9, 0.9]])
    terms = (stretching.Harmonic(5e3 * STIFF), contact.Repulsion(1 * NM, k * STIFF))
    return of.Filament(x * NM, 1 * unit.dalton, terms)


def test_extension_of_elbows_in_contact() -> None:
    """Against the exact average over the angle between the bonds, the whole turned at random under the force."""
    force, kt, k = 4.0, of.units.BOLTZMANN * 300, 200.0
    b = 0.9 + 2 * kt / (5e3 * 0.9)  # the mean length of a stiff bond

    def log_sum(f: float, k: float) -> float:
        def weight(cosine: float) -> float:
            r = b * np.sqrt(2 + 2 * cosine)
            return float(np.exp(-k / 2 * max(1 - r, 0) ** 2 / kt) * np.sinh(f * r / kt) / (f * r / kt))

        return float(np.log(integrate.quad(weight, -1, 1, limit=200)[0]))

    exact, free = (kt * (log_sum(force + 1e-4, k) - log_sum(force - 1e-4, k)) / 2e-4 for k in (k, 0.0))
    side = 6
    corners = 6.0 * np.stack(np.meshgrid(*[np.arange(side)] * 3), axis=-1).reshape(-1, 3)
    loads = [of.loads.Hold(0), of.loads.Pull(-1, (0, 0, force) * KJ / NM)]
    model = of.build([elbow(corner, k) for corner in corners], [loads] * len(corners))
    integrator = of.langevin(model, temperature=300 * KELVIN, seed=5, friction=2 / unit.picosecond)
    context = mm.Context(model.system, integrator, mm.Platform.getPlatformByName("CPU"), CPU)
    context.setPositions(model.positions)
    integrator.step(1500)
    ends = []
    for _ in range(30):
        integrator.step(150)
        x = context.getState(positions=True).getPositions(asNumpy=True)._value.reshape(-1, 3, 3)
        ends.append(x[:, 2, 2] - x[:, 0, 2])
    each = np.mean(ends, axis=0)  # by elbow: independent of one another
    found, error = each.mean(), each.std(ddof=1) / np.sqrt(len(each))
    assert abs(found - exact) < tol.SIGMAS * error
    assert abs(free - exact) > 2 * tol.SIGMAS * error  # contact matters here


def test_barrier_against_the_closed_forms() -> None:
    """Mid-bond crossings of chains as far apart as they are thick: four pairs, and two bonds that give way."""
    hard = 4 * 0.5 * (1 - np.sqrt(0.5)) ** 2
    assert passage.crossing_energy(1.0, 1.0, 1.0, 1e9) == pytest.approx(hard, rel=1e-6)
    # minimum over the length l of 2 k (d - l/sqrt2)^2 + k_s (l - d)^2
    for k_s in (0.3, 1.0, 20.0):
        length = (2 * np.sqrt(2) + 2 * k_s) / (2 + 2 * k_s)
        soft = 2 * (1 - length / np.sqrt(2)) ** 2 + k_s * (length - 1) ** 2
        assert passage.crossing_energy(1.0, 1.0, 1.0, k_s) == pytest.approx(soft, rel=1e-5)
    assert passage.crossing_energy(3.0, 3.0, 2.0, 2.0) == pytest.approx(
        18 * passage.crossing_energy(1.0, 1.0, 1.0, 1.0)
    )


def test_barrier_is_the_lowest_of_any_crossing() -> None:
    """Straight chains laid through one another at random places and angles hold no less, whichever way they open."""
    rng = np.random.default_rng(11)
    for spacing in (0.5, 0.8, 1.1):
        model = of.build(crossed(spacing))
        least = of.barrier(model).energy._value
        contacts = next(i for i in model.interactions if i.term.family == "contact")
        bonds = next(i for i in model.interactions if i.term.family == "stretching")
        for _ in range(300):
            p, q, angle, gap = [*rng.uniform(-0.5, 0.5, 2).tolist(), rng.uniform(0.3, np.pi - 0.3), rng.uniform(0, 0.5)]
            number = np.arange(16) - 7.5
            places = [spacing * (number + shift + gap * np.where(number + shift > 0, 0.5, -0.5)) for shift in (p, q)]
            axes = np.array([[1, 0, 0], [np.cos(angle), np.sin(angle), 0]])
            x = np.concatenate([np.outer(place, axis) for place, axis in zip(places, axes, strict=True)])
            assert contacts.energy(x) + bonds.energy(x) >= least * (1 - 1e-9)


def test_barrier_at_the_ends_of_chains() -> None:
    """Chains whose last bonds cross overlap less than in their middles, and that is what counts: beads nearest to the crossing
    and those behind, by hand for bonds that do not give way.
    """
    spacing, rigid = 0.5, 1e9
    rows = np.array([0.25, -0.25, -0.75, -1.25, -1.75])  # the last bond crossed in its middle
    offsets = np.linspace(-0.5, 0.5, 201)[:, None] * spacing

    def overlap(u: Array, v: Array) -> Array:
        r = np.sqrt(u[:, None, :, None] ** 2 + v[None, :, None, :] ** 2)
        return 0.5 * (np.maximum(1 - r, 0) ** 2).sum(axis=(2, 3))

    whole = np.concatenate([rows, [0.75, 1.25, 1.75]])
    at_ends = overlap(rows - offsets, rows - offsets).min()
    within = overlap(whole - offsets, whole - offsets).min()
    assert at_ends < 0.9 * within
    assert passage.crossing_energy(spacing, 1.0, 1.0, rigid) == pytest.approx(at_ends, rel=1e-3)


def jumps(model: of.Model, speeds: Array | None, steps: int = 6000) -> bool:
    """Whether the linking integral of two filaments jumps in a run without thermostat: one has passed through the other."""
    integrator = of.verlet(model)
    context = mm.Context(model.system, integrator, mm.Platform.getPlatformByName("CPU"), CPU)
    context.setPositions(model.positions)
    context.setVelocities(np.zeros((model.starts[-1], 3)) if speeds is None else speeds)
    before = None
    for _ in range(steps // 10):
        integrator.step(10)
        x = context.getState(positions=True).getPositions(asNumpy=True)._value
        if not np.isfinite(x).all():
            return True
        now = float(of.analysis.linking(*model.split(x)))
        if before is not None and abs(now - before) > 0.5:
            return True
        before = now
    return False


def admitted(model: of.Model, speeds: Array | None, *, damped: bool = False) -> bool:
    damping = of.langevin(model, 1 * KELVIN, friction=1e3 / unit.picosecond) if damped else of.verlet(model)
    context = mm.Context(model.system, damping, mm.Platform.getPlatformByName("CPU"), CPU)
    context.setPositions(model.positions)
    context.setVelocities(np.zeros((model.starts[-1], 3)) if speeds is None else speeds)
    try:
        of.preflight(model, context)
    except PreflightError as error:
        assert "through one another" in str(error)
        return False
    return True


@pytest.mark.parametrize("spacing", [0.5, 1.0])
@pytest.mark.parametrize("bend", [5.0, 500.0])
def test_the_fastest_filaments_admitted_do_not_pass(spacing: float, bend: float) -> None:
    for shift in (0.0, 0.5):
        model = of.build(crossed(spacing, bend=bend, shift=shift))
        energy = of.barrier(model).energy._value

        def speeds(share: float, energy: float = energy) -> Array:
            v = np.sqrt(2 * share * energy / 32)
            return np.repeat([[0, 0, v], [0, 0, -v]], 16, axis=0)

        assert admitted(model, speeds(0.99))
        assert not admitted(model, speeds(1.01))
        assert not jumps(model, speeds(0.99))
        assert jumps(model, speeds(16.0)) or jumps(model, speeds(32.0))


@pytest.mark.parametrize("spacing", [0.5, 1.0])
@pytest.mark.parametrize("bend", [5.0, 500.0])
def test_the_hardest_pushed_filaments_admitted_do_not_pass(spacing: float, bend: float) -> None:
    for apart in (1.4, 6.0):
        pairs = crossed(spacing, bend=bend, shift=0.5, apart=apart)
        most = of.barrier(of.build(pairs)).energy._value / (
            2 + apart - 1
        )  # both push a diameter, and each falls half the way

        def pushed(share: float, pairs: list[of.Filament] = pairs, most: float = most) -> of.Model:
            force = share * most / 16
            pulls = [[of.loads.Pull(i, (0, 0, sign * force) * KJ / NM) for i in range(16)] for sign in (1, -1)]
            return of.build(pairs, pulls)

        assert admitted(pushed(0.99), None)
        assert not admitted(pushed(1.01), None)
        assert not jumps(pushed(0.99), None)
        assert jumps(pushed(16.0), None)


def test_what_a_filament_gains_on_its_way() -> None:
    """Uniform acceleration, by the run itself; the end speed with friction; nothing for what is held, misses or goes away."""
    first, second = crossed(0.5, apart=6.0)
    pull = [of.loads.Pull(i, (0, 0, 2.0) * KJ / NM) for i in range(16)]
    model = of.build([first, second], [pull, []])
    x = np.concatenate([f.rest._value for f in (first, second)])
    integrator = of.verlet(model)
    context = mm.Context(model.system, integrator, mm.Platform.getPlatformByName("CPU"), CPU)
    context.setPositions(model.positions)
    moved = 0.0
    while moved < 5.0:  # 6 nm between the axes, less a diameter
        integrator.step(1)
        state = context.getState(positions=True, energy=True)
        moved = float(state.getPositions(asNumpy=True)._value[:16, 2].mean()) + 3.0
    kinetic = state.getKineticEnergy()._value
    assert energy_of_falling(model, x, 0.0) == pytest.approx(
        kinetic / 2, rel=0.01
    )  # of the relative motion of two equals
    masses = model.masses[:16].sum()
    assert energy_of_falling(model, x, 10.0) == pytest.approx(masses / 4 * (2.0 * 16 / masses / 10.0) ** 2)
    assert energy_of_falling(of.build([first, second], [pull, [of.loads.Hold(0)]]), x, 0.0) == pytest.approx(
        kinetic, rel=0.01
    )
    back = [of.loads.Pull(i, (0, 0, -2.0) * KJ / NM) for i in range(16)]
    assert energy_of_falling(of.build([first, second], [back, []]), x, 0.0) == 0.0
    assert energy_of_falling(of.build([first, second], [pull, pull]), x, 0.0) == pytest.approx(0.0, abs=1e-12)
    aside = np.concatenate([x[:16], x[16:] + np.array([30.0, 0, 0])])
    assert energy_of_falling(model, aside, 0.0) == 0.0
    held = of.build([first, second], [[of.loads.Hold(0), *pull[1:]], []])
    assert energy_of_falling(held, x, 0.0) == 0.0


def test_pushes_of_filaments_on_one_another_add_up() -> None:
    """A heap pressed on a held rod, each no harder than two may be; apart, they do not press. None falls far."""
    force = 0.49 * of.barrier(of.build(crossed(0.5, beads=8))).force._value / 8

    def heap(apart: float, rods: int) -> of.Model:
        axes = np.eye(3)[:2]
        chains = [
            rod(8, 0.5, axes[n % 2], np.array([apart * n if apart > 1 else 0.0, 0, apart * n])) for n in range(rods)
        ]
        pulls = [[of.loads.Pull(i, (0, 0, -force) * KJ / NM) for i in range(8)] for _ in chains[1:]]
        return of.build(chains, [[of.loads.Hold(range(8))], *pulls])

    assert admitted(heap(1.0, 3), None, damped=True)
    assert not admitted(heap(1.0, 4), None, damped=True)
    assert admitted(heap(20.0, 4), None, damped=True)


def context_of(model: of.Model, temperature: float = 100.0) -> mm.Context:
    integrator = of.langevin(model, temperature=temperature * KELVIN, seed=1)
    context = mm.Context(model.system, integrator, mm.Platform.getPlatformByName("CPU"), CPU)
    context.setPositions(model.positions)
    return context


def test_preflight_refuses_what_could_pass() -> None:
    with pytest.raises(PreflightError, match=r"within 1\.41 diameters .* but are 1\.5 apart"):
        of.preflight(of.build(crossed(1.5)))
    bare = of.Filament([[0, 0, 0], [1, 0, 0]] * NM, 1 * unit.dalton, (contact.Repulsion(1 * NM, 1 * STIFF),))
    with pytest.raises(PreflightError, match="nothing resists stretching"):
        of.preflight(of.build(bare))
    model = of.build(crossed(0.5))
    with pytest.raises(PreflightError, match=r"barrier between filaments .* 25 k_B T, but is"):
        of.preflight(model, context_of(model, 3000.0))
    loads = [[of.loads.Trap(0, 1000 * STIFF, (0, 0, 30) * NM)], []]
    with pytest.raises(PreflightError, match=r"steady force on filaments .* pN"):
        of.preflight(of.build(crossed(0.5), loads))
    assert of.preflight(model, context_of(model)).force_errors["contact"] <= 1e-3


def test_preflight_warns_of_filaments_that_others_pass_through() -> None:
    first, second = crossed(0.5)
    bare = of.Filament(second.rest, second.masses, second.terms[:-1])
    with pytest.warns(
        PreflightWarning, match=r"without contact.Repulsion, of which there are 1, the first being filament 1"
    ):
        of.preflight(of.build([first, bare]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        of.preflight(of.build([first, second]))


def test_preflight_looks_at_every_bond_in_contact() -> None:
    held, loose = crossed(0.5)
    unbound = of.Filament(loose.rest, loose.masses, loose.terms[1:])
    with pytest.raises(PreflightError, match="nothing resists stretching"):
        of.preflight(of.build([held, unbound]))
    soft = of.Filament(loose.rest, loose.masses, (stretching.Harmonic(1e-9 * STIFF), *loose.terms[1:2]))
    assert of.barrier(of.build([held, soft])).energy._value == of.barrier(of.build(held)).energy._value
    long = of.Filament(loose.rest, loose.masses, (stretching.Harmonic(100 * STIFF, 1.5 * NM), *loose.terms[1:]))
    with pytest.raises(PreflightError, match=r"within 1\.41 diameters .* but are 1\.5 apart"):
        of.preflight(of.build([held, long]))
    touch = (contact.Repulsion(1 * NM, 100 * STIFF),)
    beads = of.build([of.Filament([[0, 0, z]] * NM, 1 * unit.dalton, touch) for z in (0.0, 1.2)])
    assert of.barrier(beads) is None
    of.preflight(beads)


def test_preflight_refuses_strides_and_warns_of_overlaps() -> None:
    model = of.build(crossed(0.5))
    context = context_of(model)
    velocities = np.zeros((32, 3))
    velocities[3, 2] = 8.0
    context.setVelocities(velocities)
    reason = passage.reason_to_refuse(model, context, model.positions._value)
    stride = 8.0 * context.getIntegrator().getStepSize()._value
    assert (reason is not None) == (stride > 0.2 or 32.0 > of.barrier(model).energy._value)
    with pytest.warns(PreflightWarning, match=r"overlap by 0\.5 of their diameter, bead \d+ of filament 0 and bead"):
        of.preflight(of.build(crossed(0.5, apart=0.353553)))
    with pytest.raises(PreflightError, match="must not coincide, but bead 7 of filament 0 and bead 7 of filament 1 do"):
        of.preflight(of.build(crossed(0.5, apart=0.0, beads=15)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        of.preflight(model)


def test_time_step_counts_contacts_to_come_and_those_there() -> None:
    far, near = of.build(crossed(0.5)), of.build(crossed(0.5, apart=0.3))
    alone = of.build([of.Filament(f.rest, f.masses, f.terms[:2]) for f in crossed(0.5)])

    def squared(model: of.Model) -> float:
        return float((2 / of.stable_timestep(model)._value) ** 2)

    assert squared(far) == pytest.approx(squared(alone) + 4 * 100, rel=tol.LANCZOS)
    stack = of.build(
        [
            of.Filament([[0, 0, 0.9 * i]] * NM, 1 * unit.dalton, (contact.Repulsion(1 * NM, 100 * STIFF),))
            for i in range(12)
        ]
    )
    exact = np.linalg.eigvalsh(of.hessian.hessian(stack, stack.positions._value).toarray()).max()
    assert exact <= squared(stack) <= 1.05 * exact
    assert squared(near) >= np.linalg.eigvalsh(of.hessian.hessian(near, near.positions._value).toarray()).max() * 0.99


def test_refusals() -> None:
    line = of.shapes.line(4, 1 * NM)
    with pytest.raises(ValueError, match="`diameter` must be positive, but is 0"):
        of.Filament(line, 1 * unit.dalton, (contact.Repulsion(0 * NM, 1 * STIFF),))
    with pytest.raises(TypeError, match="`stiffness` must be a Quantity"):
        of.Filament(line, 1 * unit.dalton, (contact.Repulsion(1 * NM, 1.0),))
    with pytest.raises(ValueError, match="`diameter` must have shape"):
        of.Filament(line, 1 * unit.dalton, (contact.Repulsion([1, 1] * NM, 1 * STIFF),))
    chain = rod(6, 0.9, np.array([0, 0, 1.0]), np.zeros(3))
    with pytest.raises(ValueError, match="no contact.Repulsion in a protocol"):
        of.clamp(chain, 300 * KELVIN, extension=[3.0] * NM)


def test_statics_with_contact() -> None:
    """A rod held by its ends and pressed on a held one comes to rest, by OpenMM's forces too, and is borne by both."""
    held, pressed = crossed(0.5, apart=0.98)
    load = 0.2
    pulls = [of.loads.Pull(i, (0, 0, -load) * KJ / NM) for i in range(1, 15)]
    model = of.build([held, pressed], [[of.loads.Hold(range(16))], [of.loads.Hold([0, 15]), *pulls]])
    found = of.equilibrium(model)
    assert found.converged
    forces = of.forces(model, found.positions)
    assert np.abs(forces[17:31]).max() < tol.AT_REST_IN_CONTACT * load
    contacts = next(i for i in model.interactions if i.term.family == "contact")
    borne = contacts.forces(found.positions._value)[16:, 2].sum()
    assert 0.1 * 14 * load < borne < 14 * load


def test_replicas_of_a_curve_do_not_meet() -> None:
    """Starts are drawn without contact and in one place: they are laid apart and calmed, and the chain comes out longer."""
    x = np.outer(np.arange(8), [0.9, 0, 0])
    curves = []
    for terms in (
        (stretching.Harmonic(300 * STIFF),),
        (stretching.Harmonic(300 * STIFF), contact.Repulsion(1 * NM, 300 * STIFF)),
    ):
        chain = of.Filament(x * NM, 1 * unit.dalton, terms)
        curves.append(of.force_extension(chain, [3.0] * KJ / NM, 300 * KELVIN, 0.1, seed=2, processes=1))
    free, repelled = (float(curve.extension[0]) for curve in curves)
    error = np.hypot(*(float(curve.extension_error[0]) for curve in curves))
    assert repelled - free > tol.SIGMAS * error


def test_planar_chains_in_contact_are_sampled() -> None:
    """Their integrator has another way of strong friction for the start, and its own friction again afterwards."""
    x = np.outer(np.arange(6), [0.9, 0, 0])
    chain = of.Filament(
        x * NM, 1 * unit.dalton, (stretching.Harmonic(300 * STIFF), contact.Repulsion(1 * NM, 300 * STIFF))
    )
    curve = of.force_extension(chain, [6.0] * KJ / NM, 300 * KELVIN, 0.3, seed=2, processes=1, dimension=2)
    assert 2 < float(curve.extension[0]) < 5
    model = of.build(chain, [of.loads.Hold(0), of.loads.Plane()])
    integrator = of.langevin(model, temperature=300 * KELVIN, seed=1)
    context = mm.Context(model.system, integrator, mm.Platform.getPlatformByName("Reference"))
    context.setPositions(model.positions)
    before = [integrator.getGlobalVariable(i) for i in range(integrator.getNumGlobalVariables())]
    of.integrators.calm(integrator, model)
    assert context.getStepCount() == of.integrators.CALM[1]
    assert [integrator.getGlobalVariable(i) for i in range(integrator.getNumGlobalVariables())] == before


def test_more_refusals() -> None:
    touch = contact.Repulsion(1 * NM, 1 * STIFF)
    with pytest.raises(ValueError, match=r"`terms` must hold one contact\.Repulsion at most"):
        of.Filament(of.shapes.line(4, 1 * NM), 1 * unit.dalton, (touch, touch))
    model = of.build(crossed(0.5))
    with pytest.raises(ValueError, match="`positions` must have shape"):
        of.barrier(model, np.zeros((3, 3)) * NM)
    with pytest.raises(ValueError, match="`positions` must be finite"):
        of.barrier(model, np.full((32, 3), np.nan) * NM)
    assert of.barrier(of.build(of.Filament(of.shapes.line(4, 1 * NM), 1 * unit.dalton, ()))) is None
    hard = [[of.loads.Pull(0, (0, 0, 1e9) * unit.piconewton)], []]
    with pytest.raises(PreflightError, match=r"[\d.]+ pN, but is 0.001 N"):
        of.preflight(of.build(crossed(0.5), hard))


@pytest.mark.slow
def test_cost_grows_linearly_at_fixed_density() -> None:
    """From 10^4 beads to 10^5 on the CPU platform, in turns; the shortest of each, to which others on the machine only add."""
    contexts = []
    for side in (9, 28):
        places = [np.array([0.0, 2.0 * i, 2.0 * j]) for i in range(side) for j in range(side)]
        model = of.build([rod(125, 0.5, np.eye(3)[0], place) for place in places])
        integrator = mm.VerletIntegrator(0.005)
        context = mm.Context(model.system, integrator, mm.Platform.getPlatformByName("CPU"), CPU)
        context.setPositions(model.positions)
        context.setVelocitiesToTemperature(300, 1)
        contexts.append((context, integrator, 125 * side**2))
    few, many = np.min([[of_a_step(*each) for each in contexts] for _ in range(4)], axis=0)
    assert 0.5 < many / few < 1.5


def of_a_step(context: mm.Context, integrator: mm.Integrator, beads: int) -> float:
    """Seconds of a bead and step."""
    steps = 2_000_000 // beads
    begun = time.perf_counter()
    integrator.step(steps)
    context.getState(positions=True)
    return (time.perf_counter() - begun) / steps / beads
