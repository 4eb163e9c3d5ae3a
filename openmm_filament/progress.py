"""How far a force-extension curve has come, as its caller is told."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from openmm_filament.points import Point

__all__ = ["Meter", "Progress"]


@dataclass(frozen=True)
class Progress:
    """The state of a running curve, as passed to `progress`.

    Attributes
    ----------
    fraction : float
        Of the work now expected, done; zero while chains are chosen. It never falls, though more work may come to be
        expected.
    seconds_left : float
        Expected, at the pace so far; NaN before the first block.
    force : float
        The force, in pN, at which the last block ended, or whose chain was chosen last.
    extension, error : float
        The estimate there and its standard error in nm; NaN before its first round.
    finished : int
        Forces whose error has been reached.
    chosen : int
        Forces for which a chain has been chosen.
    """

    fraction: float
    seconds_left: float
    force: float
    extension: float
    error: float
    finished: int
    chosen: int


class Meter:
    """Tells `progress`, if there is one, what has been done."""

    def __init__(self, forces: Sequence[float], progress: Callable[[Progress], None] | None) -> None:
        if progress is not None and not callable(progress):
            raise TypeError(f"Argument `progress` must be a function of a Progress, or None, but is {progress!r}.")
        self._forces, self._tell = forces, progress
        self._fraction = 0.0
        self._begun, self._before = time.perf_counter(), 0.0

    def chosen(self, count: int) -> None:
        """For so many forces a chain has been chosen."""
        if self._tell is not None:
            force = float(self._forces[max(count, 1) - 1])
            self._tell(Progress(0.0, math.nan, force, math.nan, math.nan, 0, count))

    def begin(self, points: Sequence[Point], last: Point | None) -> None:
        """Start the clock; `last` is the point of the last block that was done before, if there are any."""
        self._begun, self._before = time.perf_counter(), _work(points)[0]
        if last is not None:
            self.show(points, last)

    def show(self, points: Sequence[Point], point: Point) -> None:
        """A block has ended at this point."""
        if self._tell is None:
            return
        done, expected = _work(points)
        fraction = min(done / expected, 1.0) if expected else 1.0
        self._fraction = max(self._fraction, fraction)
        pace = (done - self._before) / max(time.perf_counter() - self._begun, 1e-9)
        left = max(expected - done, 0.0) / pace if pace > 0 else math.nan
        finished = sum(p.finished for p in points)
        self._tell(Progress(self._fraction, left, point.force, point.mean, point.error, finished, len(points)))


def _work(points: Sequence[Point]) -> tuple[float, float]:
    """Beads times steps done and expected, of the points that are not given up."""
    running = [p for p in points if p.failure is None]
    done = sum(p.weight * sum(run.done for run in p.runs) / len(p.runs) for p in running)
    return done, sum(p.weight * p.expected() for p in running)
