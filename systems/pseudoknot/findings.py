"""The sentences of the summary."""

from __future__ import annotations

import math

from systems.pseudoknot.judgement import Outcome, Setting, Slow
from systems.pseudoknot.plan import BASE, WARMTH
from systems.pseudoknot.rows import Row

__all__ = ["sentences"]


def sentences(rows: list[Row], table: list[Setting], found: Outcome) -> list[str]:
    """One finding each, with its numbers."""
    by_label = {line.label: line for line in table}
    main = [line for line in table if line.group == "main"]
    return [
        _ratio(found),
        _net(found),
        _special(by_label, main[-1]),
        _held(rows, by_label),
        *_ways(by_label),
        *_varied(table),
        _free(rows),
    ]


def _micro(work: Slow) -> str:
    return f"{1e6 * work.mean:.3g} +- {1e6 * work.error:.2g} uJ"


def _ratio(found: Outcome) -> str:
    ratio, error = found.ratio
    speeds = f"{found.making.speeds.min():.2g} to {found.making.speeds.max():.2g} m/s"
    if found.making.mean < 2 * found.making.error:
        return (
            f"At these speeds ({speeds}) the slow limit of making, {_micro(found.making)}, is not resolved from zero, and so "
            f"no ratio to that of breaking, {_micro(found.breaking)}: the default run is slower."
        )
    return (
        f"Extrapolated to slow from {speeds}, over the {len(found.making.each)} starts that formed at all speeds, the hand "
        f"does {_micro(found.making)} to make the knot and {_micro(found.breaking)} to pull it apart: {ratio:.0f} +- "
        f"{error:.0f} times as much ({math.log10(ratio):.2f} decades), where the thesis has nearly two orders of magnitude "
        "for real springs. (--quick is fast, and its limits rough.)"
    )


def _net(found: Outcome) -> str:
    ratio, error = found.net_ratio
    resolved = found.net_making.mean >= 2 * found.net_making.error
    times = f"{ratio:.0f} +- {error:.0f} times as much" if resolved else "the first not resolved from zero"
    return (
        "With the work on a coil that is moved alone taken off at every speed, the same limits are "
        f"{_micro(found.net_making)} and {_micro(found.net_breaking)}, {times}; E I/R is "
        f"{1e6 * BASE.energy:.3g} uJ."
    )


def _special(by_label: dict[str, Setting], knot: Setting) -> str:
    pulls = [
        f"{line.label} {line.breaking / line.energy_unit:.2g}" if line.formed else f"{line.label} none formed"
        for name in ("two rods", "rod in a helix", "opposite hands")
        if (line := by_label.get(name))
    ]
    back = by_label.get("unscrewed")
    reversed_way = f", and unscrewing undoes it for {back.breaking / back.energy_unit:.2g}" if back else ""
    return (
        "What makes helices special: a helix screwed along itself takes up no new space, so two of one hand wind together for "
        f"{knot.making / knot.energy_unit:.2g} E I/R, while any other way out must bend their coils open: the straight pull "
        f"takes {knot.breaking / knot.energy_unit:.2g} E I/R (controls: {', '.join(pulls)}{reversed_way})."
    )


def _held(rows: list[Row], by_label: dict[str, Setting]) -> str:
    made = [row for row in rows if row.group == "main" and row.made]
    kept = [row.link_kept / row.link_made for row in made]
    text = (
        f"Screwing winds {len(made)} of {sum(row.group == 'main' for row in rows)} pairs together (other tips slide off beside "
        f"each other); left alone with k_B T = {WARMTH:g} E I/R, {sum(row.formed for row in made)} of them keep half the ideal "
        f"linking or more, {min(kept):.2f} to {max(kept):.2f} of what was made"
    )
    hot = by_label.get("ten times warmer and four times longer")
    return text + (f"; ten times warmer and four times longer {hot.formed} of {hot.starts}." if hot else ".")


def _ways(by_label: dict[str, Setting]) -> list[str]:
    pushes = [
        f"{line.label}: {line.formed} of {line.starts}, for {line.making / line.energy_unit:.2g} E I/R"
        for name in ("pushed without turning", "pushed from the side")
        if (line := by_label.get(name))
    ]
    out = ["Without turning no way in was found that holds as well (" + "; ".join(pushes) + ")."] if pushes else []
    side = by_label.get("pulled sideways")
    if side and side.formed:
        out.append(
            f"Pulled sideways the knot costs {side.breaking / side.energy_unit:.2g} +- "
            f"{side.breaking_error / side.energy_unit:.1g} E I/R and holds with up to "
            f"{side.holding / side.force_unit:.2g} E I/R^2."
        )
    return out


def _varied(table: list[Setting]) -> list[str]:
    out = []
    for group in dict.fromkeys(line.group for line in table if not math.isnan(line.value)):
        lines = [line for line in table if line.group == group]
        texts = [f"{line.value:g}: {line.formed}/{line.starts} form{_costs(line)}" for line in lines]
        out.append(f"{group.replace('_over_', '/').replace('_', ' ')} = " + "; ".join(texts) + ".")
    return out


def _costs(line: Setting) -> str:
    """What a setting takes and holds, with standard errors over its starts."""
    making = _over(line.making, line.making_error, line.energy_unit)
    if not line.formed:
        return f", work {making} E I/R without a knot"
    holding = _over(line.holding, line.holding_error, line.force_unit)
    breaking = _over(line.breaking, line.breaking_error, line.energy_unit)
    return f", hold {holding} E I/R^2, work {breaking} over {making} E I/R"


def _over(value: float, error: float, unit: float) -> str:
    """A number in a unit with its error, if it has one."""
    return f"{value / unit:.2g}" + ("" if math.isnan(error) else f" +- {error / unit:.1g}")


def _free(rows: list[Row]) -> str:
    knots = [row for row in rows if row.formed]
    free = sum(not math.isnan(row.freed_at) for row in knots)
    return f"{free} of {len(knots)} knots came free within the pull; works of others are lower bounds."
