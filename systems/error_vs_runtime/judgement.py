"""Checks and findings: orders of convergence, what systems state of their defaults, and what growth costs."""

from __future__ import annotations

import math
from collections.abc import Sequence

from scipy.stats import t as student

from systems.error_vs_runtime.front import fitted, thermal_time_to
from systems.error_vs_runtime.settings import Outcome, Study
from systems.error_vs_runtime.sweeps import growth as growing
from systems.error_vs_runtime.sweeps.growth import Growth
from systems.error_vs_runtime.sweeps.timing import CROWDED, WHOLE, Row
from systems.scene import Check

__all__ = [
    "cheapest", "checks", "default_of", "findings", "growth_checks", "growth_findings", "margin", "recommended",
]  # fmt: skip

ORDER = 0.2
"""By how much a measured order of convergence may differ from theory, for those that have noise two standard errors more."""

CHANCE = 6e-5
"""How often a bias that is as it is known may fail its check by noise: that of four standard errors, were there many seeds."""

ALIKE, APART = 1.25, 2.0
"""Ratios of wall times: up to the first two settings are equally cheap on any machine, above the second on none. Between
them it is a matter of the spread of the runs."""


def default_of(study: Study) -> Outcome | None:
    """The runs of what the system uses by default."""
    return next((o for o in study.outcomes if o.setting == study.default and o.results), None)


def _cost(study: Study, outcome: Outcome) -> float:
    """Wall seconds to the error that the system states; infinite for a setting that does not get there."""
    assert study.stated is not None
    if study.known is None:
        return outcome.seconds if outcome.error <= study.stated else math.inf
    return thermal_time_to(outcome.seconds, outcome.scatter, study.known(outcome.setting), study.stated)


def _spread(outcome: Outcome) -> tuple[float, float]:
    """By what factors the cost may be lower and higher: the spread of its wall times, one standard error of a scatter's square."""
    low, high = outcome.spread
    noise = math.sqrt(2 / (len(outcome.deviations) - 1)) if len(outcome.deviations) > 1 else 0.0
    return outcome.seconds / low * (1 + noise), high / outcome.seconds * (1 + noise)


def cheapest(study: Study) -> Outcome | None:
    """The admitted setting that meets what the system states in the shortest time; None without one, or where it states none."""
    if study.stated is None:
        return None
    good = [o for o in study.outcomes if o.results and study.admitted(o.setting) and math.isfinite(_cost(study, o))]
    return min(good, key=lambda o: _cost(study, o), default=None)


def margin(study: Study) -> tuple[float, float]:
    """The default's time over the cheapest setting's, and the ratio up to which they are equal within their spread.

    Infinite where the default does not meet what is stated.
    """
    default, best = default_of(study), cheapest(study)
    if default is None or best is None:
        return math.inf, ALIKE
    band = _spread(default)[0] * _spread(best)[1] if default is not best else 1.0
    return _cost(study, default) / _cost(study, best), min(max(band, ALIKE), APART)


def recommended(study: Study) -> Outcome | None:
    """The default where nothing is cheaper by more than the spread; else the cheapest setting that meets what is stated."""
    if study.stated is None:
        return None
    ratio, band = margin(study)
    return default_of(study) if ratio <= band else cheapest(study)


def checks(studies: Sequence[Study]) -> list[Check]:
    """Orders against theory, defaults against what their systems state."""
    out = []
    for study in studies:
        for order in study.orders:
            fit = fitted(order, study.outcomes)
            noisy = study.thermal
            room = ORDER + (2 * fit.error if noisy else 0.0)
            name = f"{study.system}, {study.question}: order of convergence, {order.name}"
            out.append(Check(name, order.kind, fit.order, order.theory, abs(fit.order - order.theory), room))
        default, best = default_of(study), recommended(study)
        if study.known is not None and study.default is not None:
            out.append(_bias(study, default))
        if study.stated is None or study.default is None:
            continue  # a default that did not run is one that fails
        for what, one in (("default", default), ("recommended", best)):
            error = math.inf if one is None else _reached(study, one)
            name = f"{study.system}, {study.question}: error of the {what} setting against the one stated"
            out.append(Check(name, "exact", error, 0.0, error, study.stated))
        ratio, band = margin(study)
        name = f"{study.system}, {study.question}: the default is recommended, its time over the cheapest setting's"
        out.append(Check(name, "claim", ratio, 1.0, ratio - 1, band - 1))
    return out


def _bias(study: Study, default: Outcome | None) -> Check:
    """The measured bias of a thermal default against the one known beforehand; four standard errors, more of few seeds."""
    assert study.known is not None
    name = f"{study.system}, {study.question}: bias of the default setting, measured, against the one known beforehand"
    if default is None:
        return Check(name, "exact", math.nan, 0.0, math.nan, 0.0)
    known = study.known(default.setting)
    room = float(student.isf(CHANCE / 2, len(default.deviations) - 1)) * default.bias_error
    return Check(name, "exact", default.bias, known, abs(default.bias - known), room)


def _reached(study: Study, outcome: Outcome) -> float:
    """The error of a setting; where there is noise, its known bias, for more time takes away all the rest."""
    return outcome.error if study.known is None else abs(study.known(outcome.setting))


def findings(studies: Sequence[Study]) -> list[str]:
    """Defaults beside the cheapest settings, which integrator and form pay, and what did not run."""
    out = []
    for study in studies:
        default, best = default_of(study), cheapest(study)
        if study.stated is not None and default is not None and best is not None:
            ratio, band = margin(study)
            there = f"gets there in {_cost(study, default):.2g} s" if math.isfinite(ratio) else "does not get there"
            head = (
                f"{study.system}, {study.question}: {study.stated:.2g} is stated; the default ({default.setting.label}) {there}, "
                f"with an error of {_reached(study, default):.2g}"
            )
            other = f"{best.setting.label} in {_cost(study, best):.2g} s with {_reached(study, best):.2g}"
            if default is best:
                out.append(f"{head}, and nothing that may be recommended is cheaper.")
            else:
                within = (
                    "no more than the spread of the runs" if ratio <= band else "and the default is not recommended"
                )
                out.append(f"{head}, {other}, {ratio:.2g} times as fast: {within}.")
        if study.stated is None and default is not None and study.known is None:
            out.append(
                f"{study.system}, {study.question}: the default ({default.setting.label}) takes {default.seconds:.2g} s with an "
                f"error of {default.error:.2g}; the system states none for a single run, and none is recommended."
            )
        failed = [o for o in study.outcomes if not o.results]
        out += [f"{study.system}, {study.question}: {o.setting.label} did not run: {o.failure}" for o in failed]
    return [*out, *_bending(studies), *_thermal(studies)]


def _bending(studies: Sequence[Study]) -> list[str]:
    """The cost of the exact bending form, paired with the default form at the same setting."""
    out = []
    for study in studies:
        for o in study.outcomes:
            if o.setting.form != "arctangent" or not o.results:
                continue
            for other in study.outcomes:
                same = other.setting.form == "arccosine" and other.setting.label == o.setting.label.replace(
                    ", arctangent", ""
                )
                if same and other.results:
                    out.append(
                        f"{study.system}, {study.question}: bending by arctangent costs {o.seconds / other.seconds:.2g} times the "
                        f"time of the default form; errors are {o.error:.2g} and {other.error:.2g}."
                    )
    return out


def _thermal(studies: Sequence[Study]) -> list[str]:
    """Bias measured beside bias known, and what other integrators, forms and platforms give at the default's time step."""
    out = []
    for study in studies:
        default = default_of(study)
        if study.known is not None and default is not None:
            out.append(
                f"{study.system}, {study.question}: the default setting deviates by {_deviation(default)} on average over "
                f"{len(default.deviations)} seeds, where {100 * study.known(default.setting):+.2f} % are known beforehand; one "
                f"run of {default.seconds:.2g} s scatters by {100 * default.scatter:.2g} %."
            )
            others = [o for o in study.outcomes if o.results and o.setting.series != default.setting.series]
            if others:
                said = [f"{o.setting.label} by {_deviation(o)} in {o.seconds:.2g} s" for o in others]
                out.append(f"{study.system}, {study.question}, in other ways: {'; '.join(said)}.")
    return out


def _deviation(outcome: Outcome) -> str:
    return f"({100 * outcome.bias:+.2f} +- {100 * outcome.bias_error:.2f}) %"


def growth_checks(growth: Growth) -> list[Check]:
    """The cost of a bead and step is flat."""
    out = []
    for platform in ("Reference",):
        rows = growth.sizes(platform)
        far = growing.flatness(rows)
        name = f"growth on {platform}: cost of a bead and step from {growing.FLAT_FROM} beads up, largest deviation from the median"
        out.append(Check(name, "claim", far, 0.0, far, growing.FLAT))
    return out


def growth_findings(growth: Growth) -> list[str]:
    """In words."""
    terms = {r.terms: r for r in growth.rows if r.kind == "term" and r.platform == "Reference"}
    crowded = {r.terms: r for r in growth.rows if r.kind == "term" and r.platform == "CPU"}
    whole = terms[WHOLE].over_control
    largest = growth.sizes("Reference")[-1]
    part = {name: r.over_control / whole for name, r in terms.items()}
    out = [
        f"Over a bead and step of 1000 beads with {WHOLE.removeprefix('+ ')} on Reference "
        f"({terms[WHOLE].ns_per_bead_step:.0f} ns), "
        + ", ".join(f"{cost:.2f} with {name}" for name, cost in part.items() if name != WHOLE)
        + f": leaving out torsion saves {100 * (1 - part['+ bending']):.0f} %, bending as well "
        f"{100 * (1 - part['stretching']):.0f} %.",
        f"{largest.beads:,} beads are built in {largest.build_seconds:.2g} s and take "
        f"{largest.ns_per_bead_step:.0f} ns a bead and step.",
    ]
    if CROWDED in crowded:
        out.append(
            f"On the CPU platform with one thread 1000 beads take {crowded[WHOLE].over_control / whole:.2f} of the time, and "
            f"contact adds {100 * (crowded[CROWDED].over_control / crowded[WHOLE].over_control - 1):.0f} % there."
        )
    memory = [r for r in growth.rows if r.kind == "memory"]
    out += [f"{r.beads:,} beads take {r.bytes_per_bead:.0f} bytes each, model and Context." for r in memory[-1:]]
    reference = growth.sizes("Reference")
    for platform in sorted({r.platform for r in growth.rows} - {"Reference"}):
        for threads in sorted({r.workers for r in growth.sizes(platform)}):
            rows = [r for r in growth.sizes(platform) if r.workers == threads]
            at = growing.crossover(reference, rows)
            name = f"{platform} with {threads} thread{'s' if threads > 1 else ''}" if platform == "CPU" else platform
            said = f"faster than Reference from about {at:.1g} beads up"
            if not math.isfinite(at):
                said = f"not faster than Reference at {rows[-1].beads:,} beads, the most that it was run with"
                cost = {r.beads: r.over_control for r in reference}
                between = [f"{r.beads:,}" for r in rows if r.over_control < growing.CLEAR * cost.get(r.beads, 0.0)]
                said += f", but is at {' and '.join(between)}" if between else ""
            out.append(f"{name} is {said}.")
    return [*out, *_replicas(growth.rows)]


def _replicas(rows: Sequence[Row]) -> list[str]:
    replicas = {r.replicas: r.ns_per_bead_step for r in rows if r.kind == "replicas"}
    processes = {r.workers: r.ns_per_bead_step for r in rows if r.kind == "processes"}
    out = []
    if replicas:
        most = max(replicas)
        out.append(
            f"{most} replicas of 20 beads in one System cost {replicas[most] / replicas[1]:.2f} of what as many Systems cost one "
            "after the other."
        )
    if len(processes) > 1:
        cores = max(processes)
        out.append(
            f"{cores} processes make {processes[1] / processes[cores]:.2f} times as many steps a second as one on this machine."
        )
    return out
