"""Whether 3D pictures can be drawn here, and what to install where they cannot."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["RenderingUnavailable", "available", "quiet", "require"]


class RenderingUnavailable(ImportError):  # noqa: N818 - it says what is missing, not what went wrong
    """3D pictures cannot be drawn here; the text says what to install."""


def available() -> bool:
    """Whether `still` and `animate` can work here: the extra `render` is installed and the machine can draw."""
    try:
        require()
    except RenderingUnavailable:
        return False
    return True


def require() -> None:
    """Raise RenderingUnavailable unless everything that drawing needs is there."""
    try:
        import imageio_ffmpeg  # noqa: F401
        import pyvista  # noqa: F401
    except ImportError as error:
        raise RenderingUnavailable(
            f'3D pictures need packages that are not all here ({error}): pip install "openmm-filament[render]".'
        ) from error
    if not _window_opens():
        raise RenderingUnavailable(
            "3D pictures need OpenGL, with a display or without one: install EGL and Mesa (Debian and Ubuntu: "
            "apt install libegl1 libgl1-mesa-dri), or OSMesa."
        )


@functools.cache
def _window_opens() -> bool:
    """Whether VTK gets an OpenGL context. Without this question, drawing without one ends the process."""
    from vtkmodules import vtkRenderingOpenGL2  # noqa: F401
    from vtkmodules.vtkRenderingCore import vtkRenderWindow

    with quiet():
        window = vtkRenderWindow()
        window.SetOffScreenRendering(True)
        window.Initialize()
        window.MakeCurrent()
        opened = bool(window.IsCurrent())
        window.Finalize()
    return opened


@contextmanager
def quiet() -> Iterator[None]:
    """Without VTK's warnings on each way to draw that it tries in vain before one that works."""
    from vtkmodules.vtkCommonCore import vtkLogger

    before = vtkLogger.GetCurrentVerbosityCutoff()
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
    try:
        yield
    finally:
        vtkLogger.SetStderrVerbosity(before)
