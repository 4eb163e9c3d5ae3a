"""Analysis of recorded motion: arrays in, frozen results out, plain floats in seconds, hertz and 1/s.

Imports neither openmm nor mdtraj.
"""

from openmm_filament.analysis.peaks import Lines, lines
from openmm_filament.analysis.pitch import Pitch, instantaneous_pitch
from openmm_filament.analysis.ringing import DampedSinusoids, damped_sinusoids
from openmm_filament.analysis.spectra import Spectrum, spectrum, uniform_interval

__all__ = [
    "DampedSinusoids",
    "Lines",
    "Pitch",
    "Spectrum",
    "damped_sinusoids",
    "instantaneous_pitch",
    "lines",
    "spectrum",
    "uniform_interval",
]
