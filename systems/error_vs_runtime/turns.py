"""Runs in turns: every setting of every study once, then all of them again, as often as the time allows."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from systems.error_vs_runtime.settings import Outcome, Result, Setting, Study

__all__ = ["FEWEST", "expected", "measured"]

FEWEST = 2
"""Rounds that run whatever they take (if as many are asked for): one has no spread."""


def expected(studies: Sequence[Study], rounds: int) -> float:
    """Seconds that so many rounds are expected to take."""
    return rounds * sum(study.seconds for study in studies)


def measured(
    studies: Sequence[Study],
    rounds: int,
    seed: int,
    progress: Callable[[float], None],
    *,
    seconds: float = math.inf,
    clock: Callable[[], float] = time.perf_counter,
) -> list[Study]:
    """The studies with their outcomes, each setting run once a round, so that what else the machine does falls on all of them.

    A setting that cannot run - a step that diverges, a platform that refuses - is kept with the reason. After FEWEST rounds
    another one begins only if, as long as the longest before it, it ends within `seconds` of the beginning by the `clock`.
    """
    found: list[dict[Setting, list[Result]]] = [{setting: [] for setting in study.settings} for study in studies]
    failures: list[dict[Setting, str]] = [{} for _ in studies]
    whole = sum(study.seconds for study in studies)
    begun, longest, done = clock(), 0.0, 0.0
    for turn in range(rounds):
        before = clock()
        if turn >= FEWEST and before - begun + longest > seconds:
            break
        for study, results, refused in zip(studies, found, failures, strict=True):
            for i, (setting, runs) in enumerate(results.items()):
                if setting not in refused:
                    outcome = _once(study, setting, seed + 1000 * turn + i)
                    if isinstance(outcome, Result):
                        runs.append(outcome)
                    else:
                        refused[setting] = outcome
                done += study.seconds / len(results)
                progress(done / whole / rounds)
        longest = max(longest, clock() - before)
    return [
        replace(study, outcomes=tuple(Outcome(s, () if s in no else tuple(r), no.get(s, "")) for s, r in all_.items()))
        for study, all_, no in zip(studies, found, failures, strict=True)
    ]


def _once(study: Study, setting: Setting, seed: int) -> Result | str:
    """One run, or why there is none."""
    try:
        return study.measure(setting, seed)
    except (ValueError, ArithmeticError, RuntimeError, np.linalg.LinAlgError) as error:
        return _reason(error)
    except Exception as error:
        if type(error).__name__ not in {"OpenMMException", "DivergedError"}:
            raise
        return _reason(error)


def _reason(error: Exception) -> str:
    return str(error).splitlines()[0][:200] if str(error) else type(error).__name__
