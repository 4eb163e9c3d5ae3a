"""Which discrete chain to run for a worm-like chain at a force, and what its extension is exactly."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from openmm import unit

from openmm_filament import bending, stretching, units, wlc
from openmm_filament.filament import Filament
from openmm_filament.rods import INEXTENSIBLE, Match, WormlikeChain

__all__ = ["PN", "Choice", "ExactChain", "choose", "exact_chain", "exact_extension", "time_step_bias"]

Array = NDArray[np.float64]

PN: float = (1.0 * unit.piconewton * unit.AVOGADRO_CONSTANT_NA).value_in_unit(unit.kilojoule_per_mole / unit.nanometer)
"""One piconewton in kJ/mol/nm, 0.602214."""

_LADDER = (16, 24, 40, 64, 112, 200, 360, 640, 1140)
"""Segments of a chain of 19 persistence lengths (for others in proportion) at which the discretisation error is
computed, as far as the wanted error asks; between them it is interpolated."""

_SOFTER = (1.0, 0.5, 0.25, 0.12, 0.06, 0.03, 0.015)
"""Bond stiffness over S/b that may be run: bonds are by far the stiffest modes. Softer ones are given a rest length at
which their mean length under the force is that of the chain with its own S."""

_STRETCH = 0.05
"""Strain of a chain that stands for an inextensible one at the largest force, over the smallest wanted error."""

_BOND_SPREAD, _BOND_STRAIN = 0.1, 0.1
"""Largest thermal fluctuation of a softer bond relative to its length, and largest strain by the force."""

_BOND_SPREAD_OWN = 0.25
"""The same of the chain's own bonds: with segments shorter than that the discrete chain leaves the continuous one again."""

_ENOUGH, _MOST = 0.6, 0.7
"""Parts of the wanted error that the bias may take, as estimated and as computed exactly for the chain that is run."""

_STEPS = (0.2, 0.35, 0.5, 0.7)
"""Time steps over the limit of stability that may be run."""

_STIFFENING = (0.02, 0.035)
"""LangevinMiddle at r times the limit of stability extends a chain like one whose persistence length is longer by
`0.02 r^2 + 0.035 r^4`.

Measured on DNA of 16 to 265 segments (alpha of 0.7 to 14 kT, softened bonds, default friction) at 12 forces from 0.05 to
50 pN against the exact discrete chain (tests/benchmarks/bench_time_step.py): longer by 2.76 +- 0.16 % at r = 0.8 and by
0.94 +- 0.11 % at 0.55, chi-squared 13.5 for 24 points and these two numbers, which are 0.021 +- 0.007 and 0.035 +- 0.013.
Chains of 4 to 40 segments and bonds of full stiffness at 0.8 did not contradict it, within 0.4 % of their extension; other
bending forms were not measured. 12 segments (alpha of 0.44 kT) at 0.05 pN and 0.8 of the limit are 1.66 +- 0.15 % too long
where this says 1.20 %: shorter ladders than from 16 need a law of their own."""

FEWEST_SAMPLES = 48
"""Effective samples that are taken at any force, however small its fluctuations: fewer would not support an error bar."""


@dataclass(frozen=True)
class ExactChain:
    """The arguments of `wlc.extension_discrete` for a filament at a temperature: nm, pN nm, pN/nm, rad."""

    segments: int
    bond_length: float
    bending: float | Array
    bending_form: Literal["harmonic", "cosine"]
    rest_angles: float | Array
    stretching: float
    kT: float

    def extension(self, force: Any, dimension: int = 3) -> Any:
        """Exact mean extension in nm at a force, or an array of them, in pN; free ends, joints free to flip in 2D."""
        return wlc.extension_discrete(force, **vars(self), dimension=dimension)


@dataclass(frozen=True, eq=False)
class Choice:
    """A filament to run at one force, with what is known of its error.

    Attributes
    ----------
    filament : Filament
    discretisation : float
        Exact extension of this many segments, with bonds of the chain's own stretch modulus, over that of the continuous
        chain, minus 1.
    stretch : float
        What its softer bonds add to that.
    step : float
        Time step over the limit of stability.
    time_step : float
        What the step adds, as estimated (`time_step_bias`).
    """

    filament: Filament
    discretisation: float
    stretch: float
    step: float
    time_step: float

    @property
    def bias(self) -> float:
        """Exact discrete extension of the filament over the continuous one, minus 1; NaN for one run as it is."""
        return self.discretisation + self.stretch

    @property
    def known(self) -> float:
        """What the wanted error has to leave room for: both biases; nothing for a filament that is run as it is."""
        return 0.0 if math.isnan(self.bias) else abs(self.bias) + abs(self.time_step)


def exact_chain(filament: Filament, temperature: unit.Quantity) -> ExactChain | None:
    """The exact theory of an open filament with one harmonic stretching and one bending term; None for any other.

    Bonds must be alike (`wlc.extension_discrete` has one bond for the chain); joints may differ.
    """
    bound = {i.term: i.parameters for i in filament.interactions()}
    angle = next((term for term in bound if issubclass(term, (bending.Harmonic, bending.Cosine))), None)
    if filament.closed or angle is None or set(bound) != {stretching.Harmonic, angle} or len(filament.terms) != 2:
        return None
    bond, joint = bound[stretching.Harmonic], bound[angle]
    if np.ptp(bond["k"]) or np.ptp(bond["r0"]):
        return None
    return ExactChain(
        segments=len(filament) - 1,
        bond_length=float(bond["r0"][0]),
        bending=_one(joint["alpha"] / PN),
        bending_form="harmonic" if issubclass(angle, bending.Harmonic) else "cosine",
        rest_angles=_one(joint["beta0"]) if "beta0" in joint else 0.0,
        stretching=float(bond["k"][0]) / PN,
        kT=units.BOLTZMANN * units.number("temperature", temperature, "temperature") / PN,
    )


def exact_extension(
    filament: Filament, forces: unit.Quantity, temperature: unit.Quantity, *, dimension: int = 3
) -> unit.Quantity:
    """The exact mean extension of a filament pulled at its ends, as a length shaped like `forces`.

    Compared with `wlc.extension_exact` it tells how far a chain of so many segments is from the continuous one.

    Parameters
    ----------
    filament : Filament
        Open, with one harmonic stretching and one bending term and bonds all alike; no torsion.
    forces : Quantity
        Not negative, one number or an array.
    temperature : Quantity
    dimension : int
        3, or 2 for a chain in a plane, whose joints may flip.

    Raises
    ------
    ValueError
        For a filament that no exact answer is known for.
    """
    exact = exact_chain(filament, temperature)
    if exact is None:
        raise ValueError(
            "Argument `filament` must be open, with one harmonic stretching term of equal bonds and one bending term, for "
            f"an exact extension, but has {[type(term).__qualname__ for term in filament.terms]}."
        )
    return units.quantity(exact.extension(units.numbers("forces", forces, "force") / PN, dimension), "length")


def _stiffening(step: float) -> float:
    """By how much the persistence length seems longer at this part of the limit of stability, relative."""
    return _STIFFENING[0] * step**2 + _STIFFENING[1] * step**4


def time_step_bias(chain: ExactChain, force: float, step: float) -> float:
    """What LangevinMiddle at so large a part of the limit of stability adds to a mean extension, relative, as estimated.

    NaN for chains with bent or unequal joints, for which it was not measured, and in the plane.
    """
    if np.ndim(chain.bending) or np.any(chain.rest_angles):
        return math.nan
    cosine = float(wlc.mean_cosine(chain.bending / chain.kT, bending_form=chain.bending_form))
    longer = cosine ** (1 / (1 + _stiffening(step)))
    stiffer = float(wlc.bending_from_cosine(longer, bending_form=chain.bending_form)) * chain.kT
    return float(replace(chain, bending=stiffer).extension(force) / chain.extension(force) - 1)


def _one(values: Array) -> float | Array:
    return values if np.ptp(values) else float(values[0])


def choose(
    chain: WormlikeChain,
    forces: Array,
    temperature: unit.Quantity,
    relative_error: Array,
    chosen: Callable[[int], None] = lambda _: None,
) -> list[Choice]:
    """For each force the filament and the time step that are cheapest to sample to its error, and what they are off by.

    Candidates differ in the number of segments, in how soft their bonds are and in the time step. The cost of a sample
    grows as the number of beads times the number of steps in a relaxation time, hence as
    `N^2 sqrt(4 S' + 16 alpha/b)/r` with S' the stretch modulus that is run (the stiffest mode over the slowest) and r the
    step over the limit of stability, and that of the wanted error as `1/(relative_error - |bias|)^2`, the bias being that
    of the chain and of the step together.

    Parameters
    ----------
    forces : ndarray
        pN, (M,).
    relative_error : ndarray
        Wanted errors, (M,).
    chosen : callable
        Told for how many forces a chain has been chosen; zero when the survey of all of them begins.

    Returns
    -------
    list of Choice

    Raises
    ------
    ValueError
        If no candidate has a bias below a wanted error.
    """
    length, lp = (units.number("chain", q, "length") for q in (chain.contour_length, chain.persistence_length))
    kt = units.BOLTZMANN * units.number("temperature", temperature, "temperature") / PN
    own = None if chain.stretch_modulus is None else units.number("chain", chain.stretch_modulus, "force") / PN

    def exact(force: Array, stiffer: float = 1.0) -> Array:
        return np.asarray(wlc.extension_exact(force, stiffer * lp, length, kt, stretch_modulus=own, finite=True))

    modulus = own
    if modulus is None:  # beads cannot be inextensible: let the chain stretch by a small part of the wanted errors
        modulus = max(float((forces / relative_error).max()) / _STRETCH, INEXTENSIBLE * kt * lp / length**2)
        chain = replace(chain, stretch_modulus=modulus * unit.piconewton)

    chosen(0)
    continuous = exact(forces)
    fluctuation = _fluctuation(forces, continuous, exact, kt)
    finest = _BOND_SPREAD_OWN**2 * modulus * length / kt
    ladder, biases = _survey(chain, temperature, forces, continuous, relative_error, length / lp, finest)
    slope = (exact(forces, 1.01) / continuous - 1) / 0.01
    spread = _direction_variance(np.minimum(continuous / length, 0.999))
    # the largest bias from a number of segments on: a sign change with few segments is no convergence
    envelope = np.maximum.accumulate(np.abs(biases)[::-1])[::-1]
    counts = np.unique(np.round(np.geomspace(ladder[0], ladder[-1], 60)).astype(int))
    b = length / counts
    plans = []
    for column, (force, wanted) in enumerate(zip(forces, relative_error, strict=True)):
        at = np.exp(np.interp(np.log(counts), np.log(ladder), np.log(envelope[:, column] + 1e-12)))
        candidates = []
        for soft in _SOFTER:
            run = soft * modulus
            softer = force * spread[column] * (1 / run - 1 / modulus)
            too_soft = (np.sqrt(kt / (run * b)) > _BOND_SPREAD) | (force > _BOND_STRAIN * run)
            for step in _STEPS:
                bias = at + softer + slope[column] * _stiffening(step)
                samples = (fluctuation[column] / (np.maximum(wanted - bias, 1e-9) / 2)) ** 2
                stiffest = np.sqrt(4 * run + 16 * kt * lp / b**2)
                cost = np.maximum(samples, FEWEST_SAMPLES) * counts**2 * stiffest / step
                cost[(bias >= _ENOUGH * wanted) | (too_soft & (soft < 1))] = math.inf
                candidates += [
                    (float(c), int(n), soft, step) for c, n in zip(cost, counts, strict=True) if c < math.inf
                ]
        tension = force * continuous[column] / length
        for _, count, soft, step in sorted(candidates):
            filament = _filament(chain, count, temperature, soft, tension)
            hard = filament if soft == 1.0 else _filament(chain, count, temperature)
            choice = _weighed(filament, hard, temperature, force, continuous[column], step)
            if choice.known < _MOST * wanted:
                plans.append(choice)
                chosen(len(plans))
                break
        else:
            raise ValueError(
                f"Argument `relative_error` must be well above the discretisation error of {ladder[-1]} segments, "
                f"{np.abs(biases[-1, column]):.3g} at {force:.6g} pN, but is {wanted:.6g}."
            )
    return plans


def _survey(
    chain: WormlikeChain,
    temperature: unit.Quantity,
    forces: Array,
    continuous: Array,
    wanted: Array,
    lengths: float,
    finest: float,
) -> tuple[NDArray[np.int64], Array]:
    """Numbers of segments, and biases (numbers, forces) of the chains with them, until the wanted errors are met.

    `lengths` is the contour over the persistence length; beyond `finest` segments the chain's own bonds are too short.
    """
    ladder: list[int] = []
    rows: list[Array] = []
    refused: ValueError | None = None
    for count in dict.fromkeys(max(round(n * lengths / 19), 4) for n in _LADDER):
        if ladder and count > finest:
            break
        try:
            rows.append(_bias_of(_filament(chain, count, temperature), temperature, forces, continuous))
        except ValueError as error:  # segments too long, or bonds too soft, for this chain
            refused = error
            continue
        ladder.append(count)
        if (np.abs(rows[-1]) < 0.3 * wanted).all():
            break
    if not ladder:
        raise ValueError(
            "Argument `chain` must allow some number of segments, but none of those tried serves."
        ) from refused
    return np.array(ladder), np.array(rows)


def _fluctuation(forces: Array, extension: Array, exact: Callable[[Array], Array], kt: float) -> Array:
    """Relative fluctuation of the extension, `sqrt(k_B T dz/dF)/z`."""
    slope = (exact(forces * 1.01) - exact(forces * 0.99)) / (0.02 * forces)
    return np.asarray(np.sqrt(kt * slope) / extension)


def _direction_variance(mean: Array) -> Array:
    """Variance of cos(theta) about the force for its mean, as in a von Mises-Fisher distribution."""
    concentration = mean * (3 - mean**2) / (1 - mean**2)
    return np.asarray(1 - 2 * mean / concentration - mean**2)


def _filament(
    chain: WormlikeChain, segments: int, temperature: unit.Quantity, soft: float = 1.0, tension: float = 0.0
) -> Filament:
    """The chain in so many segments, with bonds softer by a factor under a tension in pN."""
    make = partial(chain.filament, segments, temperature)
    if soft != 1.0:
        assert chain.stretch_modulus is not None
        make = partial(make, stretch_modulus=soft * chain.stretch_modulus, tension=tension * unit.piconewton)
    try:
        return make(match=Match.END_TO_END)
    except ValueError:  # a chain much shorter than its persistence length has an end-to-end distance like a rod's
        return make(match=Match.PERSISTENCE_LENGTH)


def _weighed(
    filament: Filament, hard: Filament, temperature: unit.Quantity, force: float, continuous: float, step: float
) -> Choice:
    """The choice of a filament, beside one whose bonds have the chain's own stiffness."""
    discretisation, whole = (float(_bias_of(f, temperature, force, continuous)) for f in (hard, filament))
    exact = exact_chain(filament, temperature)
    assert exact is not None
    return Choice(filament, discretisation, whole - discretisation, step, time_step_bias(exact, force, step))


def _bias_of(filament: Filament, temperature: unit.Quantity, force: Any, continuous: Any) -> Any:
    exact = exact_chain(filament, temperature)
    assert exact is not None  # a worm-like chain has one stretching and one bending term
    return exact.extension(force) / continuous - 1
