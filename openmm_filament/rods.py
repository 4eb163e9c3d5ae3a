"""Physical filaments as terms and chains: elastic rods of a material, and worm-like chains at a temperature."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from openmm import unit
from scipy.optimize import brentq

from openmm_filament import _checks as check
from openmm_filament import bending, shapes, stretching, torsion, units, wlc
from openmm_filament._term import Term
from openmm_filament.filament import Filament

__all__ = ["Match", "WormlikeChain", "rod_terms"]


def rod_terms(
    youngs_modulus: unit.Quantity,
    shear_modulus: unit.Quantity | None,
    radius: unit.Quantity,
    segment_length: unit.Quantity,
) -> tuple[Term, ...]:
    """Harmonic terms of a rod of circular section: k = E S/l0, alpha = E I/l0, C = G J/l0.

    S = pi R^2, I = pi R^4/4, J = pi R^4/2 (thesis, section 1). Rest values are left to the rest shape.

    Parameters
    ----------
    youngs_modulus, shear_modulus : Quantity
        E and G, pressure. Without a shear modulus (None) the torsion term is left out.
    radius, segment_length : Quantity
        R of the section and l0 of one segment, length.
    """
    e = float(check.positive("youngs_modulus", units.number("youngs_modulus", youngs_modulus, "pressure")))
    r = float(check.positive("radius", units.number("radius", radius, "length")))
    l0 = float(check.positive("segment_length", units.number("segment_length", segment_length, "length")))
    terms: tuple[Term, ...] = (
        stretching.Harmonic(units.quantity(e * math.pi * r**2 / l0, "stiffness")),
        bending.Harmonic(units.quantity(e * math.pi * r**4 / 4 / l0, "energy")),
    )
    if shear_modulus is None:
        return terms
    g = float(check.positive("shear_modulus", units.number("shear_modulus", shear_modulus, "pressure")))
    return (*terms, torsion.Harmonic(units.quantity(g * math.pi * r**4 / 2 / l0, "energy")))


class Match(Enum):
    """What a discrete chain shares exactly with the continuous one that it stands for."""

    PERSISTENCE_LENGTH = "persistence_length"
    """The decay of tangent correlations: `<cos beta> = exp(-b/l_p)`."""
    END_TO_END = "end_to_end"
    """The mean-square end-to-end distance without force, hence the response to small forces."""


INEXTENSIBLE = 400.0
"""k b^2/(k_B T) of the bonds of a chain without stretch modulus: they fluctuate by 5 % of their length."""


@dataclass(frozen=True)
class WormlikeChain:
    """A continuous worm-like chain: what is meant physically, before it is cut into segments.

    Parameters
    ----------
    contour_length, persistence_length : Quantity
        L and l_p, length. l_p = A/(k_B T) with A the bending rigidity.
    stretch_modulus : Quantity, optional
        S, force: the extension by a force F is F/S. None for an inextensible chain.
    line_density : Quantity, optional
        Mass per length. By default that of double-stranded DNA, 650 Da per 0.34 nm. It sets the time scale only:
        averages in equilibrium do not depend on it.
    """

    contour_length: unit.Quantity
    persistence_length: unit.Quantity
    stretch_modulus: unit.Quantity | None = None
    line_density: unit.Quantity = field(default_factory=lambda: units.quantity(650.0 / 0.34, "line_density"))

    def __post_init__(self) -> None:
        for name, dimension in (
            ("contour_length", "length"),
            ("persistence_length", "length"),
            ("line_density", "line_density"),
        ):
            check.positive(name, units.number(name, getattr(self, name), dimension))
        if self.stretch_modulus is not None:
            check.positive("stretch_modulus", units.number("stretch_modulus", self.stretch_modulus, "force"))

    def filament(
        self,
        segments: int,
        temperature: unit.Quantity,
        *,
        match: Match = Match.PERSISTENCE_LENGTH,
        stretch_modulus: unit.Quantity | None = None,
        tension: unit.Quantity | None = None,
    ) -> Filament:
        """A discrete chain of `segments` equal segments, b = L/segments, straight along z, that stands for this one.

        Bending is harmonic, with the stiffness at which the *discrete* chain has the property that `match` names.
        Bonds have stiffness k = S/b and a rest length b0 shortened so that their mean length at this temperature is b
        (to first order b0 + 2 k_B T/(k b0) = b).

        Parameters
        ----------
        segments : int
            At least 2.
        temperature : Quantity
        match : Match
        stretch_modulus : Quantity, optional
            A softer (or stiffer) S' for the bonds that are run, which allows a longer time step. The mean bond length
            stays that of the chain with its own S, at the `tension`.
        tension : Quantity, optional
            Mean tension along the bonds, force, at which softer bonds have the right mean length `b (1 + tension/S)`;
            by default none.

        Raises
        ------
        ValueError
            If no bending stiffness gives segments so long the asked property.
        """
        count = check.integer("segments", segments, low=2)
        kt = units.BOLTZMANN * float(
            check.positive("temperature", units.number("temperature", temperature, "temperature"))
        )
        length = units.number("contour_length", self.contour_length, "length")
        b = length / count
        modulus = stretch_modulus if stretch_modulus is not None else self.stretch_modulus
        if modulus is None:
            k = INEXTENSIBLE * kt / b**2
        else:
            k = float(check.positive("stretch_modulus", units.number("stretch_modulus", modulus, "force"))) / b
        pull = (
            0.0 if tension is None else check.non_negative("tension", units.number("tension", tension, "force")).item()
        )
        own = (
            math.inf if self.stretch_modulus is None else units.number("stretch_modulus", self.stretch_modulus, "force")
        )
        mean = b * (1 + pull / own)
        # a tension f on a harmonic bond only moves its rest length, by f/k
        loaded = float(wlc.rest_length(mean, k, kt))
        rest_length = loaded - pull / k
        if rest_length <= 0:
            raise ValueError(
                f"Argument `stretch_modulus` must be well above the tension, but is {k * b / pull:.3g} times it."
            )
        # <s^2> = b0 <s> + 3 kT/k, integrating (s^3 exp(-k (s - b0)^2/2kT))' over all lengths
        squared_bond = loaded * mean + 3 * kt / k - (mean**2 - b**2)
        cosine = self._mean_cosine(count, b, squared_bond, check.one_of("match", match, tuple(Match)))
        alpha = kt * wlc.bending_from_cosine(cosine)
        density = units.number("line_density", self.line_density, "line_density")
        masses = np.full(count + 1, density * b)
        return Filament(
            rest=shapes.line(count, units.quantity(rest_length, "length")),
            masses=units.quantity(masses, "mass"),
            terms=(
                stretching.Harmonic(units.quantity(k, "stiffness")),
                bending.Harmonic(units.quantity(alpha, "energy")),
            ),
        )

    def _mean_cosine(self, count: int, b: float, squared_bond: float, match: Match) -> float:
        """`<cos beta>` of a free joint for `count` segments of mean length b and mean-square length `squared_bond`."""
        lp = units.number("persistence_length", self.persistence_length, "length")
        if match is Match.PERSISTENCE_LENGTH:
            return math.exp(-b / lp)
        wanted = wlc.mean_squared_end_to_end(lp, count * b)

        def excess(cosine: float) -> float:
            rigid = wlc.mean_squared_end_to_end_discrete(count, b, cosine)
            return float(rigid + count * (squared_bond - b**2) - wanted)

        low, high = 0.01, 1 - 1e-6
        if excess(low) > 0 or excess(high) < 0:
            raise ValueError(f"Argument `segments` must be larger to match the end-to-end distance, but is {count}.")
        return float(brentq(excess, low, high, xtol=1e-15, rtol=1e-13))
