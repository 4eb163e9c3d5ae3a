"""The only place where a Quantity becomes a number, and back.

Numbers inside the package are OpenMM's own units: nm, ps, Da, kJ/mol, K, rad, e. Energies, forces and stiffnesses
may be given per molecule (J, N, N/m) or per mole (kJ/mol, kJ/mol/nm): Avogadro's number is put in where it is missing.
1 pN = 0.602214 kJ/mol/nm.

A filament far from the nanometre is run in a scaled system of units; `Scale` holds the three factors and derives the
factor of every other dimension from them.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from openmm import unit

from openmm_filament import _checks as check

__all__ = [
    "BOLTZMANN",
    "COULOMB",
    "NANOMETER_SCALE",
    "Scale",
    "dimension_of",
    "frozen_copy",
    "number",
    "numbers",
    "quantity",
]

BOLTZMANN: float = unit.MOLAR_GAS_CONSTANT_R.value_in_unit(unit.kilojoule_per_mole / unit.kelvin)
"""Boltzmann's constant in kJ/mol/K (the very value OpenMM uses)."""

COULOMB: float = 138.93545764438198
"""Coulomb's constant 1/(4 pi eps0) in kJ/mol nm/e^2 (CODATA 2018)."""

_ENERGY = unit.kilojoule_per_mole
_UNITS: dict[str, unit.Unit] = {
    "length": unit.nanometer,
    "time": unit.picosecond,
    "mass": unit.dalton,
    "energy": _ENERGY,
    "force": _ENERGY / unit.nanometer,
    "stiffness": _ENERGY / unit.nanometer**2,
    "pressure": _ENERGY / unit.nanometer**3,
    "temperature": unit.kelvin,
    "angle": unit.radian,
    "charge": unit.elementary_charge,
    "pure": unit.dimensionless,
    "energy_length": _ENERGY * unit.nanometer,
    "rate": unit.picosecond**-1,
    "velocity": unit.nanometer / unit.picosecond,
    "line_density": unit.dalton / unit.nanometer,
}

# Powers of (length, mass, energy) in each dimension; time is length sqrt(mass/energy).
_POWERS: dict[str, tuple[float, float, float]] = {
    "length": (1, 0, 0),
    "time": (1, 0.5, -0.5),
    "mass": (0, 1, 0),
    "energy": (0, 0, 1),
    "energy_length": (1, 0, 1),
    "force": (-1, 0, 1),
    "stiffness": (-2, 0, 1),
    "pressure": (-3, 0, 1),
    "temperature": (0, 0, 1),
    "angle": (0, 0, 0),
    "charge": (0, 0, 0),
    "pure": (0, 0, 0),
    "rate": (-1, -0.5, 0.5),
    "velocity": (0, -0.5, 0.5),
    "line_density": (-1, 1, 0),
}

_PER_MOLECULE = frozenset({"energy", "force", "stiffness", "pressure", "mass", "line_density"})
"""Dimensions that OpenMM counts per mole (a dalton is a g/mol to it), but users also give per molecule or in kg."""


def _compatible(given: unit.Unit, dimension: str) -> unit.Unit | None:
    """The unit of `dimension` to convert into from `given`: per mole, or per molecule; None where neither fits."""
    molar = _UNITS[dimension]
    if given.is_compatible(molar):
        return molar
    if dimension in _PER_MOLECULE and given.is_compatible(molar * unit.mole):
        return molar * unit.mole
    return None


def numbers(name: str, value: Any, dimension: str) -> NDArray[np.float64]:
    """The numbers in a Quantity, in the package's unit of `dimension`, as a new float array.

    Raises TypeError where `value` carries no unit or one of another dimension.
    """
    wanted = _UNITS[dimension]
    if isinstance(value, (list, tuple)) and value and all(isinstance(v, unit.Quantity) for v in value):
        return np.stack([numbers(name, v, dimension) for v in value])
    if not isinstance(value, unit.Quantity):
        raise TypeError(
            f"Argument `{name}` must be a Quantity of {dimension} (such as {wanted.get_name()}), "
            f"but is {value!r} without a unit."
        )
    if value.unit is wanted:
        return np.array(check.array(name, value._value))
    target = _compatible(value.unit, dimension)
    if target is None:
        raise TypeError(
            f"Argument `{name}` must have a unit of {dimension} (such as {wanted.get_name()}), "
            f"but has {value.unit.get_name()}."
        )
    factor = value.unit.conversion_factor_to(target)
    if target is not wanted:
        factor *= unit.AVOGADRO_CONSTANT_NA.value_in_unit(unit.mole**-1)
    raw = check.array(name, value.value_in_unit(value.unit))
    return raw * factor if factor != 1.0 else np.array(raw)


def number(name: str, value: Any, dimension: str) -> float:
    """Like `numbers`, for one number; an array raises ValueError."""
    values = numbers(name, value, dimension)
    check.shape(name, values, ())
    return float(values)


def frozen_copy(value: Any) -> Any:
    """A Quantity with a copy of its array, which cannot be written; anything else as it is."""
    if not isinstance(value, unit.Quantity) or not isinstance(value._value, (np.ndarray, list)):
        return value
    held = copy.deepcopy(value._value)
    if isinstance(held, np.ndarray):
        held.flags.writeable = False
    return unit.Quantity(held, value.unit)


def quantity(value: Any, dimension: str) -> unit.Quantity:
    """A number or array in the package's unit of `dimension` as a Quantity."""
    return unit.Quantity(value, _UNITS[dimension])


def dimension_of(name: str, value: Any) -> str:
    """The name of a Quantity's dimension ("length", "force", ...); TypeError where the package has none such."""
    if not isinstance(value, unit.Quantity):
        raise TypeError(f"Argument `{name}` must be a Quantity, but is {value!r} without a unit.")
    for dimension in _UNITS:
        if _compatible(value.unit, dimension) is not None:
            return dimension
    raise TypeError(f"Argument `{name}` must have a unit of {', '.join(_UNITS)}, but has {value.unit.get_name()}.")


@dataclass(frozen=True)
class Scale:
    """How many physical units one internal unit stands for.

    Attributes
    ----------
    length, mass, energy : float
        nm, Da and kJ/mol per internal unit. All other factors follow, time being `length sqrt(mass/energy)`.
    """

    length: float = 1.0
    mass: float = 1.0
    energy: float = 1.0

    def factor(self, dimension: str) -> float:
        """Physical units of `dimension` in one internal unit."""
        check.one_of("dimension", dimension, _POWERS)
        length, mass, energy = _POWERS[dimension]
        return float(self.length**length * self.mass**mass * self.energy**energy)

    @property
    def is_identity(self) -> bool:
        """Whether internal units are nm, ps, Da and kJ/mol."""
        return self.length == self.mass == self.energy == 1.0


NANOMETER_SCALE = Scale()
"""The scale of filaments that need none."""
