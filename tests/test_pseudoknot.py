"""The system pseudoknot: its motions, one knot made and pulled apart, its judgement, and broken copies that it tells."""

from __future__ import annotations

import itertools
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from openmm import unit
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

import openmm_filament as of
import systems.pseudoknot as system
from systems import __main__ as command
from systems.pseudoknot import figures, findings, hands, judgement, plan, rows, runs
from systems.pseudoknot.chains import Wire
from systems.pseudoknot.poses import Pose, drawn
from systems.pseudoknot.runs import Result, run
from systems.pseudoknot.ways import Way, smooth

# Shapes and motions ---------------------------------------------------------------------------------------------------


def test_a_pose_is_a_turn_then_tilts_then_a_shift() -> None:
    shape = Wire().shape()
    pose = Pose(0.7, (1e-3, -2e-3), (0.1, -0.2))
    turned = Rotation.from_euler("zxy", [0.7, 0.1, -0.2]).apply(shape)  # about fixed axes, z first
    np.testing.assert_allclose(pose.placed(shape), turned + np.array([1e-3, -2e-3, 0.0]), atol=1e-18)


@pytest.mark.parametrize("angle", [0.0, 0.5, math.pi / 2])
def test_axes_cross_at_the_angle_where_the_two_coils_have_most_in_common(angle: float) -> None:
    case = plan.Case("", "", crossing=angle)
    drawn_task = plan.task(case, 1.0, drawn(12, 2, shift=1e-3, tilt=0.1), 1)
    pose = plan.task(case, 1.0, (Pose(),), 1).poses[0]
    axis = np.outer(np.linspace(0, plan.BASE.height, 11), [0, 0, 1.0])
    placed = pose.placed(axis)
    along = (placed[-1] - placed[0]) / plan.BASE.height
    assert along @ [0, 0, 1] == pytest.approx(math.cos(angle))
    upper_end = np.array(drawn_task.place) + drawn_task.making.along  # foot of the upper chain, screwed in
    shared = upper_end[2] + plan.OVERLAP * plan.BASE.pitch / 2
    np.testing.assert_allclose(
        placed[0] + along * (plan.BASE.height - plan.OVERLAP * plan.BASE.pitch / 2), [0, 0, shared], atol=1e-15
    )
    for pair in drawn_task.start()[:-1]:  # nothing touches before the hand moves
        below, above = np.split(pair, 2)
        assert np.linalg.norm(below[:, None] - above[None], axis=-1).min() > plan.BASE.thickness


def test_drawn_poses_fill_their_discs_and_repeat_with_the_seed() -> None:
    poses = drawn(400, 3, shift=2e-3, tilt=0.1)
    sizes = np.linalg.norm([pose.shift for pose in poses], axis=1)
    assert sizes.max() <= 2e-3
    assert np.mean(sizes**2) == pytest.approx(2e-6, rel=0.1)  # of a disc: half the square of its radius
    assert poses == drawn(400, 3, shift=2e-3, tilt=0.1)
    assert poses[:5] == drawn(5, 3, shift=2e-3, tilt=0.1)


@pytest.mark.parametrize("hand", [1, -1])
def test_screwing_moves_a_helix_along_itself(hand: int) -> None:
    wire = replace(plan.BASE, hand=hand)
    way = plan.task(plan.Case("", "", wire, wire), 1.0, (), 1).making
    shape = wire.shape()
    for part in (0.3, 1.0):
        x, y, z = (shape + way.displacements(shape, part)).T
        angle = 2 * math.pi * z / wire.pitch  # of the endless helix at that height
        np.testing.assert_allclose(x, wire.radius * np.cos(angle), atol=1e-15)
        np.testing.assert_allclose(y, hand * wire.radius * np.sin(angle), atol=1e-15)


def test_the_hand_starts_and_stops_softly_and_goes_the_whole_way() -> None:
    times = np.linspace(0, 1, 2001)
    parts = np.array([smooth(float(t)) for t in times])
    speeds = np.diff(parts) * 2000
    assert (parts[0], parts[-1], smooth(0.5)) == (0.0, 1.0, pytest.approx(0.5))
    assert speeds.min() > 0
    assert max(speeds[0], speeds[-1]) < 0.01
    assert speeds.max() == pytest.approx(1 / 0.85)
    assert np.abs(np.diff(speeds)).max() < 0.01  # no jump of the speed


def test_an_ideal_knot_links_once_a_turn_and_a_mirrored_one_the_other_way_round() -> None:
    assert plan.linked(plan.BASE) == pytest.approx(plan.OVERLAP, abs=0.15)
    longer = replace(plan.BASE, turns=2 * plan.BASE.turns)
    assert abs(plan.linked(longer) - plan.OVERLAP) < 0.15
    shape = plan.BASE.shape()
    other = Pose(math.pi).placed(shape)
    mirror = np.array([1.0, -1.0, 1.0])
    assert of.analysis.linking(shape * mirror, other * mirror) == pytest.approx(-of.analysis.linking(shape, other))


# One knot -------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def knot() -> Result:
    """One pair and one out of reach, at a fast speed."""
    case = plan.Case("two helices", "main", rest=0.3)
    return run([plan.task(case, 2.0, (Pose(phase=4.0),), 5, film=True)])[0]


def test_a_knot_is_made_holds_and_comes_apart(knot: Result) -> None:
    (row,) = rows.rows_of(plan.Case("two helices", "main"), 2.5, knot)
    assert row.formed
    assert row.link_made == pytest.approx(plan.linked(plan.BASE), abs=0.4)
    assert 0 < row.freed_at < 1
    assert abs(row.link_broken) < rows.FREE
    assert row.net_breaking > 3 * abs(row.net_making)
    assert row.holding > 0
    assert row.largest_jump < judgement.PASSED
    assert row.nearest > 0.9


def test_its_energies_balance(knot: Result) -> None:
    assert abs(knot.making.misfit) < runs.CLOSES
    assert abs(knot.breaking.misfit) < runs.CLOSES


def test_left_alone_it_comes_to_the_temperature(knot: Result) -> None:
    moving = len(knot.task.poses) * np.count_nonzero(knot.task.masses())
    late = knot.resting.kinetic[len(knot.resting.times) // 2 :]
    assert late.mean() == pytest.approx(1.5 * moving * knot.task.warmth, rel=0.2)  # a single one has an error of 8 %


def test_friction_that_is_forgotten_breaks_the_balance(knot: Result) -> None:
    for phase in (knot.making, knot.breaking):
        assert abs(replace(phase, whole_lost=0.7 * phase.whole_lost).misfit) > runs.CLOSES


def test_the_work_is_that_of_the_recorded_force(knot: Result) -> None:
    phase, way = knot.breaking, knot.task.breaking
    path = np.outer(phase.parts, way.along)
    summed = np.einsum("knc,kc->n", phase.force[1:], np.diff(path, axis=0))  # one in eight of the forces that did it
    np.testing.assert_allclose(summed, phase.work[-1], rtol=0.02, atol=5e-3 * plan.BASE.energy)


def test_the_linking_integral_is_that_of_the_film(knot: Result) -> None:
    first = knot.task.lower.segments + 1
    frames = knot.making.frames[::20]
    found = of.analysis.linking(frames[:, :first], frames[:, first:])
    np.testing.assert_allclose(found, knot.making.link[::20, 0], atol=1e-12)


def test_tasks_in_one_context_do_what_each_does_alone() -> None:
    alone = [
        plan.task(plan.Case("a", "way", held=True, rest=0.05, breaking="side"), 0.5, (), 1),
        plan.task(plan.Case("b", "way", making="push", held=True, rest=0.05, breaking="side"), 0.5, (), 2),
    ]  # a chain each, out of reach of its lower one: nothing to be chaotic about
    for separate, together in zip([run([task])[0] for task in alone], run(alone), strict=True):
        for name in ("making", "resting", "breaking"):
            one, other = getattr(separate, name), getattr(together, name)
            np.testing.assert_allclose(other.work[-1], one.work[-1], rtol=1e-6)
            np.testing.assert_allclose(other.lost[-1], one.lost[-1], rtol=1e-6)
    assert separate.making.work[-1] != pytest.approx(run([alone[0]])[0].making.work[-1], rel=0.01)  # ways differ
    longer = plan.task(plan.Case("c", "way", held=True), 0.4, (), 1)
    with pytest.raises(ValueError, match="`tasks` must share times, damping, warmth"):
        run([alone[0], longer])


def test_energies_that_do_not_balance_take_half_the_time_step(knot: Result, monkeypatch: pytest.MonkeyPatch) -> None:
    limits: list[float] = []
    good, bad = (replace(knot, making=replace(knot.making, whole_lost=f * knot.making.whole_lost)) for f in (1.0, 0.7))

    def attempt(tasks: Any, limit: float) -> list[Result]:
        limits.append(limit)
        return [bad if len(limits) < 2 else good]

    monkeypatch.setattr(runs, "_attempt", attempt)
    assert run([knot.task]) == [good]
    assert limits[1] == limits[0] / 2
    monkeypatch.setattr(runs, "_attempt", lambda tasks, limit: [bad])
    assert run([knot.task]) == [bad]  # which the check of the balance then tells


def test_each_task_is_in_one_crew_whose_tasks_share_what_they_must() -> None:
    planned = [task for _, _, task in plan.tasks(plan.cases(quick=False), 1)]
    crews = plan.crews(planned)
    assert sorted(i for crew in crews for i in crew) == list(range(len(planned)))
    for crew in crews:
        assert len({planned[i].shared for i in crew}) == 1
        assert sum(len(planned[i].poses) for i in crew) <= 60
        pairs = [pair for each in hands.placed([planned[i] for i in crew]) for pair in each]
        apart = min(cdist(one, other).min() for one, other in itertools.combinations(pairs, 2))
        assert apart > 10 * plan.BASE.thickness  # none lies in the way of another
    assert len(crews) < len(planned) / 2


def test_the_stiffest_mode_is_reckoned_as_the_hessian_has_it() -> None:
    limits, reckoned = [], []
    for case in plan.cases(quick=False):
        if case.lower == case.upper and case.lower.hand and not case.held:
            task = plan.task(case, 1.0, (), 1)
            model = hands.model_of([task], [task.start()])
            limits.append(sum(task.times) / of.stable_timestep(model).value_in_unit(unit.second))
            reckoned.append(plan.steps(task))
    ratio = np.array(limits) / np.array(reckoned)
    np.testing.assert_allclose(ratio / np.median(ratio), 1.0, atol=0.25)


def test_a_holding_force_is_that_without_ringing() -> None:
    times = np.linspace(0, 1.0, 2001)
    pull = 3.0 * np.sin(np.pi * times)
    ringing = 2.0 * np.sin(2 * np.pi * times / 0.02)
    assert rows.steadily(pull + ringing, times, 1.0) == pytest.approx(3.0, rel=0.01)
    assert rows.steadily(np.array([1.0, 2.0]), times[:2], 1.0) == 1.5


def test_a_chain_that_flies_off_to_nan_is_one_that_comes_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    task = plan.task(plan.cases(quick=True)[0], 0.8, (Pose(),), 1)
    look = hands.World.look

    def flown(world: hands.World) -> Any:
        x = world.context.getState(positions=True).getPositions(asNumpy=True)._value
        world.context.setVelocities(np.full(x.shape, np.nan))
        return look(world)

    monkeypatch.setattr(hands.World, "look", flown)
    with pytest.raises(RuntimeError, match="comes apart with 0.5 of the stable time step"):
        runs.made(task, 0.5)
    assert runs.attempt((task,)) == [
        "two helices: A chain of 'two helices' comes apart with 0.1 of the stable time step."
    ]


# Judgement ------------------------------------------------------------------------------------------------------------


def row(**changes: Any) -> rows.Row:
    """A pair of the main ensemble, 1 uJ to make and 100 uJ to break."""
    given = dict.fromkeys(rows.Row.__dataclass_fields__, 0.0)
    given |= {
        "label": "two helices",
        "group": "main",
        "start": 0,
        "slowness": 1.0,
        "made": True,
        "formed": True,
        "nearest": 1.0,
    }
    given |= {"making_speed": 1.0, "breaking_speed": 1.0, "link_made": 1.5, "link_kept": 1.5, "freed_at": 0.5}
    works = {"work_making": 1e-6, "net_making": 1e-6, "work_breaking": 1e-4, "net_breaking": 1e-4, "holding": 2.0}
    return rows.Row(**(given | works | changes))


def ensemble(intercepts: list[float], slope: float) -> list[rows.Row]:
    return [
        row(start=i, slowness=1 / v, making_speed=v, breaking_speed=v, work_making=a + slope * v, net_making=a)
        for v in (1.0, 2.0, 4.0)
        for i, a in enumerate(intercepts)
    ]


def test_a_slow_limit_is_the_mean_intercept_with_its_error() -> None:
    found = judgement.slow(ensemble([1e-6, 2e-6, 4e-6, 5e-6], 3e-6), "work_making", "making_speed")
    assert found.mean == pytest.approx(3e-6)
    assert found.error == pytest.approx(np.std([1e-6, 2e-6, 4e-6, 5e-6], ddof=1) / 2)
    assert found.slope == pytest.approx(3e-6)


def test_starts_that_once_did_not_form_are_left_out() -> None:
    main = ensemble([1e-6, 2e-6, 9e-6], 0.0)
    main[2] = replace(main[2], formed=False)
    assert judgement.slow(main, "work_making", "making_speed").mean == pytest.approx(1.5e-6)
    with pytest.raises(ValueError, match=r"needs two speeds and two starts, but there are 3 and 1"):
        judgement.slow([r for r in main if r.start != 1], "work_making", "making_speed")


def test_the_ratio_and_its_claim() -> None:
    making = np.linspace(0.8e-6, 1.2e-6, 16)
    found = judgement.outcome(ensemble(making.tolist(), 1e-6))
    assert found.ratio[0] == pytest.approx(100)
    assert found.ratio[1] == pytest.approx(100 * making.std() / 1e-6 / 4, rel=0.1)


def test_a_table_counts_what_formed_and_averages_over_it() -> None:
    case = plan.Case("two helices", "main", slowness=(1.0,))
    given = [
        row(start=0),
        row(start=1, net_breaking=3e-4, freed_at=math.nan),
        row(start=2, formed=False, net_making=9.0),
    ]
    (line,) = judgement.settings(given, [case])
    assert (line.starts, line.formed, line.freed) == (3, 2, 1)
    assert line.probability == pytest.approx(2 / 3)
    assert line.making == pytest.approx(1e-6)
    assert (line.breaking, line.breaking_error) == (pytest.approx(2e-4), pytest.approx(1e-4))
    assert line.ratio == pytest.approx(200)
    (none,) = judgement.settings([row(formed=False)], [case])
    assert (none.probability, none.making) == (0, pytest.approx(1e-6))
    assert math.isnan(none.breaking)
    assert math.isnan(none.ratio)


def test_broken_copies_fail_the_exact_checks(knot: Result) -> None:
    case = plan.Case("two helices", "main")
    main = ensemble([1e-6, 1.2e-6], 1e-6)
    twins = [row(label="unscrewed", group="way"), row(label="E", group="E_GPa", value=10.0, work_making=1e-5)]

    def failed(results: list[Any], given: list[rows.Row]) -> list[str]:
        found = judgement.checks(results, given, judgement.outcome(main))
        return [check.name.split(":")[0] for check in found if check.kind == "exact" and not check.passed]

    good = [(case, 1.0, knot)]
    assert failed(good, main + twins) == []
    forgotten = replace(knot, making=replace(knot.making, whole_lost=0.9 * knot.making.whole_lost))
    assert failed([(case, 1.0, forgotten)], main) == ["energy"]
    through = "no chain passed through another"
    assert failed(good, [*main, row(largest_jump=0.9)]) == [through]
    assert failed(good, [*main, row(nearest=0.5)]) == [through]
    scaled = replace(twins[1], work_making=1.02e-5)
    assert failed(good, [*main, twins[0], scaled]) == ["E and G ten times larger"]


def test_without_slow_limits_what_is_exact_is_still_checked(knot: Result, tmp_path: Path) -> None:
    case = plan.Case("two helices", "main")
    good, apart = [(case, 1.0, knot)], [row(made=False, formed=False)]

    def judged(results: list[Any], given: list[rows.Row], failed: int) -> list[str]:
        film_less = [(c, s, replace(r, task=replace(r.task, film=False))) for c, s, r in results]
        _, found = system._judged(tmp_path, film_less, given, [], failed=failed, interrupted=False, frames=2)
        return [check.name for check in found if check.kind == "exact" and not check.passed]

    assert judged(good, apart, 0) == []
    (through,) = judged(good, [*apart, row(largest_jump=0.9)], 0)
    assert through.startswith("no chain passed")
    assert judged(good, apart, 2) == judged([], [], 2) == ["settings that could not be run"]


@pytest.mark.parametrize("formed", [0, 1, 4, 5])
def test_bounds_of_a_probability_are_where_it_is_one_deviation_off(formed: int) -> None:
    given = [row(start=i, formed=i < formed) for i in range(5)]
    (line,) = judgement.settings(given, [plan.Case("two helices", "main", slowness=(1.0,))])
    assert 0 <= line.probability_low <= line.probability <= line.probability_high <= 1
    for bound in (line.probability_low, line.probability_high):
        assert (line.probability - bound) ** 2 == pytest.approx(bound * (1 - bound) / 5, abs=1e-12)


def test_findings_on_what_was_varied_give_errors_and_no_nan() -> None:
    given = [row(start=0, label="E", group="E_GPa"), row(start=1, label="E", group="E_GPa", net_making=3e-6)]
    given += [row(start=i, label="F", group="E_GPa", formed=False) for i in range(2)]
    cases = [plan.Case(name, "E_GPa", value=i, slowness=(1.0,)) for i, name in enumerate("EF")]
    (text,) = findings._varied(judgement.settings(given, cases))
    mean, error = 2e-6 / plan.BASE.energy, 1e-6 / plan.BASE.energy
    assert f"over {mean:.2g} +- {error:.1g} E I/R; 1: 0/2 form" in text
    assert "nan" not in text


@pytest.mark.parametrize(
    ("making", "of_a_rod", "special"), [(1e-6, 1e-6, True), (1e-6, 1e-4, False), (5e-5, 1e-6, False)]
)
def test_what_makes_helices_special_is_said_only_where_it_shows(making: float, of_a_rod: float, special: bool) -> None:
    rod = plan.Case("rod in a helix", "control", slowness=(1.0,))
    knot = plan.Case("two helices", "main", slowness=(1.0,))
    given = [row(net_making=making, net_breaking=1e-4), row(label=rod.label, group=rod.group, net_breaking=of_a_rod)]
    control, main = judgement.settings(given, [rod, knot])
    text = findings._special({control.label: control}, main)
    assert ("What makes helices special: a helix" in text) == special
    assert ("do not show" in text) != special


@pytest.mark.parametrize(("pushed", "head"), [(1e-6, "Without turning no way in"), (9e-5, "There are ways in")])
def test_ways_in_are_told_by_what_they_hold(pushed: float, head: str) -> None:
    names = {"pushed without turning": pushed, "screwed in, pulled out": 1e-4}
    cases = [plan.Case(name, "way", slowness=(1.0,)) for name in names]
    given = [row(label=name, group="way", net_breaking=work) for name, work in names.items()]
    (text,) = findings._ways({line.label: line for line in judgement.settings(given, cases)})
    assert text.startswith(head)


def test_all_that_is_varied_has_a_panel_in_the_figure() -> None:
    assert {case.group for case in plan.cases(quick=False) if not math.isnan(case.value)} == set(figures._NAMES)


def test_friction_that_bends_a_slow_limit_is_no_part_of_the_ratio() -> None:
    bent = [replace(r, work_making=r.net_making + 1e-7 * r.making_speed**1.5) for r in ensemble([1e-6, 1.1e-6], 0.0)]
    found = judgement.outcome(bent)
    assert found.making.mean < 0.9 * found.net_making.mean
    assert judgement._thesis(found).value == pytest.approx(found.net_breaking.mean / 1.05e-6)
    off = 1e6 * (found.making.mean - 1.05e-6)
    assert f"comes out as {off:.3g} uJ" in findings._whole(found)


@pytest.mark.parametrize("making", [[1e-6, 1e-6], [-1e-6, 3e-6]])
def test_a_work_of_breaking_below_zero_is_no_ratio(making: list[float]) -> None:
    pulled = [replace(r, net_breaking=-1e-6 * (1 + r.start)) for r in ensemble(making, 0.0)]
    assert not judgement._thesis(judgement.outcome(pulled)).passed


def test_of_a_work_that_is_not_resolved_the_ratio_has_a_bound(tmp_path: Path) -> None:
    slowest = judgement.settings([row()], [plan.Case("two helices", "main", slowness=(1.0,))])[-1]
    found = judgement.outcome(ensemble([-1e-6, 3e-6], 1e-6))  # 1 +- 2 uJ; breaking is the slow limit of 100 uJ
    bound = found.breaking.mean / 5e-6
    text = findings._ratio(found, slowest)
    assert f"at least {bound:.0f} " in text
    assert "times as much" not in text
    check = judgement._thesis(found)
    assert check.value == pytest.approx(bound)
    assert check.passed == (bound < 200)
    assert "100 +- 0 times as much" in findings._ratio(judgement.outcome(ensemble([1e-6, 1e-6], 1e-6)), slowest)
    below = judgement.outcome(ensemble([-5e-6, -6e-6], 1e-6))
    assert "tell no ratio" in findings._ratio(below, slowest)
    assert not judgement._thesis(below).passed
    for i, drawn_of in enumerate((found, below)):
        figures.summary(tmp_path / f"{i}.png", [slowest], drawn_of)
        assert (tmp_path / f"{i}.png").stat().st_size > 10_000


# The whole ------------------------------------------------------------------------------------------------------------


def test_a_rod_has_no_torsion_and_a_way_its_length() -> None:
    rod = replace(plan.BASE, hand=0)
    terms = {type(term).__module__.split(".")[-1] for term in rod.filament(rod.shape()).terms}
    assert terms == {"stretching", "bending", "contact"}
    assert rod.contour == pytest.approx(plan.BASE.contour)
    assert Way("", (0.0, 0.0, 3.0), 2.0).length(4 / (4 * math.pi)) == pytest.approx(5.0)


@pytest.mark.slow
def test_the_quick_run_passes_and_writes_its_files(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    assert command.main(["pseudoknot", "--output", str(folder), "--quick"]) == 0
    names = {path.name for path in folder.iterdir()}
    assert {"summary.json", "pseudoknot.csv", "parameters.csv", "trajectory.dcd", "topology.pdb"} <= names
    assert {"pseudoknot.png", "energy.png", "making_and_breaking.png"} <= names  # parameters.png needs the sweeps
    assert ("still.png" in names) == of.rendering.available()
    summary = json.loads((folder / "summary.json").read_text())
    assert all(check["passed"] for check in summary["checks"] if check["kind"] == "exact")
    assert "CustomNonbondedForce" in summary["terms"]
    frames = of.load(folder / "trajectory.dcd")
    assert frames.n_chains == 2
    assert 20 < len(frames) <= 30
