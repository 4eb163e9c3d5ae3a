"""One figure a system: error against wall time with its front, and convergence beside theory; one figure of growth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from systems.error_vs_runtime.front import fitted, pareto
from systems.error_vs_runtime.judgement import recommended
from systems.error_vs_runtime.settings import Outcome, Study
from systems.error_vs_runtime.sweeps.growth import FLAT, FLAT_FROM, Growth
from systems.error_vs_runtime.sweeps.timing import CONTROL, WHOLE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_growth", "draw_system"]

_MARKERS = "osD^vPX*<>p"


def draw_system(path: Path, studies: Sequence[Study]) -> None:
    """A column a question: error against wall time above, error against what is swept below."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.8 * len(studies), 8.6), layout="constrained")
    axes = figure.subplots(2, len(studies), squeeze=False)
    for column, study in enumerate(studies):
        if not any(o.results and o.error > 0 for o in study.outcomes):
            _nothing(list(axes[:, column]), study)
            continue
        _front(axes[0, column], study)
        _convergence(axes[1, column], study)
    figure.suptitle(f"{studies[0].system}: error against wall time, and how it converges", fontsize=13)
    figure.savefig(path, dpi=130)


def _nothing(axes: Sequence[Axes], study: Study) -> None:
    """What did not run at all has no axes."""
    for ax in axes:
        ax.set_axis_off()
    why = next((o.failure for o in study.outcomes), "")
    axes[0].text(0.5, 0.5, f"{study.question}\nnothing ran: {why}", ha="center", va="center", fontsize=9, wrap=True)


def _series(study: Study) -> dict[str, list[Outcome]]:
    out: dict[str, list[Outcome]] = {}
    for o in study.outcomes:
        if o.results and o.error > 0:
            name = o.setting.series
            if study.thermal:
                other = f", {o.setting.integrator}" if o.setting.integrator != "LangevinMiddle" else ""
                name = f"{o.setting.segments} segments{other}{o.setting.variant}"
            elif len({x.setting.softer for x in study.outcomes}) > 1:
                name += f", bonds / {o.setting.softer:g}"
            out.setdefault(name, []).append(o)
    return out


def _front(ax: Axes, study: Study) -> None:
    good = [o for o in study.outcomes if o.results and o.error > 0]
    for i, (name, some) in enumerate(_series(study).items()):
        seconds = np.array([o.seconds for o in some])
        spread = np.array([o.spread for o in some])
        ax.errorbar(
            seconds, [o.error for o in some], xerr=np.abs(spread.T - seconds), fmt=_MARKERS[i % len(_MARKERS)], ms=5,
            color=f"C{i % 10}", elinewidth=0.8, alpha=0.85, label=name,
        )  # fmt: skip
    t, e = np.array([o.seconds for o in good]), np.array([o.error for o in good])
    front = pareto(t, e)
    ax.step(t[front], e[front], where="post", color="k", lw=1, zorder=0, label="Pareto front")
    if study.stated is not None:
        ax.axhline(study.stated, color="0.5", ls=":", lw=1.2)
        ax.annotate(
            "stated", (0.99, study.stated), xycoords=("axes fraction", "data"), ha="right", va="bottom", fontsize=8
        )
    for o, size, colour, name in (
        (next((o for o in good if o.setting == study.default), None), 12, "C3", "the system's default"),
        (recommended(study), 16, "C2", "recommended"),
    ):
        if o is not None:
            ax.plot(o.seconds, o.error, "o", ms=size, mfc="none", mec=colour, mew=1.5, label=name)
    kind = "rms deviation over seeds" if study.thermal else "largest relative error"
    ax.set(
        xscale="log", yscale="log", xlabel="wall time of a run, built and stepped (s)", ylabel=kind,
        title=f"{study.question}\nagainst: {study.exact}",
    )  # fmt: skip
    ax.title.set_fontsize(10)
    _ticks(ax)
    ax.grid(alpha=0.25)
    ax.legend(fontsize=7, labelspacing=0.8, loc="upper left", bbox_to_anchor=(1.01, 1.0))  # inside it would hide points


def _ticks(ax: Axes) -> None:
    """Few round numbers where an axis spans less than two decades: the usual ones would run into one another."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    for axis in (ax.xaxis, ax.yaxis):
        low, high = axis.get_view_interval()
        if high < 100 * low:
            few = (1.0, 2.0, 5.0) if high > 8 * low else (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0)
            axis.set_major_locator(LogLocator(subs=few))
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())


_LABELS = {
    "step": "time step over the stability limit",
    "segments": "segments (masses)",
    "effort": "length of a run (relaxation times, or samples)",
}


def _convergence(ax: Axes, study: Study) -> None:
    if not study.orders:
        _residuals(ax, study)
        return
    for i, order in enumerate(study.orders):
        scatter = order.variable == "effort"
        chosen = [o for o in study.outcomes if order.chosen(o.setting) and o.results]
        x = np.array([float(getattr(o.setting, order.variable)) for o in chosen])
        y = np.array([o.scatter if scatter else abs(o.bias) for o in chosen])
        by = np.argsort(x)
        x, y = x[by], y[by]
        fit = fitted(order, study.outcomes)
        measured = f"{fit.order:.2f}" + (f" ± {fit.error:.2f}" if study.thermal else "")
        ax.plot(
            x, y, _MARKERS[i], color=f"C{i}", ms=9 - 2 * i if len(study.orders) > 1 else 6, mfc="none" if i else None,
            label=f"{order.name}: measured {measured}, theory {order.theory:g}",
        )  # fmt: skip
        if scatter and chosen:
            _apart(ax, study, [chosen[k] for k in by])
        if len(x) and math.isfinite(y[-1]) and y.max() > 0:
            anchor = int(np.argmin(y)) if order.variable == "segments" else int(np.argmax(y))
            grid = np.geomspace(x.min(), x.max(), 30)
            ax.plot(grid, y[anchor] * (grid / x[anchor]) ** order.theory, color=f"C{i}", lw=0.8, ls="--")
    what = "scatter over seeds, and bias" if study.orders[0].variable == "effort" else "error"
    ax.set(xscale="log", yscale="log", xlabel=_LABELS[study.orders[0].variable], ylabel=what)
    ax.set_title("convergence (dashed: theory)", fontsize=10)
    _ticks(ax)
    ax.grid(alpha=0.25, which="both")
    ax.legend(fontsize=7)


def _apart(ax: Axes, study: Study, some: Sequence[Outcome]) -> None:
    """The bias of thermal runs beside their scatter, measured and as it is known beforehand; standard errors of both."""
    assert study.known is not None
    x = [o.setting.effort for o in some]
    scatter = np.array([o.scatter for o in some])
    ax.errorbar(
        x, scatter, [o.scatter / math.sqrt(2 * (len(o.deviations) - 1)) for o in some], fmt="none", color="C0", capsize=2
    )  # fmt: skip
    bias = np.abs([o.bias for o in some])
    ax.errorbar(
        x, bias, [o.bias_error for o in some], fmt="D", color="C3", ms=5, capsize=2, label="size of the bias, measured"
    )
    known = abs(study.known(some[-1].setting))
    if known > 0:
        ax.axhline(known, color="C3", lw=1, ls=":", label="bias known beforehand")


def _residuals(ax: Axes, study: Study) -> None:
    """The residual of statics beside the deviation, or how the step matters where no order is asked for."""
    for i, (name, some) in enumerate(_series(study).items()):
        residual = [o.residual for o in some]
        statics = not all(math.isnan(r) for r in residual)
        x = residual if statics else [o.setting.step for o in some]
        ax.plot(
            x, [o.error for o in some], _MARKERS[i % len(_MARKERS)], color=f"C{i % 10}", ms=5 if i else 8, label=name,
            mfc=f"C{i % 10}" if i else "none",
        )  # fmt: skip
        ax.set_xlabel("largest force left over the load" if statics else _LABELS["step"])
        ax.set_title("deviation and residual" if statics else "error by time step", fontsize=10)
    ax.set(xscale="log", yscale="log", ylabel="largest relative error")
    _ticks(ax)
    ax.grid(alpha=0.25, which="both")
    ax.legend(fontsize=7)


_OVER = f"cost of a bead and step over that of {CONTROL}\nbeads on Reference, run in turn with it"


def draw_growth(path: Path, growth: Growth) -> None:
    """Cost by size and platform, by term, build time and memory, replicas and processes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 8.6), layout="constrained")
    (size, term), (build, wide) = figure.subplots(2, 2)
    _sizes(size, growth)
    costs = [r for r in growth.rows if r.kind == "term"]
    names = [r.terms + ("" if r.platform == "Reference" else f", {r.platform}") for r in costs]
    bars = [r.over_control for r in costs]
    term.barh(names, bars, color=["C0" if r.platform == "Reference" else "C1" for r in costs], alpha=0.8)
    for i, row in enumerate(costs):
        text = f"{row.over_control:.2f} ({row.ns_per_bead_step:.0f} ns)"
        term.annotate(text, (row.over_control, i), textcoords="offset points", xytext=(4, -3), fontsize=9)
    term.invert_yaxis()
    term.set(xlabel=_OVER, title="What a term costs, 1000 beads")
    term.margins(x=0.35)
    rows = growth.sizes("Reference")
    build.plot(
        [r.beads for r in rows], [r.build_seconds for r in rows], "o-", color="C0", label="filament, model, Context"
    )
    build.set(xscale="log", yscale="log", xlabel="beads", ylabel="seconds", title="Building")
    build.grid(alpha=0.25)
    memory = [r for r in growth.rows if r.kind == "memory"]
    if memory:
        build.set_title(f"Building; memory {memory[-1].bytes_per_bead:.0f} bytes a bead (of {memory[-1].beads:,})")
    build.legend(fontsize=8)
    _wide(wide, growth)
    figure.suptitle("Growth: what a bead and step cost", fontsize=13)
    figure.savefig(path, dpi=130)


def _sizes(ax: Axes, growth: Growth) -> None:
    kinds = sorted(
        {(r.platform, r.workers) for r in growth.rows if r.kind == "size"}, key=lambda k: (k[0] != "Reference", k)
    )
    for i, (platform, threads) in enumerate(kinds):
        rows = [r for r in growth.sizes(platform) if r.workers == threads]
        beads, cost = [r.beads for r in rows], [r.over_control for r in rows]
        name = f"{platform}, {threads} thread{'s' if threads > 1 else ''}" if platform == "CPU" else platform
        ax.plot(beads, cost, _MARKERS[i] + "-", color=f"C{i}", ms=5, lw=1, label=name)
    rows = [r for r in growth.sizes("Reference") if r.beads >= FLAT_FROM]
    middle = float(np.median([r.over_control for r in rows]))
    low, high = (1 - FLAT) * middle, (1 + FLAT) * middle
    ax.fill_between([FLAT_FROM, rows[-1].beads], low, high, color="C0", alpha=0.15, label=f"± {100 * FLAT:.0f} %")
    ax.set(xscale="log", yscale="log", xlabel="beads", ylabel=_OVER, title=f"Cost by size (stretching {WHOLE})")
    _ticks(ax)
    ax.grid(alpha=0.25)
    ax.legend(fontsize=8)


def _wide(ax: Axes, growth: Growth) -> None:
    one = [r for r in growth.rows if r.kind == "replicas"]
    many = [r for r in growth.rows if r.kind == "processes"]
    names = [f"{r.replicas} in one System" for r in one] + [
        f"{r.workers} process{'es' if r.workers > 1 else ''} of {r.replicas}" for r in many
    ]
    rows = [*one, *many]
    value = [1e3 / r.ns_per_bead_step for r in rows]
    ax.barh(names, value, color=["C0"] * len(one) + ["C1"] * len(many), alpha=0.8)
    for i, v in enumerate(value):
        ax.annotate(f"{v:.1f}", (v, i), textcoords="offset points", xytext=(4, -3), fontsize=9)
    ax.invert_yaxis()
    ax.margins(x=0.12)
    ax.set(xlabel="million bead-steps a second", title="Replicas of 20 beads (stretching + bending)")
