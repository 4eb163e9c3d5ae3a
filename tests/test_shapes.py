"""Rest shapes: lengths, angles, handedness, closure, planes."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import tolerances as tol
from conftest import NM, Array, magnitudes
from hypothesis import given
from hypothesis import strategies as st
from openmm import unit

from openmm_filament import shapes
from openmm_filament.geometry import bending_angles, chain_indices, dihedrals, segments


def nm(shape: unit.Quantity) -> Array:
    return shape.value_in_unit(NM)


def lengths(x: Array, closed: bool = False) -> Array:
    return np.linalg.norm(segments(x, closed), axis=1)


def bends(x: Array, closed: bool = False) -> Array:
    return bending_angles(x[chain_indices(len(x), 3, closed)])


def torsions(x: Array) -> Array:
    return dihedrals(x[chain_indices(len(x), 4)])


@given(st.integers(1, 50), magnitudes())
def test_a_line_is_straight_along_z(n: int, step: float) -> None:
    x = nm(shapes.line(n, step * NM))
    assert x.shape == (n + 1, 3)
    np.testing.assert_array_equal(x[0], 0)
    np.testing.assert_array_equal(x[:, :2], 0)
    np.testing.assert_allclose(np.diff(x[:, 2]), step, rtol=tol.ROUNDING)
    np.testing.assert_array_equal(bends(x), 0)


@given(st.integers(3, 60), magnitudes())
def test_a_ring_closes_on_itself(n: int, step: float) -> None:
    x = nm(shapes.ring(n, step * NM))
    assert x.shape == (n, 3)
    np.testing.assert_allclose(lengths(x, closed=True), step, rtol=tol.ROUNDING)
    np.testing.assert_allclose(bends(x, closed=True), 2 * np.pi / n, rtol=tol.ROUNDING)
    np.testing.assert_array_equal(x[:, 2], 0)


@given(st.integers(8, 60), magnitudes(0.1, 10), magnitudes(0.1, 10), st.floats(0.2, 2), st.booleans())
def test_a_helix_has_its_radius_pitch_and_hand(n: int, radius: float, pitch: float, turns: float, left: bool) -> None:
    x = nm(shapes.helix(n, radius=radius * NM, pitch=pitch * NM, turns=turns, left_handed=left))
    assert x.shape == (n + 1, 3)
    np.testing.assert_allclose(np.hypot(x[:, 0], x[:, 1]), radius, rtol=tol.ROUNDING)
    np.testing.assert_allclose(x[0], [radius, 0, 0])
    assert x[-1, 2] - x[0, 2] == pytest.approx(turns * pitch, rel=tol.ROUNDING)
    assert (np.sign(torsions(x)) == (-1 if left else 1)).all()
    angle = np.unwrap(np.arctan2(x[:, 1], x[:, 0]))[-1]
    assert angle == pytest.approx((-1 if left else 1) * 2 * np.pi * turns, rel=tol.ROUNDING)
    chord = np.hypot(2 * radius * np.sin(np.pi * turns / n), turns * pitch / n)
    np.testing.assert_allclose(lengths(x), chord, rtol=tol.ROUNDING)


def test_a_fine_helix_has_the_curvature_and_torsion_of_the_curve() -> None:
    radius, pitch, n = 2.0, 3.0, 4000
    x = nm(shapes.helix(n, radius=radius * NM, pitch=pitch * NM, turns=1))
    c = pitch / (2 * np.pi)
    step = lengths(x)[0]
    assert bends(x).mean() / step == pytest.approx(radius / (radius**2 + c**2), rel=1e-5)
    assert torsions(x).mean() / step == pytest.approx(c / (radius**2 + c**2), rel=1e-5)


def test_left_and_right_are_mirror_images() -> None:
    right, left = (
        nm(shapes.helix(20, radius=1 * NM, pitch=2 * NM, turns=1.5, left_handed=hand)) for hand in (False, True)
    )
    np.testing.assert_array_equal(left, right * [1, -1, 1])
    np.testing.assert_array_equal(torsions(left), -torsions(right))


@given(st.integers(1, 50), magnitudes(), st.floats(0, 1), st.integers(0, 2**32))
def test_a_planar_walk_lies_in_the_plane_and_starts_along_x(n: int, step: float, bend: float, seed: int) -> None:
    x = nm(shapes.planar_walk(n, step * NM, bend=bend * unit.radian, seed=seed))
    assert x.shape == (n + 1, 3)
    np.testing.assert_array_equal(x[:, 2], 0)
    np.testing.assert_array_equal(x[0], 0)
    np.testing.assert_allclose(x[1], [step, 0, 0])
    np.testing.assert_allclose(lengths(x), step, rtol=tol.ROUNDING * n)
    np.testing.assert_array_equal(x, nm(shapes.planar_walk(n, step * NM, bend=bend * unit.radian, seed=seed)))


def test_the_turns_of_a_planar_walk_have_the_asked_spread() -> None:
    x = nm(shapes.planar_walk(4001, 1 * NM, bend=10 * unit.degree, seed=5))
    z = (np.mean(bends(x) ** 2) / np.radians(10) ** 2 - 1) / np.sqrt(2 / 4000)
    assert abs(z) < 4
    assert not np.array_equal(x, nm(shapes.planar_walk(4001, 1 * NM, bend=10 * unit.degree, seed=6)))


def test_a_walk_without_bends_is_straight() -> None:
    x = nm(shapes.planar_walk(9, 1 * NM, bend=0 * unit.radian, seed=1))
    np.testing.assert_array_equal(x, np.arange(10)[:, None] * [1, 0, 0])


SHAPES: dict[str, Callable[..., Any]] = {
    "segments line": lambda segments: shapes.line(segments, 1 * NM),
    "segment_length line": lambda segment_length: shapes.line(3, segment_length),
    "beads ring": lambda beads: shapes.ring(beads, 1 * NM),
    "segment_length ring": lambda segment_length: shapes.ring(3, segment_length),
    "segments helix": lambda segments: shapes.helix(segments, radius=1 * NM, pitch=1 * NM, turns=1),
    "radius helix": lambda radius: shapes.helix(3, radius=radius, pitch=1 * NM, turns=1),
    "pitch helix": lambda pitch: shapes.helix(3, radius=1 * NM, pitch=pitch, turns=1),
    "segments walk": lambda segments: shapes.planar_walk(segments, 1 * NM, bend=1 * unit.radian, seed=1),
    "segment_length walk": lambda segment_length: shapes.planar_walk(3, segment_length, bend=1 * unit.radian, seed=1),
}


@pytest.mark.parametrize("key", [key for key in SHAPES if key.startswith(("segments", "beads"))])
@pytest.mark.parametrize("bad", [0, -1, 2.0, None, True, "3"])
def test_a_count_that_is_no_positive_whole_number_is_refused(key: str, bad: object) -> None:
    name = key.split(maxsplit=1)[0]
    with pytest.raises((ValueError, TypeError), match=f"`{name}` must be .* but is {re.escape(repr(bad))}"):
        SHAPES[key](**{name: bad})


@pytest.mark.parametrize("key", [key for key in SHAPES if not key.startswith(("segments", "beads"))])
def test_lengths_must_be_positive_and_have_their_unit(key: str) -> None:
    name = key.split(maxsplit=1)[0]
    for bad in (0.0, -1.5, np.nan, np.inf):
        with pytest.raises(ValueError, match=f"`{name}` must be (positive|finite), but is {bad}"):
            SHAPES[key](**{name: bad * NM})
    with pytest.raises(TypeError, match=f"`{name}` must be a Quantity of length"):
        SHAPES[key](**{name: 1.0})
    with pytest.raises(TypeError, match=f"`{name}` must have a unit of length"):
        SHAPES[key](**{name: 1.0 * unit.second})
    with pytest.raises(ValueError, match=rf"`{name}` must have shape \(\)"):
        SHAPES[key](**{name: np.ones(2) * NM})


def test_a_ring_needs_three_beads_and_a_helix_some_turns() -> None:
    with pytest.raises(ValueError, match="`beads` must be at least 3, but is 2"):
        shapes.ring(2, 1 * NM)
    for bad in (0.0, -1.0):
        with pytest.raises(ValueError, match=f"`turns` must be positive, but is {bad}"):
            shapes.helix(9, radius=1 * NM, pitch=1 * NM, turns=bad)
    with pytest.raises(ValueError, match=r"`bend` must not be negative, but is -0.1\."):
        shapes.planar_walk(9, 1 * NM, bend=-0.1 * unit.radian, seed=1)
