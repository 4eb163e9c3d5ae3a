"""The transfer operator of a joint in two dimensions: the bending kernel summed on a uniform grid of angles."""

from __future__ import annotations

import functools
import math

import numpy as np
from scipy import linalg, special

from openmm_filament import _checks as check
from openmm_filament.wlc.chain import DiscreteChain
from openmm_filament.wlc.joints import CUT
from openmm_filament.wlc.numerics import Floats, gauss

__all__ = ["Planar"]

_LARGEST = 8000  # nodes of a message: a matrix of half a gigabyte
_STEP_WIDTH = 0.17  # of the rounded edge of the low-pass filter, in units of 1/(grid spacing); the filter passes 0.6 pi
_STEP_REACH = 46.0  # grid spacings after which the filtered step is flat to 1e-14


def _filtered_step(x: Floats) -> Floats:
    """Unit step after a low-pass filter, x in grid spacings.

    On a uniform grid the sum of `step(x) g(x)` is spectrally accurate for a smooth g, although the step is sharp: the
    filter leaves every frequency of g (below 0.6 pi) alone and removes those that would alias onto them.
    """
    result = np.where(x > 0, 1.0, 0.0)
    near = np.abs(x) < _STEP_REACH
    nodes, weights = gauss(160)
    q = (nodes + 1) / 2 * (math.pi + 9 * _STEP_WIDTH)
    passed = special.erfc((q - math.pi) / (math.sqrt(2) * _STEP_WIDTH)) / 2 * weights * (math.pi + 9 * _STEP_WIDTH) / 2
    result[near] = 0.5 + np.sin(np.multiply.outer(x[near], q)) @ (passed / q) / math.pi
    return result


@functools.lru_cache(maxsize=16)
def _window(size: int, low: float, high: float) -> Floats:
    """The filtered indicator of low < phi < high at the angles `2 pi m/size`, m from -2 size to 3 size."""
    spacing = 2 * math.pi / size
    m = np.arange(-2.0 * size, 3.0 * size)
    window: Floats = _filtered_step(m - low / spacing) - _filtered_step(m - high / spacing)
    return window


def _kernel(stiffness: float, rest: float, form: str, flip: bool, size: int) -> Floats:
    """The bending weight at the signed angles `phi_m = 2 pi m/size`, m < size.

    The harmonic form has a kink opposite its minimum and, where it is even in phi, at phi = 0; see `_filtered_step`.
    """
    phi = 2 * math.pi / size * np.arange(-2 * size, 3 * size)
    if form == "cosine":
        return np.exp(-2 * stiffness * np.sin(phi[2 * size : 3 * size] / 2) ** 2)
    pieces = [(rest - math.pi, rest + math.pi, rest)]
    if flip and rest != 0:
        pieces = [(0.0, math.pi, rest), (-math.pi, 0.0, -rest)]
    elif stiffness * math.pi**2 / 2 > CUT:  # the kink is too small to matter
        pieces = [(-math.inf, math.inf, rest)]
    images = np.zeros(phi.shape)
    for low, high, centre in pieces:
        window = 1.0 if math.isinf(low) else _window(size, low, high)
        images += window * np.exp(-stiffness * (phi - centre) ** 2 / 2)
    kernel: Floats = images.reshape(5, size).sum(axis=0)
    return kernel


class Planar:
    """Messages at uniform angles.

    The kernel is summed as it stands, all terms positive, so that no digit is lost even where a strong force picks out
    the far tail of a stiff bent joint.
    """

    positive = True
    """Whether every element of the operator is."""

    def __init__(self, chain: DiscreteChain, curvature: float, refine: float) -> None:
        self.chain, joints = chain, chain.joints
        stiffest = joints[:, 0].max(initial=0.0)
        bent = bool(joints[:, 1].any())
        kinked = chain.bending_form == "harmonic" and (
            (bent and joints[:, 2].any()) or joints[:, 0].min(initial=np.inf) * math.pi**2 / 2 < CUT
        )
        # An integrand exp(-c theta^2/2) has frequencies up to 7.7 sqrt(c), which the sampling rate must exceed; beside
        # a kink they must stay below 0.3 of it.
        band = 7.7 * math.sqrt(2 * stiffest + (2 if kinked else 1) * curvature)
        size = 4 * math.ceil(refine * (band / 0.3 if kinked else band + 16) / 4)
        self.size = max(size, 128)
        self.even = bool(joints[:, 2].all()) or not bent  # its mirror image weighs the same: half the circle
        self.nodes = 2 * math.pi * (np.arange(self.size // 2 if self.even else self.size) + 0.5) / self.size
        self.cosines, self.weights = np.cos(self.nodes), np.full(self.nodes.shape, 2 * math.pi / self.size)
        if len(self.nodes) > _LARGEST:
            raise check.fail("force", f"be weaker: this chain would need {len(self.nodes)} angles, at most", _LARGEST)
        self.built = -1

    def __call__(self, joint: int, messages: Floats) -> Floats:
        joints = self.chain.joints
        if self.built < 0 or (joints[joint] != joints[self.built]).any():
            stiffness, rest, flip = joints[joint].tolist()
            kernel = _kernel(stiffness, rest, self.chain.bending_form, flip == 1, self.size)
            kernel /= kernel.sum()
            size = len(self.nodes)
            self.matrix = linalg.toeplitz(kernel[:size], np.roll(kernel[::-1], 1)[:size])  # kernel[i - j]
            if self.even:
                self.matrix += linalg.hankel(kernel[1 : size + 1], kernel[size : 2 * size])  # kernel[i + j + 1]
        self.built = joint
        result: Floats = self.matrix @ messages
        return result
