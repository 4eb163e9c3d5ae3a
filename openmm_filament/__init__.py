"""Elastic filaments in OpenMM: chains of beads held by stretching, bending and torsion.

Names are loaded when first used, so that `openmm_filament.wlc` needs neither openmm nor mdtraj.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

_MODULES = ("bending", "electrostatics", "loads", "reference", "shapes", "stretching", "torsion", "units", "wlc")
_NAMES = {
    "Filament": "filament",
    "Match": "rods",
    "Model": "model",
    "WormlikeChain": "rods",
    "build": "model",
    "energies": "evaluation",
    "euler_cromer": "integrators",
    "fastest_platform": "platforms",
    "force_extension": "sampling",
    "forces": "evaluation",
    "langevin": "integrators",
    "load": "trajectory",
    "platform_properties": "platforms",
    "preflight": "inspection",
    "rod_terms": "rods",
    "stable_timestep": "timestep",
    "trajectory_reporter": "trajectory",
    "verlet": "integrators",
    "watch": "divergence",
}

__all__ = ["__version__", *_MODULES, *_NAMES]


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return import_module(f"{__name__}.{name}")
    if name in _NAMES:
        value = getattr(import_module(f"{__name__}.{_NAMES[name]}"), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
