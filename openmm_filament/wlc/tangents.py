"""Tangent correlations of discrete chains with bending and torsion, by a product of mean rotations."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from openmm_filament import _checks as check
from openmm_filament.wlc.joints import CUT, BendingForm, check_joint, joint_rule
from openmm_filament.wlc.numerics import Floats, gauss, positive_scalar

__all__ = ["TorsionForm", "tangent_correlation_discrete"]

TorsionForm = Literal["harmonic", "periodic"]

_NODES = 160


def tangent_correlation_discrete(
    count: int,
    *,
    bending: float,
    kT: float,
    bending_form: BendingForm = "harmonic",
    rest_angle: float = 0.0,
    torsion: float = 0.0,
    torsion_form: TorsionForm = "harmonic",
    rest_torsion: float = 0.0,
    multiplicity: int = 1,
) -> Floats:
    """Exact `<t_n . t_0>`, n = 0 ... `count`, of a uniform discrete chain without force, in three dimensions.

    The tangents of a chain follow from one another by turns about its own axes: `R_z(tau) R_y(beta)` from one segment to
    the next, z along the segment and tau the torsion about it. Without force all angles are independent, so

        `<t_n . t_0> = e_z . A^n . e_z`,    `A = <R_z(tau)> <R_y(beta)>`,

    the average over beta weighted with `sin(beta) exp(-E(beta)/kT)` on [0, pi], `E = 1/2 alpha (beta - beta0)^2` or
    `-alpha cos(beta)`, and that over tau with `exp(-E(tau)/kT)`, `E = 1/2 C d^2` with `d = tau - tau0` brought into
    [-pi, pi], or `K (1 - cos(a (tau - tau0)))`. Stretching plays no part: it does not turn tangents. For the averages of
    rotations see Flory, *Statistical Mechanics of Chain Molecules* (1969), chapter 1.

    `torsion.Weighted` is not covered: its energy couples bends and torsions of neighbouring joints, whose angles are then
    not independent.

    Parameters
    ----------
    count : int
        Largest separation n, in segments, not negative.
    bending : float
        alpha in pN nm, not negative.
    kT : float
        Thermal energy in pN nm.
    bending_form : str
        "harmonic" or "cosine".
    rest_angle : float
        beta0 in [0, pi]; must be 0 for the cosine form.
    torsion : float
        C or K in pN nm, not negative; 0 for a chain without torsion.
    torsion_form : str
        "harmonic" or "periodic".
    rest_torsion : float
        tau0 in [-pi, pi], signed as in `geometry`. Its sign does not change the correlation.
    multiplicity : int
        a of the periodic form; must be 1 for the harmonic one.

    Returns
    -------
    (count + 1,) array
        The correlations, the first 1, with an absolute error of about 1e-14.

    Raises
    ------
    ValueError
        If an argument is out of its range, or without effect.

    Examples
    --------
    >>> straight = tangent_correlation_discrete(2, bending=41.14, kT=4.114)
    >>> helix = tangent_correlation_discrete(2, bending=411.4, kT=4.114, rest_angle=0.6, torsion=80.0, rest_torsion=0.3)
    >>> straight.round(6), helix.round(6)
    (array([1.      , 0.906366, 0.8215  ]), array([1.      , 0.813048, 0.354428]))
    """
    count = check.integer("count", count, low=0)
    check_joint(bending_form, 3)
    thermal = positive_scalar("kT", kT)
    stiffness = check.shape("bending", check.non_negative("bending", bending), ()) / thermal
    rest = check.shape("rest_angle", check.within("rest_angle", rest_angle, 0, math.pi, unit="rad"), ())
    if bending_form == "cosine" and rest:
        raise check.fail("rest_angle", "be 0 for the cosine form", rest_angle)
    beta, weights = joint_rule(stiffness[None], rest[None], bending_form, 3, _NODES)
    cosine, sine = float(weights[0] @ np.cos(beta[0])), float(weights[0] @ np.sin(beta[0]))
    bend = np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])

    c, s = _mean_torsion(torsion, thermal, torsion_form, rest_torsion, multiplicity)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    step = turn @ bend
    tangent, result = np.array([0.0, 0.0, 1.0]), np.ones(count + 1)
    for n in range(1, count + 1):
        tangent = step @ tangent
        result[n] = tangent[2]
    return result


def _mean_torsion(torsion: float, kT: float, form: str, rest_torsion: float, multiplicity: int) -> tuple[float, float]:
    """`<cos tau>` and `<sin tau>`."""
    check.one_of("torsion_form", form, ("harmonic", "periodic"))
    stiffness = float(check.shape("torsion", check.non_negative("torsion", torsion), ())) / kT
    rest = float(check.shape("rest_torsion", check.within("rest_torsion", rest_torsion, -math.pi, math.pi), ()))
    fold = check.integer("multiplicity", multiplicity, low=1)
    if form == "harmonic" and fold != 1:
        raise check.fail("multiplicity", "be 1 for the harmonic form", multiplicity)
    if not stiffness or fold > 1:  # every direction alike, or as many minima on all sides
        return 0.0, 0.0
    # about tau0 both wells are even: <exp(i tau)> = exp(i tau0) <cos d>
    reach = math.sqrt(2 * CUT / stiffness)
    if form == "periodic":
        reach = math.acos(max(1 - CUT / stiffness, -1.0))
    nodes, weights = gauss(_NODES)
    d = min(reach, math.pi) * (nodes + 1) / 2
    energy = stiffness * (d**2 / 2 if form == "harmonic" else 2 * np.sin(d / 2) ** 2)
    boltzmann = weights * np.exp(-energy)
    order = float(boltzmann @ np.cos(d) / boltzmann.sum())
    return order * math.cos(rest), order * math.sin(rest)
