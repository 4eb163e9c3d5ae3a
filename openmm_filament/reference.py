"""NumPy reference of every energy and force, and the thesis's forces term by term as the check of both.

Quantities in, floats out: energies in kJ/mol, forces in kJ/mol/nm. Nothing here goes through OpenMM's forces.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from openmm_filament import _checks as check
from openmm_filament import bending, stretching, torsion, units
from openmm_filament.binding import bound_together, checked
from openmm_filament.filament import Filament
from openmm_filament.geometry import cross, dot, segments, unit_vectors

__all__ = ["energies", "forces", "thesis_forces"]

Array = NDArray[np.float64]


Filaments = Filament | Sequence[Filament]


def energies(filaments: Filaments, positions: Any, loads: Sequence[Any] = ()) -> dict[str, float]:
    """Energies in kJ/mol by term: "stretching", "bending", "torsion", "electrostatics", "contact", "pull", "pluck" and "trap".

    Of what acts there, for one filament or several and their loads, given as to `build`; `positions` is a Quantity (N, 3) of
    all beads. A pluck counts as it does before it lets go. Terms of one family are summed under its name.
    """
    chains, resolved = checked(filaments, loads)
    x = _positions(chains, positions)
    out: dict[str, float] = {}
    for interaction in bound_together(chains, resolved):
        if interaction.term.family != "trap":
            family = interaction.term.family
            out[family] = out.get(family, 0.0) + interaction.energy(x)
    for load, part in zip(resolved, _split(chains, x), strict=True):
        for name, energy in load.energies(part).items():
            out[name] = out.get(name, 0.0) + energy
    return out


def forces(filaments: Filaments, positions: Any, loads: Sequence[Any] = ()) -> Array:
    """Total forces (N, 3) in kJ/mol/nm on all beads, held ones included; arguments as those of `energies`."""
    chains, resolved = checked(filaments, loads)
    x = _positions(chains, positions)
    total = np.concatenate([load.forces(part) for load, part in zip(resolved, _split(chains, x), strict=True)])
    for interaction in bound_together(chains, resolved):
        if interaction.term.family != "trap":
            total += interaction.forces(x)
    return total


def _positions(chains: Sequence[Filament], positions: Any) -> Array:
    x = units.numbers("positions", positions, "length")
    return check.finite("positions", check.shape("positions", x, (sum(map(len, chains)), 3)))


def _split(chains: Sequence[Filament], x: Array) -> list[Array]:
    return np.split(x, np.cumsum([len(chain) for chain in chains])[:-1])


def thesis_forces(filament: Filament, positions: Any) -> dict[str, Array]:
    """Forces (N, 3) in kJ/mol/nm by family, from equations (1.7), (1.16) and (1.20, A.6) of the thesis.

    Written after the thesis, independently of the gradients in the term modules, with its printed errors mended
    (`x_i x y_{i+1}` in the last bending term; segments, not unit vectors, in the torsion). It takes open chains with
    harmonic terms; torsion is the unsigned arccos, so it holds where 0 < tau < pi and tau^eq lies there too, and is
    0/0 at tau = 0. Bending needs 0 < beta < pi.
    """
    if filament.closed:
        raise ValueError("Argument `filament` must be open for the thesis's forces, but is closed.")
    x = _positions([filament], positions)
    out: dict[str, Array] = {}
    for interaction in filament.interactions():
        formula = {
            stretching.Harmonic: _thesis_stretching,
            bending.Harmonic: _thesis_bending,
            bending.ArctangentHarmonic: _thesis_bending,
            torsion.Harmonic: _thesis_torsion,
        }.get(interaction.term)
        if formula is None:
            raise ValueError(
                f"Argument `filament` must have harmonic terms alone, but has {interaction.term.__name__}."
            )
        family = interaction.term.family
        out[family] = out.get(family, 0.0) + formula(x, *interaction.parameters.values())
    return out


def _thesis_stretching(r: Array, k: Array, rest: Array) -> Array:
    """(1.7): F_i = -k_{i-1} ds_{i-1} x_{i-1} + k_i ds_i x_i."""
    s = segments(r)
    length = np.linalg.norm(s, axis=1)
    pull = (k * (length - rest) / length)[:, None] * s
    force = np.zeros_like(r)
    force[:-1] += pull
    force[1:] -= pull
    return force


def _thesis_bending(r: Array, alpha: Array, rest: Array) -> Array:
    """(1.16), bead by bead; joint j is at bead j + 1, between segments j and j + 1."""
    s = segments(r)
    length = np.linalg.norm(s, axis=1)
    x = s / length[:, None]
    y = unit_vectors(np.cross(x[:-1], x[1:]))
    moment = alpha * (np.arccos(np.clip(dot(x[:-1], x[1:]), -1, 1)) - rest)
    force = np.zeros_like(r)
    for i in range(len(r)):
        if (before := i - 2) >= 0:  # the joint at bead i - 1
            force[i] += moment[before] * np.cross(x[i - 1], y[before]) / length[i - 1]
        if 0 <= (here := i - 1) < len(moment):
            lever = x[i - 1] / length[i - 1] + x[i] / length[i]
            force[i] -= moment[here] * np.cross(lever, y[here])
        if (after := i) < len(moment):  # the joint at bead i + 1
            force[i] += moment[after] * np.cross(x[i], y[after]) / length[i]
    return force


def _thesis_torsion(r: Array, stiffness: Array, rest: Array) -> Array:
    """(1.20) with (A.6), dihedral by dihedral, tau = arccos(y_j . y_{j+1})."""
    s = segments(r)
    force = np.zeros_like(r)
    for j in range(1, len(s) - 1):
        p, q = cross(s[j - 1], s[j]), cross(s[j], s[j + 1])
        y, z = p / np.linalg.norm(p), q / np.linalg.norm(q)
        t = np.cross(p, q)
        t /= np.linalg.norm(t)
        a, b = -np.cross(t, y) / np.linalg.norm(p), np.cross(t, z) / np.linalg.norm(q)
        by_segment = (np.cross(s[j], a), np.cross(a, s[j - 1]) + np.cross(s[j + 1], b), np.cross(b, s[j]))
        tau = np.arccos(np.clip(y @ z, -1, 1))
        moment = stiffness[j - 1] * (tau - rest[j - 1])
        for k, gradient in enumerate(by_segment):  # s_m = r_{m+1} - r_m
            force[j - 1 + k] += moment * gradient
            force[j + k] -= moment * gradient
    return force
