"""Decaying sinusoids by variable projection: a least-squares problem in frequencies and decay rates alone.

At given frequencies and decay rates the model is linear in its amplitudes and offsets, which are eliminated (G. H. Golub and
V. Pereyra, SIAM J. Numer. Anal. 10, 413 (1973), with the Jacobian of L. Kaufman, BIT 15, 49 (1975), whose gradient is
exact).

The inner products of `[basis, t basis, signal]` hold all that is left: it is handed to the solver turned into as many rows
as it has unknowns, the same for one column and for hundreds. Products square the condition number, so the linear part
and the gradient are taken from the residual itself, and the condition number is told.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

__all__ = ["Problem", "Solution"]

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_GROWTH = 50.0
"""A decay rate below minus this over the length of the recording is not tried: the wave would grow e^50 times."""


@dataclass(frozen=True, eq=False)
class Solution:
    """The problem reduced to frequencies and decay rates, in as few rows as it has unknowns, and one for the rest."""

    coefficients: Array  # (2 K + 1, N): cosines, sines, constant
    residual: Array  # (P + 1,)
    jacobian: Array  # (P + 1, P)
    condition: float


class Problem:
    """The signal, and the least-squares problem in `[2 pi f, d] * duration`, shape (2 K,)."""

    def __init__(self, values: Array, lines: int, damped: bool) -> None:
        self.values, self.lines, self.damped = values, lines, damped
        self._at = np.full(2 * lines, np.nan)
        self._solution: Solution | None = None

    def solve(self, at: Array) -> Solution:
        """The solution at these frequencies and decay rates; the last one is kept, for its Jacobian is asked for later."""
        if self._solution is None or not np.array_equal(at, self._at):
            try:
                self._at, self._solution = at.copy(), self._solved(at)
            except linalg.LinAlgError:  # not to be told apart, or growing without bound: the step is shortened
                unknowns = 2 * self.lines if self.damped else self.lines
                nothing = np.zeros((2 * self.lines + 1, self.values.shape[1]))
                jacobian = np.eye(unknowns + 1, unknowns)
                self._solution = Solution(nothing, np.full(unknowns + 1, np.inf), jacobian, np.inf)
        return self._solution

    def _solved(self, at: Array) -> Solution:
        k = self.lines
        m = 2 * k + 1
        if at[k:].min() < -_GROWTH:
            raise linalg.LinAlgError
        table = _table(len(self.values), -at[k:] + 1j * at[:k])
        gram = table.T @ table
        norms = np.sqrt(np.diag(gram))
        gram /= np.outer(norms, norms)
        factor = linalg.cholesky(gram[:m, :m], lower=True)
        coefficients, left = np.zeros((m, self.values.shape[1])), self.values
        for _ in range(2):  # the second pass takes out the rounding of the first
            moments = table[:, :m].T @ left / norms[:m, None]
            coefficients += linalg.cho_solve((factor, True), moments) / norms[:m, None]
            left = self.values - table[:, :m] @ coefficients
        across = linalg.solve_triangular(factor, gram[:m, m:], lower=True)
        own = gram[m:, m:] - across.T @ across  # of the slopes `t basis` less what the basis holds of them
        slopes = norms[m:].reshape(2, k, 1)
        cosine, sine = coefficients[:k], coefficients[k : 2 * k]
        weights = [(-sine * slopes[0], cosine * slopes[1])]  # of the two slopes in the derivative by frequency
        if self.damped:
            weights.append((cosine * slopes[0], sine * slopes[1]))  # and by decay rate
        parts = own.reshape(2, k, 2, k)
        normal = np.block(
            [[sum(parts[x, :, y] * (p[x] @ q[y].T) for x in (0, 1) for y in (0, 1)) for q in weights] for p in weights]
        )
        moments = (table[:, m:].T @ left / norms[m:, None]).reshape(2, k, -1)
        gradient = np.concatenate([np.sum(c * moments[0] + s * moments[1], axis=1) for c, s in weights])
        scale = np.concatenate([np.sqrt(np.sum(c**2 + s**2, axis=1)) for c, s in weights])
        normal /= np.outer(scale, scale)
        root = linalg.cholesky(normal, lower=True)
        reduced = linalg.solve_triangular(root, gradient / scale, lower=True)
        rest = np.sqrt(max(np.sum(left**2) - reduced @ reduced, 0.0))
        least = min(np.linalg.eigvalsh(gram[:m, :m])[0], np.linalg.eigvalsh(normal)[0])
        return Solution(
            coefficients,
            np.append(reduced, rest),
            np.concatenate([root.T * scale, np.zeros((1, len(scale)))]),
            float(1 / np.sqrt(max(least, np.finfo(float).tiny))),
        )


def _table(samples: int, rates: Complex) -> Array:
    """Columns `Re w`, `Im w`, 1, `t Re w`, `t Im w` of the waves `w = exp(rate t)`, t = 0, 1/T, ... below 1."""
    k, fine = len(rates), 128
    coarse = np.exp(np.arange(0, samples, fine)[:, None] / samples * rates)
    waves = (coarse[:, None] * np.exp(np.arange(fine)[:, None] / samples * rates)).reshape(-1, k)[:samples]
    table = np.empty((samples, 4 * k + 1))
    table[:, :k], table[:, k : 2 * k], table[:, 2 * k] = waves.real, waves.imag, 1.0
    table[:, 2 * k + 1 :] = np.arange(samples)[:, None] / samples * table[:, : 2 * k]
    return table
