"""A double-stranded DNA pulled in thermal motion: extension against force, held against the worm-like chain.

Contour 1 um, persistence length 53 nm (lambda phage DNA in 10 mM Na+, thesis 2.8), stretch modulus 1000 pN, 298 K; one
end held, 12 forces from 0.05 to 50 pN. Every point is sampled by Langevin dynamics and compared with the exact discrete
chain that was run and with the exact continuous one of the same finite length.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import time
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from openmm import unit
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

import openmm_filament as of
from openmm_filament import wlc
from openmm_filament.blocks import clamped_model
from openmm_filament.discretisation import PN
from openmm_filament.sampling import Progress as Report
from systems.cluster import dask_executor
from systems.scene import Check, Summary, prepared_checkpoint

if TYPE_CHECKING:
    import xarray
    from matplotlib.axes import Axes

CONTOUR, PERSISTENCE, MODULUS, TEMPERATURE = 1000.0, 53.0, 1000.0, 298.0  # nm, nm, pN, K
KT = TEMPERATURE * of.units.BOLTZMANN / PN  # pN nm
FORCES = np.geomspace(0.05, 50.0, 12)  # pN
SHOWN = 5  # the force, about 1 pN, whose trajectory is kept

Z_LIMIT = 4.0
"""Standard errors by which one of a dozen points may miss the exact discrete chain: chance does so once in 1300 runs."""


def options(parser: argparse._ArgumentGroup) -> None:
    """Add the system's own command-line options."""
    parser.add_argument(
        "--relative-error",
        type=float,
        metavar="E",
        help="bound on bias plus two standard errors at every force; default 0.009 from 0.3 pN up, 0.027 below, so that a "
        "point seldom misses 1 and 3 %% by chance (0.06 with --quick)",
    )
    parser.add_argument("--processes", type=int, help="worker processes; by default one a core")
    parser.add_argument(
        "--platform",
        default="Reference",
        help="of OpenMM; on CUDA, HIP and OpenCL the whole curve is one Context (default Reference)",
    )
    parser.add_argument(
        "--resume",
        action="store_true",
        help="go on with a run that was ended, from the checkpoint beside its folder, with the same options",
    )
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="of a Dask scheduler, whose workers of one thread each do the work; `local` starts one here",
    )
    parser.add_argument("--all-trajectories", action="store_true", help="keep a trajectory at every force")


def wanted_errors(relative_error: float | None, *, quick: bool) -> np.ndarray:
    """The relative error asked for at each force."""
    if relative_error is not None:
        return np.full(len(FORCES), relative_error)
    if quick:
        return np.full(len(FORCES), 0.06)
    return 0.9 * np.where(FORCES < 0.3, 0.03, 0.01)


def chain() -> of.WormlikeChain:
    """The DNA as a continuous chain."""
    return of.WormlikeChain(
        contour_length=CONTOUR * unit.nanometer,
        persistence_length=PERSISTENCE * unit.nanometer,
        stretch_modulus=MODULUS * unit.piconewton,
    )


def run(folder: Path, *, quick: bool, seed: int, options: argparse.Namespace) -> int:
    """Sample the curve, write the results into `folder`; 1 if an exact check fails, else 0."""
    begun = time.perf_counter()
    console = Console()
    wanted = wanted_errors(options.relative_error, quick=quick)
    paths = {SHOWN: folder / "trajectory.dcd"}
    if options.all_trajectories:
        paths |= {i: folder / f"trajectory_{force:.3g}pN.dcd" for i, force in enumerate(FORCES) if i != SHOWN}
    kept = prepared_checkpoint(options.output, resume=options.resume, overwrite=options.overwrite)
    with ExitStack() as opened:
        executor, processes = None, options.processes
        if options.scheduler is not None:
            executor = opened.enter_context(dask_executor(options.scheduler, processes))
            processes = None if options.scheduler == "local" else processes
        display = opened.enter_context(_Display(console))
        curve = of.force_extension(
            chain(),
            FORCES * unit.piconewton,
            TEMPERATURE * unit.kelvin,
            wanted,
            seed=seed,
            processes=processes,
            executor=executor,
            platform=options.platform,
            checkpoint=kept,
            trajectories=paths,
            progress=display.show,
        )
    interrupted = bool(curve.attrs["interrupted"])
    rows = _rows(curve)
    console.print(_table(rows))
    _write_csv(folder / "force_extension.csv", rows)
    curve.to_netcdf(folder / "force_extension.nc", engine="scipy")
    _figure(folder / "force_extension.png", rows)
    checks = [] if interrupted else _checks(folder, rows, wanted)
    summary = Summary(
        system="dna_force_extension",
        models=[_model(curve)],
        platform=curve.attrs["platform"],
        wall_seconds=time.perf_counter() - begun,
        filament={
            "contour_length_nm": CONTOUR,
            "persistence_length_nm": PERSISTENCE,
            "stretch_modulus_pN": MODULUS,
            "temperature_K": TEMPERATURE,
            "bending_form": "harmonic",
            "seed": seed,
            "held_bead": 0,
            "pulled_bead": -1,
        },
        checks=checks,
        findings=_findings(rows, interrupted=interrupted),
    )
    summary.write(folder)
    for check in checks:
        verdict = "[green]passed[/]" if check.passed else "[red]FAILED[/]"
        console.print(f"{verdict} {check.name}: {check.error:.3g} (at most {check.tolerance:.3g})", soft_wrap=True)
    if interrupted:
        console.print("interrupted: the same command with --resume goes on", soft_wrap=True)
        return 130
    return 0 if summary.passed else 1


class _Display:
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

    def __enter__(self) -> _Display:
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


def _rows(curve: xarray.Dataset) -> list[dict[str, float]]:
    """One row a force: what was sampled, the chain that was run, and the exact answers, all in the units of the names."""
    continuous = np.asarray(wlc.extension_exact(FORCES, PERSISTENCE, CONTOUR, KT, stretch_modulus=MODULUS, finite=True))
    marko_siggia = np.asarray(wlc.extension_marko_siggia(FORCES, PERSISTENCE, CONTOUR, KT))
    columns = {
        "force_pN": curve.force,
        "extension_nm": curve.extension,
        "extension_error_nm": curve.extension_error,
        "effective_samples": curve.effective_samples,
        "segments": curve.segments,
        "bond_length_nm": curve.bond_length,
        "bending_kJ_per_mol": curve.bending,
        "stretching_kJ_per_mol_nm2": curve.stretching,
        "exact_discrete_nm": curve.exact_discrete,
        "exact_continuous_nm": continuous,
        "marko_siggia_nm": marko_siggia,
    }
    return [{name: float(column[i]) for name, column in columns.items()} for i in range(len(FORCES))]


def _model(curve: xarray.Dataset) -> of.Model:
    """The chain that was run at the force whose trajectory is kept (masses aside)."""
    kj = unit.kilojoule_per_mole
    filament = of.Filament(
        of.shapes.line(int(curve.segments[SHOWN]), float(curve.bond_length[SHOWN]) * unit.nanometer),
        1.0 * unit.dalton,
        (
            of.stretching.Harmonic(float(curve.stretching[SHOWN]) * kj / unit.nanometer**2),
            of.bending.Harmonic(float(curve.bending[SHOWN]) * kj),
        ),
    )
    return clamped_model(filament, float(FORCES[SHOWN]) * PN, 3, 1)


def _table(rows: list[dict[str, float]]) -> Table:
    table = Table(title="DNA, 1 um: mean extension at 298 K")
    for heading in (
        "force\npN",
        "extension\nnm",
        "error\nnm",
        "eff.\nsamples",
        "discrete\nexact, nm",
        "continuous\nexact, nm",
        "Marko-\nSiggia, nm",
    ):
        table.add_column(heading, justify="right")
    for row in rows:
        table.add_row(
            f"{row['force_pN']:.3f}",
            f"{row['extension_nm']:.2f}",
            f"{row['extension_error_nm']:.2f}",
            f"{row['effective_samples']:.0f}",
            f"{row['exact_discrete_nm']:.2f}",
            f"{row['exact_continuous_nm']:.2f}",
            f"{row['marko_siggia_nm']:.2f}",
        )
    return table


def _write_csv(path: Path, rows: list[dict[str, float]]) -> None:
    with path.open("w", newline="") as out:
        writer = csv.DictWriter(out, rows[0].keys())
        writer.writeheader()
        writer.writerows({name: f"{value:.10g}" for name, value in row.items()} for row in rows)


def _checks(folder: Path, rows: list[dict[str, float]], wanted: np.ndarray) -> list[Check]:
    """The sampled points against the exact chains, the wanted error, and the trajectory against the sampler."""
    z = np.array([(r["extension_nm"] - r["exact_discrete_nm"]) / r["extension_error_nm"] for r in rows])
    worst = int(np.argmax(np.abs(z)))
    checks = [
        Check(
            f"extension against the exact discrete chain, in standard errors (worst, at {FORCES[worst]:.3g} pN)",
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
    for row, error in zip(rows, wanted, strict=True):
        bias = row["exact_discrete_nm"] - row["exact_continuous_nm"]
        bound = (abs(bias) + 2 * row["extension_error_nm"]) / row["exact_continuous_nm"]
        checks.append(
            Check(
                f"bias plus two standard errors at {row['force_pN']:.3g} pN, relative",
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
    checks.append(
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
    return checks


def _trajectory_extensions(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Extensions in nm of the frames at `path`, by mdtraj and by the sidecar."""
    trajectory = of.load(path)
    found = trajectory.xyz[:, -1, 2].astype(float) - trajectory.xyz[:, 0, 2]
    lines = path.with_suffix(".jsonl").read_text().splitlines()[1:]
    return found, np.array([json.loads(line)["extension_nm"] for line in lines])


def _findings(rows: list[dict[str, float]], *, interrupted: bool) -> list[str]:
    if interrupted:
        done = sum(not math.isnan(row["extension_nm"]) for row in rows)
        return [f"Interrupted: {done} of {len(rows)} forces have an estimate."]
    deviation = [100 * (row["extension_nm"] / row["exact_continuous_nm"] - 1) for row in rows]
    infinite = wlc.extension_exact(FORCES[0], PERSISTENCE, CONTOUR, KT, stretch_modulus=MODULUS)
    finite = rows[0]["exact_continuous_nm"]
    high = rows[-1]
    return [
        f"Sampled extensions deviate from the exact continuous chain by {min(deviation):+.2f} to {max(deviation):+.2f} %.",
        f"At {FORCES[0]:.3g} pN the finite chain is {100 * (1 - finite / infinite):.1f} % shorter than the infinite-chain formula.",
        f"At {FORCES[-1]:.3g} pN the DNA is {high['extension_nm'] - CONTOUR:.1f} nm longer than its contour, which no inextensible "
        f"chain allows: Marko-Siggia gives {high['marko_siggia_nm']:.1f} nm.",
    ]


def _figure(path: Path, rows: list[dict[str, float]]) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 7.0), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1.3))
    _draw_curves(upper, rows)
    _draw_deviations(lower, rows)
    figure.savefig(path, dpi=150)


def _draw_curves(ax: Axes, rows: list[dict[str, float]]) -> None:
    f = np.geomspace(0.03, 80, 200)
    low = f[f < 0.14]
    ax.plot(
        f,
        wlc.extension_exact(f, PERSISTENCE, CONTOUR, KT, stretch_modulus=MODULUS, finite=True),
        "k-",
        label="exact worm-like chain (finite, extensible)",
    )
    ax.plot(
        f,
        wlc.extension_marko_siggia(f, PERSISTENCE, CONTOUR, KT),
        "C0--",
        label="Marko-Siggia (infinite, inextensible)",
    )
    ax.plot(f, wlc.extension_fjc(f, PERSISTENCE, CONTOUR, KT), "C2-.", label="freely jointed chain, Kuhn length 106 nm")
    ax.plot(low, wlc.extension_hookean(low, PERSISTENCE, CONTOUR, KT), "C1:", lw=2, label="Hookean, small forces")
    ax.errorbar(
        *_points(rows), fmt="o", color="C3", ms=5, capsize=3, label="OpenMM, Langevin dynamics (2 standard errors)"
    )
    ax.axhline(CONTOUR, color="0.7", lw=0.8)
    ax.annotate("contour length", (0.032, CONTOUR), textcoords="offset points", xytext=(0, 4), color="0.4", fontsize=9)
    ax.set(
        xscale="log",
        ylabel="mean extension (nm)",
        ylim=(0, 1130),
        title="Double-stranded DNA: 1 µm, persistence length 53 nm, 1000 pN, 298 K",
    )
    ax.legend(loc="lower right", fontsize=9)


def _points(rows: list[dict[str, float]]) -> tuple[list[float], list[float], list[float]]:
    return (
        [r["force_pN"] for r in rows],
        [r["extension_nm"] for r in rows],
        [2 * r["extension_error_nm"] for r in rows],
    )


def _draw_deviations(ax: Axes, rows: list[dict[str, float]]) -> None:
    force, extension, error = (np.array(column) for column in _points(rows))
    exact = np.array([r["exact_continuous_nm"] for r in rows])
    discrete = np.array([r["exact_discrete_nm"] for r in rows])
    ax.axhline(0, color="k", lw=1)
    ax.fill_between([0.03, 80], -1, 1, color="0.92", label="±1 %")
    ax.plot(force, 100 * (discrete / exact - 1), "k_", ms=10, label="exact discrete chain that was run")
    ax.errorbar(force, 100 * (extension / exact - 1), 100 * error / exact, fmt="o", color="C3", ms=4, capsize=3)
    ax.set(xlabel="pulling force (pN)", ylabel="deviation from the exact\ncontinuous chain (%)", xlim=(0.03, 80))
    ax.legend(loc="upper right", fontsize=9)
