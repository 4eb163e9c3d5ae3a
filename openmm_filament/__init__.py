"""Elastic filaments in OpenMM: chains of beads held by stretching, bending and torsion.

Names are loaded when first used, so that `openmm_filament.wlc` and `.analysis` need neither openmm nor mdtraj.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from openmm_filament import (
        analysis,
        bending,
        contact,
        electrostatics,
        loads,
        reference,
        rendering,
        shapes,
        sound,
        stretching,
        torsion,
        units,
        wlc,
    )
    from openmm_filament.discretisation import exact_extension
    from openmm_filament.divergence import watch
    from openmm_filament.evaluation import energies, forces
    from openmm_filament.filament import Filament
    from openmm_filament.free_energies import FreeEnergy, free_energy, free_energy_of_works
    from openmm_filament.inspection import preflight
    from openmm_filament.integrators import euler_cromer, langevin, verlet
    from openmm_filament.model import Model, build
    from openmm_filament.modes import damped_modes, normal_modes
    from openmm_filament.motion import pluck_reporter, record
    from openmm_filament.passage import Barrier, barrier
    from openmm_filament.platforms import fastest_platform, platform_properties
    from openmm_filament.protocols import clamp, ramp
    from openmm_filament.rods import Match, WormlikeChain, rod_terms
    from openmm_filament.sampling import force_extension
    from openmm_filament.statics import equilibrium
    from openmm_filament.timestep import stable_timestep
    from openmm_filament.trajectory import load, trajectory_reporter
    from openmm_filament.trapping import move_trap, trap_forces

__version__ = "0.1.0"

__all__ = [
    "Barrier",
    "Filament",
    "FreeEnergy",
    "Match",
    "Model",
    "WormlikeChain",
    "__version__",
    "analysis",
    "barrier",
    "bending",
    "build",
    "clamp",
    "contact",
    "damped_modes",
    "electrostatics",
    "energies",
    "equilibrium",
    "euler_cromer",
    "exact_extension",
    "fastest_platform",
    "force_extension",
    "forces",
    "free_energy",
    "free_energy_of_works",
    "langevin",
    "load",
    "loads",
    "move_trap",
    "normal_modes",
    "platform_properties",
    "pluck_reporter",
    "preflight",
    "ramp",
    "record",
    "reference",
    "rendering",
    "rod_terms",
    "shapes",
    "sound",
    "stable_timestep",
    "stretching",
    "torsion",
    "trajectory_reporter",
    "trap_forces",
    "units",
    "verlet",
    "watch",
    "wlc",
]

_HOME = {
    "Barrier": "passage",
    "barrier": "passage",
    "Filament": "filament",
    "FreeEnergy": "free_energies",
    "Match": "rods",
    "Model": "model",
    "WormlikeChain": "rods",
    "build": "model",
    "clamp": "protocols",
    "damped_modes": "modes",
    "energies": "evaluation",
    "equilibrium": "statics",
    "euler_cromer": "integrators",
    "exact_extension": "discretisation",
    "fastest_platform": "platforms",
    "force_extension": "sampling",
    "forces": "evaluation",
    "free_energy": "free_energies",
    "free_energy_of_works": "free_energies",
    "langevin": "integrators",
    "load": "trajectory",
    "move_trap": "trapping",
    "normal_modes": "modes",
    "platform_properties": "platforms",
    "pluck_reporter": "motion",
    "preflight": "inspection",
    "ramp": "protocols",
    "record": "motion",
    "rod_terms": "rods",
    "stable_timestep": "timestep",
    "trajectory_reporter": "trajectory",
    "trap_forces": "trapping",
    "verlet": "integrators",
    "watch": "divergence",
}
"""The module of each name that is not itself a module."""


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = import_module(f"{__name__}.{_HOME.get(name, name)}")
    if name not in _HOME:
        return module
    globals()[name] = getattr(module, name)
    return globals()[name]


def __dir__() -> list[str]:
    return sorted(__all__)
