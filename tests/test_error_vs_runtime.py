"""The report of error against run time: its fronts and orders on made-up data, one small sweep a family, its quick run."""

from __future__ import annotations

import csv
import json
import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import openmm as mm
import pytest
from matplotlib.figure import Figure
from openmm import unit
from scipy import linalg

import openmm_filament as of
from systems import __main__ as command
from systems import mass_spring, strings
from systems.error_vs_runtime import figures, front, integrators, judgement, tables, turns
from systems.error_vs_runtime.settings import Order, Outcome, Result, Setting, Study
from systems.error_vs_runtime.sweeps import growth, loaded, masses, statics, strung, thermal, timing
from systems.weighted_string import chain as weighted


def outcome(segments: int, seconds: float, *deviations: float, step: float = 0.5) -> Outcome:
    return Outcome(Setting(segments, step), (Result(seconds, np.array(deviations)),))


def study(outcomes: list[Outcome], **more: object) -> Study:
    made = Study("made", "up", "zero", lambda s, seed: outcomes[0].results[0], [o.setting for o in outcomes])
    return replace(made, outcomes=tuple(outcomes), **more)  # type: ignore[arg-type]


def test_a_front_holds_what_nothing_beats_in_both() -> None:
    seconds = np.array([1.0, 2.0, 2.0, 3.0, 0.5, 4.0])
    errors = np.array([0.1, 0.01, 0.02, 0.5, math.nan, 0.001])
    assert front.pareto(seconds, errors).tolist() == [0, 1, 5]
    rng = np.random.default_rng(0)
    t, e = rng.random(60), rng.random(60)
    slow = [i for i in range(60) if not any((t[j] <= t[i]) & (e[j] <= e[i]) for j in range(60) if j != i)]
    assert sorted(front.pareto(t, e).tolist()) == slow


def test_the_time_to_an_error_is_that_of_a_setting_that_was_run() -> None:
    seconds = np.geomspace(0.01, 100, 9)
    errors = 0.05 * seconds**-0.5
    assert front.time_to(seconds, errors, 0.02) == seconds[6]
    assert front.time_to(seconds, errors, errors[6]) == seconds[6]
    assert (
        front.time_to(np.array([0.05, 0.2]), np.array([0.2, 1e-9]), 0.01) == 0.2
    )  # of two methods there is no between
    assert front.time_to(seconds, errors, 0.9) == seconds[0]
    assert math.isnan(front.time_to(seconds, errors, 1e-4))
    assert math.isnan(front.time_to(np.array([]), np.array([]), 0.1))


def test_scatter_falls_as_the_root_of_time_and_bias_stays() -> None:
    assert front.thermal_time_to(3.0, 0.1, 0.0, 0.02) == pytest.approx(300.0)
    assert front.thermal_time_to(3.0, 0.1, -0.01, 0.02) == pytest.approx(1200.0)
    assert front.thermal_time_to(3.0, 0.1, 0.03, 0.02) == math.inf


def test_a_thermal_time_is_never_below_that_of_a_run_that_was_made() -> None:
    noisy = study([outcome(5, 0.02, 0.001, -0.001), outcome(5, 0.3, 1e-4, -1e-4)], known=lambda s: 0.0)
    assert tables.times(noisy)[:2] == [0.02, 0.02]
    assert tables.times(noisy)[2] == pytest.approx(0.02 * 8)


def test_seconds_are_written_as_people_write_them() -> None:
    said = [tables._seconds(t) for t in (0.0004, 0.0997, 0.44, 334.9, 1892.0, math.nan)]
    assert said == ["0.4 ms", "100 ms", "0.44 s", "330 s", "32 min", "-"]


def test_a_fit_finds_the_exponent() -> None:
    x = np.array([0.1, 0.2, 0.4])
    assert front.power_law(x, 3 * x**4).order == pytest.approx(4.0)
    noisy = front.power_law(x, 3 * x**2 * np.array([1.0, 1.5, 1.0]), 3 * x**2 * np.array([0.01, 10.0, 0.01]))
    assert noisy.order == pytest.approx(2.0, abs=1e-3)  # the point in the middle weighs nothing
    assert math.isnan(front.power_law(x[:1], x[:1]).order)


def test_an_order_leaves_out_rounding() -> None:
    runs = [outcome(n, 1.0, n**-2.0 if n < 100 else 1e-13) for n in (10, 20, 40, 1000)]
    order = Order("segments", "segments", -2.0, lambda s: True, floor=1e-9)
    assert front.fitted(order, runs).order == pytest.approx(-2.0)
    assert front.fitted(replace(order, floor=0.0), runs).order < -3


def test_bias_and_scatter_are_told_apart() -> None:
    one = outcome(10, 1.0, *(0.1 + 0.02 * np.random.default_rng(1).standard_normal(4000)))
    assert one.bias == pytest.approx(0.1, abs=4 * one.bias_error)
    assert one.scatter == pytest.approx(0.02, rel=0.05)
    assert one.error == pytest.approx(math.hypot(0.1, 0.02), rel=0.01)
    assert math.isnan(outcome(10, 1.0, 0.3).scatter)


def test_the_cheapest_setting_is_recommended_and_a_default_only_if_it_is_as_cheap() -> None:
    coarse, mid, fine = outcome(10, 1.0, 0.1), outcome(20, 2.0, 0.01), outcome(40, 8.0, 0.002)
    made = study([coarse, mid, fine], stated=0.02)
    assert judgement.recommended(replace(made, default=fine.setting)) is mid
    assert judgement.recommended(replace(made, default=mid.setting)) is mid
    near = outcome(21, 2.2, 0.009)
    both = study([coarse, mid, near], stated=0.02, default=near.setting)
    assert judgement.recommended(both) is near
    assert (
        "4 times as fast: and the default is not recommended"
        in judgement.findings([replace(made, default=fine.setting)])[0]
    )
    assert "does not get there" in judgement.findings([replace(made, default=coarse.setting)])[0]
    assert [c.passed for c in judgement.checks([replace(made, default=coarse.setting)])] == [False, True, False]
    assert [c.passed for c in judgement.checks([replace(made, default=fine.setting)])] == [True, True, False]
    assert [c.passed for c in judgement.checks([both])] == [True, True, True]
    assert judgement.cheapest(study([coarse, mid])) is None
    assert judgement.findings([study([coarse, mid])]) == []


def test_a_default_that_did_not_run_fails() -> None:
    good = outcome(20, 2.0, 0.01)
    made = study([Outcome(Setting(10, 0.5), (), "refused"), good], stated=0.02, default=Setting(10, 0.5))
    assert [c.passed for c in judgement.checks([made])] == [False, True, False]
    noisy = replace(made, known=lambda s: 0.0)
    assert not judgement.checks([noisy])[0].passed


@pytest.mark.parametrize(("known", "passed"), [(0.01, True), (0.02, False), (0.0, False)])
def test_a_measured_bias_that_is_not_the_known_one_fails(known: float, passed: bool) -> None:
    seeds = 0.01 + 0.01 * (-1.0) ** np.arange(100)
    one = outcome(10, 1.0, *seeds)
    made = study([one], stated=0.05, default=one.setting, known=lambda s: known)
    assert [c.passed for c in judgement.checks([made]) if "bias of the default" in c.name] == [passed]


def test_platforms_and_forms_are_compared_at_a_setting_that_is_run_without_them() -> None:
    for made in (*strung.guitar_studies(quick=True), *loaded.weighted_studies(quick=True)):
        for s in made.settings:
            if s.segments > 45 and (s.platform != "Reference" or s.form != "arccosine"):
                assert replace(s, platform="Reference", precision="double", form="arccosine") in made.settings


def test_settings_are_equal_within_the_spread_of_their_runs_and_never_beyond_a_factor_of_two() -> None:
    def timed(segments: int, *seconds: float) -> Outcome:
        return Outcome(Setting(segments, 0.5), tuple(Result(t, np.array([1e-3])) for t in seconds))

    best, steady = timed(10, 1.0, 1.1, 1.2), timed(20, 1.6, 1.65, 1.7)
    wide, slow = timed(20, 1.2, 1.65, 1.7), timed(20, 1.0, 2.5, 9.0)
    for default, equal in ((steady, False), (wide, True), (slow, False)):
        made = study([best, default], stated=0.02, default=default.setting)
        assert judgement.cheapest(made) is best
        assert (judgement.recommended(made) is default) == equal
        assert judgement.checks([made])[-1].passed == equal


def test_a_scatter_of_few_seeds_tells_less() -> None:
    def scattered(segments: int, seconds: float, seeds: int) -> Outcome:
        return Outcome(Setting(segments, 0.5), (Result(seconds, 0.1 * (-1.0) ** np.arange(seeds)),))

    default = scattered(20, 1.5, 200)
    few, many = (
        study([scattered(10, 1.0, n), default], stated=0.02, default=default.setting, known=lambda s: 0.0)
        for n in (8, 200)
    )
    assert judgement.recommended(few) is default
    assert judgement.recommended(many) is not default


def test_a_wrong_order_fails() -> None:
    runs = [outcome(10, 1.0, step**1.5, step=step) for step in (0.1, 0.2, 0.4)]
    order = Order("Verlet, time step", "step", 2.0, lambda s: True)
    (check,) = judgement.checks([study(runs, orders=(order,))])
    assert check.value == pytest.approx(1.5)
    assert not check.passed


def test_runs_take_turns_and_what_cannot_run_is_kept_with_the_reason() -> None:
    seen: list[int] = []

    def measure(setting: Setting, seed: int) -> Result:
        seen.append(setting.segments)
        if setting.segments == 2:
            raise ValueError("too short")
        return Result(1.0, np.array([0.1]))

    made = Study("made", "up", "zero", measure, [Setting(1), Setting(2), Setting(3)])
    (first, second) = turns.measured([made, replace(made, question="again")], 2, 1, lambda fraction: None)
    assert seen == [1, 2, 3, 1, 2, 3, 1, 3, 1, 3]
    assert [len(o.results) for o in first.outcomes] == [2, 0, 2] == [len(o.results) for o in second.outcomes]
    assert first.outcomes[1].failure == "too short"


def test_no_round_begins_that_would_end_too_late() -> None:
    now = [0.0]

    def measure(setting: Setting, seed: int) -> Result:
        now[0] += setting.segments
        return Result(1.0, np.array([0.1]))

    made = Study("made", "up", "zero", measure, [Setting(2), Setting(3)], seconds=5.0)
    assert turns.expected([made, made], 3) == 30.0
    for seconds, rounds in ((19.9, 3), (20.0, 4), (1.0, turns.FEWEST), (math.inf, 6)):
        now[0], told = 0.0, []
        (one,) = turns.measured([made], 6, 1, told.append, seconds=seconds, clock=lambda: now[0])
        assert [len(o.results) for o in one.outcomes] == [rounds, rounds]
        assert told[1] == pytest.approx(1 / 6)


def test_growth_is_flat_or_not_and_platforms_cross() -> None:
    def row(beads: int, ns: float, platform: str = "Reference") -> timing.Row:
        return timing.Row("size", beads, platform, timing.WHOLE, 1, 1, ns, ns, ns, over_control=ns / 100)

    assert growth.flatness([row(10, 500), row(100, 100), row(1000, 110), row(10_000, 90)]) == pytest.approx(0.1)
    slow = [row(n, 100.0) for n in (10, 100, 1000)]
    fast = [row(n, 10_000 / n, "CPU") for n in (10, 100, 1000)]
    assert growth.crossover(slow, fast) == pytest.approx(100.0 / growth.CLEAR)
    assert math.isnan(growth.crossover(slow, [row(n, 200.0) for n in (10, 100, 1000)]))
    assert growth.crossover(slow, [row(n, 50.0) for n in (10, 100, 1000)]) == 10
    other = [row(n, ns, "OpenCL") for n, ns in ((100, 200.0), (1000, 50.0), (10_000, 200.0))]
    terms = [replace(row(1000, 100.0), kind="term", terms=name) for name in timing.TERMS]
    said = judgement.growth_findings(growth.Growth([*slow, row(10_000, 100.0), *other, *terms]))
    assert (
        "OpenCL is not faster than Reference at 10,000 beads, the most that it was run with, but is at 1,000." in said
    )
    crowded = [
        replace(row(1000, ns, "CPU"), kind="term", terms=t)
        for t, ns in ((timing.WHOLE, 300.0), (timing.CROWDED, 350.0))
    ]
    said = judgement.growth_findings(growth.Growth([*slow, *terms, *crowded]))
    assert "On the CPU platform with one thread 1000 beads take 3.00 of the time, and contact adds 17 % there." in said


def test_growth_passes_over_platforms_that_do_not_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(growth, "available", lambda: ["Reference", "missing"])
    assert growth._working() == ["Reference"]


def test_ctrl_c_while_processes_are_timed_ends_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(growth, "run_all", lambda function, tasks, workers, progress: [100.0, None])
    with pytest.raises(KeyboardInterrupt):
        growth._processes(2, 1)


def test_a_chain_is_timed_beside_its_control() -> None:
    made = timing.timed(30, "+ bending", "Reference", 3, kind="size")
    assert made.least <= made.ns_per_bead_step <= made.most
    assert math.isnan(made.over_control)
    twice = timing.timed(30, "+ bending", "Reference", 3, kind="size", control=lambda: made.least / 2e9)
    assert twice.over_control == pytest.approx(2 * twice.ns_per_bead_step / made.least)
    alike = timing.timed(timing.CONTROL, timing.WHOLE, "Reference", 5, kind="size", control=timing.controlled())
    assert 0.5 < alike.over_control < 2


def test_turns_of_a_measurement_become_one_row() -> None:
    turns = [
        timing.Row("size", 100, "CPU", timing.WHOLE, 2, 1, ns, ns - 1, ns + 1, build)
        for ns, build in ((300.0, 0.1), (500.0, 0.3), (320.0, 0.2))
    ]
    one = growth._together(turns)
    assert (one.ns_per_bead_step, one.least, one.most, one.build_seconds) == (320.0, 299.0, 501.0, 0.2)
    assert (one.platform, one.workers, one.beads) == ("CPU", 2, 100)


def test_lines_of_masses_converge_and_the_default_is_the_systems_own() -> None:
    lines, _ = masses.mass_spring_studies(quick=True)
    default = lines.default
    assert default is not None
    limit = default.step / mass_spring.PHASE
    assert limit == pytest.approx(1 / 1.4318419, rel=1e-6)  # 2/sqrt(2 q): springs twice as stiff as tension makes them
    steps = [Setting(9, step, name) for name in ("Verlet", "PEFRL") for step in (0.4, 0.2)]
    small = replace(lines, settings=steps)
    (small,) = turns.measured([small], 1, 1, lambda fraction: None)
    verlet, fourth = (next(o for o in lines.orders if name in o.name) for name in ("Verlet", "PEFRL"))
    assert front.fitted(verlet, small.outcomes).order == pytest.approx(2.0, abs=0.1)
    assert front.fitted(fourth, small.outcomes).order == pytest.approx(4.0, abs=0.1)


def test_noise_in_eulers_kick_widens_a_well_as_said() -> None:
    """200 beads on springs at r = 0.8 against the stationary state of the linear map, and that against `1/(1 - r^2)`."""
    stiffness, step, rate = 100.0, 0.8 * 2 / 10, 0.1
    system, spring = mm.System(), mm.CustomExternalForce(f"0.5*{stiffness}*(x^2+y^2+z^2)")
    for i in range(200):
        system.addParticle(1.0)
        spring.addParticle(i)
    system.addForce(spring)
    integrator = integrators.noisy_euler_cromer(300.0, rate, step, 1)
    context = mm.Context(system, integrator, mm.Platform.getPlatformByName("Reference"))
    context.setPositions(np.zeros((200, 3)))
    integrator.step(500)
    squares = []
    for _ in range(600):
        integrator.step(20)
        squares.append((context.getState(positions=True).getPositions(asNumpy=True)._value ** 2).mean())
    kt, kept = of.units.BOLTZMANN * 300, 1 - rate * step
    turn = np.array([[1 - step**2 * stiffness, step * kept], [-step * stiffness, kept]])
    kick = np.array([step, 1.0])
    exact = linalg.solve_discrete_lyapunov(turn, 2 * rate * step * kt * np.outer(kick, kick))[0, 0]
    assert np.mean(squares) == pytest.approx(exact, rel=0.02)
    assert exact * stiffness / kt == pytest.approx(1 / (1 - 0.64), rel=0.03)


def test_the_loaded_string_in_sines_is_the_limit_of_its_beads() -> None:
    segments = 600
    masses = weighted.CASES[1].masses(segments)[1:-1]
    stiffness = weighted.matrices(segments)
    squared = linalg.eigh(stiffness / np.sqrt(np.outer(masses, masses)), eigvals_only=True, subset_by_index=(0, 5))
    np.testing.assert_allclose(loaded.loaded_string(6), np.sqrt(squared) / (2 * np.pi), rtol=2e-3)
    assert loaded.loaded_string(1)[0] < float(strings.stiff_law(1))


def test_statics_come_to_the_exact_answer_with_their_residual() -> None:
    force, exact = statics._planar_exact()
    model = statics.chain.cold_model(statics.chain.YOUNG[-1], force)
    rest = model.to_physical(model.positions, "length").value_in_unit(unit.meter)
    (planar,) = statics.planar_studies(quick=True)
    stiff = planar.measure(Setting(30, method=statics.MINIMISER, effort=1e9), 1)  # it stops where it begins
    begun = float(rest[-1, 0] - rest[0, 0]) / statics.chain.CONTOUR
    assert stiff.deviations[0] == pytest.approx(begun / exact - 1)
    assert planar.default is not None
    found = planar.measure(planar.default, 1)
    assert abs(found.deviations[0]) < 1e-9
    assert found.residual < 1e-7
    loose = planar.measure(Setting(30, method=statics.MINIMISER, effort=1e-1), 1)
    assert abs(loose.deviations[0]) > 1e-4


def test_a_thermal_run_gives_a_deviation_a_replica() -> None:
    first, *_ = thermal.dna_studies(quick=True)
    assert first.default is not None
    assert first.known is not None
    setting = replace(first.default, effort=2.0)
    found = first.measure(setting, 5)
    assert len(found.deviations) > 10
    assert np.ptp(found.deviations) > 0
    again = first.measure(setting, 5)
    np.testing.assert_array_equal(found.deviations, again.deviations)
    assert abs(first.known(setting)) < 0.027


def test_the_error_of_a_correlation_is_relative(monkeypatch: pytest.MonkeyPatch) -> None:
    exact = thermal.helix.exact()[thermal.SEPARATION]
    monkeypatch.setattr(thermal, "run", lambda *_: (np.array([1.01 * exact]), 1.0))
    (made,) = thermal.helix_studies(quick=True)
    assert made.measure(made.settings[0], 1).deviations == pytest.approx([0.01])


def test_tables_and_figures_are_written(tmp_path: Path) -> None:
    runs = [outcome(n, n / 10, n**-2.0) for n in (10, 20, 40)]
    order = Order("segments", "segments", -2.0, lambda s: True)
    made = study(runs, orders=(order,), default=runs[2].setting, stated=1e-3)
    noisy = study([outcome(5, 1.0, 0.1, 0.2)], known=lambda s: 0.0)
    tables.write_runs(tmp_path / "runs.csv", [made, noisy])
    tables.write_table(tmp_path / "table.csv", [made, noisy])
    figures.draw_system(tmp_path / "made.png", [made, noisy])
    ax = Figure(layout="constrained").add_subplot()
    figures._front(ax, made)
    ax.figure.draw_without_rendering()
    legend = ax.get_legend()
    assert legend is not None
    assert not legend.get_window_extent().overlaps(ax.get_window_extent())  # it would hide points
    assert (tmp_path / "made.png").stat().st_size > 10_000
    effort = Order("scatter, length of the run", "effort", -0.5, lambda s: True)
    none = study([Outcome(Setting(5, effort=1.0), (), "refused")], orders=(effort,), known=lambda s: 0.0)
    figures.draw_system(tmp_path / "none.png", [none])
    rows = list(csv.DictReader((tmp_path / "runs.csv").read_text().splitlines()))
    assert [row["default"] for row in rows] == ["0", "0", "1", "0"]
    assert float(rows[1]["error"]) == pytest.approx(1 / 400)
    first, second = csv.DictReader((tmp_path / "table.csv").read_text().splitlines())
    assert float(first["seconds_to_0.01"]) == pytest.approx(1.0)
    assert float(second["seconds_to_0.1"]) == pytest.approx((2 * 0.1 / math.sqrt(2) / 0.1) ** 2)


def test_a_system_that_there_is_not_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["error_vs_runtime", "--output", str(tmp_path / "out"), "--only", "harp"]) == 2
    assert "`--only` must be one of mass_spring" in capsys.readouterr().err
    assert command.main(["error_vs_runtime", "--output", str(tmp_path / "out"), "--repeats", "0"]) == 2


@pytest.mark.slow
def test_the_quick_run_passes_and_writes_its_files(tmp_path: Path) -> None:
    """All systems; two of them where OPENMM_FILAMENT_SHORT is set."""
    folder = tmp_path / "out"
    systems = ["mass_spring", "dna_force_extension"] if os.environ.get("OPENMM_FILAMENT_SHORT") else []
    only = [word for name in systems for word in ("--only", name)]
    assert command.main(["error_vs_runtime", "--output", str(folder), "--quick", *only]) == 0
    names = {path.name for path in folder.iterdir()}
    assert {"runs.csv", "table.csv", "dna_force_extension.png", "summary.json"} <= names
    assert only or {"growth.csv", "growth.png"} <= names
    summary = json.loads((folder / "summary.json").read_text())
    assert all(check["passed"] for check in summary["checks"] if check["kind"] == "exact")
    assert summary["filament"]["recommended"]
