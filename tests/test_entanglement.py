"""Linking, writhe and contacts: quadrature, crossings seen from all sides, 60 digits, and what has to be refused."""

from __future__ import annotations

import itertools
import re
import tracemalloc
from collections.abc import Callable
from typing import Any

import mdtraj
import mpmath
import numpy as np
import pytest
import tolerances as tol
from conftest import Array, random_chain, random_rotation
from scipy import integrate

from openmm_filament import analysis
from openmm_filament.analysis import entanglement

MIRROR = np.array([1.0, 1.0, -1.0])
SQUARE = np.array([[1.0, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]])
HOOKED = np.array([[0.0, 0, 1], [0, 0, -1], [3, 0, -1], [3, 0, 1]])


def edges(x: Array, closed: bool) -> tuple[Array, Array]:
    """First and last points (n, 3) of the segments."""
    return (x, np.roll(x, -1, axis=0)) if closed else (x[:-1], x[1:])


def crossings(p: Array, q: Array, closed: bool, rotation: Array, pairs: Array | None = None) -> float:
    """Signed crossings of two projected curves, +1 for a right-handed one, over the pairs of segments chosen."""
    a, b = (x[:, None] for x in edges(p @ rotation.T, closed))
    c, d = (x[None] for x in edges(q @ rotation.T, closed))
    u, v, w = b - a, d - c, c - a
    area = u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
    s = (w[..., 0] * v[..., 1] - w[..., 1] * v[..., 0]) / np.where(area, area, np.inf)
    t = (w[..., 0] * u[..., 1] - w[..., 1] * u[..., 0]) / np.where(area, area, np.inf)
    over = (a + s[..., None] * u - c - t[..., None] * v)[..., 2]
    met = (s > 0) & (s < 1) & (t > 0) & (t < 1) & (True if pairs is None else pairs)
    return float((np.sign(area * over) * met).sum())


def quadrature(p: Array, q: Array, closed: bool, order: int, pairs: Array | None = None) -> float:
    """The Gauss integral by Gauss and Legendre's rule along every segment."""
    nodes, weights = np.polynomial.legendre.leggauss(order)
    (a, b), (c, d) = edges(p, closed), edges(q, closed)
    total = 0.0
    for s, ws in zip((nodes + 1) / 2, weights / 2, strict=True):
        for t, wt in zip((nodes + 1) / 2, weights / 2, strict=True):
            r = (a + s * (b - a))[:, None] - (c + t * (d - c))[None]
            volume = np.einsum("ijk,ijk->ij", r, np.cross((b - a)[:, None], (d - c)[None]))
            length = np.linalg.norm(r, axis=-1)
            term = volume / np.where(length, length, 1) ** 3
            total += ws * wt * float((term if pairs is None else np.where(pairs, term, 0)).sum())
    return total / (4 * np.pi)


def in_many_digits(p: Array, q: Array, closed: bool = False) -> float:
    """Klenin and Langowski's four arcsines a pair, in 60 digits."""
    with mpmath.workdps(60):

        def vector(x: Array) -> Any:
            return [mpmath.mpf(float(k)) for k in x]

        def less(x: Any, y: Any) -> Any:
            return [i - j for i, j in zip(x, y, strict=True)]

        def dot(x: Any, y: Any) -> Any:
            return mpmath.fdot(x, y)

        def cross(x: Any, y: Any) -> Any:
            return [x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]]

        total = mpmath.mpf(0)
        for e, f in zip(*edges(p, closed), strict=True):
            for g, h in zip(*edges(q, closed), strict=True):
                one, two, three, four = (vector(x) for x in (e, f, g, h))
                r13, r14, r23, r24 = less(three, one), less(four, one), less(three, two), less(four, two)
                side = dot(cross(less(four, three), less(two, one)), r13)
                if side == 0:
                    continue
                normals = [cross(r13, r14), cross(r14, r24), cross(r24, r23), cross(r23, r13)]
                units = [[k / mpmath.sqrt(dot(n, n)) for k in n] for n in normals]
                angle = sum(mpmath.asin(dot(units[k], units[(k + 1) % 4])) for k in range(4))
                total += mpmath.sign(side) * angle
        return float(total / (4 * mpmath.pi))


def not_neighbours(count: int, closed: bool) -> Array:
    i, j = np.indices((count, count))
    apart = np.abs(i - j)
    return (np.minimum(apart, count - apart) if closed else apart) > 1


def torus_knot(longways: int, round_it: int, points: int, start: float = 0.0) -> Array:
    """Right-handed: strands along the tube turn about its core as a right-handed helix does."""
    t = 2 * np.pi * np.arange(points) / points
    tube, turn = 2 + np.cos(round_it * t + start), longways * t
    return np.stack([tube * np.cos(turn), tube * np.sin(turn), -np.sin(round_it * t + start)], axis=-1)


# --- linking --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [3, 4, 7, 50])
def test_hopf_links_of_both_hands_are_linked_once(count: int) -> None:
    t = 2 * np.pi * np.arange(count) / count + 0.1
    flat = np.stack([np.cos(t), np.sin(t), 0 * t], axis=-1)
    upright = np.stack([1 + np.cos(t), 0 * t, np.sin(t)], axis=-1)
    hand = round(crossings(flat, upright, True, random_rotation(np.random.default_rng(3))) / 2)
    assert abs(hand) == 1
    assert float(analysis.linking(flat, upright, closed=True)) == pytest.approx(hand, abs=tol.LINKING)
    assert float(analysis.linking(flat[::-1], upright, closed=True)) == pytest.approx(-hand, abs=tol.LINKING)
    assert float(analysis.linking(flat * MIRROR, upright * MIRROR, closed=True)) == pytest.approx(
        -hand, abs=tol.LINKING
    )
    assert abs(analysis.linking(flat, upright + np.array([0.0, 3, 0]), closed=True)) < tol.LINKING


def test_strands_of_a_right_handed_double_helix_are_linked_positively() -> None:
    t = np.linspace(0, 20 * np.pi, 401)
    strand = np.stack([np.cos(t), np.sin(t), 0.5 * t], axis=-1)
    found = float(analysis.linking(strand, strand * [-1, -1, 1]))
    assert 9 < found < 10
    assert found == pytest.approx(-float(analysis.linking(strand * MIRROR, strand * [-1, -1, -1])), abs=tol.LINKING)


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_torus_links_are_linked_as_often_as_they_turn(turns: int) -> None:
    first, second = torus_knot(1, turns, 61), torus_knot(1, turns, 61, np.pi)
    assert float(analysis.linking(first, second, closed=True)) == pytest.approx(turns, abs=tol.LINKING)
    assert float(analysis.linking(first * MIRROR, second * MIRROR, closed=True)) == pytest.approx(
        -turns, abs=tol.LINKING
    )


def test_random_closed_chains_are_linked_as_their_crossings_say(rng: np.random.Generator) -> None:
    first, second = (np.array([random_chain(rng, n) for _ in range(40)]) for n in (40, 51))
    second += first.mean(axis=1, keepdims=True) - second.mean(axis=1, keepdims=True)
    wanted = [crossings(p, q, True, random_rotation(rng)) / 2 for p, q in zip(first, second, strict=True)]
    assert len(set(wanted)) > 3
    np.testing.assert_allclose(analysis.linking(first, second, closed=True), wanted, atol=tol.LINKING)


def test_open_chains_by_quadrature(rng: np.random.Generator) -> None:
    p, q = random_chain(rng, 6), random_chain(rng, 8) + np.array([0.0, 0, 3])
    coarse, fine = (quadrature(p, q, False, order) for order in (24, 40))
    assert coarse == pytest.approx(fine, abs=tol.GAUSS_QUADRATURE / 10), "the quadrature itself"
    assert abs(fine) > 1e-3
    assert float(analysis.linking(p, q)) == pytest.approx(fine, abs=tol.GAUSS_QUADRATURE)
    ring = quadrature(np.concatenate([p, p[:1]]), q, False, 40)
    assert float(analysis.linking(p, q, closed=(True, False))) == pytest.approx(ring, abs=tol.GAUSS_QUADRATURE)


def test_open_chains_in_many_digits(rng: np.random.Generator) -> None:
    for _ in range(10):
        p, q = random_chain(rng, 5), random_chain(rng, 7)
        q += p.mean(axis=0) - q.mean(axis=0)
        assert float(analysis.linking(p, q)) == pytest.approx(in_many_digits(p, q), abs=tol.LINKING)


def test_what_linking_and_writhe_do_not_depend_on(rng: np.random.Generator) -> None:
    p, q, turn = random_chain(rng, 30), random_chain(rng, 20), random_rotation(rng)
    q += p.mean(axis=0) - q.mean(axis=0)
    linked, bent = float(analysis.linking(p, q)), float(analysis.writhe(p))
    assert abs(linked) > 0.01
    assert abs(bent) > 0.01
    for factor, way in itertools.product([1e-100, 1e-9, 1.0, 1e6, 1e100], [np.eye(3), turn]):
        assert float(analysis.linking(factor * p @ way, factor * q @ way)) == pytest.approx(linked, abs=tol.LINKING)
        assert float(analysis.writhe(factor * p @ way)) == pytest.approx(bent, abs=tol.LINKING)
    assert float(analysis.linking(q, p)) == pytest.approx(linked, abs=tol.LINKING)
    assert float(analysis.linking(p[::-1], q)) == pytest.approx(-linked, abs=tol.LINKING)
    assert float(analysis.linking(p * MIRROR, q * MIRROR)) == pytest.approx(-linked, abs=tol.LINKING)
    assert float(analysis.writhe(p[::-1])) == pytest.approx(bent, abs=tol.LINKING)
    assert float(analysis.writhe(p * MIRROR)) == pytest.approx(-bent, abs=tol.LINKING)


def test_linking_adds_up_along_a_chain(rng: np.random.Generator) -> None:
    p, q = random_chain(rng, 30), random_chain(rng, 20)
    parts = float(analysis.linking(p[:12], q)) + float(analysis.linking(p[11:], q))
    assert float(analysis.linking(p, q)) == pytest.approx(parts, abs=tol.LINKING)
    halves = float(analysis.writhe(p[:12])) + float(analysis.writhe(p[11:]))
    between = 2 * float(analysis.linking(p[:11], p[11:])) + 2 * float(analysis.linking(p[10:12], p[12:]))
    assert float(analysis.writhe(p)) == pytest.approx(halves + between, abs=tol.LINKING)


# --- near and touching ----------------------------------------------------------------------------------------------

HEIGHTS = [1.0, 1e-3, 1e-6, 1e-9, 1e-12]


@pytest.mark.parametrize("height", HEIGHTS)
def test_segments_that_cross_in_their_middles_have_the_solid_angle_of_a_rectangle(height: float) -> None:
    over, under = np.array([[-0.5, 0, height], [0.5, 0, height]]), np.array([[0.0, -0.5, 0], [0, 0.5, 0]])
    wanted = np.arctan2(0.25, height * np.sqrt(height**2 + 0.5)) / np.pi
    assert float(analysis.linking(over, under)) == pytest.approx(wanted, rel=0, abs=tol.LINKING_OF_A_PAIR)
    assert float(analysis.linking(over, under[::-1])) == pytest.approx(-wanted, rel=0, abs=tol.LINKING_OF_A_PAIR)


@pytest.mark.parametrize("height", HEIGHTS)
def test_segments_that_cross_anywhere_agree_with_many_digits(height: float, rng: np.random.Generator) -> None:
    for s, t in rng.uniform(0.05, 0.95, (20, 2)):
        u, v = rng.normal(size=(2, 3))
        normal = np.cross(u, v) / np.linalg.norm(np.cross(u, v))
        p = np.array([-s * u, (1 - s) * u])
        q = np.array([-t * v, (1 - t) * v]) + height * normal
        # coordinates round by 1e-16, and the side with them
        assert float(analysis.linking(p, q)) == pytest.approx(in_many_digits(p, q), abs=tol.LINKING_OF_A_PAIR)


@pytest.mark.parametrize("height", HEIGHTS[1:])
def test_a_corner_close_to_a_segment_keeps_closed_curves_whole(height: float, rng: np.random.Generator) -> None:
    way = random_rotation(rng)

    def linked(depth: float) -> float:
        """The square, and a triangle whose tip reaches over an edge of it from outside by `depth`."""
        hook = np.array([[0.3, 1 - depth, 0], [1.0, 5, -2], [-1.0, 5, 3]])
        return float(analysis.linking(SQUARE @ way, hook @ way, closed=True))

    deep = round(linked(0.5))
    assert abs(deep) == 1
    assert linked(height) == pytest.approx(deep, abs=tol.LINKING)
    assert linked(-height) == pytest.approx(0, abs=tol.LINKING)


@pytest.mark.parametrize("gap", [1e-3, 1e-6, 1e-9, 1e-12])
def test_corners_close_to_corners_keep_closed_curves_whole(gap: float, rng: np.random.Generator) -> None:
    for _ in range(30):
        p, q = rng.normal(size=(2, 8, 3))
        q[3] = p[4] + gap * rng.normal(size=3)
        linked = float(analysis.linking(p, q, closed=True))
        assert linked == pytest.approx(round(linked), abs=tol.LINKING)


@pytest.mark.parametrize("gap", [1e-6, 1e-9, 1e-12])
def test_segments_side_by_side_from_a_corner_on_are_on_the_right_side(gap: float, rng: np.random.Generator) -> None:
    """One that begins near a corner and runs along the other, either way: the sides count for half a turn."""
    for backwards in (False, True) * 10:
        p = np.array([[0.0, 0, 0], [1, 0, 0]]) @ random_rotation(rng)
        q = p * [[0.0], [0.6]] + gap * rng.normal(size=(2, 3))
        q = q[::-1] if backwards else q
        # the rounding of coordinates turns directions between corners so close
        assert float(analysis.linking(p, q)) == pytest.approx(in_many_digits(p, q), abs=tol.LINKING_OF_A_PAIR / gap)


@pytest.mark.parametrize("gap", [1e-2, 1e-4, 1e-6])
def test_segments_side_by_side_add_nothing(gap: float, rng: np.random.Generator) -> None:
    p = np.array([[0.0, 0, 0], [1, 0, 0]])
    assert float(analysis.linking(p, p + np.array([2.0, 0, 0]))) == 0
    for way in (random_rotation(rng) for _ in range(10)):  # which leaves an angle of 1e-16 between them
        found = float(analysis.linking(p @ way, (p + np.array([0.3, gap, 0])) @ way))
        assert abs(found) < tol.LINKING_OF_A_PAIR / gap


@pytest.mark.parametrize(
    "other",
    [
        pytest.param([[0.0, -0.5, 0], [0, 0.5, 0]], id="crossing"),
        pytest.param([[0.2, 0.0, 0], [0, 0.5, 1]], id="corner on a segment"),
        pytest.param([[0.5, 0.0, 0], [0.7, 0.5, 1]], id="corner on a corner"),
        pytest.param([[0.2, 0.0, 0], [3, 0, 0]], id="overlapping"),
        pytest.param([[0.2, 1e-9, 0], [3, 1e-9, 0]], id="side by side"),
        pytest.param([[-0.4, 0.0, 0], [0.4, 0, 0]], id="within"),
    ],
)
def test_touching_curves_are_refused(other: Any, rng: np.random.Generator) -> None:
    p = np.array([[-0.5, -3, 0], [-0.5, 0, 0], [0.5, 0, 0]])
    with pytest.raises(ValueError, match="must not touch, but segments 1 and 0 do in frame 1"):
        analysis.linking([p + 5, p], other)
    for way in (random_rotation(rng) for _ in range(10)):  # whose rounding decides whether they cross
        with pytest.raises(ValueError, match="must not touch"):
            analysis.linking(p @ way, other @ way)


def test_a_curve_that_touches_itself_is_refused() -> None:
    eight = np.array([[-1.0, -1, 0], [1, 1, 0], [1, -1, 0], [-1, 1, 0]])
    for closed in (False, True):
        with pytest.raises(ValueError, match="segments 0 and 2 do in frame 0"):
            analysis.writhe(eight, closed=closed)


# --- writhe ---------------------------------------------------------------------------------------------------------


def test_planar_and_straight_curves_have_no_writhe(rng: np.random.Generator) -> None:
    t = 2 * np.pi * np.arange(60) / 60
    wavy = np.stack([(2 + np.cos(5 * t)) * np.cos(t), (2 + np.cos(5 * t)) * np.sin(t), 0 * t], axis=-1)
    assert float(analysis.writhe(wavy, closed=True)) == 0
    turned = wavy @ random_rotation(rng) + rng.normal(size=3)
    assert abs(float(analysis.writhe(turned, closed=True))) < tol.LINKING
    assert abs(float(analysis.writhe(turned))) < tol.LINKING
    line = np.linspace(0, 1, 40)[:, None] * rng.normal(size=3)
    assert abs(float(analysis.writhe(line))) < tol.LINKING
    assert float(analysis.writhe(wavy[:3], closed=True)) == 0
    assert float(analysis.writhe(wavy[:2])) == 0


@pytest.mark.parametrize("closed", [False, True])
def test_writhe_by_quadrature_and_in_many_directions(closed: bool, rng: np.random.Generator) -> None:
    knot = torus_knot(2, 3, 36) + rng.normal(scale=0.05, size=(36, 3))
    found = float(analysis.writhe(knot, closed=closed))
    apart = not_neighbours(36 if closed else 35, closed)
    by_quadrature = quadrature(knot, knot, closed, 16, apart)
    assert found == pytest.approx(by_quadrature, abs=tol.GAUSS_QUADRATURE)
    seen = [crossings(knot, knot, closed, random_rotation(rng), np.triu(apart)) for _ in range(2000)]
    error = float(np.std(seen) / np.sqrt(len(seen)))
    assert error < 0.05
    assert abs(found - np.mean(seen)) < tol.SIGMAS * error
    assert found > 2, "a right-handed trefoil"


def test_writhe_of_a_smooth_helix_by_one_integral() -> None:
    rise, length = 0.4, 12 * np.pi

    def density(u: float) -> float:
        r = np.array([np.cos(u) - 1, np.sin(u), rise * u])
        volume = r @ np.cross([-np.sin(u), np.cos(u), rise], [0, 1, rise])
        return float((length - u) * volume / (r @ r) ** 1.5) / (2 * np.pi)

    wanted = integrate.quad(density, 1e-6, length, limit=400, epsabs=1e-10)[0]

    def polygon(count: int) -> float:
        t = np.linspace(0, length, count + 1)
        return float(analysis.writhe(np.stack([np.cos(t), np.sin(t), rise * t], axis=-1)))

    coarse, fine = polygon(200), polygon(400)
    assert (coarse - wanted) / (fine - wanted) == pytest.approx(4, rel=0.05), "second order in the segments"
    assert (4 * fine - coarse) / 3 == pytest.approx(wanted, abs=tol.EXTRAPOLATED_WRITHE)


def test_a_closed_ribbon_is_linked_by_its_twist_and_writhe() -> None:
    """A knotted core and an edge that turns about it, unevenly: `Lk = Tw + Wr` (Calugareanu, White, Fuller)."""

    def core_and_edge(points: int, turns: int) -> tuple[Array, Array]:
        t = 2 * np.pi * np.arange(points) / points
        core = torus_knot(2, 3, points)
        tangent = derivative(core)
        tangent /= np.linalg.norm(tangent, axis=1)[:, None]
        normal = np.stack([np.cos(2 * t) * np.cos(3 * t), np.sin(2 * t) * np.cos(3 * t), -np.sin(3 * t)], axis=-1)
        normal -= (normal * tangent).sum(axis=1, keepdims=True) * tangent
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        turn = (turns * t + 0.5 * np.sin(t))[:, None]
        return core, np.cos(turn) * normal + np.sin(turn) * np.cross(tangent, normal)

    def derivative(x: Array) -> Array:
        waves = 1j * np.fft.rfftfreq(len(x), 1 / len(x))[:, None]
        return np.fft.irfft(waves * np.fft.rfft(x, axis=0), n=len(x), axis=0)

    for turns in (-2, 0, 3):
        core, edge = core_and_edge(401, turns)
        tangent = derivative(core) / np.linalg.norm(derivative(core), axis=1)[:, None]
        twist = float((tangent * np.cross(edge, derivative(edge))).sum() / 401)
        linked = float(analysis.linking(core, core + 0.2 * edge, closed=True))
        assert linked == pytest.approx(round(linked), abs=tol.LINKING)
        coarse, fine = (float(analysis.writhe(core_and_edge(n, turns)[0], closed=True)) for n in (200, 400))
        assert linked - twist == pytest.approx((4 * fine - coarse) / 3, abs=tol.EXTRAPOLATED_WRITHE)


# --- frames, blocks and input ---------------------------------------------------------------------------------------


def test_frames_and_blocks_change_nothing(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    p, q = (np.array([random_chain(rng, n) for _ in range(7)]) for n in (70, 40))
    before = p.copy(), q.copy()
    linked, bent = analysis.linking(p, q, closed=True), analysis.writhe(p, closed=True)
    assert linked.shape == bent.shape == (7,)
    np.testing.assert_allclose(analysis.linking(p, q[2], closed=True)[2], linked[2], atol=tol.LINKING)
    assert np.ndim(analysis.linking(p[0], q[0])) == np.ndim(analysis.writhe(p[0])) == 0
    monkeypatch.setattr(entanglement, "_PAIRS", 100)
    monkeypatch.setattr(entanglement, "_ROWS", 5)
    np.testing.assert_allclose(analysis.linking(p, q, closed=True), linked, atol=tol.LINKING)
    np.testing.assert_allclose(analysis.writhe(p, closed=True), bent, atol=tol.LINKING)
    np.testing.assert_array_equal(p, before[0])
    np.testing.assert_array_equal(q, before[1])
    q[4, 30] = (p[4, 60] + p[4, 61]) / 2
    with pytest.raises(ValueError, match="segments 60 and 29 do in frame 4"):
        analysis.linking(p, q)
    p[4, 66] = (p[4, 60] + p[4, 61]) / 2
    with pytest.raises(ValueError, match="segments 60 and 65 do in frame 4"):
        analysis.writhe(p)


@pytest.mark.parametrize("function", [analysis.writhe, lambda p: analysis.linking(p, p[:, ::-1] * MIRROR + 0.1)])
@pytest.mark.parametrize(("frames", "beads"), [(1, 1500), (150, 100)])
def test_memory_does_not_grow_with_the_pairs(
    frames: int, beads: int, function: Callable[[Array], Array], rng: np.random.Generator
) -> None:
    p = np.array([random_chain(rng, beads) for _ in range(frames)])
    tracemalloc.start()
    function(p)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20e6  # one array of all pairs takes 12 or 18 MB, and some twenty are needed


def trajectory(x: Array, lengths: tuple[int, ...]) -> mdtraj.Trajectory:
    topology = mdtraj.Topology()
    for length in lengths:
        residue = topology.add_residue("FIL", topology.add_chain())
        for _ in range(length):
            topology.add_atom("B", None, residue)
    return mdtraj.Trajectory(x, topology)


def test_trajectories_are_taken(rng: np.random.Generator) -> None:
    x = np.array([random_chain(rng, 30) for _ in range(5)]).astype(np.float32)
    both = trajectory(x, (18, 12))
    p, q = analysis.split_chains(both)
    np.testing.assert_array_equal(p, x[:, :18])
    np.testing.assert_array_equal(q, x[:, 18:])
    one = both.atom_slice(range(18))
    np.testing.assert_array_equal(analysis.linking(one, q), analysis.linking(p, q))
    np.testing.assert_array_equal(analysis.writhe(one), analysis.writhe(p))
    np.testing.assert_array_equal(analysis.contacts(one, q, distance=2.0), analysis.contacts(p, q, distance=2.0))
    with pytest.raises(ValueError, match="must hold one chain, but holds 2: take them apart"):
        analysis.writhe(both)
    with pytest.raises(TypeError, match="must be an mdtraj.Trajectory, but is a ndarray"):
        analysis.split_chains(x)


@pytest.mark.parametrize(
    ("curve", "message"),
    [
        (np.zeros((4, 2)), "must have shape (points, 3) or (frames, points, 3), but has shape (4, 2)"),
        (np.zeros((2, 3, 4, 3)), "but has shape (2, 3, 4, 3)"),
        (np.zeros((0, 4, 3)), "but has shape (0, 4, 3)"),
        (SQUARE[:2], "must have at least 3 points, but has 2"),
        (SQUARE * [1, np.nan, 1], "must be finite, but is nan at index (0, 1)"),
        (SQUARE[[0, 1, 1, 2]], "points 1 and 2 coincide in frame 0"),
        (SQUARE[[0, 1, 2, 3, 0]], "points 4 and 0 coincide in frame 0"),
        (np.array([SQUARE, SQUARE[[0, 1, 2, 2]]]), "points 2 and 3 coincide in frame 1"),
    ],
)
def test_broken_curves_are_refused(curve: Array, message: str) -> None:
    with pytest.raises(ValueError, match="Argument `curve`.*" + re.escape(message)):
        analysis.writhe(curve, closed=True)
    with pytest.raises(ValueError, match="Argument `first`.*" + re.escape(message)):
        analysis.linking(curve, HOOKED, closed=True)
    with pytest.raises(ValueError, match="Argument `second`.*" + re.escape(message)):
        analysis.linking(HOOKED, curve, closed=(False, True))


def test_curves_are_closed_or_not() -> None:
    for closed in ((True, False, True), [True, False], np.array([True, False]), (1, 0), "no"):
        with pytest.raises(ValueError, match="`closed` must be True, False or a tuple of two of them, but is"):
            analysis.linking(SQUARE, HOOKED, closed=closed)  # type: ignore[arg-type]
    for single in ((True, False), 1, "no"):
        with pytest.raises(ValueError, match="`closed` must be True or False, but is"):
            analysis.writhe(SQUARE, closed=single)  # type: ignore[arg-type]


def test_curves_of_other_frames_are_refused() -> None:
    for function in (analysis.linking, lambda p, q: analysis.contacts(p, q, distance=1.0)):
        with pytest.raises(ValueError, match="Argument `second` must have 2 frames or one, but has 3"):
            function(np.array([SQUARE] * 2), np.array([HOOKED] * 3))


# --- contacts -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("apart", "closed"), [(None, None), (1, False), (4, True), (10, False), (25, True)])
def test_contacts_within_a_chain_are_those_of_all_pairs(apart: Any, closed: Any, rng: np.random.Generator) -> None:
    x = np.array([random_chain(rng, 40) for _ in range(6)])
    wanted = []
    for frame in x:
        count = 0
        for i, j in itertools.combinations(range(40), 2):
            along = min(j - i, 40 - j + i) if closed else j - i
            count += along >= (apart or 2) and np.linalg.norm(frame[i] - frame[j]) <= 3.0
        wanted.append(count)
    found = analysis.contacts(x, distance=3.0, apart=apart, closed=closed)
    np.testing.assert_array_equal(found, wanted)
    assert found.dtype.kind == "i"
    assert (apart == 25) == (not any(wanted))
    assert analysis.contacts(x[0], distance=3.0, apart=apart, closed=closed) == wanted[0]


def test_contacts_of_two_chains_are_those_of_all_pairs(rng: np.random.Generator) -> None:
    x, y = (np.array([random_chain(rng, n) for _ in range(6)]) for n in (40, 25))
    wanted = (np.linalg.norm(x[:, :, None] - y[:, None], axis=-1) <= 3.0).sum(axis=(1, 2))
    assert len(set(wanted)) > 2
    np.testing.assert_array_equal(analysis.contacts(x, y, distance=3.0), wanted)
    np.testing.assert_array_equal(analysis.contacts(y, x, distance=3.0), wanted)
    fixed = (np.linalg.norm(x[:, :, None] - y[:1, None], axis=-1) <= 3.0).sum(axis=(1, 2))
    np.testing.assert_array_equal(analysis.contacts(x, y[0], distance=3.0), fixed)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"distance": 0.0}, "`distance` must be positive"),
        ({"distance": np.nan}, "`distance` must be finite"),
        ({"distance": 1.0, "apart": 0}, "`apart` must be at least 1"),
        ({"distance": 1.0, "second": HOOKED, "apart": 2}, "`apart` must be left out for two chains"),
        ({"distance": 1.0, "second": HOOKED, "closed": False}, "`closed` must be left out for two chains"),
        ({"distance": 1.0, "second": HOOKED[:, :2]}, r"`second` must have shape"),
    ],
)
def test_contacts_refuse_what_has_no_meaning(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        analysis.contacts(SQUARE, **options)


# --- nearest --------------------------------------------------------------------------------------------------------


def closest(a: Array, b: Array, c: Array, d: Array) -> float:
    """Of segments ab and cd, by SciPy: a convex function of two numbers."""
    from scipy.optimize import lsq_linear

    found = lsq_linear(np.stack([b - a, c - d], axis=1), c - a, bounds=(0, 1), tol=1e-15)
    return float(np.linalg.norm(found.fun))


@pytest.mark.parametrize("closed", [False, True])
def test_nearest_is_the_smallest_of_all_segments(closed: bool, rng: np.random.Generator) -> None:
    for _ in range(20):
        x, y = rng.normal(size=(5, 3)), rng.normal(size=(4, 3)) + np.array([1.5, 0, 0])
        count = 0 if closed else 1
        pairs = itertools.product(range(5 - count), range(4 - count))
        wanted = min(closest(x[i], x[(i + 1) % 5], y[j], y[(j + 1) % 4]) for i, j in pairs)
        assert analysis.nearest(x, y, closed=closed) == pytest.approx(wanted, abs=1e-7)
        assert analysis.nearest(y, x, closed=closed) == pytest.approx(wanted, abs=1e-7)
    frames = np.stack([x, x + 9.0])
    np.testing.assert_allclose(
        analysis.nearest(frames, y), [analysis.nearest(x, y), analysis.nearest(x + 9.0, y)], rtol=1e-12
    )


@pytest.mark.parametrize(
    ("second", "wanted"),
    [
        ([[0.0, 1, 0], [4, 1, 0]], 1.0),  # side by side, and not quite
        ([[0.0, 1, 0], [4, 1, 1e-13]], 1.0),
        ([[6.0, 0, 0], [9, 0, 0]], 2.0),  # in one line
        ([[2.0, 0, 0], [9, 0, 0]], 0.0),
        ([[6.0, 0, 3], [9, 0, 3]], 13**0.5),  # beyond an end
        ([[1.0, -1, 2], [1, 1, 2]], 2.0),  # crossing between beads, where none is near
        ([[1.0, 0, 2], [1, 0, 2]], 2.0),  # a point
    ],
)
def test_nearest_of_two_segments(second: list[list[float]], wanted: float) -> None:
    first = [[0.0, 0, 0], [4, 0, 0]]
    assert analysis.nearest(first, second) == pytest.approx(wanted, abs=1e-12)
    assert analysis.nearest(second, first) == pytest.approx(wanted, abs=1e-12)


def test_nearest_refuses_curves_of_one_point_and_other_frames() -> None:
    with pytest.raises(ValueError, match="`second` must have"):
        analysis.nearest(SQUARE, SQUARE[:1])
    with pytest.raises(ValueError, match="`second` must have 3 frames or one, but has 2"):
        analysis.nearest(np.stack([SQUARE] * 3), np.stack([SQUARE] * 2))
