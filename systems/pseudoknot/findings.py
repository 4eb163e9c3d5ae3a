"""The sentences of the summary."""

from __future__ import annotations

import math

from systems.pseudoknot.judgement import Outcome, Setting, Slow, least
from systems.pseudoknot.plan import BASE, WARMTH
from systems.pseudoknot.rows import Row

__all__ = ["sentences"]

SPECIAL = 0.1
"""Part of the work of breaking two helices that making them, and breaking the controls, must stay below to call them special."""


def sentences(rows: list[Row], table: list[Setting], found: Outcome) -> list[str]:
    """One finding each, with its numbers."""
    by_label = {line.label: line for line in table}
    main = [line for line in table if line.group == "main"]
    return [
        _ratio(found, main[-1]),
        _whole(found),
        _special(by_label, main[-1]),
        _held(rows, by_label),
        *_ways(by_label),
        *_varied(table),
        _free(rows),
    ]


def _micro(work: Slow) -> str:
    return f"{1e6 * work.mean:.3g} +- {1e6 * work.error:.2g} uJ"


def _ratio(found: Outcome, slowest: Setting) -> str:
    making, breaking = found.net_making, found.net_breaking
    return (
        f"With the work on a coil that is moved alone taken off, and extrapolated to slow from {making.speeds.min():.2g} to "
        f"{making.speeds.max():.2g} m/s, over the {len(making.each)} starts that formed at all speeds, making the knot takes "
        f"{_micro(making)} and pulling it apart {_micro(breaking)} (E I/R is {1e6 * BASE.energy:.3g} uJ): "
        f"{_times(making, breaking, found.ratio)}, where the thesis has nearly two orders of magnitude for real springs, "
        f"which rub. At the slowest speed alone, over the {slowest.formed} of {slowest.starts} starts that formed there, it "
        f"is {slowest.ratio:.0f} +- {slowest.ratio_error:.0f} times."
    )


def _times(making: Slow, breaking: Slow, ratio: tuple[float, float]) -> str:
    """Work over work; a bound where that of making is not resolved from zero."""
    if not making.resolved:
        low = least(making, breaking)
        if math.isnan(low):
            return "these speeds are too high for a straight line to zero, and tell no ratio"
        return (
            f"the first is not resolved from zero, and the ratio at least {low:.0f} (two standard errors of the first)"
        )
    return f"{ratio[0]:.0f} +- {ratio[1]:.0f} times as much"


def _whole(found: Outcome) -> str:
    alone = found.making.mean - found.net_making.mean
    return (
        f"Of all that the hand does the same limits are {_micro(found.making)} and {_micro(found.breaking)}. Friction on a coil "
        f"that is moved alone, which slow motion does not feel, comes out as {1e6 * alone:.3g} uJ of the former: by so much a "
        "straight line misses it."
    )


def _special(by_label: dict[str, Setting], knot: Setting) -> str:
    """What the two helices take beside the controls; why they are special only where they are."""
    controls = [line for name in ("two rods", "rod in a helix", "opposite hands") if (line := by_label.get(name))]
    beside = [
        f"{line.label} {line.breaking / line.energy_unit:.2g}" if line.formed else f"{line.label} none formed"
        for line in controls
    ]
    back = by_label.get("unscrewed")
    reversed_way = f", and unscrewing undoes it for {back.breaking / back.energy_unit:.2g}" if back else ""
    took = (
        f"Two helices of one hand wind together for {knot.making / knot.energy_unit:.2g} E I/R, and the straight pull takes "
        f"{knot.breaking / knot.energy_unit:.2g} E I/R (controls: {', '.join(beside)}{reversed_way})"
    )
    others_hold = any(_pull(line) >= SPECIAL * _pull(knot) for line in controls if line.formed)
    if others_hold or knot.making > SPECIAL * knot.breaking or not knot.formed:
        return f"{took}: these runs do not show what makes helices special."
    return (
        f"{took}. What makes helices special: a helix screwed along itself takes up no new space, while any other way out "
        "must bend the coils open."
    )


def _pull(line: Setting) -> float:
    """Work of breaking over E I/R."""
    return line.breaking / line.energy_unit


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
    pushed = [line for name in ("pushed without turning", "pushed from the side") if (line := by_label.get(name))]
    pushes = [
        f"{line.label}: {line.formed} of {line.starts}, for {line.making / line.energy_unit:.2g} E I/R, out again for "
        f"{_pull(line):.2g}"
        if line.formed
        else f"{line.label}: none of {line.starts}"
        for line in pushed
    ]
    knot, hold = by_label.get("screwed in, pulled out"), [line for line in pushed if line.formed]
    as_well = knot and knot.formed and any(_pull(line) >= _pull(knot) / 2 for line in hold)
    head = (
        "There are ways in that hold without turning"
        if as_well
        else "Without turning no way in was found that holds as well"
    )
    out = [f"{head} ({'; '.join(pushes)})."] if pushes else []
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
