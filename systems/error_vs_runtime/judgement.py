"""Checks and findings: orders of convergence, what systems state of their defaults, and what growth costs."""

from __future__ import annotations

import math
from collections.abc import Sequence

from systems.error_vs_runtime.front import cheapest, fitted, thermal_time_to
from systems.error_vs_runtime.settings import Outcome, Study
from systems.error_vs_runtime.sweeps import growth as growing
from systems.error_vs_runtime.sweeps.growth import Growth, Row
from systems.scene import Check

__all__ = ["checks", "default_of", "findings", "growth_checks", "growth_findings", "recommended"]

ORDER = 0.2
"""By how much a measured order of convergence may differ from theory, for those that have noise two standard errors more."""

ALIKE = 1.25
"""Ratio of wall times up to which two settings count as equally cheap: less than what a shared machine tells apart."""


def default_of(study: Study) -> Outcome | None:
    """The runs of what the system uses by default."""
    return next((o for o in study.outcomes if o.setting == study.default and o.results), None)


def _cost(study: Study, outcome: Outcome) -> float:
    """Wall seconds to the error that the system states; infinite for a setting that does not get there."""
    assert study.stated is not None
    if study.known is None:
        return outcome.seconds if outcome.error <= study.stated else math.inf
    return thermal_time_to(outcome.seconds, outcome.scatter, study.known(outcome.setting), study.stated)


def recommended(study: Study) -> Outcome | None:
    """The cheapest setting that meets what the system states; its default where that is as cheap within timing noise."""
    if study.stated is None:
        return None
    if study.known is None:
        best = cheapest(study, study.stated)
    else:
        alike = [o for o in study.outcomes if study.admitted(o.setting)]
        good = [o for o in alike if o.results and math.isfinite(_cost(study, o))]
        best = min(good, key=lambda o: _cost(study, o), default=None)
    default = default_of(study)
    if best is not None and default is not None and _cost(study, default) <= ALIKE * _cost(study, best):
        return default
    return best


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
        if study.stated is None or default is None:
            continue
        for what, one in (("default", default), ("recommended", best)):
            error = math.inf if one is None else _reached(study, one)
            name = f"{study.system}, {study.question}: error of the {what} setting against the one stated"
            out.append(Check(name, "exact", error, 0.0, error, study.stated))
    return out


def _reached(study: Study, outcome: Outcome) -> float:
    """The error of a setting; where there is noise, its known bias, for more time takes away all the rest."""
    return outcome.error if study.known is None else abs(study.known(outcome.setting))


def findings(studies: Sequence[Study]) -> list[str]:
    """Defaults beside the cheapest settings, which integrator and form pay, and what did not run."""
    out = []
    for study in studies:
        default, best = default_of(study), recommended(study)
        if study.stated is not None and default is not None and best is not None:
            times = _cost(study, default), _cost(study, best)
            head = f"{study.system}, {study.question}: {study.stated:.2g} is stated; the default ({default.setting.label}) "
            if default is best:
                out.append(
                    f"{head}gets there in {times[0]:.2g} s, and nothing that was tried is cheaper by more than noise."
                )
            else:
                out.append(
                    f"{head}takes {times[0]:.2g} s with an error of {default.error:.2g}; {best.setting.label} gets there in "
                    f"{times[1]:.2g} s with {best.error:.2g}, {times[0] / times[1]:.2g} times as fast."
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
    """Bias measured beside bias known."""
    out = []
    for study in studies:
        default = default_of(study)
        if study.known is not None and default is not None:
            out.append(
                f"{study.system}, {study.question}: the default setting deviates by ({100 * default.bias:+.2f} +- "
                f"{100 * default.bias_error:.2f}) % on average over {len(default.deviations)} seeds, where "
                f"{100 * study.known(default.setting):+.2f} % are known beforehand; one run of {default.seconds:.2g} s "
                f"scatters by {100 * default.scatter:.2g} %."
            )
    return out


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
    terms = {r.terms: r.ns_per_bead_step for r in growth.rows if r.kind == "term"}
    whole = terms[growing.WHOLE]
    largest = growth.sizes("Reference")[-1]
    out = [
        "A bead and step on Reference, 1000 beads, take "
        + ", ".join(f"{ns:.0f} ns with {name}" for name, ns in terms.items())
        + f": leaving out torsion saves {100 * (1 - terms['+ bending'] / whole):.0f} %, bending as well "
        f"{100 * (1 - terms['stretching'] / whole):.0f} %.",
        f"{largest.beads:,} beads are built in {largest.build_seconds:.2g} s and take "
        f"{largest.ns_per_bead_step:.0f} ns a bead and step.",
    ]
    memory = [r for r in growth.rows if r.kind == "memory"]
    out += [f"{r.beads:,} beads take {r.bytes_per_bead:.0f} bytes each, model and Context." for r in memory[-1:]]
    reference = growth.sizes("Reference")
    for platform in sorted({r.platform for r in growth.rows} - {"Reference"}):
        for threads in sorted({r.workers for r in growth.sizes(platform)}):
            rows = [r for r in growth.sizes(platform) if r.workers == threads]
            at = growing.crossover(reference, rows)
            name = f"{platform} with {threads} thread{'s' if threads > 1 else ''}" if platform == "CPU" else platform
            said = f"from {at:.2g} beads up" if math.isfinite(at) else f"never, up to {rows[-1].beads:,} beads"
            out.append(f"{name} is faster than Reference {said}.")
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
