"""The bar under tension and as played: its exact answers by two routes, what is refused, and the system in its quick form."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
import tolerances as tol
from openmm import unit
from scipy import constants
from scipy.io import wavfile

import openmm_filament as of
from systems import __main__ as command
from systems import xylophone_bar as system
from systems.xylophone_bar import bar, judgement

DALTON = constants.physical_constants["atomic mass constant"][0]  # kg


def test_exact_lines_by_closed_forms_and_by_the_hessian() -> None:
    assert bar.modes(bar.tense(40), 10)[0] == pytest.approx(bar.discrete_tense(10, 40), rel=1e-9)
    assert bar.modes(bar.free(40), 10)[0] == pytest.approx(bar.discrete_free(10, 40), rel=1e-8)


def test_the_free_bar_weighs_what_it_should_and_the_beam_is_its_limit() -> None:
    """Half masses at the ends make the error of second order, whole ones of first."""
    kilograms = bar.free(20).filaments[0].masses.sum() / unit.dalton * DALTON
    assert kilograms == pytest.approx(bar.DENSITY * bar.LENGTH, rel=tol.CONSTANT)
    for ends, order in ((0.5, 2.0), (1.0, 1.0)):
        off = [1 - bar.discrete_free(1, n, ends=ends)[0] / bar.beam()[0] for n in (100, 200)]
        assert math.log2(off[0] / off[1]) == pytest.approx(order, abs=0.02)
    assert np.cos(bar.BETA_L) == pytest.approx(1 / np.cosh(bar.BETA_L), abs=1e-7)


def test_a_strike_leaves_the_free_bar_where_it_is() -> None:
    model = bar.free(30)
    velocities = bar.strike(model, 0.2, rise=0.1)
    z = model.filaments[0].rest.value_in_unit(unit.meter)[:, 2]
    scale = np.abs(model.masses * velocities).sum()
    assert abs(model.masses @ velocities) < 1e-13 * scale
    assert abs((model.masses * z) @ velocities) < 1e-13 * scale * bar.LENGTH


@pytest.mark.parametrize("kind", ["tense", "free"])
def test_simulated_lines_are_those_of_the_chain_and_of_no_other(kind: str) -> None:
    """The same lines held against one per cent more tension, or rigidity, miss by far more than the tolerance."""
    found = system.struck(kind, 30, step=system.COARSE_STEP)
    exact = bar.discrete_tense(5, 30) if kind == "tense" else bar.discrete_free(5, 30)
    assert np.abs(found.frequencies[:5] / exact - 1).max() < judgement.TOLERANCE
    wrong = bar.discrete_tense(5, 30, 1.01 * bar.TENSION) if kind == "tense" else math.sqrt(1.01) * exact
    assert np.abs(found.frequencies[:5] / wrong - 1).min() > 10 * judgement.TOLERANCE


def test_bad_input_is_refused_before_anything_runs() -> None:
    with pytest.raises(ValueError, match="tension.*negative|tension.*at least|tension"):
        bar.tense(20, -1.0)
    model = bar.free(20)
    with pytest.raises(ValueError, match="duration.*four periods"):
        bar.ring_out(model, bar.strike(model, 0.2, rise=0.1), 1e-3, 1e-5, lowest=1200.0)
    with pytest.raises(ValueError, match="timestep.*stability limit"):
        bar.ring_out(model, bar.strike(model, 0.2, rise=0.1), 1e-2, 1e-5, lowest=1200.0, step=10.0)
    with pytest.raises(ValueError, match="damping"):
        of.euler_cromer(bar.free(16, damping=1e6), timestep=0.9 * of.stable_timestep(bar.free(16)))


@pytest.mark.slow
def test_the_quick_run_passes_and_writes_its_files(tmp_path: Path) -> None:
    out = tmp_path / "bar"
    assert command.main(["xylophone_bar", "--output", str(out), "--quick"]) == 0
    written = json.loads((out / "summary.json").read_text())
    assert written["terms"] == [
        "CustomAngleForce",
        "CustomBondForce",
        "CustomCompoundBondForce",
    ]  # by arctangent: energy
    assert {check["kind"] for check in written["checks"]} == {"exact", "claim"}
    assert all(check["passed"] for check in written["checks"])
    assert all(line.endswith(".") for line in written["findings"])
    names = {file.name for file in out.iterdir()}
    assert {"lines.csv", "frequencies.png", "shapes.png", "spectrum.png", "convergence.png"} <= names
    assert {"topology.pdb", "trajectory.dcd", "trajectory.jsonl"} <= names
    assert ("animation.mp4" in names) == of.rendering.available()
    rate, samples = wavfile.read(out / "xylophone_bar.wav")
    assert (rate, samples.dtype, samples.ndim) == (44_100, np.int16, 1)
    assert len(samples) >= 2 * rate
    assert np.abs(samples.astype(int)).max() < 32767
    assert of.load(out / "trajectory.dcd").n_frames > 100
