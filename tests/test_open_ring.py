"""The open ring: its two shapes, its exact answers, and the whole system in its quick form."""

from __future__ import annotations

import io
import json
import math
from pathlib import Path

import numpy as np
import pytest
import tolerances as tol
from openmm import unit
from rich.console import Console

import openmm_filament as of
from systems import __main__ as command
from systems import stage
from systems.open_ring import judgement, static
from systems.open_ring.ring import BEADS, BENDING, SEGMENT, ring, swing, thesis_ring, turned
from systems.scene import Check, Summary


@pytest.mark.parametrize("gap", [True, False])
def test_the_two_shapes_have_13_beads_10_mm_apart_on_a_circle(gap: bool) -> None:
    body = thesis_ring(gap=gap)
    x = body.positions
    assert len(x) == BEADS
    assert np.linalg.norm(np.diff(x, axis=0), axis=1) == pytest.approx(SEGMENT, rel=tol.ROUNDING)
    assert np.ptp(np.linalg.norm(x, axis=1)) < tol.ROUNDING
    assert np.linalg.norm(x[0] - x[-1]) == pytest.approx(SEGMENT if gap else 0.0, abs=tol.ROUNDING)
    assert not body.filament.closed
    assert len(of.build(body.filament).system.getForces()) == 3


def test_statics_by_balance_and_by_the_hessian_agree_and_converge() -> None:
    """Two routes to the compliance of a chain, and its convergence to the closed form with the square of the segment."""
    off = {}
    for beads in (13, 25, 49):
        body = static.of_size(beads)
        by_hessian = static.from_hessian(body)
        for name in static.DIRECTIONS:
            by_balance = static.from_statics(body, name)
            assert by_hessian[name] == pytest.approx(by_balance, rel=1e-9)
            off[name, beads] = by_balance / static.cut_ring(name) - 1
    for name in static.DIRECTIONS:
        assert math.log2(off[name, 13] / off[name, 25]) == pytest.approx(2, abs=0.05)
        assert math.log2(off[name, 25] / off[name, 49]) == pytest.approx(2, abs=0.02)


def test_a_damped_run_comes_to_rest_where_statics_says() -> None:
    for name in static.DIRECTIONS:
        assert static.relaxed(13, name) == pytest.approx(static.from_statics(static.of_size(13), name), rel=1e-5)


def test_a_wrong_stiffness_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a bending rigidity off by one per cent in the exact answers the checks of the deflections fail."""
    runs = {name: {n: static.relaxed(n, name) for n in (13, 19, 25)} for name in static.DIRECTIONS}
    sizes = (13, judgement.HESSIAN_SIZE)
    hess = {name: {n: static.from_hessian(static.of_size(n))[name] for n in sizes} for name in static.DIRECTIONS}

    def failed() -> set[str]:
        closed = {name: {n: static.from_statics(static.of_size(n), name) for n in sizes} for name in static.DIRECTIONS}
        return {check.name.split()[0] for check in judgement.static_checks(closed, hess, runs) if not check.passed}

    assert failed() == set()
    monkeypatch.setattr(static, "BENDING", 1.01 * BENDING)
    assert failed() == {"tangential", "radial"}


def test_in_the_plane_there_is_no_torsion_and_energy_is_the_work_done() -> None:
    body = thesis_ring(gap=True)
    run = swing(body, 2.0, 0.0, duration=1e-3, samples=40)
    general = swing(turned(body), 2.0, 0.0, duration=1e-3, samples=40)
    assert 0.0 < general.peak_share("torsion") < judgement.rounding(general)
    assert general.peak == pytest.approx(run.peak, rel=1e-8)
    assert run.imbalance < judgement.BALANCE
    force = 2.0 * body.opening
    parted = (run.positions[-1, 0] - run.positions[-1, -1]) - (run.positions[0, 0] - run.positions[0, -1])
    assert run.energies["work"][-1] == pytest.approx(float(force @ parted), rel=1e-9)


def test_a_force_out_of_the_plane_by_1e_7_is_more_torsion_than_rounding() -> None:
    run = swing(thesis_ring(gap=True), 2.0, 1e-7, duration=1e-3, samples=40)
    assert run.peak_share("torsion") > judgement.rounding(run)


def test_normal_forces_turn_a_ring_with_a_gap_and_only_that_one() -> None:
    turned = {gap: swing(thesis_ring(gap=gap), 2.0, math.pi / 2, samples=50, step=0.2) for gap in (True, False)}
    assert turned[True].share("bending") > 0.1
    assert turned[False].share("bending") < 1e-3


def test_a_small_load_moves_the_ends_as_the_normal_modes_say() -> None:
    body = thesis_ring(gap=False)
    checks = judgement.linear_checks(body, 1e-4)
    assert all(check.passed for check in checks)
    times = np.linspace(0, 1e-3, 20)
    force = 1e-4 * body.opening
    still = static.modal_opening(body, force, np.zeros(1))
    assert np.abs(still).max() == 0.0
    average = static.modal_opening(body, force, np.linspace(0, 1, 20_000)).mean(axis=0) @ body.opening
    assert average / 1e-4 == pytest.approx(static.from_statics(body, "tangential"), rel=0.02)
    assert static.modal_opening(body, 2 * force, times) == pytest.approx(2 * static.modal_opening(body, force, times))


def test_the_closing_list_puts_failures_first_and_keeps_brackets(tmp_path: Path) -> None:
    checks = [
        Check("fine [1/s]", "exact", 1.0, 1.0, 0.0, 0.1),
        Check("said", "claim", 1.0, 2.0, 1.0, 0.1),
        Check("wrong", "exact", 1.0, 2.0, 1.0, 0.1),
    ]
    console = Console(file=io.StringIO(), width=200)
    summary = Summary("none", [], "Reference", 0.0, {}, checks, [stage.NO_PICTURES])
    assert stage.close(tmp_path, summary, console) == 1
    assert isinstance(console.file, io.StringIO)
    lines = console.file.getvalue().splitlines()
    starts = [
        "FAILED wrong:",
        "differs from the thesis said:",
        "passed fine [1/s]:",
        "1 FAILED, 1 checks passed, 1 of the ",
    ]
    assert [line.startswith(start) for line, start in zip(lines, starts, strict=False)] == [True] * 4
    assert "openmm-filament[render]" in lines[4]


def test_too_long_a_step_is_refused() -> None:
    with pytest.raises(ValueError, match="timestep.*stability limit"):
        swing(ring(BEADS, SEGMENT, gap=True), 1.0, 0.0, step=3.0)


def test_the_quick_run_passes_and_writes_its_files(tmp_path: Path) -> None:
    out = tmp_path / "ring"
    assert command.main(["open_ring", "--output", str(out), "--quick"]) == 0
    written = json.loads((out / "summary.json").read_text())
    assert written["terms"] == ["CustomAngleForce", "CustomBondForce", "CustomExternalForce", "CustomTorsionForce"]
    kinds = {check["kind"] for check in written["checks"]}
    assert kinds == {"exact", "claim"}
    assert {check["name"].split(",")[0] for check in written["checks"] if not check["passed"]} == {
        "claim: torsion only at pi/2 (bending",
        "claim: torsion peaks above bending at pi/4",
    }
    assert all(line.endswith(".") for line in written["findings"])
    names = {file.name for file in out.iterdir()}
    assert {"energies.csv", "deflections.csv", "energies.png", "paths.png", "deflections.png", "balance.png"} <= names
    loaded = of.load(out / "trajectory.dcd")
    assert loaded.n_frames > 50
    assert loaded.time[-1] == pytest.approx((5 * unit.millisecond).value_in_unit(unit.picosecond), rel=1e-6)
    assert {"topology.pdb", "trajectory.dcd", "trajectory.jsonl"} <= names
    assert ("animation.mp4" in names) == of.rendering.available()
