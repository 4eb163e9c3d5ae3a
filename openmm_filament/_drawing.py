"""What a 3D picture of filaments shows, in NumPy: where the viewer stands, the surfaces, the labels.

Lengths come in nm. `View` turns them into pixels before anything is drawn, so that filaments of any size are drawn
with the same accuracy: x to the right, y up, z towards the viewer, the origin in the middle of the picture.
The projection is parallel: a length in the plane of the picture is the same wherever it stands.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, floor, log10

import numpy as np
from numpy.typing import NDArray

from openmm_filament import geometry

__all__ = [
    "View",
    "bar",
    "bead_radius",
    "cylinders",
    "faces",
    "look",
    "magnification",
    "principal_axes",
    "spheres",
    "stand",
    "time_labels",
]

Array = NDArray[np.float64]

_PLANES = {"xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
_LENGTHS = {"m": 1e9, "mm": 1e6, "µm": 1e3, "nm": 1.0, "pm": 1e-3}
_TIMES = {"s": 1e12, "ms": 1e9, "µs": 1e6, "ns": 1e3, "ps": 1.0, "fs": 1e-3}


@dataclass(frozen=True)
class View:
    """A parallel projection.

    Attributes
    ----------
    axes : array, shape (3, 3)
        Rows: the unit vectors to the right, up and towards the viewer.
    centre : array, shape (3,)
        The point in the middle of the picture, in nm.
    nm_per_pixel : float
    """

    axes: Array
    centre: Array
    nm_per_pixel: float

    def pixels(self, points: Array) -> Array:
        """Points (..., 3) in nm as (..., 3) pixels: right, up and towards the viewer from the middle of the picture."""
        turned: Array = (points - self.centre) @ self.axes.T / self.nm_per_pixel
        return turned


def principal_axes(points: Array) -> tuple[Array, Array]:
    """Spreads (3,) of the points (n, 3), largest first, and the directions (rows) along which they are found.

    Where spreads are equal to 5 %, as in a ring or across a helix, the directions follow x, y or z as far as they can:
    they must not hang on rounding. The largest component of the first two is positive; the third makes them right-handed.
    """
    values, vectors = np.linalg.eigh(np.cov(points.T, bias=True))
    spreads = np.sqrt(np.maximum(values[::-1], 0.0))
    spreads[spreads < 1e-9 * spreads[0]] = 0.0
    rows: list[Array] = []
    for spread in spreads[:2]:
        alike = vectors[:, ::-1][:, spreads >= 0.95 * spread]
        free = alike @ alike.T - sum((np.outer(row, row) for row in rows), np.zeros((3, 3)))  # a projector
        row = free[:, np.argmax(np.round(np.diag(free), 6))]
        row = row / np.linalg.norm(row)
        rows.append(row * np.sign(row[np.argmax(np.round(np.abs(row), 6))]))
    return spreads, np.array([*rows, geometry.cross(rows[0], rows[1])])


def look(points: Array, plane: str | None = None) -> Array:
    """Axes (rows: right, up, towards the viewer) from which the points (n, 3) are seen well.

    The longest direction runs to the right. A shape in 3D is seen obliquely, one three times as long as wide from
    above, a flat one from 29 degrees off its normal, a thin one (a string in motion, a straight chain) square on.
    `plane`, "xy", "xz" or "yz", is looked at square on, its first axis to the right and its second up.
    """
    if plane is not None:
        right, up = np.eye(3)[list(_PLANES[plane])]
        return np.array([right, up, geometry.cross(right, up)])
    spreads, axes = principal_axes(points)
    if spreads[1] < 0.1 * spreads[0]:
        return axes
    if spreads[2] < 0.1 * spreads[1]:
        turn, lean = np.radians((15.0, -25.0))
    else:
        turn, lean = np.radians((25.0 if spreads[1] > spreads[0] / 3 else 0.0, 20.0))
    about_up = np.array([[np.cos(turn), 0, -np.sin(turn)], [0, 1, 0], [np.sin(turn), 0, np.cos(turn)]])
    about_right = np.array([[1, 0, 0], [0, np.cos(lean), -np.sin(lean)], [0, np.sin(lean), np.cos(lean)]])
    seen: Array = about_right @ about_up @ axes
    return seen


def stand(points: Array, axes: Array, reach: float, size: tuple[int, int]) -> View:
    """The view along `axes` in which points (n, 3) with `reach` (nm) around them fill a picture of `size` pixels.

    Room for a line of text is left at the top, and for the scale bar at the bottom.
    """
    width, height = size
    side, top, bottom = 0.05 * width, 0.13 * height, 0.17 * height
    turned = points @ axes.T
    low, high = turned.min(axis=0) - reach, turned.max(axis=0) + reach
    span = high - low
    nm_per_pixel = max(span[0] / (width - 2 * side), span[1] / (height - top - bottom))
    middle = (low + high) / 2 - np.array([0.0, (bottom - top) / 2 * nm_per_pixel, 0.0])
    return View(axes, middle @ axes, float(nm_per_pixel))


def magnification(radius: float, spacing: float, height: int) -> float:
    """The factor, 1 or more, that makes a tube of `radius` visible in a picture of `height`; lengths in pixels.

    Tubes are drawn with a radius of at least 0.6 % of the height, or a quarter of the spacing of the beads where that is
    less, but not below 1.5 pixels. A factor above 1 has two significant figures.
    """
    least = float(np.clip(0.25 * spacing, 1.5, max(0.006 * height, 1.5)))
    if radius >= least:
        return 1.0
    step = 10.0 ** (floor(log10(least / radius)) - 1)
    return ceil(least / radius / step) * step


def bead_radius(radius: float, spacing: float) -> float:
    """The radius of beads where none is given: 1.6 of that of the tube, less where beads would touch."""
    return radius * float(np.clip(0.4 * spacing / radius, 1.15, 1.6))


# Surfaces: patches of rows x columns points, periodic in the columns --------------------------------------------------


def faces(patches: int, rows: int, columns: int) -> NDArray[np.int64]:
    """Quadrilaterals (n, 4) between the points of `patches` x `rows` x `columns`."""
    index = np.arange(patches * rows * columns).reshape(patches, rows, columns)
    right = np.roll(index, -1, axis=2)
    corners = [index[:, :-1], right[:, :-1], right[:, 1:], index[:, 1:]]
    return np.stack([corner.ravel() for corner in corners], axis=-1)


def spheres(centres: Array, radii: Array, rows: int, columns: int) -> tuple[Array, Array]:
    """Points and outward normals (n, rows, columns, 3) of spheres at `centres` (n, 3) with `radii` (n,)."""
    polar = np.linspace(0.0, np.pi, rows)[:, None]
    azimuth = -2 * np.pi * np.arange(columns) / columns  # clockwise: faces then look outwards
    unit = np.stack(
        np.broadcast_arrays(np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)), -1
    )
    normals = np.broadcast_to(unit, (len(centres), *unit.shape))
    return centres[:, None, None] + radii[:, None, None, None] * unit, normals


def cylinders(positions: Array, closed: bool, radius: float, columns: int) -> tuple[Array, Array]:
    """Points and normals (segments, 2, columns, 3) of open cylinders of `radius` about the segments of (N, 3)."""
    vectors = geometry.segments(positions, closed)
    lengths = np.sqrt(geometry.dot(vectors, vectors))[:, None]
    along = np.where(lengths > 0, vectors / np.where(lengths > 0, lengths, 1.0), [0.0, 0.0, 1.0])
    across = geometry.cross(along, np.eye(3)[np.argmin(np.abs(along), axis=1)])
    across /= np.sqrt(geometry.dot(across, across))[:, None]
    other = geometry.cross(along, across)
    angle = 2 * np.pi * np.arange(columns)[:, None] / columns
    circle = np.cos(angle) * across[:, None] + np.sin(angle) * other[:, None]
    ends = np.stack([positions[: len(vectors)], positions[: len(vectors)] + vectors], axis=1)
    normals = np.broadcast_to(circle[:, None], (len(vectors), 2, columns, 3))
    return ends[:, :, None] + radius * normals, normals


# Labels -------------------------------------------------------------------------------------------------------------


def bar(width_nm: float) -> tuple[float, str]:
    """The longest of 1, 2, 5 times a power of ten that is at most `width_nm`, in nm, and its label."""
    power = 10.0 ** floor(log10(width_nm))
    length = max(step * power for step in (1, 2, 5) if step * power <= width_nm)
    unit = _unit(length * 1.000001, _LENGTHS)
    return length, f"{length / _LENGTHS[unit]:.3g} {unit}"


def time_labels(times_ps: Array) -> list[str]:
    """Times (n,) in ps as text, all in one unit and with the decimals that tell frames apart."""
    unit = _unit(float(np.abs(times_ps).max()), _TIMES)
    values = times_ps / _TIMES[unit]
    steps = np.abs(np.diff(values))
    step = float(np.median(steps[steps > 0])) if steps.any() else 1.0
    decimals = next((d for d in range(6) if abs(round(step, d) - step) <= 0.05 * step), 6)
    return [f"{value:.{decimals}f} {unit}" for value in values]


def _unit(value: float, units: dict[str, float]) -> str:
    """The largest unit of which `value` holds at least one; the smallest where there is none."""
    return next((name for name, size in units.items() if value >= size), list(units)[-1])
