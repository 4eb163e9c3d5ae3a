"""Static equilibria against the elastica, the helix formulas, buckling and Hellmann-Feynman; and what is said of failures."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import tolerances as tol
from conftest import KJ, NM, Array, random_chain
from openmm import unit
from scipy.integrate import solve_bvp

import openmm_filament as of
from openmm_filament import bending, stretching, torsion
from openmm_filament.articulated import _Arm, relaxed
from openmm_filament.loads import Hold, Plane, Pluck, Pull, Tension

N_PER = KJ / NM
STIFF = 1e4 * KJ / NM**2


def tip(result: Any) -> Array:
    x = result.positions.value_in_unit(NM)
    return np.asarray(x[-1] - x[0])


def test_a_spring_is_as_long_as_hooke_says() -> None:
    chain = of.Filament(of.shapes.line(5, 1 * NM), 1 * unit.dalton, (stretching.Harmonic(40 * KJ / NM**2),))
    found = of.equilibrium(of.build(chain, [Hold(0), Pull(-1, (0, 0, 8) * N_PER)]))
    np.testing.assert_allclose(tip(found), [0, 0, 5 * (1 + 8 / 40)], atol=1e-9)
    assert found.converged
    assert found.is_minimum
    assert found.residual <= 1e-8 * 8
    assert found.energies == {
        "stretching": pytest.approx(5 * 8**2 / 80, rel=1e-9),
        "pull": pytest.approx(-8 * 6.0, rel=1e-9),
    }


def elastica(load: float) -> Array:
    """Tip (x, y) of a unit cantilever of unit rigidity along x under a force along y: theta'' = -load cos(theta)."""

    def slope(_: Array, y: Array) -> Array:
        return np.stack([y[1], -load * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])])

    def ends(a: Array, b: Array) -> Array:
        return np.array([a[0], b[1], a[2], a[3]])

    s = np.linspace(0, 1, 50)
    found = solve_bvp(slope, ends, s, np.stack([s, 1 - s, s, s]), tol=1e-10, max_nodes=20000)
    assert found.success
    return np.asarray(found.y[2:, -1])


@pytest.mark.parametrize("load", [0.3, 2.0, 10.0])
def test_a_clamped_rod_bends_as_the_elastica(load: float) -> None:
    errors = []
    for n in (20, 40):
        # clamped at half a segment before bead 1: a joint there has half the length to bend, hence twice the stiffness
        alpha = np.full(n, float(n))
        alpha[0] *= 2
        rest = of.shapes.line(n + 1, NM / n)[:, ::-1]
        chain = of.Filament(
            rest, 1 * unit.dalton, (stretching.Harmonic(1e9 * KJ / NM**2), bending.Harmonic(alpha * KJ))
        )
        found = of.equilibrium(of.build(chain, [Hold([0, 1]), Pull(-1, (0, load, 0) * N_PER)]))
        assert found.converged
        assert found.is_minimum
        x = found.positions.value_in_unit(NM)
        errors.append(np.abs((x[-1] - x[1])[:2] - elastica(load)).max())
    assert errors[1] < tol.ELASTICA
    assert 3.5 < errors[0] / errors[1] < 5  # second order in the segment length


@pytest.mark.parametrize("beyond", [0.95, 1.3])
def test_a_compressed_rod_buckles_at_its_critical_load_and_the_saddle_is_left(beyond: float) -> None:
    n, alpha = 20, 50.0
    critical = 4 * alpha * np.sin(np.pi / (2 * n)) ** 2  # hinged chain of rigid unit links
    rest = of.shapes.line(n, 1 * NM)
    chain = of.Filament(rest, 1 * unit.dalton, (stretching.Harmonic(1e7 * KJ / NM**2), bending.Harmonic(alpha * KJ)))
    # a hinge at both ends: the last bead slides along the axis in a plane, so push along x against a held first bead
    squeezed = of.build(chain, [Hold([0, -1]), Tension(0 * N_PER)])
    assert of.equilibrium(squeezed).is_minimum
    shorter = of.Filament(
        rest, 1 * unit.dalton,
        (stretching.Harmonic(1e4 * KJ / NM**2, (1 + beyond * critical / 1e4) * NM), bending.Harmonic(alpha * KJ)),
    )  # fmt: skip
    found = of.equilibrium(of.build(shorter, [Hold([0, -1])]))
    assert found.is_minimum
    aside = float(np.abs(found.positions.value_in_unit(NM)[:, :2]).max())
    assert (aside > 0.05) == (beyond > 1)


def helix(segments: int, *, softer: float = 1.0, loads: Any = (), twist: Any = torsion.Harmonic) -> of.Model:
    """Three turns of radius 2 and pitch 6 nm; B = 1000 and C = 700 kJ/mol nm over `softer`, hardly stretchable."""
    rest = of.shapes.helix(segments, radius=2 * NM, pitch=6 * NM, turns=3)
    step = float(np.linalg.norm(np.diff(rest.value_in_unit(NM), axis=0), axis=1)[0])
    terms = (
        stretching.Harmonic(1e6 / step * KJ / NM**2),
        bending.Harmonic(1000 / softer / step * KJ),
        twist(700 / softer / step * KJ),
    )
    return of.build(of.Filament(rest, 1 * unit.dalton, terms), loads)


def test_a_helix_pulled_at_its_end_beads_has_two_thirds_of_the_stiffness_of_one_pulled_on_its_axis() -> None:
    force, radius, pitch = 1e-3, 2.0, 6.0
    wire = 3 * np.hypot(2 * np.pi * radius, pitch)
    sine = pitch / np.hypot(2 * np.pi * radius, pitch)
    b, c = 1000.0, 700.0
    free = b * c / (radius**2 * wire * (b * (1 - sine**2) + c * sine**2))
    errors = []
    for segments in (60, 120):
        model = helix(segments, loads=[Hold(0), Pull(-1, (0, 0, force) * N_PER)])
        found = of.equilibrium(model)
        assert found.converged
        errors.append(force / (tip(found)[2] - 3 * pitch) / (2 / 3 * free) - 1)
    assert abs(errors[1]) < 0.02
    assert abs(errors[1]) < 0.6 * abs(errors[0])


@pytest.mark.parametrize("twist", [torsion.Harmonic, torsion.Periodic, torsion.Weighted])
@pytest.mark.parametrize("force", [0.5, 50.0, 5000.0])
@pytest.mark.parametrize("softer", [1.0, 1e6])
def test_the_energy_falls_with_the_force_as_the_extension_says(twist: Any, force: float, softer: float) -> None:
    """Hellmann-Feynman: -dE/dF = the extension, whatever the stiffnesses, up to a helix pulled all but straight."""
    extension, energy = [], []
    for pull in force * np.array([1 - 1e-3, 1, 1 + 1e-3]):
        found = of.equilibrium(helix(40, softer=softer, loads=[Hold(0), Pull(-1, (0, 0, pull) * N_PER)], twist=twist))
        assert found.converged, found.message
        assert found.is_minimum, found.message
        extension.append(tip(found)[2])
        # the pull's energy counts from the origin
        x0 = found.positions.value_in_unit(NM)[0, 2]
        energy.append(sum(found.energies.values()) + pull * x0)
    slope = -(energy[2] - energy[0]) / (2e-3 * force)
    assert slope == pytest.approx(extension[1], rel=tol.HELLMANN_FEYNMAN)
    assert extension[0] < extension[1] < extension[2]


def test_a_planar_chain_stays_in_its_plane_and_a_free_one_may_leave_it() -> None:
    rest = of.shapes.planar_walk(12, 1 * NM, bend=0.6 * unit.radian, seed=3)
    chain = of.Filament(rest, 1 * unit.dalton, (stretching.Harmonic(STIFF), bending.Harmonic(80 * KJ)))
    loads = [Hold(0), Pull(-1, (30, 0, 0) * N_PER)]
    flat = of.equilibrium(of.build(chain, [*loads, Plane()]))
    whole = of.equilibrium(of.build(chain, loads))
    assert not flat.positions.value_in_unit(NM)[:, 2].any()
    for found in (flat, whole):
        assert found.converged
        assert found.is_minimum
        force = of.reference.forces(chain, found.positions, loads)
        assert np.abs(force[1:, :2]).max() <= 1.01 * found.residual
    assert sum(whole.energies.values()) <= sum(flat.energies.values()) + 1e-6


def test_a_curve_goes_on_from_point_to_point() -> None:
    weak, strong = (helix(40, loads=[Hold(0), Pull(-1, (0, 0, f) * N_PER)]) for f in (20, 40))
    at_once = of.equilibrium(strong)
    onwards = of.equilibrium(strong, positions=of.equilibrium(weak).positions, begin_at=0.5)
    np.testing.assert_allclose(tip(onwards)[2], tip(at_once)[2], rtol=1e-9)


def test_the_arm_has_the_derivatives_of_its_energy() -> None:
    model = helix(8, twist=torsion.Weighted)
    terms = [*model.interactions, *helix(8).interactions, *helix(8, twist=torsion.Periodic).interactions]
    rng = np.random.default_rng(5)
    arm = _Arm(random_chain(rng, 9))
    loads = rng.normal(size=(9, 3)) * 100
    energy, gradient, matrix = arm.derivatives(terms, loads)
    cartesian = sum(i.energy(arm.positions) for i in terms) - (loads * arm.positions).sum()
    assert energy == pytest.approx(cartesian, rel=1e-12)
    scale, bends, size = arm.scales(1.0), arm.bend_places, len(gradient)
    gradient, matrix = gradient * scale, matrix * np.outer(scale, scale)
    matrix[bends, bends] += gradient[bends]
    h = 1e-4

    def at(*pushes: tuple[int, float]) -> float:
        step = np.zeros(size)
        for place, push in pushes:
            step[place] += push
        moved = arm.moved(step, 1.0)
        assert moved is not None
        return moved.derivatives(terms, loads)[0]

    first = [(at((k, h)) - at((k, -h))) / (2 * h) for k in range(size)]
    np.testing.assert_allclose(gradient, first, atol=1e-6 * np.abs(gradient).max())
    for k, m in rng.integers(0, size, (60, 2)):
        found = (at((k, h), (m, h)) - at((k, h), (m, -h)) - at((k, -h), (m, h)) + at((k, -h), (m, -h))) / (4 * h * h)
        assert matrix[k, m] == pytest.approx(found, abs=1e-6 * np.abs(matrix).max())


def test_the_arm_comes_to_rest_where_the_forces_vanish() -> None:
    model = helix(30, loads=[Hold(0), Pull(-1, (3, 0, 900) * N_PER), Pull(12, (0, -20, 5) * N_PER)])
    x, steps = relaxed(model.positions.value_in_unit(NM), model.interactions, model.pulls, most=300, tolerance=1e-9)
    force = model.pulls + sum(i.forces(x) for i in model.interactions)
    assert np.abs(force[1:]).max() < 1e-5 * 900
    assert steps < 100


def test_what_did_not_converge_is_said() -> None:
    model = helix(40, loads=[Hold(0), Pull(-1, (0, 0, 50) * N_PER)])
    found = of.equilibrium(model, most_steps=3)
    assert not found.converged
    assert found.message.startswith("NOT converged in ")
    assert found.residual > 1e-8 * 50


def test_plucks_play_no_part_and_bad_arguments_are_refused() -> None:
    chain = of.Filament(
        of.shapes.line(3, 1 * NM), 1 * unit.dalton, (stretching.Harmonic(STIFF), bending.Harmonic(9 * KJ))
    )
    plucked = of.build(chain, [Hold([0, 1]), Pluck(-1, (9, 0, 0) * N_PER, 1 * unit.picosecond)])
    np.testing.assert_allclose(
        of.equilibrium(plucked).positions.value_in_unit(NM), chain.rest.value_in_unit(NM), atol=1e-12
    )
    model = of.build(chain, [Hold(0)])
    for name, bad in (("stages", 0), ("most_steps", 0)):
        with pytest.raises(ValueError, match=f"`{name}` must be at least 1, but is 0"):
            of.equilibrium(model, **{name: bad})
    with pytest.raises(ValueError, match=r"`begin_at` must lie in \[0, 1\], but is 1.5"):
        of.equilibrium(model, begin_at=1.5)
    with pytest.raises(ValueError, match="`model` must have a free bead to come to rest, but all are held"):
        of.equilibrium(of.build(chain, [Hold(range(4))]))


def test_a_chain_that_nothing_holds_is_refused_where_it_is_pulled_away() -> None:
    chain = of.Filament(of.shapes.line(3, 1 * NM), 1 * unit.dalton, (stretching.Harmonic(STIFF),))
    with pytest.raises(ValueError, match="`model` must hold a bead of a filament that is pulled away"):
        of.equilibrium(of.build(chain, [Pull(-1, (0, 0, 5) * N_PER)]))
    balanced = of.equilibrium(of.build(chain, [Pull(-1, (0, 0, 5) * N_PER), Pull(0, (0, 0, -5) * N_PER)]))
    assert balanced.converged
    assert tip(balanced)[2] == pytest.approx(3 * (1 + 5 / 1e4), rel=1e-9)


@pytest.mark.parametrize(
    ("beads", "force"), [(12, (-5, 0, 0)), (12, (5, 0, 0)), (20, (-1, 0, 0)), (12, (0, 0, 5)), (30, (-50, 0, 0))]
)
def test_a_ring_held_at_one_bead_comes_to_rest_away_from_it(beads: int, force: tuple[float, ...]) -> None:
    """Pushed towards its hold, too, where symmetry keeps it on a ridge: it turns over and hangs along the force."""
    terms = (of.stretching.Harmonic(500 * KJ / NM**2), of.bending.Harmonic(50 * KJ))
    ring = of.Filament(of.shapes.ring(beads, 2 * NM), 1 * unit.dalton, terms, closed=True)
    model = of.build(ring, [of.loads.Hold(0), of.loads.Pull(beads // 2, force * unit.piconewton)])
    found = of.equilibrium(model, most_steps=1000)
    assert found.converged
    assert found.is_minimum
    assert f"{beads} joints rest bent without a torsion" in found.message
    x = found.positions.value_in_unit(NM)
    along = np.array(force) / np.linalg.norm(force)
    reach = x[beads // 2] - x[0]
    assert reach @ along == pytest.approx(np.linalg.norm(reach), rel=1e-6)
    others = of.forces(model, found.positions)[1:]
    assert np.abs(others).max() < 1e-7


def test_equilibrium_refuses_what_is_no_shape() -> None:
    line = of.Filament(of.shapes.line(4, 1 * NM), 1 * unit.dalton, (of.stretching.Harmonic(500 * KJ / NM**2),))
    model = of.build(line, [of.loads.Hold(0), of.loads.Pull(-1, (0, 0, 5) * unit.piconewton)])
    with pytest.raises(ValueError, match="`positions` must be finite"):
        of.equilibrium(model, positions=np.full((5, 3), np.nan) * NM)
    with pytest.raises(ValueError, match="neighbours in one place"):
        of.equilibrium(model, positions=np.zeros((5, 3)) * NM)
    with pytest.raises(ValueError, match="must have a term or a trap"):
        of.equilibrium(of.build(of.Filament([[0, 0, 0]] * NM, 1 * unit.dalton, ())))
    with pytest.raises(ValueError, match="`stages` must be at most"):
        of.equilibrium(model, stages=10**400)


@pytest.mark.parametrize("ratio", [1e6, 1e7, 1e8])
@pytest.mark.parametrize("load", [0.1, 10.0, 1000.0])
@pytest.mark.parametrize("shape", ["helix", "clamped helix", "clamped rod"])
def test_bonds_a_hundred_million_times_stiffer_than_joints(shape: str, load: float, ratio: float) -> None:
    """Coiled to all but straight: at rest to rounding, by OpenMM's own forces where these are no coarser."""
    terms = [of.stretching.Harmonic(100 * ratio * KJ / NM**2), of.bending.Harmonic(100 * KJ)]
    if "helix" in shape:
        rest, direction = of.shapes.helix(30, radius=2 * NM, pitch=3 * NM, turns=3), (0, 0, load)
        terms.append(of.torsion.Harmonic(100 * KJ))
    else:
        rest, direction = of.shapes.line(30, 1 * NM), (0, load, 0)
    hold = Hold([0, 1] if "clamped" in shape else 0)
    chain = of.Filament(rest, 1 * unit.dalton, tuple(terms))
    found = of.equilibrium(of.build(chain, [hold, Pull(-1, direction * unit.piconewton)]), most_steps=1000)
    assert found.converged, found.message
    assert found.is_minimum
    x = found.positions.value_in_unit(NM)
    assert np.linalg.norm(np.diff(x, axis=0), axis=1) == pytest.approx(
        np.linalg.norm(np.diff(rest.value_in_unit(NM), axis=0), axis=1), rel=load / ratio
    )
