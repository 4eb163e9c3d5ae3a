"""A sampled force-extension curve as a dataset that says in what units and from what it is."""

from __future__ import annotations

import math
import platform as host
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import openmm as mm
from numpy.typing import NDArray
from openmm import unit

from openmm_filament.discretisation import PN, Choice, ExactChain, exact_chain
from openmm_filament.points import Point

if TYPE_CHECKING:
    import xarray

__all__ = ["dataset", "provenance"]

Array = NDArray[np.float64]


def dataset(points: Sequence[Point], *, kelvin: float, dimension: int, attributes: Mapping[str, Any]) -> xarray.Dataset:
    """The dataset that `force_extension` returns."""
    import xarray

    def column(values: Sequence[Any], units_: str, meaning: str) -> tuple[str, Array, dict[str, str]]:
        return "force", np.array(values), {"units": units_, "long_name": meaning}

    blocks = [point.runs[0].block for point in points]
    exact = [exact_chain(block.filament, kelvin * unit.kelvin) for block in blocks]

    def of_chain(value: Callable[[ExactChain], float]) -> list[float]:
        return [math.nan if chain is None else value(chain) for chain in exact]

    def bias(part: Callable[[Choice], float], meaning: str) -> tuple[str, Array, dict[str, str]]:
        return column([p.mean / (1 + p.choice.bias) * part(p.choice) for p in points], "nm", meaning)

    variables = {
        "extension": column([p.mean for p in points], "nm", "mean extension along the force"),
        "extension_error": column([p.error for p in points], "nm", "one standard error of the extension"),
        "bias": bias(lambda c: c.bias, "exact discrete minus exact continuous extension"),
        "discretisation_bias": bias(lambda c: c.discretisation, "part of the bias that the number of segments makes"),
        "stretch_bias": bias(lambda c: c.stretch, "part of the bias that softer bonds make"),
        "time_step_bias": column(
            [p.mean * p.choice.time_step for p in points], "nm", "estimated effect of the time step on the extension"
        ),
        "effective_samples": column([p.samples for p in points], "1", "effective sample size of all chains"),
        "r_hat": column([p.r_hat for p in points], "1", "rank-normalised split R-hat"),
        "segments": column([len(b.filament) - 1 for b in blocks], "1", "segments of the chain"),
        "bond_length": column(of_chain(lambda c: c.bond_length), "nm", "rest length of the bonds"),
        "bending": column(of_chain(lambda c: _uniform(c.bending) * PN), "kJ/mol", "bending stiffness of the joints"),
        "stretching": column(of_chain(lambda c: c.stretching * PN), "kJ/mol/nm^2", "stiffness of the bonds"),
        "exact_discrete": column(
            [
                math.nan if c is None else float(c.extension(p.force, dimension))
                for c, p in zip(exact, points, strict=True)
            ],
            "nm",
            "exact extension of the discrete chain",
        ),
        "time_step": column([b.timestep for b in blocks], "ps", "time step"),
        "friction": column([b.friction for b in blocks], "1/ps", "friction"),
        "steps": column(
            [b.stride * min(run.done for run in p.runs) for b, p in zip(blocks, points, strict=True)],
            "1",
            "sampled steps of each chain",
        ),
        "finished": column([int(p.finished) for p in points], "1", "whether the wanted error was reached"),
        "diverged": column([int(p.failure is not None) for p in points], "1", "whether the run was given up"),
    }
    return xarray.Dataset(
        variables,
        coords={"force": ("force", np.array([p.force for p in points]), {"units": "pN", "long_name": "pulling force"})},
        attrs={
            "temperature_K": kelvin,
            "dimension": dimension,
            **attributes,
            **provenance(),
        },
    )


def provenance() -> dict[str, str]:
    """The attributes of every sampled dataset: its integrator and the versions that made it."""
    from openmm_filament import __version__

    return {
        "integrator": "LangevinMiddle",
        "openmm_filament_version": __version__,
        "openmm_version": mm.Platform.getOpenMMVersion(),
        "numpy_version": np.__version__,
        "python_version": host.python_version(),
    }


def _uniform(values: float | Array) -> float:
    return float(values) if np.ndim(values) == 0 else math.nan
