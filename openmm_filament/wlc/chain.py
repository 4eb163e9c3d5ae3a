"""The frozen description of a discrete chain that its extension, its force and its transfer operators share."""

from __future__ import annotations

import math
from dataclasses import InitVar, dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from openmm_filament import _checks as check
from openmm_filament.wlc.bonds import bond
from openmm_filament.wlc.joints import BendingForm, check_joint
from openmm_filament.wlc.numerics import Floats, positive_scalar

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = ["DiscreteChain"]


@dataclass(frozen=True)
class DiscreteChain:
    """The arguments of `extension_discrete` after the force, in its order, checked once.

    `joints`, (segments - 1, 3), holds alpha/kT, rest angle and whether it may flip (1 or 0) of each joint, in place of
    `bending`, `rest_angles` and `flip`.

    Raises
    ------
    ValueError
        If an argument is out of its range.
    """

    segments: int
    bond_length: float
    bending: InitVar[ArrayLike]
    kT: float
    stretching: float | None
    bending_form: BendingForm
    rest_angles: InitVar[ArrayLike]
    flip: InitVar[ArrayLike]
    dimension: int
    joints: Floats = field(init=False)

    def __post_init__(self, bending: ArrayLike, rest_angles: ArrayLike, flip: ArrayLike) -> None:
        check_joint(self.bending_form, self.dimension)
        segments, kT = check.integer("segments", self.segments, low=1), positive_scalar("kT", self.kT)
        stiffness = check.non_negative("bending", bending) / kT
        free = np.asarray(flip, dtype=float)
        low = 0.0 if free.all() else -math.pi
        rest = check.within("rest_angles", rest_angles, low, math.pi, unit="rad")
        joints = np.empty((segments - 1, 3))
        for column, (name, values) in enumerate((("bending", stiffness), ("rest_angles", rest), ("flip", free))):
            joints[:, column] = values if values.ndim == 0 else check.shape(name, values, (segments - 1,))
        if (signed := (joints[:, 2] == 1) & (joints[:, 1] < 0)).any():
            raise check.fail("rest_angles", "not be negative where a joint may flip", joints[signed, 1][0])
        if self.bending_form == "cosine" and rest.any():
            raise check.fail("rest_angles", "be 0 for the cosine form", rest_angles)
        if self.dimension == 3 and not free.all():
            raise check.fail("flip", "be True in three dimensions, where an angle has no sign", flip)
        length = positive_scalar("bond_length", self.bond_length)
        stretching = None if self.stretching is None else positive_scalar("stretching", self.stretching)
        checked = {"segments": segments, "bond_length": length, "kT": kT, "stretching": stretching, "joints": joints}
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    @property
    def contour_length(self) -> float:
        """Length of the straight chain without load, in nm."""
        return self.segments * self.bond_length

    def bond(self, tension: Floats) -> tuple[Floats, Floats]:
        """Log of the weight, and mean length, of a bond under `tension` in pN; see `bonds.bond`."""
        return bond(tension, self.bond_length, self.stretching, self.kT, self.dimension)
