"""Analysis of recorded motion and of thermal chains: arrays in, frozen results out, plain floats in the units stated.

Seconds, hertz and 1/s for spectra; nm, pN and K for chains. Imports neither openmm nor mdtraj; an `mdtraj.Trajectory` is
taken wherever positions are.
"""

from openmm_filament.analysis.averages import Average, average
from openmm_filament.analysis.chains import split_chains
from openmm_filament.analysis.contacts import contacts, nearest
from openmm_filament.analysis.curves import Curve, read_curve
from openmm_filament.analysis.entanglement import linking, writhe
from openmm_filament.analysis.force_extension import ForceExtensionFit, fit_force_extension
from openmm_filament.analysis.peaks import Lines, lines
from openmm_filament.analysis.pitch import Pitch, instantaneous_pitch
from openmm_filament.analysis.ringing import DampedSinusoids, damped_sinusoids
from openmm_filament.analysis.sizes import mean_squared_end_to_end, mean_squared_radius_of_gyration
from openmm_filament.analysis.spectra import Spectrum, spectrum, uniform_interval
from openmm_filament.analysis.tangents import (
    PersistenceLength,
    TangentCorrelation,
    persistence_length,
    tangent_correlation,
)

__all__ = [
    "Average",
    "Curve",
    "DampedSinusoids",
    "ForceExtensionFit",
    "Lines",
    "PersistenceLength",
    "Pitch",
    "Spectrum",
    "TangentCorrelation",
    "average",
    "contacts",
    "damped_sinusoids",
    "fit_force_extension",
    "instantaneous_pitch",
    "lines",
    "linking",
    "mean_squared_end_to_end",
    "mean_squared_radius_of_gyration",
    "nearest",
    "persistence_length",
    "read_curve",
    "spectrum",
    "split_chains",
    "tangent_correlation",
    "uniform_interval",
    "writhe",
]
