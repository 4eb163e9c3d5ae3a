"""What a sweep varies, and what one run of a setting gives."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import Literal

import numpy as np
from numpy.typing import NDArray

__all__ = ["Order", "Outcome", "Result", "Setting", "Study"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Setting:
    """One way to run a system.

    Attributes
    ----------
    segments : int
        Segments of the chain (of `mass_spring` masses).
    step : float
        Time step over the stability limit; NaN where nothing moves in time.
    integrator, platform, precision, form, method : str
        `form` is that of the bending, `method` that of statics.
    softer : float
        What the bonds' stiffness is divided by.
    effort : float
        Length of a thermal run in relaxation times, tolerance of a minimiser, stages of a load.
    force : float
        pN, of a thermal run.
    """

    segments: int
    step: float = math.nan
    integrator: str = "Verlet"
    platform: str = "Reference"
    precision: str = "double"
    form: str = "arccosine"
    method: str = ""
    softer: float = 1.0
    effort: float = math.nan
    force: float = math.nan

    @property
    def series(self) -> str:
        """What a figure calls it: what is not a matter of more or less."""
        if self.method:
            return self.method
        return self.integrator + self.variant

    @property
    def variant(self) -> str:
        """Form of the bending and platform where they are not the usual ones, after a comma each."""
        name = f", {self.form}" if self.form != "arccosine" else ""
        if self.platform != "Reference":
            name += f", {self.platform}"
            name += f" {self.precision}" if self.platform == "OpenCL" else ""
        return name

    @property
    def label(self) -> str:
        """All of it in a few words."""
        words = [self.series, f"{self.segments} segments"]
        words += [f"step {self.step:.3g} of the limit"] if self.step == self.step else []
        words += [f"bonds {self.softer:.4g} times softer"] if self.softer != 1 else []
        words += [f"effort {self.effort:.3g}"] if self.effort == self.effort else []
        words += [f"{self.force:.3g} pN"] if self.force == self.force else []
        return ", ".join(words)


@dataclass(frozen=True, eq=False)
class Result:
    """One run: wall seconds, relative deviations from the exact answer (one, or one a seed), and the residual of statics."""

    seconds: float
    deviations: Array
    residual: float = math.nan


@dataclass(frozen=True, eq=False)
class Outcome:
    """All runs of a setting; `failure` says why there are none that count."""

    setting: Setting
    results: Sequence[Result]
    failure: str = ""

    @property
    def deviations(self) -> Array:
        """Of all seeds of all repeats; of a run without noise, of one repeat."""
        every = np.concatenate([r.deviations for r in self.results]) if self.results else np.array([math.nan])
        return every if len(self.results) and len(self.results[0].deviations) > 1 else every[:1]

    @property
    def error(self) -> float:
        """Root mean square deviation from the exact answer: the deviation itself where there is no noise."""
        return float(np.sqrt((self.deviations**2).mean()))

    @property
    def bias(self) -> float:
        """Mean deviation, with its sign."""
        return float(self.deviations.mean())

    @property
    def scatter(self) -> float:
        """Standard deviation over seeds; NaN without noise."""
        return float(self.deviations.std(ddof=1)) if len(self.deviations) > 1 else math.nan

    @property
    def bias_error(self) -> float:
        """Standard error of the bias; 0 without noise."""
        return self.scatter / math.sqrt(len(self.deviations)) if len(self.deviations) > 1 else 0.0

    @property
    def seconds(self) -> float:
        """Median wall time of one run."""
        return median(r.seconds for r in self.results) if self.results else math.nan

    @property
    def spread(self) -> tuple[float, float]:
        """Shortest and longest wall time."""
        times = [r.seconds for r in self.results] or [math.nan]
        return min(times), max(times)

    @property
    def residual(self) -> float:
        """Of statics, over the load."""
        return self.results[0].residual if self.results else math.nan


@dataclass(frozen=True)
class Order:
    """A power law that theory expects: error against `variable` ("step", "segments", "effort") over some settings.

    `theory` is the exponent, `floor` the error below which points are rounding or noise and are left out. Of thermal settings
    the error is the scatter (by `effort`) or the size of the bias.
    """

    name: str
    variable: str
    theory: float
    chosen: Callable[[Setting], bool]
    floor: float = 1e-11
    kind: Literal["exact", "claim"] = "exact"


@dataclass(frozen=True, eq=False)
class Study:
    """A question that a system answers, and the settings that answer it.

    Attributes
    ----------
    system, question : str
        Such as "guitar_string" and "lines 1 to 20 of the chain".
    exact : str
        What the answer is held against.
    measure : callable
        Takes a setting and a seed, and runs it once.
    settings : sequence of Setting
    orders : sequence of Order
    default : Setting, optional
        What the system uses.
    stated : float, optional
        The error that the system states for it.
    seconds : float
        What one run of every setting is expected to take on one core, all in all.
    known : callable, optional
        The bias of a thermal setting that is known beforehand.
    admitted : callable
        Which settings may be recommended: those that do all that the system needs.
    """

    system: str
    question: str
    exact: str
    measure: Callable[[Setting, int], Result]
    settings: Sequence[Setting]
    orders: Sequence[Order] = ()
    default: Setting | None = None
    stated: float | None = None
    seconds: float = 1.0
    known: Callable[[Setting], float] | None = None
    admitted: Callable[[Setting], bool] = lambda setting: True
    outcomes: Sequence[Outcome] = field(default_factory=tuple)

    @property
    def thermal(self) -> bool:
        """Whether the error has scatter."""
        return self.known is not None
