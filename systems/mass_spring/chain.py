"""Masses on a stretched chain of springs between two fixed ends (thesis 2.2): the chain, its exact answers, its motion.

N masses and N + 1 springs under the tension T0 make a chain of length L and mass M. Springs have the length l0 = L/(N + 1)
under tension, masses are m = M/(N + 2): the two fixed beads carry mass too, which is what reproduces the thesis's Table 2.1.
The stiffness of the springs is not in the thesis. Here it is given as `ratio = k l0/T0`, which is above 1: a spring rests at
`l0 (1 - 1/ratio)`. With 2 the tension stretches a spring to twice its rest length, and the stretching waves are only sqrt(2)
times as fast as the transverse ones, so that they hardly shorten the time step.

For small transverse amplitudes `f_j = (1/2 pi) sqrt(chi_j T0/(m l0))` with `chi_j = 2 - 2 cos(j pi/(N + 1))`, whatever the
stiffness.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import openmm as mm
from numpy.typing import ArrayLike, NDArray
from openmm import unit
from scipy import integrate

import openmm_filament as of
from openmm_filament import _checks as check
from systems.fourth_order import fourth_order

__all__ = [
    "LENGTH",
    "MASS",
    "TENSION",
    "Chain",
    "Recording",
    "amplitude_law",
    "continuum_frequency",
    "launch",
    "leapfrog",
    "play",
]

Array = NDArray[np.float64]

TENSION = 20.0
"""T0 in N."""
LENGTH = 0.71
"""L in m: the thesis's guitar string."""
MASS = 7.8e-4 / LENGTH
"""M in kg, such that T0/(M L) = 25641 s^-2."""


def continuum_frequency() -> float:
    """The first line of the continuous string in Hz, (2.9): `1/2 sqrt(T0/(M L))`."""
    return 0.5 * float(np.sqrt(TENSION / (MASS * LENGTH)))


@dataclass(frozen=True)
class Chain:
    """N masses between fixed ends; see the head of this module.

    Attributes
    ----------
    masses : int
        N.
    ratio : float
        Stiffness of a spring in units of T0/l0, above 1.
    """

    masses: int
    ratio: float = 2.0

    def __post_init__(self) -> None:
        check.integer("masses", self.masses, low=1)
        if not check.finite("ratio", self.ratio) > 1:
            raise check.fail("ratio", "be above 1, where the springs have a rest length", self.ratio)

    @property
    def spacing(self) -> float:
        """l0 in m."""
        return LENGTH / (self.masses + 1)

    @property
    def mass(self) -> float:
        """Of one bead in kg."""
        return MASS / (self.masses + 2)

    @property
    def stiffness(self) -> float:
        """Of one spring in N/m."""
        return self.ratio * TENSION / self.spacing

    @property
    def cutoff(self) -> float:
        """`2 sqrt(T0/(m l0))` in rad/s, above all transverse frequencies."""
        return 2 * float(np.sqrt(TENSION / (self.mass * self.spacing)))

    @property
    def wavenumbers(self) -> Array:
        """(N,) `q_j = j pi/(N + 1)`, per bead."""
        return np.arange(1, self.masses + 1) * np.pi / (self.masses + 1)

    @property
    def frequencies(self) -> Array:
        """The exact lines (N,) in Hz for small amplitude."""
        chi = 2 - 2 * np.cos(self.wavenumbers)
        return np.asarray(np.sqrt(chi * TENSION / (self.mass * self.spacing)) / (2 * np.pi))

    @property
    def shapes(self) -> Array:
        """The exact shapes (N, N), one mode a row: `sin(q_j i)` at the masses i = 1..N."""
        return np.asarray(np.sin(np.outer(self.wavenumbers, np.arange(1, self.masses + 1))))

    @cached_property
    def model(self) -> of.Model:
        """The chain in OpenMM, along x: springs, and no other force."""
        rest = np.zeros((self.masses + 2, 3))
        rest[:, 0] = self.spacing * np.arange(self.masses + 2)
        filament = of.Filament(
            rest * unit.meter,
            self.mass * unit.kilogram,
            (of.stretching.Harmonic(self.stiffness * unit.newton / unit.meter),),
        )
        return of.build(filament, [of.loads.Hold([0, -1]), of.loads.Tension(TENSION * unit.newton)])

    def pluck(self, mass: int) -> Array:
        """The triangular shape (N,) of a string held aside at one mass (1..N), whose displacement is 1."""
        check.integer("mass", mass, low=1, high=self.masses)
        i = np.arange(1, self.masses + 1)
        return np.asarray(np.minimum(i / mass, (self.masses + 1 - i) / (self.masses + 1 - mass)))

    def frequency_at(self, amplitude: float) -> float:
        """The exact frequency in Hz of a single mass (N = 1) that swings to `amplitude` times l0, however far.

        From energy conservation, `t = int dy/v(y)`, with `y = a sin(s)`, by quadrature.
        """
        if self.masses != 1:
            raise check.fail("masses", "be 1 for a closed answer at any amplitude", self.masses)
        k, b, rest = self.stiffness, self.spacing, self.spacing * (1 - 1 / self.ratio)
        top = amplitude * b

        def slowness(s: float) -> float:
            y = top * np.sin(s)
            far, near = np.hypot(b, top), np.hypot(b, y)
            # the energy that is left, (far - rest)^2 - (near - rest)^2, over top^2 - y^2 and without its 0/0
            rise = (far + near - 2 * rest) / (far + near)
            return float(1 / np.sqrt(2 * k * rise / self.mass))

        quarter, _ = integrate.quad(slowness, 0, np.pi / 2, epsabs=0, epsrel=1e-13)
        return float(1 / (4 * quarter))


def amplitude_law(chain: Chain, mode: int) -> float:
    """The coefficient c in `f = f_j (1 + c a^2)` for the mode j that swings alone to `a l0`, to leading order in a.

    Worked out by harmonic balance. The energy of a spring that is longer by u along the chain and by w across it is, up to
    fourth order, `T0 w^2/(2 l0) + k u^2/2 + D u w^2/(2 l0^2) + D w^4/(8 l0^3)` with `D = k l0 - T0`. The mode stretches its
    springs by w^2, which drives the longitudinal mode 2j, at rest and at twice the frequency; what that and w^4 give back
    at the frequency itself is the shift. Springs of rest length 0 (ratio 1) would have none. In a long stiff string c is
    3/2 times what the mean tension alone gives.
    """
    ratio = chain.ratio
    q = float(chain.wavenumbers[check.integer("mode", mode, low=1, high=chain.masses) - 1])
    across = 4 * np.sin(q / 2) ** 2  # (w/a)^2 of the largest stretch
    if 2 * mode == chain.masses + 1:  # every spring is stretched alike and nothing moves along the chain
        return float((ratio - 1) * across * 3 / 32)
    shortening = ratio * np.cos(q / 2) ** 2
    return float(
        (ratio - 1) / 2 * across * (9 / 32 - (ratio - 1) / (16 * ratio) * (1 + shortening / (shortening - 1) / 2))
    )


def leapfrog(frequencies: ArrayLike, timestep: ArrayLike) -> Array:
    """What leapfrog at time steps (s) makes of the frequencies (Hz) of a harmonic motion: `sin(w' dt/2) = w dt/2`."""
    half = np.pi * np.asarray(timestep)
    return np.asarray(np.arcsin(half * np.asarray(frequencies)) / half)


@dataclass(frozen=True, eq=False)
class Recording:
    """A motion that OpenMM made.

    Attributes
    ----------
    interval : float
        Seconds between samples.
    across : (T, N) array
        Displacements of the masses across the chain (y), in units of l0.
    """

    interval: float
    across: Array


def launch(chain: Chain, start: Array, timestep: float, *, order: Literal[2, 4] = 2) -> mm.Context:
    """A Context whose masses are about to be let go, with displacements `start` (N,) across the chain in units of l0.

    They move by leapfrog, or of `order` 4 by PEFRL, four forces a step.

    It runs on the Reference platform, in double precision: across a straight chain single precision feels nothing this small.

    Raises
    ------
    ValueError
        If a displacement is not finite, or the time step (s) not positive or above the stability limit.
    """
    moved = check.finite("start", check.shape("start", np.asarray(start, dtype=np.float64), (chain.masses,)))
    model = chain.model
    positions = model.positions.value_in_unit(unit.nanometer).copy()
    positions[1:-1, 1] += moved * chain.spacing * 1e9 / model.scale.length
    integrator = of.verlet(model, timestep=float(check.positive("timestep", timestep, unit="s")) * unit.second)
    if order == 4:
        integrator = fourth_order(integrator.getStepSize())
    context = mm.Context(model.system, integrator, mm.Platform.getPlatformByName("Reference"))
    context.setPositions(positions * unit.nanometer)
    with warnings.catch_warnings():  # steps far below the limit are meant here, and PEFRL's are in the model's units
        warnings.filterwarnings("ignore", "The time step is .* of the stability limit")
        of.preflight(model, context)
    return context


def play(
    chain: Chain,
    start: Array,
    seconds: float,
    *,
    timestep: float,
    interval: float | None = None,
    order: Literal[2, 4] = 2,
) -> Recording:
    """Let the masses go from `start`, as `launch` does, and record their motion.

    Parameters
    ----------
    seconds : float
        Length of the recording, to the next sample.
    timestep : float
        Seconds.
    interval : float, optional
        Seconds between samples, to the next step; by default a third of the shortest period that such a chain can have.
    """
    check.positive("seconds", seconds, unit="s")
    context = launch(chain, start, timestep, order=order)
    every = max(1, int((2 * np.pi / chain.cutoff / 3 if interval is None else interval) / timestep))
    samples = int(np.ceil(seconds / (every * timestep)))
    to_spacings = 1 / (chain.spacing * 1e9)
    motion = of.record(chain.model, context, samples, every, observe=lambda x: x[1:-1, 1] * to_spacings)
    return Recording(every * timestep, motion.values)
