"""What is shown while the curve is sampled, and the table after it."""

from __future__ import annotations

import math

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from openmm_filament.sampling import Progress as Report
from systems.dna_force_extension.curve import FORCES, Row

__all__ = ["Display", "table"]


class Display:
    """A progress bar with the time left; where there is no terminal, a line whenever a force is done."""

    def __init__(self, console: Console) -> None:
        self._bar = Progress(
            TextColumn("pulling"),
            BarColumn(),
            TextColumn("{task.percentage:3.0f} %"),
            TimeElapsedColumn(),
            TextColumn("{task.description}"),
            console=console,
            transient=True,
        )
        self._task = self._bar.add_task("starting", total=1.0)
        self._console = console
        self._finished = 0

    def __enter__(self) -> Display:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def show(self, report: Report) -> None:
        """Move the bar to what the sampler reports."""
        if not report.fraction:
            self._bar.update(self._task, description=f"chains chosen for {report.chosen} of {len(FORCES)} forces")
            return
        left = "" if math.isnan(report.seconds_left) else f"about {report.seconds_left:.0f} s left, "
        point = (
            ""
            if math.isnan(report.extension)
            else (f"; {report.force:.3g} pN: {report.extension:.1f} +- {report.error:.1f} nm")
        )
        text = f"{left}{report.finished} of {len(FORCES)} forces done{point}"
        self._bar.update(self._task, completed=report.fraction, description=text)
        if report.finished > self._finished and not self._console.is_terminal:
            self._console.print(f"{report.fraction:4.0%} {text}", soft_wrap=True)
        self._finished = report.finished


def table(rows: list[Row]) -> Table:
    """The curve in nm."""
    shown = Table(title="DNA, 1 um: mean extension at 298 K")
    for heading in (
        "force\npN",
        "extension\nnm",
        "error\nnm",
        "eff.\nsamples",
        "discrete\nexact, nm",
        "continuous\nexact, nm",
        "Marko-\nSiggia, nm",
    ):
        shown.add_column(heading, justify="right")
    for row in rows:
        shown.add_row(
            f"{row['force_pN']:.3f}",
            f"{row['extension_nm']:.2f}",
            f"{row['extension_error_nm']:.2f}",
            f"{row['effective_samples']:.0f}",
            f"{row['exact_discrete_nm']:.2f}",
            f"{row['exact_continuous_nm']:.2f}",
            f"{row['marko_siggia_nm']:.2f}",
        )
    return shown
