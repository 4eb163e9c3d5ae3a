"""Physical filaments as terms and chains: elastic rods of a material, and worm-like chains at a temperature."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum
from functools import lru_cache

import numpy as np
from openmm import unit
from scipy.optimize import brentq

from openmm_filament import _checks as check
from openmm_filament import bending, shapes, stretching, torsion, units, wlc
from openmm_filament._term import Term
from openmm_filament.contact import Repulsion
from openmm_filament.filament import Filament

__all__ = ["Match", "WormlikeChain", "rod_terms"]


def rod_terms(
    youngs_modulus: unit.Quantity,
    shear_modulus: unit.Quantity | None,
    radius: unit.Quantity,
    segment_length: unit.Quantity,
    *,
    contact: bool = False,
) -> tuple[Term, ...]:
    """Harmonic terms of a rod of circular section: k = E S/l0, alpha = E I/l0, C = G J/l0.

    S = pi R^2, I = pi R^4/4, J = pi R^4/2 (thesis, section 1). Rest values are left to the rest shape.

    The model has no material frame: its torsion is that of the centre line. It is an elastic rod where the rod bends in
    its own plane, or as a straight rod does; a curved rod can also bend about the normal of its curve, which costs nothing
    here that is not torsion, so that a helix loaded off its axis comes out too stiff, and a curve without a shear modulus,
    however slight, has no stiffness out of its plane (see `bending.Harmonic`).

    Parameters
    ----------
    youngs_modulus, shear_modulus : Quantity
        E and G, pressure. Without a shear modulus (None) the torsion term is left out.
    radius, segment_length : Quantity
        R of the section and l0 of one segment, length.
    contact : bool
        Whether rods repel where they touch: `contact.Repulsion` of diameter 2 R and stiffness E S/l0, which leaves the time
        step nearly as it is. The segments must then be shorter than 2.8 R.
    """
    e = float(check.positive("youngs_modulus", units.number("youngs_modulus", youngs_modulus, "pressure")))
    r = float(check.positive("radius", units.number("radius", radius, "length")))
    l0 = float(check.positive("segment_length", units.number("segment_length", segment_length, "length")))
    terms: tuple[Term, ...] = (
        stretching.Harmonic(units.quantity(e * math.pi * r**2 / l0, "stiffness")),
        bending.Harmonic(units.quantity(e * math.pi * r**4 / 4 / l0, "energy")),
    )
    if contact:
        stiffness = units.quantity(e * math.pi * r**2 / l0, "stiffness")
        terms += (Repulsion(units.quantity(2 * r, "length"), stiffness),)
    if shear_modulus is None:
        return terms
    g = float(check.positive("shear_modulus", units.number("shear_modulus", shear_modulus, "pressure")))
    return (*terms[:2], torsion.Harmonic(units.quantity(g * math.pi * r**4 / 2 / l0, "energy")), *terms[2:])


class Match(Enum):
    """What a discrete chain shares exactly with the continuous one that it stands for."""

    PERSISTENCE_LENGTH = "persistence_length"
    """The decay of tangent correlations: `<cos beta> = exp(-b/l_p)`."""
    END_TO_END = "end_to_end"
    """The mean square and mean fourth power of the end-to-end distance, hence the response to a small force and where it
    bends off. Bonds are then somewhat shorter than L/segments, as a polygon inscribed in a curve is shorter than the
    curve, and far fewer of them serve at small and moderate forces."""


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
        S, force: the extension by a force F is F/S. None for an inextensible chain. Beads cannot be that: `force_extension`
        takes bonds stiff enough for its wanted error, `filament` bonds that are stiff against temperature (they fluctuate
        by 5 %) and stretch by `F b/(400 k_B T)`, which is much for long segments: give a modulus there.
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

        A discrete chain is longer than the continuous one, by 3.6 % with 40 segments of 1 um of DNA at 5 pN: segments
        should be well below `sqrt(k_B T l_p/F)`. `exact_extension` tells; `force_extension` chooses by itself.

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
        pull, own = self._tension(tension)
        lp = units.number("persistence_length", self.persistence_length, "length")
        matched = check.one_of("match", match, tuple(Match)) is Match.END_TO_END
        free = _inscribed_bond(length, lp, own, count, kt) if matched else b
        mean = free * (1 + pull / own)
        # a tension f on a harmonic bond only moves its rest length, by f/k
        loaded = float(wlc.rest_length(mean, k, kt))
        rest_length = loaded - pull / k
        if rest_length <= 0:
            raise ValueError(
                f"Argument `stretch_modulus` must be well above the tension, but is {k * b / pull:.3g} times it."
            )
        # <s^2> = b0 <s> + 3 kT/k, integrating (s^3 exp(-k (s - b0)^2/2kT))' over all lengths
        variance = loaded * mean + 3 * kt / k - mean**2
        cosine = _cosine_of_end_to_end(length, lp, count, free, variance) if matched else math.exp(-b / lp)
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

    def _tension(self, tension: unit.Quantity | None) -> tuple[float, float]:
        """The tension and the chain's own stretch modulus (infinite where it has none), in kJ/mol/nm."""
        pull = 0.0
        if tension is not None:
            pull = float(check.non_negative("tension", units.number("tension", tension, "force")))
        if self.stretch_modulus is None:
            return pull, math.inf
        return pull, units.number("stretch_modulus", self.stretch_modulus, "force")


def _cosine_of_end_to_end(length: float, lp: float, count: int, bond: float, variance: float) -> float:
    """`<cos beta>` at which bonds of this mean length and variance have the continuous chain's `<R^2>`."""
    wanted = wlc.mean_squared_end_to_end(lp, length)

    def excess(cosine: float) -> float:
        return float(wlc.mean_squared_end_to_end_discrete(count, bond, cosine)) + count * variance - wanted

    low, high = 1e-3, 1 - 1e-7
    if excess(low) > 0 or excess(high) < 0:
        raise ValueError(f"Argument `segments` must be larger to match the end-to-end distance, but is {count}.")
    return float(brentq(excess, low, high, xtol=1e-15, rtol=1e-13))


@lru_cache(maxsize=256)
def _inscribed_bond(length: float, lp: float, modulus: float, count: int, kt: float) -> float:
    """Mean bond length at which a chain matched in `<R^2>` is matched in `<R^4>` too, by its extension at a force that
    is small, 1.5 k_B T/R, where the fourth moment is what makes the first difference.
    """
    b = length / count
    k = INEXTENSIBLE * kt / b**2 if math.isinf(modulus) else modulus / b
    probe = 1.5 * kt / math.sqrt(wlc.mean_squared_end_to_end(lp, length))
    stretch = None if math.isinf(modulus) else modulus
    wanted = wlc.extension_exact(probe, lp, length, kt, stretch_modulus=stretch, finite=True)

    def excess(mean: float) -> float:
        rest = float(wlc.rest_length(mean, k, kt))
        cosine = _cosine_of_end_to_end(length, lp, count, mean, rest * mean + 3 * kt / k - mean**2)
        alpha = kt * float(wlc.bending_from_cosine(cosine))
        found = wlc.extension_discrete(probe, segments=count, bond_length=rest, bending=alpha, kT=kt, stretching=k)
        return float(found) / float(wanted) - 1

    low = b * max(1 - 0.6 * b / (6 * lp), 0.8)
    if excess(b) <= 0:  # segments so fine that the difference is rounding
        return b
    if excess(low) >= 0:
        raise ValueError(f"Argument `segments` must be larger to match the end-to-end distance, but is {count}.")
    return float(brentq(excess, low, b, xtol=1e-7 * b))
