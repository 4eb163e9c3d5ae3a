"""The energy of harmonic traps on beads: NumPy formula and OpenMM forces whose traps can be moved."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np
import openmm as mm
from numpy.typing import NDArray

from openmm_filament._term import Interaction, Parameters, Term

__all__ = ["AXES", "Harmonic", "as_moved", "displaced", "interaction", "openmm_forces", "parameter"]

Array = NDArray[np.float64]

AXES = "xyz"


@final
@dataclass(frozen=True, eq=False)
class Harmonic(Term):
    """Energy `1/2 sum_a k_a (r_a - r0_a)^2` of single beads. It acts from outside: see `loads.Trap`."""

    family = "trap"
    span = 1
    expression = "0.5*(kx*(x-x0)^2+ky*(y-y0)^2+kz*(z-z0)^2)"
    dimensions = {f"k{a}": "stiffness" for a in AXES} | {f"{a}0": "length" for a in AXES}

    def parameters(self, rest: Array, closed: bool) -> dict[str, Array]:
        raise TypeError("A trap must be given as a load, but stands among the terms of a filament.")

    @staticmethod
    def energy(x: Array, p: Parameters) -> Array:
        off = x[:, 0] - _centres(p)
        return np.asarray(0.5 * (_stiffnesses(p) * off * off).sum(axis=-1))

    @staticmethod
    def gradient(x: Array, p: Parameters) -> Array:
        return np.asarray((_stiffnesses(p) * (x[:, 0] - _centres(p)))[:, None])


def _stiffnesses(p: Parameters) -> Array:
    return np.stack([p[f"k{a}"] for a in AXES], axis=-1)


def _centres(p: Parameters) -> Array:
    return np.stack([p[f"{a}0"] for a in AXES], axis=-1)


def interaction(beads: Any, stiffnesses: Any, positions: Any) -> Interaction:
    """Traps of these stiffnesses (M, 3) at these positions (M, 3) on beads (M,), in one consistent set of units."""
    k, r0 = (np.asarray(values, dtype=np.float64).reshape(-1, 3) for values in (stiffnesses, positions))
    columns = {f"k{a}": k[:, i] for i, a in enumerate(AXES)} | {f"{a}0": r0[:, i] for i, a in enumerate(AXES)}
    return Interaction(Harmonic, np.asarray(beads, dtype=np.int64).reshape(-1, 1), columns)


def parameter(trap: int, axis: str) -> str:
    """The Context parameter that holds how far the traps of this number have been moved along an axis."""
    return f"trap{trap}_{axis}"


def displaced(traps: Interaction, shifts: Array) -> Interaction:
    """The traps moved by (M, 3)."""
    moved = {f"{a}0": traps.parameters[f"{a}0"] + shifts[:, i] for i, a in enumerate(AXES)}
    return replace(traps, parameters={**traps.parameters, **moved})


def as_moved(traps: Interaction, numbers: NDArray[np.int64], context: mm.Context) -> Interaction:
    """The traps, of these numbers (M,), where a Context has them."""
    shifts = [[context.getParameter(parameter(int(n), axis)) for axis in AXES] for n in numbers]
    return displaced(traps, np.array(shifts))


def openmm_forces(traps: Interaction, numbers: NDArray[np.int64]) -> list[mm.CustomExternalForce]:
    """One force for the traps of each number (M,), which move together by Context parameters that are zero at first."""
    forces = []
    for number in dict.fromkeys(numbers.tolist()):
        centres = ";".join(f"{a}0={a}c+{parameter(number, a)}" for a in AXES)
        force = mm.CustomExternalForce(f"{Harmonic.expression};{centres}")
        for axis in AXES:
            force.addGlobalParameter(parameter(number, axis), 0.0)
        names = [f"k{a}" for a in AXES] + [f"{a}0" for a in AXES]
        for name in names:
            force.addPerParticleParameter(name.replace("0", "c"))
        for i in np.flatnonzero(numbers == number):
            force.addParticle(int(traps.beads[i, 0]), [float(traps.parameters[name][i]) for name in names])
        force.setName(f"trap{number}")
        forces.append(force)
    return forces
