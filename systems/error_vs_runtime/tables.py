"""CSV files and the table over all systems."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
from rich.table import Table

from systems.error_vs_runtime.front import thermal_time_to, time_to
from systems.error_vs_runtime.settings import Outcome, Study
from systems.error_vs_runtime.sweeps.growth import Growth

__all__ = ["WANTED", "front_row", "printed", "times", "write_growth", "write_runs", "write_table"]

WANTED = (0.1, 0.01, 0.001)

_COLUMNS = (
    "system", "question", "segments", "step_over_limit", "integrator", "platform", "precision", "bending_form",
    "method", "bonds_softer", "effort", "force_pN", "default", "repeat", "seconds", "seeds",
    "deviation", "residual", "error", "bias", "bias_error", "scatter", "median_seconds", "failure",
)  # fmt: skip


def times(study: Study) -> list[float]:
    """Wall seconds to 10 %, 1 % and 0.1 %: on the front, or where there is noise by the law of the scatter.

    Of a thermal setting the error is the known bias and two standard deviations of a run, and the time at least that of a run
    which was made; NaN where no setting gets there.
    """
    counted = [o for o in study.outcomes if o.results]
    if not study.thermal:
        seconds, errors = (np.array([getattr(o, name) for o in counted]) for name in ("seconds", "error"))
        return [time_to(seconds, errors, wanted) for wanted in WANTED]
    found = [min((_thermal(study, o, wanted) for o in counted), default=math.inf) for wanted in WANTED]
    return [value if math.isfinite(value) else math.nan for value in found]


def _thermal(study: Study, outcome: Outcome, wanted: float) -> float:
    assert study.known is not None
    found = thermal_time_to(outcome.seconds, outcome.scatter, study.known(outcome.setting), wanted)
    return max(found, outcome.seconds)


def front_row(study: Study) -> list[str]:
    """One row of the table as text."""
    return [study.system, study.question, study.exact, *(_seconds(t) for t in times(study))]


def _seconds(value: float) -> str:
    if math.isnan(value):
        return "-"
    number, unit = (1e3 * value, "ms") if value < 0.1 else (value, "s") if value < 600 else (value / 60, "min")
    return f"{float(f'{number:.2g}'):g} {unit}"


def printed(studies: Sequence[Study]) -> Table:
    """For the terminal."""
    table = Table(title="Wall time to an error")
    for heading in ("system", "what", "against", "10 %", "1 %", "0.1 %"):
        table.add_column(heading, justify="right" if "%" in heading else "left")
    for study in studies:
        table.add_row(*front_row(study))
    return table


def write_table(path: Path, studies: Sequence[Study]) -> None:
    """`table.csv`: seconds; empty where no setting that was tried gets there."""
    with path.open("w", newline="") as out:
        writer = csv.writer(out)
        writer.writerow(["system", "question", "exact", *(f"seconds_to_{wanted:g}" for wanted in WANTED)])
        for study in studies:
            cells = ["" if math.isnan(t) else f"{t:.6g}" for t in times(study)]
            writer.writerow([study.system, study.question, study.exact, *cells])


def write_runs(path: Path, studies: Sequence[Study]) -> None:
    """`runs.csv`: every run of every setting, with what all runs of its setting give together."""
    with path.open("w", newline="") as out:
        writer = csv.writer(out)
        writer.writerow(_COLUMNS)
        for study in studies:
            for o in study.outcomes:
                s = o.setting
                head = [
                    study.system, study.question, s.segments, s.step, s.integrator, s.platform, s.precision, s.form,
                    s.method, s.softer, s.effort, s.force, int(s == study.default),
                ]  # fmt: skip
                tail = [o.error, o.bias, o.bias_error, o.scatter, o.seconds, o.failure]
                for i, r in enumerate(o.results):
                    run = [i, r.seconds, len(r.deviations), float(r.deviations.mean()), r.residual]
                    writer.writerow([_cell(v) for v in (*head, *run, *tail)])
                if not o.results:
                    writer.writerow([_cell(v) for v in (*head, "", "", "", "", "", *tail)])


def write_growth(path: Path, growth: Growth) -> None:
    """`growth.csv`."""
    with path.open("w", newline="") as out:
        writer = csv.DictWriter(out, asdict(growth.rows[0]).keys())
        writer.writeheader()
        writer.writerows({k: _cell(v) for k, v in asdict(row).items()} for row in growth.rows)


def _cell(value: object) -> str:
    if isinstance(value, float):
        return "" if math.isnan(value) else f"{value:.8g}"
    return str(value)
