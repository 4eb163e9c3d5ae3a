"""3D pictures: what is drawn stands where it should, at the scale that the picture says; and what is refused."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import mdtraj
import numpy as np
import pytest
import tolerances as tol
from conftest import NM, Array, random_chain, random_rotation
from numpy.typing import NDArray
from openmm import unit

import openmm_filament as of
from openmm_filament import _drawing as drawing
from openmm_filament import _opengl

SMALL = (320, 180)
RADIUS = 0.2 * NM
LINE = np.array([[0.0, 0, 0], [4, 0, 0], [8, 0, 0]])
BARS = [step * 10.0**power for power in range(-6, 12) for step in (1, 2, 5)]


def needs_a_window() -> None:
    pytest.importorskip("pyvista")
    if not of.rendering.available():
        pytest.skip("no OpenGL here, with or without a display")


@pytest.fixture(name="picture")
def _picture(tmp_path: Path) -> Callable[..., NDArray[np.int16]]:
    """Draws a still and reads it back: (height, width, 3)."""
    needs_a_window()
    from PIL import Image

    def draw(positions: Any, **options: Any) -> NDArray[np.int16]:
        options = {"radius": RADIUS, "size": SMALL, **options}
        return np.asarray(Image.open(of.rendering.still(positions, tmp_path / "still.png", **options)), dtype=np.int16)

    return draw


def inked(image: NDArray[np.int16]) -> NDArray[np.bool_]:
    """Pixels that are not background, without the strips of text and scale bar."""
    height = len(image)
    mask: NDArray[np.bool_] = (image < 250).any(axis=2)
    mask[: height // 10], mask[-height // 6 :] = False, False
    return mask


def box(mask: NDArray[np.bool_]) -> tuple[int, int, int, int]:
    """First and last row and column with ink."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return int(rows[0]), int(rows[-1]), int(columns[0]), int(columns[-1])


def likeness(a: NDArray[np.bool_], b: NDArray[np.bool_]) -> float:
    """Common ink over all ink."""
    return float((a & b).sum() / (a | b).sum())


# Where the viewer stands --------------------------------------------------------------------------------------------


def test_principal_axes_turn_with_the_shape(rng: np.random.Generator) -> None:
    cloud = rng.normal(size=(200, 3)) * [5.0, 2.0, 0.5]
    turn = random_rotation(rng)
    spreads, axes = drawing.principal_axes(cloud)
    turned_spreads, turned = drawing.principal_axes(cloud @ turn.T)
    np.testing.assert_allclose(turned_spreads, spreads, rtol=tol.ROUNDING)
    np.testing.assert_allclose(np.abs(turned @ turn), np.abs(axes), atol=tol.ANGLE)
    np.testing.assert_allclose(np.std(cloud @ axes.T, axis=0), spreads, rtol=tol.ROUNDING)
    assert np.linalg.det(turned) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        (of.shapes.line(5, 1 * NM), [[0, 0, 1], [1, 0, 0], [0, 1, 0]]),
        (of.shapes.ring(17, 1 * NM), [[1, 0, 0], [0, 1, 0], [0, 0, 1]]),
        (np.zeros((2, 3)) * NM, np.eye(3)),
    ],
)
def test_directions_that_the_shape_leaves_open_follow_the_coordinates(shape: unit.Quantity, expected: Any) -> None:
    np.testing.assert_allclose(drawing.principal_axes(shape.value_in_unit(NM))[1], expected, atol=tol.ANGLE)


@pytest.mark.parametrize("stretch", [(1, 1, 1), (9, 1, 1), (1, 1, 0), (1, 1e-3, 0), (1, 0, 0), (0, 0, 0)])
@pytest.mark.parametrize("plane", [None, "xy", "xz", "yz"])
def test_the_view_holds_the_shape_and_is_filled_by_it(
    rng: np.random.Generator, stretch: tuple[float, ...], plane: str | None
) -> None:
    points, reach, (width, height) = random_chain(rng, 30) * stretch, 0.3, (640, 360)
    axes = drawing.look(points, plane)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=tol.ROUNDING)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    view = drawing.stand(points, axes, reach, (width, height))
    pixels = view.pixels(points)[:, :2]
    room = reach / view.nm_per_pixel
    low, high = pixels.min(axis=0) - room, pixels.max(axis=0) + room
    assert (low >= [-0.45 * width - 1e-6, (0.17 - 0.5) * height - 1e-6]).all()
    assert (high <= [0.45 * width + 1e-6, (0.5 - 0.13) * height + 1e-6]).all()
    assert np.max((high - low) / [0.9 * width, 0.7 * height]) == pytest.approx(1.0)
    distances = np.linalg.norm(view.pixels(points)[:, None] - view.pixels(points), axis=2)
    np.testing.assert_allclose(
        distances * view.nm_per_pixel, np.linalg.norm(points[:, None] - points, axis=2), atol=tol.ANGLE
    )


# Surfaces -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["spheres", "cylinders"])
def test_surfaces_look_outwards_and_keep_their_radius(kind: str, rng: np.random.Generator) -> None:
    chain = random_chain(rng, 5)
    if kind == "spheres":
        points, normals = drawing.spheres(chain, np.full(5, 0.3), 9, 16)
    else:
        points, normals = drawing.cylinders(chain, True, 0.3, 12)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1.0, rtol=tol.ROUNDING)
    corners = drawing.faces(*points.shape[:3])
    assert len(corners) == points.shape[0] * (points.shape[1] - 1) * points.shape[2]
    flat, outward = points.reshape(-1, 3), normals.reshape(-1, 3)
    crossed = np.cross(flat[corners[:, 2]] - flat[corners[:, 0]], flat[corners[:, 3]] - flat[corners[:, 1]])
    assert (np.einsum("ij,ij->i", crossed, outward[corners].mean(axis=1)) > 0).all()
    ends = np.roll(chain, -1, axis=0) if kind == "cylinders" else chain
    for patch, start, end in zip(points.reshape(5, -1, 3), chain, ends, strict=True):
        along = (end - start) / max(float(np.linalg.norm(end - start)), 1e-300)
        away = patch - start
        np.testing.assert_allclose(np.linalg.norm(away - np.outer(away @ along, along), axis=1), 0.3, rtol=1e-9)


def test_a_segment_without_length_is_drawn_without_nan() -> None:
    assert np.isfinite(drawing.cylinders(np.zeros((3, 3)), False, 1.0, 8)[0]).all()


# Labels -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("width", "length", "label"),
    [(3.0, 2.0, "2 nm"), (999.9, 500.0, "500 nm"), (1.4e8, 1e8, "100 mm"), (2.5e9, 2e9, "2 m"), (0.06, 0.05, "50 pm")],
)
def test_the_scale_bar_is_a_round_length(width: float, length: float, label: str) -> None:
    found, text = drawing.bar(width)
    assert found == pytest.approx(length)
    assert text == label


@pytest.mark.parametrize(
    ("times", "labels"),
    [
        ([0.0, 5e7, 1e8], ["0 µs", "50 µs", "100 µs"]),
        ([0.0, 2.5e8, 5e9], ["0.0 ms", "0.2 ms", "5.0 ms"]),
        ([0.0, 2.5e8, 5e8, 7.5e8, 1e9], ["0.00 ms", "0.25 ms", "0.50 ms", "0.75 ms", "1.00 ms"]),
        ([0.0], ["0.0 fs"]),
        ([7.0, 7.0], ["7.0 ps", "7.0 ps"]),
    ],
)
def test_times_have_the_decimals_that_tell_frames_apart(times: list[float], labels: list[str]) -> None:
    found = drawing.time_labels(np.array(times))
    assert [label.split()[1] for label in found] == [label.split()[1] for label in labels]
    if len(set(times)) == len(times):
        assert len(set(found)) == len(times)
    for label, expected in zip(found, labels, strict=True):
        assert float(label.split()[0]) == pytest.approx(float(expected.split()[0]), abs=0.06)


def test_thin_tubes_are_thickened_and_thick_ones_are_not() -> None:
    assert drawing.magnification(4.0, 20.0, 540) == 1.0
    factor = drawing.magnification(0.1, 20.0, 540)
    assert 3.24 <= 0.1 * factor <= 3.24 * 1.1
    assert factor == float(f"{factor:.2g}")
    assert drawing.magnification(0.1, 8.0, 540) == 20.0


# Pictures -----------------------------------------------------------------------------------------------------------


def test_a_ring_is_drawn_round_and_the_scale_bar_measures_it(picture: Callable[..., NDArray[np.int16]]) -> None:
    ring = of.shapes.ring(24, 1 * NM)
    image = picture(ring, closed=True, plane="xy", bead_radius=RADIUS, size=(640, 360))
    mask = inked(image)
    top, bottom, left, right = box(mask)
    assert abs((bottom - top) - (right - left)) <= 2
    cut = mask[top : bottom + 1, left : right + 1]
    assert likeness(cut, cut[:, ::-1]) > tol.MIRRORED
    assert likeness(cut, cut[::-1]) > tol.MIRRORED
    rows, columns = np.ogrid[top : bottom + 1, left : right + 1]
    inside = np.hypot(rows - (top + bottom) / 2, columns - (left + right) / 2) < 0.85 * (right - left) / 2
    assert not cut[inside].any()
    strip = (image[310:, :200] < 128).all(axis=2)
    measured = strip.any(axis=0).sum() if strip.any() else 0
    longest = max(int(row.sum()) for row in strip)
    outer = 2 * float(np.linalg.norm(ring[0].value_in_unit(NM))) + 0.4
    in_nm = (longest - 1) * outer / (right - left + 1)
    assert measured
    assert min(abs(in_nm / length - 1) for length in BARS) < tol.SCALE_BAR


def test_beads_are_where_they_should_be_and_nothing_is_cut_off(
    picture: Callable[..., NDArray[np.int16]], rng: np.random.Generator
) -> None:
    chain = random_chain(rng, 12)
    image = picture(chain * NM, bead_radius=2 * RADIUS)
    mask = (image < 250).any(axis=2)
    view = drawing.stand(chain, drawing.look(chain), 0.4, SMALL)
    right, up, _ = view.pixels(chain).T
    columns, rows = np.round(SMALL[0] / 2 + right).astype(int), np.round(SMALL[1] / 2 - up).astype(int)
    assert mask[rows, columns].all()
    assert not np.concatenate([mask[0], mask[-1], mask[:, 0], mask[:, -1]]).any()


def test_a_closed_chain_has_one_segment_more(picture: Callable[..., NDArray[np.int16]]) -> None:
    square = np.array([[0.0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0]]) * NM
    opened, closed = (inked(picture(square, closed=c, plane="xy")) for c in (False, True))
    top, bottom, left, _ = box(opened)
    gap = np.s_[(top + bottom) // 2, left : left + 8]
    assert not opened[gap].any()
    assert closed[gap].any()


def test_each_filament_has_its_colour(picture: Callable[..., NDArray[np.int16]]) -> None:
    image = picture([LINE * NM, (LINE + np.array([0, 2, 0])) * NM], plane="xy")
    mask = inked(image)
    top, bottom, _, _ = box(mask)
    upper, lower = image[: (top + bottom) // 2], image[(top + bottom) // 2 :]
    red, blue = (
        p[..., 0][m].mean() - p[..., 2][m].mean()
        for p, m in zip((upper, lower), np.array_split(mask, [(top + bottom) // 2]), strict=True)
    )
    assert red > 20
    assert blue < -20


def test_a_heavy_bead_may_be_larger(picture: Callable[..., NDArray[np.int16]]) -> None:
    mask = inked(picture(LINE * NM, plane="xy", bead_radius=[0.3, 0.9, 0.3] * NM))
    thick = mask.sum(axis=0)
    _, _, left, right = box(mask)
    middle = thick[(left + right) // 2]
    assert middle == pytest.approx(3 * thick[left : left + 20].max(), abs=3)


def test_what_is_drawn_is_not_changed(picture: Callable[..., NDArray[np.int16]]) -> None:
    positions = np.array(LINE)
    positions.flags.writeable = False
    picture(unit.Quantity(positions, NM), title="a line")


# Films --------------------------------------------------------------------------------------------------------------


def swing(frames: int = 8) -> Array:
    """A chain of three beads whose middle goes up and down once."""
    phase = 2 * np.pi * np.arange(frames) / frames
    moving = np.tile(LINE, (frames, 1, 1))
    moving[:, 1, 1] = np.sin(phase)
    return moving


def film(path: Path) -> NDArray[np.int16]:
    """The frames of a film, (frames, height, width, 3)."""
    if path.suffix == ".gif":
        from PIL import Image, ImageSequence

        with Image.open(path) as image:
            return np.stack([np.asarray(f.convert("RGB"), dtype=np.int16) for f in ImageSequence.Iterator(image)])
    import imageio_ffmpeg

    decode = [
        imageio_ffmpeg.get_ffmpeg_exe(),
        "-v",
        "error",
        "-i",
        str(path),
        "-f",
        "rawvideo",
        "-pix_fmt",
        "rgb24",
        "-",
    ]
    raw = subprocess.run(decode, check=True, capture_output=True, stdin=subprocess.DEVNULL).stdout
    return np.frombuffer(raw, np.uint8).reshape(-1, SMALL[1], SMALL[0], 3).astype(np.int16)


@pytest.mark.parametrize("suffix", ["mp4", "gif"])
def test_a_film_has_every_frame_and_they_differ(suffix: str, tmp_path: Path) -> None:
    needs_a_window()
    path = of.rendering.animate(
        swing() * NM, tmp_path / f"film.{suffix}", times=np.arange(8) * unit.nanosecond, radius=RADIUS, size=SMALL
    )
    frames = film(path)
    assert frames.shape == (8, SMALL[1], SMALL[0], 3)
    assert all(likeness(inked(a), inked(b)) < tol.MOVED_PICTURE for a, b in pairwise(frames))
    assert likeness(inked(frames[1]), inked(frames[3])) > tol.SAME_PICTURE  # sin(pi - x) = sin(x)
    height = SMALL[1] // 10
    assert (np.abs(frames[1, :height] - frames[3, :height]) > 60).any()  # the times differ
    assert list(tmp_path.iterdir()) == [path]


def test_exaggeration_multiplies_displacements(tmp_path: Path) -> None:
    needs_a_window()
    small = LINE + 0.01 * (swing() - LINE)
    options: dict[str, Any] = {"radius": RADIUS, "size": SMALL}
    large = film(of.rendering.animate(swing() * NM, tmp_path / "a.gif", **options))
    told = film(of.rendering.animate(small * NM, tmp_path / "b.gif", rest=LINE * NM, exaggerate=100.0, **options))
    for a, b in zip(large, told, strict=True):
        assert likeness(inked(a), inked(b)) > tol.SAME_PICTURE
    assert (inked(large[0]) ^ (told[0] < 250).any(axis=2))[-SMALL[1] // 6 :].any()  # and the picture says so


def test_a_trajectory_is_drawn_like_its_positions(tmp_path: Path) -> None:
    needs_a_window()
    topology = mdtraj.Topology()
    for _ in range(2):
        residue = topology.add_residue("BEA", topology.add_chain())
        for _ in range(3):
            topology.add_atom("C", mdtraj.element.carbon, residue)
    first, second = swing(3), swing(3) + np.array([0.0, 3.0, 0.0])
    trajectory = mdtraj.Trajectory(np.concatenate([first, second], axis=1), topology, time=[0.0, 5.0, 10.0])
    options: dict[str, Any] = {"radius": RADIUS, "size": SMALL}
    a = of.rendering.animate(trajectory, tmp_path / "a.gif", **options)
    times = [0.0, 5.0, 10.0] * unit.picosecond
    b = of.rendering.animate([first * NM, second * NM], tmp_path / "b.gif", times=times, **options)
    assert (np.abs(film(a) - film(b)) > 40).mean() < 1e-3  # a trajectory has single precision


def test_a_film_that_stops_leaves_the_old_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    needs_a_window()
    path = tmp_path / "film.gif"
    path.write_text("old")

    def stop(self: object, i: int) -> list[Array]:
        if i == 2:
            raise KeyboardInterrupt
        return [np.zeros((3, 3))]

    monkeypatch.setattr(of.rendering._Scene, "frame", stop)
    with pytest.raises(KeyboardInterrupt):
        of.rendering.animate(swing() * NM, path, radius=RADIUS, size=SMALL)
    assert [p.read_text() for p in tmp_path.iterdir()] == ["old"]


# What is missing ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("package", ["pyvista", "imageio_ffmpeg"])
def test_without_the_extra_the_error_says_what_to_install(
    package: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    assert not of.rendering.available()
    with pytest.raises(of.rendering.RenderingUnavailable, match=r'pip install "openmm-filament\[render\]"') as error:
        of.rendering.still(LINE * NM, tmp_path / "a.png", radius=RADIUS)
    assert isinstance(error.value, ImportError)
    assert not list(tmp_path.iterdir())


def test_without_opengl_the_error_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pyvista")
    monkeypatch.setattr(_opengl, "_window_opens", lambda: False)
    assert not of.rendering.available()
    with pytest.raises(of.rendering.RenderingUnavailable, match="libegl1"):
        of.rendering.still(LINE * NM, tmp_path / "a.png", radius=RADIUS)


def test_asking_does_not_end_the_process_where_vtk_cannot_draw() -> None:
    """OSMesa is seldom installed, and VTK crashes when it draws without it."""
    pytest.importorskip("pyvista")
    run = subprocess.run(
        [sys.executable, "-c", "import openmm_filament as of; print(of.rendering.available())"],
        env={**os.environ, "VTK_DEFAULT_OPENGL_WINDOW": "vtkOSOpenGLRenderWindow"},
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0
    assert run.stdout.strip() in {"True", "False"}


# What is refused ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"positions": LINE}, TypeError, "`positions` must be a Quantity of length"),
        ({"positions": LINE * unit.kelvin}, TypeError, "unit of length"),
        ({"positions": LINE[:1] * NM}, ValueError, "at least two beads"),
        ({"positions": LINE[:, :2] * NM}, ValueError, r"shape \(n, 3\)"),
        ({"positions": []}, ValueError, "at least one filament"),
        ({"positions": LINE * np.nan * NM}, ValueError, "`positions` must be finite"),
        ({"path": "a.jpg"}, ValueError, "`path` must end in .png"),
        ({"path": "nowhere/a.png"}, FileNotFoundError, "folder that exists"),
        ({"radius": 0 * NM}, ValueError, "`radius` must be positive"),
        ({"radius": 1.0}, TypeError, "`radius` must be a Quantity"),
        ({"bead_radius": 0.1 * NM}, ValueError, "at least the radius of the tube"),
        ({"bead_radius": [1, 1] * NM}, ValueError, "`bead_radius` must have shape"),
        ({"bead_radius": [1 * NM, 1 * NM]}, ValueError, "one a filament"),
        ({"closed": [True, False]}, ValueError, "one a filament"),
        ({"plane": "zx"}, ValueError, "`plane` must be one of"),
        ({"size": (640, 0)}, ValueError, "`size` must be at least 64"),
    ],
)
def test_a_still_refuses(change: dict[str, Any], error: type[Exception], message: str, tmp_path: Path) -> None:
    arguments = {"positions": LINE * NM, "path": "a.png", "radius": RADIUS, **change}
    path = tmp_path / arguments.pop("path")
    with pytest.raises(error, match=message):
        of.rendering.still(arguments.pop("positions"), path, **arguments)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"frames": LINE * NM}, ValueError, r"shape \(n, n, 3\)"),
        ({"frames": swing()[:0] * NM}, ValueError, "one frame"),
        ({"frames": (swing() + np.inf) * NM}, ValueError, "`frames` must be finite"),
        ({"frames": [swing(3) * NM, swing(4) * NM]}, ValueError, "as many frames"),
        ({"path": "a.png"}, ValueError, "end in .mp4 or .gif"),
        ({"times": [1, 2] * unit.picosecond}, ValueError, "`times` must have shape"),
        ({"times": np.arange(8) * NM}, TypeError, "unit of time"),
        ({"fps": 0}, ValueError, "`fps` must be positive"),
        ({"exaggerate": 10.0}, ValueError, "`rest` must be given with `exaggerate`"),
        ({"rest": LINE * NM}, ValueError, "`rest` must be given with `exaggerate`"),
        ({"rest": LINE[:2] * NM, "exaggerate": 2.0}, ValueError, "`rest` must have shape"),
        ({"rest": [LINE * NM, LINE * NM], "exaggerate": 2.0}, ValueError, "one a filament"),
        ({"size": (321, 180)}, ValueError, "`size` must be even"),
    ],
)
def test_a_film_refuses(change: dict[str, Any], error: type[Exception], message: str, tmp_path: Path) -> None:
    arguments = {"frames": swing() * NM, "path": "a.mp4", "radius": RADIUS, **change}
    path = tmp_path / arguments.pop("path")
    with pytest.raises(error, match=message):
        of.rendering.animate(arguments.pop("frames"), path, **arguments)
