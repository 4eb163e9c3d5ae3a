"""3D pictures of filaments: beads as spheres, segments as tubes, without a display. Needs the extra `render`.

The projection is parallel, so the scale bar holds everywhere in the plane of the picture, and the axes x, y, z are drawn
beside it. Tubes and beads too thin to be seen are drawn thicker, and the picture says by what factor; their centre lines
are true. Colours are told apart by colour-blind readers. VTK chooses how to draw: on a display if there is one, else
off-screen through EGL or OSMesa, which come with Mesa (Debian: libegl1 and libgl1-mesa-dri) and need no graphics card.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray
from openmm import unit

from openmm_filament import _checks as check
from openmm_filament import _drawing as drawing
from openmm_filament import units
from openmm_filament._opengl import RenderingUnavailable, available
from openmm_filament._stage import Skin, Stage

if TYPE_CHECKING:
    import mdtraj

__all__ = ["RenderingUnavailable", "animate", "available", "still"]

Array = NDArray[np.float64]
_TIMES = "\N{MULTIPLICATION SIGN}"


def still(
    positions: unit.Quantity | Sequence[unit.Quantity],
    path: str | os.PathLike[str],
    *,
    radius: unit.Quantity,
    bead_radius: unit.Quantity | Sequence[unit.Quantity] | None = None,
    closed: bool | Sequence[bool] = False,
    title: str = "",
    plane: Literal["xy", "xz", "yz"] | None = None,
    size: tuple[int, int] = (1280, 720),
) -> Path:
    """Draw one shape, or several filaments together, into a PNG file.

    Parameters
    ----------
    positions : Quantity, shape (N, 3), or a sequence of them
        Physical positions of one filament, or of several.
    path : path
        Ends in .png; an existing file is replaced.
    radius : Quantity
        Of the tubes. Where it would be too thin to be seen, tubes and beads are drawn larger by one factor ("thickness
        x 9" in the picture).
    bead_radius : Quantity, scalar or shape (N,), or a sequence of them, one a filament
        At least `radius`; without it 1.6 times that, and less where beads would touch. Heavy beads show when they get a
        larger one, say `radius * 1.6 * np.cbrt(masses / masses.min())`.
    closed : bool, or one a filament
        Whether a segment joins the last bead to the first.
    title : str
        A line above the picture.
    plane : "xy", "xz" or "yz"
        Look at this plane square on. Otherwise the view follows the shape: its longest direction runs to the right,
        thin shapes are seen square on, others obliquely.
    size : (int, int)
        Width and height in pixels.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    RenderingUnavailable
        Where the extra `render` is not installed or the machine cannot draw.
    ValueError, TypeError, FileNotFoundError
        Fewer than two beads, coordinates that are not finite, a wrong unit, shape, suffix or folder.
    """
    target = _target(path, (".png",))
    filaments = [_filament("positions", q)[None] for q in _several(positions)]
    scene = _Scene(filaments, radius, bead_radius, closed, plane, size)
    with scene.stage(title, (), fine=3) as stage:
        stage.save(target, scene.frame(0))
    return target


def animate(
    frames: unit.Quantity | Sequence[unit.Quantity] | mdtraj.Trajectory,
    path: str | os.PathLike[str],
    *,
    times: unit.Quantity | None = None,
    radius: unit.Quantity,
    bead_radius: unit.Quantity | Sequence[unit.Quantity] | None = None,
    closed: bool | Sequence[bool] = False,
    title: str = "",
    plane: Literal["xy", "xz", "yz"] | None = None,
    size: tuple[int, int] = (960, 540),
    fps: float = 25.0,
    rest: unit.Quantity | Sequence[unit.Quantity] | None = None,
    exaggerate: float = 1.0,
) -> Path:
    """Draw a motion into an MP4 or GIF file, seen from one place that holds every frame.

    Parameters
    ----------
    frames : Quantity, shape (T, N, 3), or a sequence of them, or an mdtraj.Trajectory
        Physical positions of one filament, or of several with as many frames each. A sequence of (N, 3) Quantities is one
        filament. A trajectory holds one filament a chain, as `openmm_filament.load` gives it.
    path : path
        Ends in .mp4 (H.264) or .gif; an existing file is replaced once the new one is complete.
    times : Quantity, shape (T,)
        Shown in each frame; those of a trajectory by default. Without times a frame shows its number.
    radius, bead_radius, closed, title, plane, size
        As for `still`; an MP4 takes even sizes only.
    fps : float
        Frames a second. GIF files count in hundredths of a second.
    rest : Quantity, shape (N, 3), or a sequence of them
        The shape that displacements are counted from.
    exaggerate : float
        Displacements from `rest` are drawn this many times as large, and the picture says so.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    RenderingUnavailable, ValueError, TypeError, FileNotFoundError
        As `still`; also for `rest` without `exaggerate` and the reverse.
    """
    target = _target(path, (".mp4", ".gif"))
    check.positive("fps", fps)
    check.positive("exaggerate", exaggerate)
    filaments, clock = _motion(frames)
    count = len(filaments[0])
    if any(len(filament) != count for filament in filaments):
        raise check.fail("frames", "have as many frames for each filament", [len(f) for f in filaments])
    if times is not None:
        clock = check.finite("times", check.shape("times", units.numbers("times", times, "time"), (count,)))
    if (rest is None) != (exaggerate == 1.0):
        raise check.fail(
            "rest", "be given with `exaggerate`, and only then", "given" if rest is not None else "missing"
        )
    if rest is not None:
        filaments = [r + exaggerate * (f - r) for f, r in zip(filaments, _rests(rest, filaments), strict=True)]
    if target.suffix == ".mp4" and any(side % 2 for side in size):
        raise check.fail("size", "be even for an MP4", size)
    scene = _Scene(filaments, radius, bead_radius, closed, plane, size)
    labels = [f"{i + 1} / {count}" for i in range(count)] if clock is None else drawing.time_labels(clock)
    notes = () if rest is None else (f"displacement {_TIMES} {exaggerate:.4g}",)
    with scene.stage(title, notes, fine=2) as stage:
        stage.film(target, ((scene.frame(i), label) for i, label in enumerate(labels)), count, fps)
    return target


class _Scene:
    """Filaments of T frames each, (T, N, 3) in nm, as they stand in the picture."""

    def __init__(
        self, filaments: list[Array], radius: Any, bead_radius: Any, closed: Any, plane: Any, size: tuple[int, int]
    ) -> None:
        if plane is not None:
            check.one_of("plane", plane, ("xy", "xz", "yz"))
        self.size = (check.integer("size", size[0], low=64), check.integer("size", size[1], low=64))
        self.closed = list(closed) if isinstance(closed, Sequence) else [closed] * len(filaments)
        if len(self.closed) != len(filaments):
            raise check.fail("closed", f"have {len(filaments)} values, one a filament", self.closed)
        tube = float(check.positive("radius", units.number("radius", radius, "length")))
        beads = _bead_radii(bead_radius, filaments, tube)
        points = np.concatenate([f.reshape(-1, 3) for f in filaments])
        axes = drawing.look(points, plane)
        self.view = drawing.stand(points, axes, tube, self.size)
        spacing = _spacing([f[0] for f in filaments])
        pixel = self.view.nm_per_pixel
        self.thicker = drawing.magnification(tube / pixel, spacing / pixel, self.size[1])
        self.tube = tube * self.thicker
        default = drawing.bead_radius(self.tube, spacing)
        self.beads = [
            np.full(f.shape[1], default) if r is None else r * self.thicker
            for f, r in zip(filaments, beads, strict=True)
        ]
        self.view = drawing.stand(points, axes, max(float(r.max()) for r in self.beads), self.size)
        self.filaments = [self.view.pixels(f) for f in filaments]

    def stage(self, title: str, notes: tuple[str, ...], *, fine: int) -> Stage:
        """What the scene is drawn on."""
        pixel = self.view.nm_per_pixel
        skins = [
            Skin(radii / pixel, self.tube / pixel, bool(closed))
            for radii, closed in zip(self.beads, self.closed, strict=True)
        ]
        depth = max(float(np.abs(f[..., 2]).max()) for f in self.filaments) + max(float(s.beads.max()) for s in skins)
        if self.thicker > 1:
            notes = (f"thickness {_TIMES} {self.thicker:.4g}", *notes)
        return Stage(self.size, skins, self.view, depth, title, notes, fine=fine)

    def frame(self, i: int) -> list[Array]:
        """The beads of every filament in frame `i`, in pixels."""
        return [f[i] for f in self.filaments]


# Arguments ------------------------------------------------------------------------------------------------------------


def _target(path: str | os.PathLike[str], suffixes: tuple[str, ...]) -> Path:
    target = Path(path)
    if target.suffix not in suffixes:
        raise check.fail("path", f"end in {' or '.join(suffixes)}", str(path))
    if not target.parent.is_dir():
        raise FileNotFoundError(f"Argument `path` must lie in a folder that exists, but {path} does not.")
    return target


def _several(value: Any) -> list[Any]:
    """The Quantities of several filaments: a Quantity alone is one."""
    if isinstance(value, unit.Quantity) or not isinstance(value, Sequence):
        return [value]
    if not value:
        raise check.fail("positions", "hold at least one filament", "empty")
    return list(value)


def _filament(name: str, value: Any, frames: tuple[None, ...] = ()) -> Array:
    """Positions (..., N, 3) in nm, of two beads or more."""
    numbers = check.finite(name, check.shape(name, units.numbers(name, value, "length"), (*frames, None, 3)))
    if numbers.shape[-2] < 2 or not len(numbers):
        raise check.fail(name, "hold at least two beads and one frame", f"of shape {numbers.shape}")
    return numbers


def _motion(frames: Any) -> tuple[list[Array], Array | None]:
    """The filaments (T, N, 3) in nm, and the times (T,) in ps of a trajectory."""
    mdtraj = sys.modules.get("mdtraj")
    if mdtraj is not None and isinstance(frames, mdtraj.Trajectory):
        xyz = units.quantity(np.asarray(frames.xyz, dtype=np.float64), "length")
        chains = [[atom.index for atom in chain.atoms] for chain in frames.topology.chains]
        return [_filament("frames", xyz[:, chain], (None,)) for chain in chains], np.asarray(frames.time, np.float64)
    several = _several(frames)
    if not isinstance(frames, unit.Quantity) and all(np.ndim(_raw(q)) == 2 for q in several):
        return [_filament("frames", several, (None,))], None
    return [_filament("frames", q, (None,)) for q in several], None


def _raw(value: Any) -> Any:
    return value.value_in_unit(value.unit) if isinstance(value, unit.Quantity) else value


def _rests(rest: Any, filaments: list[Array]) -> Iterator[Array]:
    given = _several(rest)
    if len(given) != len(filaments):
        raise check.fail("rest", f"have {len(filaments)} shapes, one a filament", len(given))
    for value, filament in zip(given, filaments, strict=True):
        yield check.shape("rest", _filament("rest", value), filament.shape[1:])


def _bead_radii(value: Any, filaments: list[Array], tube: float) -> list[Array | None]:
    """Radii (N,) in nm for each filament, or None."""
    if value is None:
        return [None] * len(filaments)
    given = [value] * len(filaments) if isinstance(value, unit.Quantity) else list(value)
    if len(given) != len(filaments):
        raise check.fail("bead_radius", f"have {len(filaments)} entries, one a filament", len(given))
    radii: list[Array | None] = []
    for entry, filament in zip(given, filaments, strict=True):
        numbers = units.numbers("bead_radius", entry, "length")
        if numbers.ndim:
            check.shape("bead_radius", numbers, filament.shape[1:2])
        if (check.positive("bead_radius", numbers) < tube * (1 - 1e-9)).any():
            raise check.fail(
                "bead_radius", f"be at least the radius of the tube, {tube:.6g} nm", f"{numbers.min():.6g} nm"
            )
        radii.append(np.broadcast_to(numbers, filament.shape[1:2]))
    return radii


def _spacing(filaments: list[Array]) -> float:
    """The median length of the segments of filaments (N, 3) in nm."""
    return float(np.median(np.concatenate([np.linalg.norm(np.diff(f, axis=0), axis=1) for f in filaments])))
