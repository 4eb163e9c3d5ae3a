"""What a cell of the map is, and how running something makes one: right, told of, refused, or wrong."""

from __future__ import annotations

import csv
import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import openmm as mm

import openmm_filament as of
from openmm_filament.divergence import DivergedError
from openmm_filament.inspection import PreflightWarning

__all__ = ["OUTCOMES", "TOLERANCE", "Cell", "Outcome", "judged", "missing", "reference", "write"]

Outcome = Literal["right", "warned", "refused", "wrong", "not available"]
OUTCOMES: tuple[Outcome, ...] = ("right", "warned", "refused", "wrong", "not available")

TOLERANCE = 1e-3
"""Largest error of a force over the largest force that still counts as right: the tolerance of `of.preflight`."""

_SAYS_WHY = (
    "must",
    "diverged",
    "heated up",
    "NOT converged",
    "carry an error of",
    "should",
    "is lost there",
    "few digits",
    "rose to",
)
"""A clear message names a rule or what happened; a bare "nan" does not."""


@dataclass(frozen=True)
class Cell:
    """One setting that was run.

    Attributes
    ----------
    axis, case, label : str
        What is varied, on which chain, and the setting in words.
    value : float
        The setting.
    ran : str
        What was run.
    outcome : str
        "right": the error is within `tolerance`. "warned": it is not, and a warning said so before. "refused": an error
        with a clear message. "wrong": anything else, a NaN and a crash among it.
    error, tolerance : float
        NaN where nothing came out.
    message : str
        The error or the warning.
    """

    axis: str
    case: str
    label: str
    value: float
    ran: str
    outcome: Outcome
    error: float
    tolerance: float
    message: str


def judged(
    place: tuple[str, str, str, float],
    ran: str,
    run: Callable[[], float | tuple[float, float]],
    tolerance: float = TOLERANCE,
) -> Cell:
    """Run it and say what came of it: `run` returns its error against the exact answer, or error and tolerance."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", UserWarning)
        warnings.simplefilter("always", PreflightWarning)
        try:
            found = run()
        except (ValueError, TypeError, DivergedError) as error:
            return Cell(*place, ran, "refused" if _is_clear(str(error)) else "wrong", math.nan, tolerance, str(error))
        except Exception as error:  # a crash is a wrong cell of the map, not the end of it
            return Cell(*place, ran, "wrong", math.nan, tolerance, f"{type(error).__name__}: {error}")
    off, allowed = found if isinstance(found, tuple) else (found, tolerance)
    said = " ".join(dict.fromkeys(str(entry.message) for entry in caught))
    if off <= allowed:
        return Cell(*place, ran, "right", off, allowed, said)
    return Cell(*place, ran, "warned" if _is_clear(said) else "wrong", off, allowed, said)


def missing(place: tuple[str, str, str, float], ran: str, why: str) -> Cell:
    """A cell that cannot be run here."""
    return Cell(*place, ran, "not available", math.nan, math.nan, why)


def _is_clear(message: str) -> bool:
    return any(word in message for word in _SAYS_WHY)


def reference(model: of.Model, integrator: mm.Integrator, positions: object = None) -> mm.Context:
    """A Context on Reference at internal positions, by default the model's own."""
    context = mm.Context(model.system, integrator, mm.Platform.getPlatformByName("Reference"))
    context.setPositions(model.positions if positions is None else positions)
    return context


def write(path: Path, cells: Sequence[Cell]) -> None:
    """All cells as CSV, one a row."""
    with path.open("w", newline="") as file:
        out = csv.writer(file)
        out.writerow(["axis", "case", "setting", "value", "run", "outcome", "error", "tolerance", "message"])
        for c in cells:
            out.writerow(
                [
                    c.axis,
                    c.case,
                    c.label,
                    f"{c.value:.6g}",
                    c.ran,
                    c.outcome,
                    f"{c.error:.3g}",
                    f"{c.tolerance:.3g}",
                    c.message,
                ]
            )
