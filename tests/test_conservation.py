"""The energy of small motion: kept where bending is by arctangent, lost where it is not, and a slope that is seen."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import openmm as mm
import pytest
from openmm import unit

import openmm_filament as of
from systems import conservation, stage, strings
from systems.guitar_string import steady
from systems.scene import Check, Summary
from systems.strings import Pluck
from systems.weighted_string import chain, remainder
from systems.xylophone_bar import energy


def test_a_line_through_noise_has_its_slope_and_error(rng: np.random.Generator) -> None:
    steps = np.arange(2000) * 100.0
    energies = 5.0 * (1 + 3e-6 * steps / 1e6 + 1e-7 * rng.normal(size=2000))
    found = conservation.through(energies, 100)
    assert abs(found.slope - 3e-6) < 4 * found.error
    assert found.error < 1e-6
    assert found.length == 200_000


def test_a_slope_and_an_uncertain_one_both_fail() -> None:
    steps = np.arange(2000) * 100.0
    steep = conservation.through(1 + 3e-6 * steps / 1e6, 100)
    assert not conservation.check_drift(steep).passed
    noisy = conservation.through(1 + 1e-5 * np.random.default_rng(0).normal(size=2000), 100)
    assert noisy.error > conservation.SLOPE
    assert not conservation.check_drift(noisy).passed
    assert conservation.check_drift(conservation.through(1 + 1e-7 * steps / 1e6, 100)).passed


def test_the_energy_of_a_gentle_pluck_stays_by_arctangent() -> None:
    kept, bend, _ = steady.plucked([Pluck(12, 0.01)], 50, 50_000, form="arctangent")
    default, *_ = steady.plucked([Pluck(12, 0.01)], 50, 50_000)
    assert conservation.check_drift(kept).passed
    assert default.error > 10 * kept.error
    assert 1e-6 < bend < 1e-3


def test_a_free_bar_at_small_bends_keeps_its_energy_by_arctangent_alone() -> None:
    kept, bend, _ = energy.kept(16, 50_000, 0.03, "arctangent")
    default, *_ = energy.kept(16, 50_000, 0.03, "arccosine")
    assert conservation.check_drift(kept).passed
    assert default.slope < -1e-5
    assert abs(default.slope) > 4 * default.error
    assert bend < 1e-3


def test_exact_modes_take_all_lines_out_of_a_sound_and_wrong_ones_do_not() -> None:
    case = chain.CASES[1]
    sound, modes = chain.sounding(case, 30, 1.02, 6_000, 8, weaker=1.0, form="arccosine")
    assert remainder.remainder("b", sound, 6_000, modes).largest < 0.1 * remainder.LEFT
    tighter = chain.exact(case, 30, 1 / 48_000, 1.01 * strings.TENSION)
    assert remainder.remainder("b", sound, 6_000, tighter).largest > 0.1
    tone = sound + 0.01 * sound.std() * np.sin(2 * np.pi * 480 * np.arange(len(sound)) / 6_000)
    assert remainder.remainder("b", tone, 6_000, modes).between > remainder.LEFT


def test_units_stand_in_the_summary_where_there_are_some(tmp_path: Path) -> None:
    checks = [Check("line", "exact", 1.0, 1.0, 0.0, 0.1, "Hz"), Check("ratio", "exact", 1.0, 1.0, 0.0, 0.1)]
    Summary("x", (), "Reference", 0.0, {}, checks).write(tmp_path)
    first, second = json.loads((tmp_path / "summary.json").read_text())["checks"]
    assert first["name"] == "line (Hz)"
    assert second["name"] == "ratio"


def test_the_fast_steps_are_those_of_euler_cromer() -> None:
    """`stage.alike` in forces `1 - gamma dt/2` as large: positions differ from Euler-Cromer's by that alone."""
    ends = []
    for fast in (True, False):
        model = strings.string(12, [Pluck(4, 0.01)], damping=strings.DAMPING)
        dt = 1e-5
        integrator = (
            stage.alike(model, dt, strings.DAMPING) if fast else of.euler_cromer(model, timestep=dt * unit.second)
        )
        context = mm.Context(model.system, integrator, mm.Platform.getPlatformByName("Reference"))
        context.setPositions(model.positions)
        integrator.step(300)
        ends.append(context.getState(positions=True).getPositions(asNumpy=True)._value[:, 0])
    assert ends[0] == pytest.approx(ends[1], rel=1e-3, abs=1e-3 * np.abs(ends[1]).max())
