"""The transfer operator of a joint in three dimensions: the bending kernel is diagonal in Legendre polynomials."""

from __future__ import annotations

import functools
import math

import numpy as np

from openmm_filament import _checks as check
from openmm_filament.wlc.chain import DiscreteChain
from openmm_filament.wlc.joints import CUT, joint_rule
from openmm_filament.wlc.numerics import Floats, gauss

__all__ = ["Spatial"]

_MOST_HARMONICS = 2400  # of a message: three matrices of 46 megabytes


@functools.lru_cache(maxsize=4)
def _legendre_basis(size: int) -> tuple[Floats, Floats, Floats]:
    """Nodes and weights in cos(theta), and the orthonormal Legendre polynomials on them, (nodes, modes)."""
    nodes, weights = gauss(size)
    values = np.empty((size, size))
    values[:, 0], values[:, 1] = 1.0, nodes
    for n in range(1, size - 1):
        values[:, n + 1] = ((2 * n + 1) * nodes * values[:, n] - n * values[:, n - 1]) / (n + 1)
    return nodes, weights, values * np.sqrt(np.arange(size) + 0.5)


def _legendre_coefficients(stiffness: Floats, rest: Floats, form: str, size: int) -> Floats:
    """`<P_l(cos beta)>` of each joint, (joints, size): what the bending kernel does to the harmonics of a message."""
    span = math.pi if stiffness.min() <= 0 else min(math.pi, 3 * math.sqrt(2 * CUT / stiffness.min()))
    beta, weights = joint_rule(stiffness, rest, form, 3, 64 + int(0.7 * size * span))
    x, previous, current = np.cos(beta), np.ones_like(beta), np.cos(beta)
    result = np.empty((len(stiffness), size))
    result[:, 0] = 1.0
    for n in range(1, size):
        result[:, n] = np.einsum("jm,jm->j", weights, current)
        previous, current = current, ((2 * n + 1) * x * current - n * previous) / (n + 1)
    return result


class Spatial:
    """Messages at Gauss-Legendre nodes in cos(theta); the bending kernel acts on their Legendre coefficients."""

    positive = False
    """Whether every element of the operator is."""

    def __init__(self, chain: DiscreteChain, curvature: float, refine: float) -> None:
        joints = chain.joints
        stiffest = joints[:, 0].max(initial=0.0)
        # exp(-g theta^2/2) has harmonics up to 8.3 sqrt(g); g of a message in a straight chain from
        # 1/g' = 1/(g + curvature) + 1/stiffness, or the bound g' = stiffness where joints are bent.
        g = stiffest if joints[:, 1].any() else curvature * (math.sqrt(0.25 + stiffest / max(curvature, 1e-12)) - 0.5)
        self.size = 16 * math.ceil(refine * (24 + 8.3 * math.sqrt(min(g, stiffest) + curvature)) / 16)
        if self.size > _MOST_HARMONICS:
            raise check.fail(
                "force", f"be weaker: this chain would need {self.size} harmonics, at most", _MOST_HARMONICS
            )
        self.cosines, self.weights, self.polynomials = _legendre_basis(self.size)
        self.projection = np.ascontiguousarray((self.polynomials * self.weights[:, None]).T)
        distinct, self.which = np.unique(joints, axis=0, return_inverse=True)
        self.which = self.which.reshape(-1)
        self.coefficients = np.empty((0, 0))
        if len(joints):
            self.coefficients = _legendre_coefficients(distinct[:, 0], distinct[:, 1], chain.bending_form, self.size)
        kept = np.abs(self.coefficients).max(axis=0, initial=0.0) > 1e-18
        self.kept = int(np.flatnonzero(kept).max(initial=0)) + 1
        self.tail = 0.0

    def __call__(self, joint: int, messages: Floats) -> Floats:
        coefficients = self.projection @ messages
        self.tail = max(self.tail, float((np.abs(coefficients[-4:]) / np.abs(coefficients).max(axis=0)).max()))
        damped = self.coefficients[self.which[joint], : self.kept, None] * coefficients[: self.kept]
        result: Floats = self.polynomials[:, : self.kept] @ damped
        return result
