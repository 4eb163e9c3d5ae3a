"""Single, mixed and double precision: forces of every term, from small bending angles and strains to large ones."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
import openmm as mm
from numpy.typing import NDArray
from openmm import unit

import openmm_filament as of
from openmm_filament._term import Term
from systems.stability import exact
from systems.stability.cells import Cell, judged, missing
from systems.stability.shapes import bent

__all__ = ["precisions"]

Array = NDArray[np.float64]

KJ, NM, RAD, DALTON = unit.kilojoule_per_mole, unit.nanometer, unit.radian, unit.dalton
_TINY = 1e-9

_CHOICES: tuple[tuple[str, dict[str, str]], ...] = (
    ("Reference", {}), ("CPU", {}), ("OpenCL", {"Precision": "double"}), ("OpenCL", {"Precision": "mixed"}),
    ("OpenCL", {"Precision": "single"}),
)  # fmt: skip

_NAMES = ("stretching", "bending, arccosine", "bending, arctangent", "torsion, weighted")


def _terms(name: str) -> tuple[Term, ...]:
    stiffness = 30 * KJ
    return {
        "stretching": (of.stretching.Harmonic(500 * KJ / NM**2, 1 * NM),),
        "bending, arccosine": (of.bending.Harmonic(stiffness, 0 * RAD),),
        "bending, arctangent": (of.bending.Harmonic(stiffness, 0 * RAD, form="arctangent"),),
        "torsion, weighted": (of.torsion.Weighted(stiffness, 0.3 * RAD),),
    }[name]


def _shape(name: str, size: float) -> Array:
    """Bonds strained, or joints bent, by `size`; off the axes, so that coordinates are rounded."""
    if name == "stretching":
        x = bent((1 + size, 1 + size), (0.7,))
    elif name == "torsion, weighted":
        x = bent((0.8, 1.3, 0.6), (size, 1.2), (0.9,))
    else:
        x = bent((0.8, 1.3), (size,))
    turned, _ = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))
    return np.asarray(x @ turned.T)


def _model(name: str) -> of.Model:
    shape = _shape(name, 0.5)
    return of.build(of.Filament(shape * NM, 10 * DALTON, _terms(name)))


def _error(model: of.Model, context: mm.Context, x: Array) -> float:
    context.setPositions(x)
    of.preflight(model, context)
    found = context.getState(forces=True).getForces(asNumpy=True).value_in_unit(KJ / NM)
    return exact.error(found, model.interactions, x)


def precisions(*, quick: bool) -> Iterator[Cell]:
    """Against the exact forces at the positions that were asked for, not at those that the platform has rounded."""
    available = {mm.Platform.getPlatform(i).getName() for i in range(mm.Platform.getNumPlatforms())}
    for platform, properties in _CHOICES:
        said = f"{platform}, {properties.get('Precision', 'double')}"
        for name in _NAMES:
            place = ("precision", f"{said}: {name}")
            model = _model(name)
            context: mm.Context | None = None
            why = f"Platform {platform} is not installed."
            if platform in available:
                try:
                    where = mm.Platform.getPlatformByName(platform)
                    context = mm.Context(model.system, mm.VerletIntegrator(_TINY), where, properties)
                except mm.OpenMMException as error:  # installed, but without a device or without this precision
                    why = f"Platform {platform} cannot run here: {error}"
            for power in (-12, -9, -6, -4, -3, -2, -1, 0) if quick else range(-12, 1):
                at = (*place, f"1e{power}", 10.0**power)
                if context is None:
                    yield missing(at, "forces", why)
                else:
                    yield judged(at, "forces", partial(_error, model, context, _shape(name, 10.0**power)))
