"""How a run is refused or warned of, and how beads are named in what is said of it."""

from __future__ import annotations

import numpy as np

from openmm_filament.model import Model

__all__ = ["PreflightError", "PreflightWarning", "describe_bead"]


class PreflightError(ValueError):
    """A run that would give wrong results or none."""


class PreflightWarning(UserWarning):
    """A run that may give less than it promises."""


def describe_bead(model: Model, *beads: int) -> str:
    """Beads of one filament in words: "bead 3", "beads 3, 4 and 5", with "of filament 1" where there are several."""
    filament = int(np.searchsorted(model.starts, beads[0], side="right")) - 1
    local = [str(bead - model.starts[filament]) for bead in beads]
    named = f"bead {local[0]}" if len(local) == 1 else f"beads {', '.join(local[:-1])} and {local[-1]}"
    return named if len(model.filaments) == 1 else f"{named} of filament {filament}"
