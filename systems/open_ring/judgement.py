"""What the runs of the ring are held against, and what they show."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

import openmm_filament as of
from systems.open_ring import static
from systems.open_ring.figures import ANGLES, SHAPES
from systems.open_ring.ring import BEADS, BENDING, PARTS, SEGMENT, TORSION, Ring, Swing, swing
from systems.scene import Check

__all__ = ["BALANCE", "HESSIAN_SIZE", "LINEAR", "findings", "linear_checks", "motion_checks", "static_checks"]

Runs = Mapping[tuple[bool, float], Swing]
Shares = Mapping[bool, Sequence[tuple[float, float]]]
Table = Mapping[str, Mapping[int, float]]

BALANCE, SLOPE = 1e-4, 1e-6
"""What is asked of the energy balance, and of the slope of the energy per 10^6 steps."""

ROUNDING = 1e-5
"""Of a compliance from the Hessian of 200 beads, whose stiffest direction is 1e10 times its softest: 1e-6 is found."""
HESSIAN_SIZE = 200
"""The ring whose Hessian is held against the closed forms: finer ones lose digits, 2e-4 at 400 beads (a torsion is a third
difference of the positions)."""


def _largest(name: str, kind: Any, value: float, tolerance: float) -> Check:
    """A check of a number that should be zero."""
    return Check(name, kind, float(value), 0.0, abs(float(value)), tolerance)


LINEAR = 1e-4
"""Of the motion under a small load against the sum over the modes, over its largest."""

NEGLIGIBLE = 0.01
"""Share of bending in the energy up to which there is torsion only."""


def rounding(run: Swing) -> float:
    """Torsion energy over the peak of the internal energy that rounding may leave in motion in a general plane.

    A step rounds a position by eps R, normal to the plane as well, and n steps add up to sqrt(n) of these. A dihedral is a
    third difference of such displacements, at most 8 of them, over l sin^2(beta). All N - 3 may have this angle; ten times
    their energy is allowed, for the walk is random.
    """
    steps = run.times[-1] / run.timestep
    radius = float(np.linalg.norm(run.positions[0] - run.positions[0].mean(axis=0), axis=1).max())
    angle = 8 * math.sqrt(steps) * np.finfo(np.float64).eps * radius / SEGMENT / run.sines[0] ** 2
    return float(10 * (BEADS - 3) * TORSION / SEGMENT * angle**2 / 2 / run.peak)


def _holds(claim: bool) -> str:
    return "holds" if claim else "does not hold"


def _power(points: Sequence[tuple[float, float]]) -> float:
    """Exponent of the power law through the last two (x, y)."""
    (a, first), (b, second) = points[-2:]
    return math.log(second / first) / math.log(b / a)


def _ratio(run: Swing) -> float:
    """The peak of the torsion energy over that of bending."""
    return float(run.energies["torsion"].max() / run.energies["bending"].max())


def motion_checks(
    runs: Runs,
    general: Mapping[bool, Swing],
    balance: Sequence[tuple[float, float]],
    shares: Shares,
    drift: tuple[Any, Any, float, float],
) -> list[Check]:
    """Energy balance, symmetry and slope, and the claims of the thesis on its energies.

    `general` holds the runs at phi = 0 of rings turned into a general plane.
    """
    _, _, slope, error = drift
    order = math.log(balance[0][1] / balance[1][1]) / math.log(balance[0][0] / balance[1][0])
    worst = {gap: max(r.imbalance for (g, _), r in runs.items() if g is gap) for gap in SHAPES}
    checks = [
        _largest(f"energy balance, largest of the runs, {SHAPES[gap]}", "exact", worst[gap], BALANCE)
        for gap in SHAPES
    ]  # fmt: skip
    checks.append(Check("order of the energy balance in the time step", "exact", order, 2.0, abs(order - 2), 0.3))
    checks.append(_largest("energy slope per 10^6 steps, plus two errors", "exact", abs(slope) + 2 * error, SLOPE))
    for gap, shape in SHAPES.items():
        mirrored = max(
            float(np.abs(runs[gap, phi].energies[part] - runs[gap, -phi].energies[part]).max()) / runs[gap, phi].peak
            for phi in ANGLES
            if phi > 0
            for part in PARTS
        )
        normal, between = (runs[gap, phi] for phi in (math.pi / 2, math.pi / 4))
        plane = general[gap]
        power = _power(shares[gap])
        ratio = _ratio(between)
        stretched = max(r.peak_share("stretching") for (g, _), r in runs.items() if g is gap)
        checks += [
            _largest(f"difference between +phi and -phi over the peak, {shape}", "exact", mirrored, 1e-9),
            _largest(
                f"torsion in the plane (a general one) over the peak, {shape}",
                "exact",
                plane.peak_share("torsion"),
                rounding(plane),
            ),
            Check(f"power of the load in the bending share at pi/2, {shape}", "exact", power, 2.0, abs(power - 2), 0.05),
            _largest(f"claim: torsion only at pi/2 (bending, mean share), {shape}", "claim", normal.share("bending"), NEGLIGIBLE),
            Check(f"claim: torsion peaks above bending at pi/4, {shape}", "claim", ratio, 1.0, max(0.0, 1 - ratio), 0.0),
            _largest(f"claim: stretching negligible (largest share), {shape}", "claim", stretched, 1e-3),
        ]  # fmt: skip
    return checks


def linear_checks(body: Ring, force: float) -> list[Check]:
    """Motion under a small load, 2 ms of it, against the sum over the normal modes."""
    omega, _ = static.small_modes(body)
    found = 2 * math.pi * of.normal_modes(of.build(body.filament)).frequencies[6:]
    off = float(np.abs(found / omega - 1).max())
    checks = [_largest("normal_modes of the ring against the modes of its strains, relative", "exact", off, 1e-8)]
    for phi in (0.0, math.pi / 4, math.pi / 2):
        vector = force * (math.cos(phi) * body.opening + math.sin(phi) * np.array([0.0, 0.0, 1.0]))
        small = swing(body, force, phi, duration=2e-3, samples=200)
        exact = static.modal_opening(body, vector, small.times + small.timestep / 2)
        off = np.abs(small.positions[:, 0] - small.positions[:, -1] - exact).max() / np.abs(exact).max()
        name = f"small load, phi = {ANGLES[phi]}: motion of the ends against the sum over the modes of its strains"
        checks.append(_largest(name, "exact", float(off), LINEAR))
    return checks


def static_checks(
    closed: Table,
    hess: Table,
    relaxed: Table,
) -> list[Check]:
    """Deflections by the Hessian and by damped runs, against the statics of the chain and the cut ring."""
    checks = []
    for name, values in relaxed.items():
        worst = max(values, key=lambda n: abs(values[n] / static.from_statics(static.of_size(n), name) - 1))
        exact = static.from_statics(static.of_size(worst), name)
        error = abs(values[worst] / exact - 1)
        checks.append(
            Check(
                f"{name} compliance of {worst} beads, damped run against statics, m/N",
                "exact",
                values[worst],
                exact,
                error,
                1e-5,
                "m/N",
            )
        )
        limit = static.extrapolated(list(values), list(values.values()))
        formula = static.cut_ring(name)
        checks.append(
            Check(
                f"{name} compliance, damped runs extrapolated, against the cut ring, m/N",
                "exact",
                limit,
                formula,
                abs(limit / formula - 1),
                2e-4,
                "m/N",
            )
        )
    for name, values in hess.items():
        found, formula = values[HESSIAN_SIZE], static.cut_ring(name)
        error = abs(found / formula - 1)
        checks.append(
            Check(
                f"{name} compliance of {HESSIAN_SIZE} beads from the Hessian against the cut ring, m/N",
                "exact",
                found,
                formula,
                error,
                5e-4,
                "m/N",
            )
        )
        largest = max(abs(values[n] / closed[name][n] - 1) for n in values if n <= HESSIAN_SIZE)
        checks.append(
            _largest(
                f"{name} compliance: Hessian against statics up to {HESSIAN_SIZE} beads", "exact", largest, ROUNDING
            )
        )
    return checks  # fmt: skip


def findings(
    runs: Runs,
    general: Mapping[bool, Swing],
    forces: Mapping[bool, float],
    balance: Sequence[tuple[float, float]],
    shares: Shares,
    drift: tuple[Any, Any, float, float],
    gap_sizes: Mapping[int, float],
) -> list[str]:
    """What was found, a sentence each."""
    apart, meet = (runs[gap, math.pi / 2] for gap in SHAPES)
    between = {gap: runs[gap, math.pi / 4] for gap in SHAPES}
    low = min(r.sines[0] for r in runs.values())
    high = max(r.sines[1] for r in runs.values())
    coarse = static.of_size(13)
    off = {name: 100 * abs(static.from_statics(coarse, name) / static.cut_ring(name) - 1) for name in static.DIRECTIONS}
    powers = [
        _power([(1 / (n - 1), static.from_statics(static.of_size(n), d) / static.cut_ring(d) - 1) for n in (25, 13)])
        for d in ("tangential", "normal")
    ]
    powers.append(_power([(1 / n, abs(gap_sizes[n] / static.cut_ring("tangential") - 1)) for n in (25, 13)]))
    in_plane = all(run.peak_share("torsion") <= rounding(run) for run in general.values())
    alone, coupled = (run.share("bending") <= NEGLIGIBLE for run in (meet, apart))
    missing = 3 * BENDING / TORSION
    softer = 1 + 1 / missing
    _, _, slope, error = drift
    return [
        f"Forces of {forces[True]:.3f} N (gap of one segment) and {forces[False]:.3f} N (ends that meet) make the internal "
        f"energy at phi = 0 peak at {1e3 * runs[True, 0.0].peak:.3f} and {1e3 * runs[False, 0.0].peak:.3f} mJ.",
        "In the plane (turned into a general one) the torsion energy is at most "
        f"{max(run.peak_share('torsion') for run in general.values()):.1e} of the peak, where rounding may leave "
        f"{min(rounding(run) for run in general.values()):.1e}: that there is none {_holds(in_plane)}.",
        f"Torsion only at phi = pi/2 {_holds(alone)} where the ends meet (bending below {NEGLIGIBLE:.0%}): bending "
        f"stores {100 * meet.share('bending'):.3f} % of the energy "
        f"on average and peaks at {100 * meet.peak_share('bending'):.3f} % of the total's peak.",
        f"With a gap of one segment it {_holds(coupled)}: normal forces are a couple that turns the line between the ends by "
        f"{math.degrees(apart.turn):.0f} degrees in 5 ms, and bending stores {100 * apart.share('bending'):.1f} % on average, "
        f"{100 * apart.peak_share('bending'):.1f} % at its peak"
        + ("; the thesis's claims suggest that its ends met." if alone and not coupled else "."),
        "The share of bending at phi = pi/2 falls with the force, "
        + " and ".join(
            f"to the power {_power(p):.3f} to {p[-1][1]:.1e} at {p[-1][0]:.2g} N ({SHAPES[g]})" for g, p in shares.items()
        ) + ".",
        "At phi = pi/4 torsion peaks at "
        + " and ".join(f"{_ratio(r):.2f} times bending ({SHAPES[g]})" for g, r in between.items())
        + ".",
        f"Stretching stores at most {max(r.peak_share('stretching') for r in runs.values()):.1e} of the peak energy.",
        f"sin(beta) stays from {low:.3f} to {high:.3f}; dihedral torsion is singular at 0.",
        f"Work of the loads and energy agree to {balance[-1][1]:.1e} of the peak at {balance[-1][0]:g} of the "
        f"stability limit, and to {balance[0][1]:.1e} at {balance[0][0]:g} of it.",
        f"Energy of the free ring: slope ({slope:.1e} +- {error:.1e}) of it per 10^6 steps; of the loaded ring, less the work, "
        f"over the peak of its internal energy: {runs[False, 0.0].drift} in the plane and {between[False].drift} at phi = pi/4 "
        f"where the ends meet, {between[True].drift} there with a gap ({between[True].drift.length} steps).",
        "Normal to the plane the bead chain gives 3 pi P R^3/GJ, for its torsion is that of the centre line; a rod with material "
        f"twist has pi P R^3/EI besides, here {100 / missing:.1f} % more: the chain is too stiff there by a factor {softer:.3f}.",
        f"At 13 beads the chain is off by {off['tangential']:.1f} % along the tangents and {off['normal']:.1f} % normal to the "
        f"plane, with a gap by {100 * abs(gap_sizes[13] / static.cut_ring('tangential') - 1):.1f} % along the tangents; "
        f"from 25 beads to 13 these grow with the segment to the powers {powers[0]:.2f}, {powers[1]:.2f} and {powers[2]:.2f}.",
    ]  # fmt: skip
