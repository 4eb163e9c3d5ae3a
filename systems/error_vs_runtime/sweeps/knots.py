"""The pseudoknot: no exact answer is known to it, but that energy is kept; what a time step leaves of that."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import cache

import numpy as np

from systems.error_vs_runtime.settings import Result, Setting, Study
from systems.pseudoknot import plan
from systems.pseudoknot.hands import PLATFORM, Task
from systems.pseudoknot.poses import drawn
from systems.pseudoknot.runs import STEPS, made

__all__ = ["pseudoknot_studies"]

_SLOWNESS = 0.8
"""Time of making over the period of the slowest swing: that of the fastest of the quick run of the system."""


@cache
def _task() -> Task:
    """Two helices that are screwed together, as the first start of the system has them."""
    (case, *_) = plan.cases(quick=True)
    poses = drawn(1, 1, shift=plan.SHIFT * case.lower.thickness, tilt=plan.TILT)
    return plan.task(case, _SLOWNESS, poses, 1)


def _screwed(setting: Setting, seed: int) -> Result:
    """Work less what is stored and lost when the knot is made, over the largest of them."""
    del seed
    begun = time.perf_counter()
    phase = made(_task(), setting.step)
    return Result(time.perf_counter() - begun, np.array([abs(phase.misfit)]))


def pseudoknot_studies(*, quick: bool) -> list[Study]:
    """The energy balance of making a knot by time step.

    No error is stated of it: what the system states is for the slowest of its many runs, whose works are smaller, and it
    halves the time step of a run that misses it.
    """
    default = Setting(plan.BASE.segments, STEPS[0], "LangevinMiddle", platform=PLATFORM, precision="single")
    steps = (0.8,) if quick else (0.8, 0.35, 0.25, 0.18)
    return [
        Study(
            "pseudoknot", "energy balance of screwing in", "energy kept", _screwed,
            [default, *(replace(default, step=step) for step in steps)], default=default, seconds=2.3 if quick else 11.0,
        )
    ]  # fmt: skip
