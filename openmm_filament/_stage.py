"""What pictures are drawn on: an off-screen window, its lights, labels and surfaces, by PyVista. Lengths are pixels."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from openmm_filament import _drawing as drawing
from openmm_filament._opengl import quiet, require

__all__ = ["Skin", "Stage"]

Array = NDArray[np.float64]

_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
"""Told apart with any colour vision (Okabe and Ito)."""
_INK = "#222222"


@dataclass(frozen=True)
class Skin:
    """The look of a filament: radii of its beads (N,) and of its tube, and whether it is closed."""

    beads: Array
    tube: float
    closed: bool


class Stage:
    """A window for pictures of `size`, with labels; surfaces are made once and moved from frame to frame.

    It is `fine` times as large as its pictures, which are averaged down: edges become smooth, in less time than by VTK's
    own means where there is no graphics card.
    """

    def __init__(
        self,
        size: tuple[int, int],
        skins: list[Skin],
        view: drawing.View,
        depth: float,
        title: str,
        notes: tuple[str, ...],
        *,
        fine: int = 2,
    ) -> None:
        require()
        import pyvista

        self.size, self.skins, self._fine = size, skins, fine
        with quiet():
            window = [fine * side for side in size]
            self._plotter = pyvista.Plotter(off_screen=True, window_size=window, lighting="none")
        self._plotter.render_window.SetMultiSamples(0)
        self._plotter.background_color = "white"
        self._light()
        self._meshes: list[tuple[Any, Any]] = []
        camera = self._plotter.camera
        camera.position, camera.focal_point, camera.up = (0.0, 0.0, 2 * depth), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)
        camera.parallel_projection, camera.parallel_scale = True, size[1] / 2
        self._clipping = (0.5 * depth, 3.5 * depth)
        self._font = max(10, round(0.033 * size[1]))
        self._label(view, title, notes)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._plotter.close()

    def picture(self, beads: list[Array]) -> NDArray[np.uint8]:
        """The picture (height, width, 3) of filaments with beads at (N, 3)."""
        from PIL import Image

        surfaces = [self._surfaces(positions, skin) for positions, skin in zip(beads, self.skins, strict=True)]
        if not self._meshes:
            self._meshes = [
                tuple(self._add(*surface, colour) for surface, colour in zip(pair, _shades(i), strict=True))
                for i, pair in enumerate(surfaces)
            ]
        else:
            for meshes, pair in zip(self._meshes, surfaces, strict=True):
                for mesh, (points, normals) in zip(meshes, pair, strict=True):
                    mesh.points = points.reshape(-1, 3).astype(np.float32)
                    mesh.point_data["Normals"][:] = normals.reshape(-1, 3)
        self._plotter.camera.clipping_range = self._clipping
        self._plotter.render()
        return np.asarray(Image.fromarray(self._plotter.screenshot(None, return_img=True)).reduce(self._fine))

    def save(self, path: Path, beads: list[Array]) -> None:
        """Write the picture as PNG."""
        from PIL import Image

        Image.fromarray(self.picture(beads)).save(path)

    def film(self, path: Path, frames: Iterable[tuple[list[Array], str]], count: int, fps: float) -> None:
        """Write frames, each with its caption, as MP4 or GIF; a film that is not complete leaves no file."""
        partial = path.with_name(f".{path.stem}.part{path.suffix}")
        pictures = (self._captioned(beads, caption) for beads, caption in frames)
        try:
            (_write_mp4 if path.suffix == ".mp4" else _write_gif)(partial, pictures, self.size, fps)
            os.replace(partial, path)
        finally:
            partial.unlink(missing_ok=True)

    def _captioned(self, beads: list[Array], caption: str) -> NDArray[np.uint8]:
        self._caption.SetInput(caption)
        return self.picture(beads)

    def _surfaces(self, positions: Array, skin: Skin) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        columns = _columns(self._fine * skin.tube)
        around = _columns(self._fine * float(np.median(skin.beads)))
        tube = drawing.cylinders(positions, skin.closed, skin.tube, columns)
        return tube, drawing.spheres(positions, skin.beads, around // 2 + 1, around)

    def _add(self, points: Array, normals: Array, colour: str) -> Any:
        import pyvista

        patches, rows, columns, _ = points.shape
        corners = drawing.faces(patches, rows, columns)
        mesh = pyvista.PolyData.from_regular_faces(points.reshape(-1, 3).astype(np.float32), corners)
        mesh.point_data.active_normals = normals.reshape(-1, 3).astype(np.float32)
        actor = self._plotter.add_mesh(
            mesh, color=colour, ambient=0.2, diffuse=0.8, specular=0.25, specular_power=30, reset_camera=False
        )
        actor.prop.interpolation = "Phong"
        return mesh

    def _light(self) -> None:
        """A main light from the upper left, a weak one from the right that opens the shadows, and one at the eye."""
        import pyvista

        for position, strength in (((-0.7, 1.0, 2.0), 0.55), ((1.5, -0.3, 1.5), 0.25), ((0.0, 0.0, 1.0), 0.35)):
            light = pyvista.Light(
                position=position, focal_point=(0, 0, 0), intensity=strength, light_type="camera light"
            )
            self._plotter.add_light(light)

    # Labels ---------------------------------------------------------------------------------------------------------

    def _label(self, view: drawing.View, title: str, notes: tuple[str, ...]) -> None:
        """Title and caption at the top, scale bar, notes and axes at the bottom."""
        width, height = self.size
        left, right, top, low = 0.04 * width, 0.96 * width, 0.96 * height, 0.055 * height
        self._write(title, left, top, "left", "top")
        self._caption = self._write("", right, top, "right", "top")
        length, label = drawing.bar(0.2 * width * view.nm_per_pixel)
        end = left + length / view.nm_per_pixel
        tick = 0.008 * height
        self._line([(left, low), (end, low)])
        self._line([(left, low - tick), (left, low + tick)])
        self._line([(end, low - tick), (end, low + tick)])
        self._write(label, (left + end) / 2, low + 0.02 * height, "center", "bottom")
        self._write(", ".join(notes), 0.5 * (end + right), low, "center", "center")
        self._axes(view, right - 0.06 * height, low + 0.03 * height, 0.05 * height)

    def _axes(self, view: drawing.View, x: float, y: float, length: float) -> None:
        """The directions of x, y, z as the viewer sees them; one that points at the viewer has no room for a name."""
        for name, direction in zip("xyz", view.axes.T, strict=True):
            across, up = float(direction[0]), float(direction[1])
            if np.hypot(across, up) > 0.2:
                self._line([(x, y), (x + length * across, y + length * up)])
                beyond = length + 0.5 * self._font / np.hypot(across, up)
                self._write(name, x + beyond * across, y + beyond * up, "center", "center", 0.85)

    def _write(self, text: str, x: float, y: float, across: str, up: str, share: float = 1.0) -> Any:
        actor = self._plotter.add_text(text, position=(self._fine * x, self._fine * y), font_size=10, color=_INK)
        style = actor.GetTextProperty()
        style.SetFontSize(round(self._fine * share * self._font))
        {"left": style.SetJustificationToLeft, "center": style.SetJustificationToCentered}.get(
            across, style.SetJustificationToRight
        )()
        {"top": style.SetVerticalJustificationToTop, "center": style.SetVerticalJustificationToCentered}.get(
            up, style.SetVerticalJustificationToBottom
        )()
        return actor

    def _line(self, points: list[tuple[float, float]]) -> None:
        import pyvista
        from vtkmodules.vtkRenderingCore import vtkActor2D, vtkPolyDataMapper2D

        mapper = vtkPolyDataMapper2D()
        mapper.SetInputData(pyvista.lines_from_points(self._fine * np.array([(x, y, 0.0) for x, y in points])))
        actor = vtkActor2D()
        actor.SetMapper(mapper)
        actor.GetProperty().SetColor(pyvista.Color(_INK).float_rgb)
        actor.GetProperty().SetLineWidth(self._fine * max(1.0, self.size[1] / 540))
        self._plotter.renderer.AddViewProp(actor)


def _columns(radius: float) -> int:
    """Points around a circle of `radius` pixels: an even number, enough to look round."""
    return 2 * int(np.clip(round(4 + radius / 2), 5, 24))


def _shades(i: int) -> tuple[str, str]:
    """Colours of the tube and the beads of filament `i`: the tube is lighter."""
    dark = _COLOURS[i % len(_COLOURS)]
    parts = [int(dark[k : k + 2], 16) for k in (1, 3, 5)]
    return "#" + "".join(f"{round(0.5 * part + 0.5 * 235):02X}" for part in parts), dark


def _write_mp4(path: Path, pictures: Iterable[NDArray[np.uint8]], size: tuple[int, int], fps: float) -> None:
    import imageio_ffmpeg

    writer = imageio_ffmpeg.write_frames(
        str(path), size, fps=fps, quality=8, macro_block_size=2, output_params=["-movflags", "+faststart"]
    )
    writer.send(None)
    try:
        for picture in pictures:
            writer.send(np.ascontiguousarray(picture))
    finally:
        writer.close()


def _write_gif(path: Path, pictures: Iterable[NDArray[np.uint8]], size: tuple[int, int], fps: float) -> None:
    from PIL import Image

    images = (Image.fromarray(picture) for picture in pictures)
    first = next(images).quantize(128, method=Image.Quantize.FASTOCTREE)
    rest = (image.quantize(palette=first, dither=Image.Dither.NONE) for image in images)
    with path.open("wb") as out:  # Pillow would leave a file of its own open where a picture fails
        first.save(out, format="GIF", save_all=True, append_images=rest, duration=1000 / fps, loop=0)
