"""Static equilibrium under constant forces: continuation in the force, damped Newton steps, and what was reached."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from openmm import unit

from openmm_filament import _checks as check
from openmm_filament.descent import COARSE, Descent
from openmm_filament.evaluation import internal_positions
from openmm_filament.hessian import loose_bends
from openmm_filament.model import Model

__all__ = ["Equilibrium", "equilibrium"]

Array = NDArray[np.float64]

_STAGE = 60
"""Newton steps of one stage before the load is raised by less."""

_SMALLEST_STAGE = 1e-3
"""Part of the load that is not divided further."""

_MANY = 10**9
"""Stages at most: more would not be told apart."""

_ESCAPES = 5
"""Saddles left at most, one after another."""


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """What was reached.

    Attributes
    ----------
    positions : Quantity
        (N, 3), physical.
    energies : dict of str to float
        kJ/mol by term, with "pull" and "trap" where one acts.
    residual : float
        Largest force left on a free bead, kJ/mol/nm.
    floor : float
        What rounding of the coordinates alone leaves of it, kJ/mol/nm, estimated.
    converged : bool
        Whether the residual is at most 1e-8 of the largest load, or ten times the floor where that is larger; never above a
        thousandth of the load, where the floor may be beside the singularity of a dihedral.
    is_minimum : bool
        Whether the Hessian of the free coordinates has no negative eigenvalue beyond rounding (rigid motions left free
        have zero).
    lowest_eigenvalue : float
        The lowest over the largest eigenvalue of that Hessian.
    steps : int
        Newton steps taken.
    message : str
        In words, with the numbers.
    """

    positions: unit.Quantity
    energies: dict[str, float]
    residual: float
    floor: float
    converged: bool
    is_minimum: bool
    lowest_eigenvalue: float
    steps: int
    message: str


def equilibrium(
    model: Model,
    *,
    positions: unit.Quantity | None = None,
    begin_at: float = 0.0,
    stages: int = 8,
    most_steps: int = 5000,
) -> Equilibrium:
    """The static equilibrium of a model under its constant forces, as the load is raised from nothing.

    The load is raised in stages, each solved by Newton steps with the exact sparse Hessian, damped until the energy
    falls; a stage that takes too many steps is divided. An open filament that is bent everywhere and held at bead 0 alone,
    or at beads 0 and 1, is solved in its lengths, bends and torsions instead, which a nearly straight chain does not make
    singular (see `articulated`), and then in Cartesian coordinates as any other. At the full load a saddle is left along the
    direction in which the energy falls, so that the result is a minimum wherever one was found. Traps act in full from the
    start. Temperature and plucks play no part. Joints that rest bent without a torsion beside them give way out of their
    plane at no cost (see `bending.Harmonic`): such a chain turns its bends towards the load, and `lowest_eigenvalue`
    is zero by them as by rigid motions.

    Parameters
    ----------
    positions : Quantity, optional
        Physical positions (N, 3) to begin with; the rest positions by default.
    begin_at : float
        The part of the load, in [0, 1], under which these positions are an equilibrium: a force-extension curve is
        quickest from point to point.
    stages : int
        Equal steps in which the load is raised from there at first; 1 to apply it at once.
    most_steps : int
        Newton steps at most.

    Returns
    -------
    Equilibrium
        Converged or not: look at `converged` and `is_minimum`, or print `message`.

    Raises
    ------
    ValueError
        For a model without a free bead, one with a filament that is pulled away and held nowhere, counts below one, and
        `begin_at` outside [0, 1].
    """
    check.within("begin_at", begin_at, 0, 1)
    check.integer("stages", stages, low=1, high=_MANY)
    check.integer("most_steps", most_steps, low=1)
    problem = Descent(model)
    begin = check.finite("positions", internal_positions(model, positions))
    if not problem.shortest(begin) > 0:
        raise ValueError("Argument `positions` must not have neighbours in one place, but has.")
    x = problem.reduced(begin)
    left = most_steps
    reached, raise_by = begin_at, (1.0 - begin_at) / stages
    if problem.is_arm(x):
        x, left = problem.led_on(x, begin_at, left)
        reached = 1.0
    while reached < 1.0 and left > 0:
        share = min(reached + raise_by, 1.0)
        tried, steps, done = problem.relax(x, share, COARSE, min(left, _STAGE))
        left -= steps
        if not done and problem.fell:
            x = tried  # on its way down to another shape: no smaller stage would lead there
            continue
        if not done and raise_by > _SMALLEST_STAGE:
            raise_by /= 2
            continue
        x, reached = tried, share
        raise_by *= 1.5
    x, left, converged = problem.settle(x, left)
    lowest, direction = problem.lowest(x)
    for _ in range(_ESCAPES):
        if not problem.falls(x, lowest) or left <= 0:
            break
        x, steps, converged = problem.relax(x, 1.0, 0.0, left)  # a residual may pass for a curvature: down to the floor
        left -= steps
        lowest, direction = problem.lowest(x)
        if not problem.falls(x, lowest) or left <= 0:
            break
        x, left, converged = problem.settle(problem.nudged(x, direction), left)
        lowest, direction = problem.lowest(x)
    return _report(problem, x, converged, lowest, most_steps - left)


def _report(problem: Descent, x: Array, converged: bool, lowest: float, steps: int) -> Equilibrium:
    model = problem.model
    force, energy = model.scale.factor("force"), model.scale.factor("energy")
    positions = problem.whole(x)
    energies: dict[str, float] = {}
    for interaction in model.interactions:
        family = interaction.term.family
        energies[family] = energies.get(family, 0.0) + interaction.energy(positions) * energy
    if problem.load:
        energies["pull"] = -float((model.pulls * positions).sum()) * energy
    residual = problem.residual(problem.force(x, 1.0)) * force
    floor = problem.floor(x) * force
    minimum = not problem.falls(x, lowest)
    message = (
        f"{'Converged' if converged else 'NOT converged'} in {steps} steps to a residual of {residual:.3g} kJ/mol/nm "
        f"(load {problem.load * force:.3g}, rounding floor {floor:.3g}), "
        f"{'a minimum' if minimum else 'NOT a minimum'}: the lowest eigenvalue of the Hessian is {lowest:.2g} of the largest."
    )
    if loose := len(loose_bends(model)):
        message += (
            f" {loose} joints rest bent without a torsion and turn out of their plane at no cost: give the filament a "
            "torsion, or loads.Plane() to keep it in its plane."
        )
    return Equilibrium(
        model.to_physical(positions, "length"),
        energies,
        residual,
        floor,
        converged,
        minimum,
        lowest,
        steps,
        message,
    )
