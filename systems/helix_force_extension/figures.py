"""The curves of the helix, and its shapes in 3D."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from openmm import unit

import openmm_filament as of
from systems import stage
from systems.helix_force_extension import coil

__all__ = ["curves", "pictures"]


def curves(path: Path, found: list[coil.Curve]) -> None:
    """Extension against force for every G, and what the torsion does to the time step of dynamics."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 8.0), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    for i, curve in enumerate(found):
        force = [p.force for p in curve.converged]
        extension = np.array([p.extension for p in curve.converged]) / coil.CONTOUR
        weighted = curve.form == "weighted"
        label = f"G/E = {curve.shear / coil.YOUNG:g}" + (", weighted torsion" if weighted else "")
        style = {"color": "k" if weighted else f"C{i}", "marker": "x" if weighted else "o", "ms": 4}
        upper.plot(force, extension, "--" if weighted else "-", label=label, **style)
        lower.plot(force, [p.step for p in curve.converged], "--" if weighted else "-", **style)
    fine = np.geomspace(1e-2, 1e3, 200)
    steel = [coil.free_helix_extension(coil.YOUNG, float(f)) / coil.CONTOUR for f in fine]
    upper.plot(fine, steel, color="0.6", lw=1.2, ls=":", label="helix formula, G/E = 1, pulled on its axis")
    straight = np.asarray(1 + fine / coil.STRETCHING)
    upper.plot(fine, straight, color="0.6", lw=1.2, label="straight wire, 1 + F/(E S)")
    upper.axhline(coil.HEIGHT / coil.CONTOUR, color="0.8", lw=0.8)
    upper.set(
        ylabel="extension over contour length",
        ylim=(0.78, 1.25),
        title="Helix of two turns pulled at its ends: E = 1 GPa, contour 125 mm, wire 1 mm thick",
    )
    upper.legend(fontsize=9)
    lower.set(xscale="log", yscale="log", xlabel="force (N)", ylabel="stable time step of dynamics\nover that at rest")
    figure.savefig(path, dpi=150)


def pictures(folder: Path, curve: coil.Curve) -> list[str]:
    """The helix drawn out, as a still and a film; a finding where it cannot be drawn."""
    if not of.rendering.available():
        return [stage.NO_PICTURES]
    points = curve.converged
    shapes = np.array([p.positions for p in points]) * unit.nanometer
    radius = coil.WIRE * unit.meter
    shown = [shapes[i] for i in np.linspace(0, len(points) - 1, 4).astype(int)]
    apart = 4 * coil.RADIUS * 1e9
    spread = [shape + np.array([i * apart, 0.0, 0.0]) * unit.nanometer for i, shape in enumerate(shown)]
    labels = ", ".join(f"{points[i].force:.2g}" for i in np.linspace(0, len(points) - 1, 4).astype(int))
    of.rendering.still(spread, folder / "still.png", radius=radius, title=f"Helix pulled with {labels} N")
    of.rendering.animate(
        shapes, folder / "animation.mp4", radius=radius, fps=8, title="Helix drawn out by a rising force"
    )
    return []
