"""What the curve is held against, and what it says."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import openmm_filament as of
from openmm_filament import wlc
from systems.dna_force_extension.curve import CONTOUR, FORCES, KT, MODULUS, PERSISTENCE, Row
from systems.scene import Check

__all__ = ["checks", "findings"]

Z_LIMIT = 4.0
"""Standard errors by which one of a dozen points may miss the exact discrete chain: chance does so once in 1300 runs."""


def checks(folder: Path, rows: Sequence[Row], parts: Sequence[Row], wanted: np.ndarray) -> list[Check]:
    """The sampled points against the exact chains, the wanted error, and the trajectory against the sampler."""
    z = np.array([_missed(row, part) for row, part in zip(rows, parts, strict=True)])
    worst = int(np.argmax(np.abs(z)))
    made = [
        Check(
            "extension against the exact discrete chain, less what the time step is known to add, in standard errors "
            f"(worst, at {FORCES[worst]:.3g} pN)",
            "exact",
            rows[worst]["extension_nm"],
            rows[worst]["exact_discrete_nm"],
            float(abs(z[worst])),
            Z_LIMIT,
            "nm",
        ),
        Check(
            "mean square deviation of all points in standard errors",
            "exact",
            float((z**2).mean()),
            1.0,
            float((z**2).mean()),
            2.8,
        ),  # chi-squared of 12 degrees of freedom: p = 1e-3
    ]
    for row, part, error in zip(rows, parts, wanted, strict=True):
        bias = row["exact_discrete_nm"] - row["exact_continuous_nm"]
        bound = (abs(bias) + 2 * row["extension_error_nm"]) / row["exact_continuous_nm"]
        bound += abs(part["time_step_percent"]) / 100
        made.append(
            Check(
                f"biases of chain and time step plus two standard errors at {row['force_pN']:.3g} pN, relative",
                "exact",
                row["extension_nm"],
                row["exact_continuous_nm"],
                bound,
                float(error) * 1.02,
                "nm",
            )
        )
    found, said = _trajectory_extensions(folder / "trajectory.dcd")
    deviation = np.abs(found - said).max()
    made.append(
        Check(
            "extensions in trajectory.dcd by mdtraj against the sampler's own, relative to the largest coordinate",
            "exact",
            float(found.mean()),
            float(said.mean()),
            float(deviation / np.abs(said).max()),
            3e-7,
            "nm",
        )
    )
    return made


def _missed(row: Row, part: Row) -> float:
    """Standard errors between a point and the exact discrete chain with the effect of the time step taken off."""
    step = part["time_step_percent"] / 100 * row["exact_continuous_nm"]
    return (row["extension_nm"] - step - row["exact_discrete_nm"]) / row["extension_error_nm"]


def _trajectory_extensions(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Extensions in nm of the frames at `path`, by mdtraj and by the sidecar."""
    trajectory = of.load(path)
    found = trajectory.xyz[:, -1, 2].astype(float) - trajectory.xyz[:, 0, 2]
    lines = path.with_suffix(".jsonl").read_text().splitlines()[1:]
    return found, np.array([json.loads(line)["extension_nm"] for line in lines])


def findings(rows: Sequence[Row], parts: Sequence[Row], *, interrupted: bool) -> list[str]:
    """Single sentences with numbers."""
    if interrupted:
        done = sum(not math.isnan(row["extension_nm"]) for row in rows)
        return [f"Interrupted: {done} of {len(rows)} forces have an estimate."]
    deviation = [100 * (row["extension_nm"] / row["exact_continuous_nm"] - 1) for row in rows]
    infinite = wlc.extension_exact(FORCES[0], PERSISTENCE, CONTOUR, KT, stretch_modulus=MODULUS)
    finite = rows[0]["exact_continuous_nm"]
    high = rows[-1]
    named = ("discretisation", "stretch", "time_step", "two_standard_errors")
    low, top = ({name: abs(part[f"{name}_percent"]) for name in named} for part in (parts[0], parts[-1]))
    return [
        f"Sampled extensions deviate from the exact continuous chain by {min(deviation):+.2f} to {max(deviation):+.2f} %.",
        f"At {FORCES[0]:.3g} pN the finite chain is {100 * (1 - finite / infinite):.1f} % shorter than the infinite-chain formula.",
        *(
            f"At {force:.3g} pN the error is made of {of_it['discretisation']:.2f} % by the segments, {of_it['stretch']:.2f} % by "
            f"softer bonds, {of_it['time_step']:.2f} % by the time step (estimated) and {of_it['two_standard_errors']:.2f} % by "
            "sampling (two standard errors)."
            for force, of_it in ((FORCES[0], low), (FORCES[-1], top))
        ),
        f"At {FORCES[-1]:.3g} pN the DNA is {high['extension_nm'] - CONTOUR:.1f} nm longer than its contour, which no inextensible "
        f"chain allows: Marko-Siggia gives {high['marko_siggia_nm']:.1f} nm.",
    ]
