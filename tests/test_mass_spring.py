"""The mass-spring chains: their exact answers by second routes, their checks, what they write, and what they refuse."""

from __future__ import annotations

import argparse
import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import mdtraj
import numpy as np
import pytest
import tolerances as tol
from scipy import integrate

import openmm_filament as of
from systems import __main__ as command
from systems import mass_spring
from systems.mass_spring import chain as chains
from systems.mass_spring import continuum, energy, table
from systems.mass_spring.chain import Chain


@pytest.fixture(scope="module")
def measured() -> table.Measured:
    chain = Chain(4)
    return table.measure(chain, 0.2, timestep=mass_spring.timestep_of(chain), order=4)


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a quick run, which passed."""
    out = tmp_path_factory.mktemp("mass_spring") / "out"
    assert command.main(["mass_spring", "--output", str(out), "--quick"]) == 0
    return out


# Exact answers by a second route ------------------------------------------------------------------------------------


@pytest.mark.parametrize("masses", [1, 2, 5, 9])
def test_the_closed_lines_and_shapes_are_those_of_the_matrix(masses: int) -> None:
    chain = Chain(masses)
    matrix = 2 * np.eye(masses) - np.eye(masses, k=1) - np.eye(masses, k=-1)
    chi, vectors = np.linalg.eigh(matrix)
    expected = np.sqrt(chi * chains.TENSION / (chain.mass * chain.spacing)) / (2 * np.pi)
    assert chain.frequencies == pytest.approx(expected, rel=tol.ROUNDING)
    overlap = np.sum(vectors.T * chain.shapes, axis=1) / np.linalg.norm(chain.shapes, axis=1)
    assert np.abs(overlap) == pytest.approx(1, rel=tol.ROUNDING)


def test_the_chain_is_the_thesis_s() -> None:
    assert chains.TENSION / (chains.MASS * chains.LENGTH) == pytest.approx(25641, rel=2e-6)
    assert {n: len(lines) for n, lines in table.THESIS.items()} == {n: n for n in (1, 2, 3, 4, 5, 7, 9)}
    off = {
        (n, j + 1)
        for n, printed in table.THESIS.items()
        for j, line in enumerate(printed)
        if abs(Chain(n).frequencies[j] - line) > table.DIGIT
    }
    assert off == {(9, 3), (9, 9)}


@pytest.mark.parametrize("amplitude", [0.05, 0.5, 2.0])
def test_the_period_at_any_amplitude_is_that_of_an_ode_solver(amplitude: float) -> None:
    chain = Chain(1, 3.0)
    k, b = chain.stiffness, chain.spacing
    rest = b * (1 - 1 / chain.ratio)

    def motion(_: float, state: Any) -> tuple[float, float]:
        y, v = state
        return v, -2 * k * y * (1 - rest / np.hypot(b, y)) / chain.mass

    def crossing(_: float, state: Any) -> float:
        return float(state[0])

    crossing.terminal = True  # type: ignore[attr-defined]
    quarter = integrate.solve_ivp(
        motion, (0, 1), (amplitude * b, 0.0), events=crossing, rtol=1e-12, atol=1e-15, max_step=1e-4
    ).t_events[0][0]
    assert chain.frequency_at(amplitude) == pytest.approx(1 / (4 * quarter), rel=tol.QUADRATURE)


def test_the_amplitude_law_is_the_quadrature_s_and_the_long_string_s() -> None:
    small = 1e-3
    chain = Chain(1, 5.0)
    shift = chain.frequency_at(small) / chain.frequencies[0] - 1
    assert chains.amplitude_law(chain, 1) == pytest.approx(shift / small**2, rel=1e-5)
    long, stiff = 400, 1e6
    q = np.pi / (long + 1)
    assert chains.amplitude_law(Chain(long, stiff), 1) == pytest.approx(3 / 32 * stiff * q**2, rel=1e-4)


def test_leapfrog_s_dispersion_is_what_the_recursion_does() -> None:
    """`x' = 2 x - x_before - (w dt)^2 x` turns by the angle whose cosine is `1 - (w dt)^2/2`."""
    angle = np.arccos(1 - 0.3**2 / 2)
    assert chains.leapfrog(0.3 / (2 * np.pi), 1.0) == pytest.approx(angle / (2 * np.pi), rel=tol.ROUNDING)


def test_nested_radicals_are_the_closed_formula() -> None:
    for masses in (1, 3, 63, 1023):
        assert continuum.radicals(masses) == pytest.approx(Chain(masses).frequencies[0], rel=1e-10)


def test_a_pluck_is_a_triangle() -> None:
    assert Chain(4).pluck(2) == pytest.approx([0.5, 1.0, 2 / 3, 1 / 3])


# Checks that can fail -----------------------------------------------------------------------------------------------


def broken(measured: table.Measured, **changes: Any) -> dict[str, bool]:
    wrong = replace(measured, **changes)
    return {check.name: check.passed for check in table.checks([wrong], table.rows([wrong]))}


def test_simulated_lines_pass_and_those_of_another_tension_do_not(
    measured: table.Measured, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert all(check.passed for check in table.checks([measured], table.rows([measured])))
    monkeypatch.setattr(chains, "TENSION", 1.01 * chains.TENSION)
    lines = [passed for name, passed in broken(measured).items() if "relative error" in name]
    assert len(lines) == 4
    assert not any(lines)


def test_wrong_shapes_and_one_line_off_are_seen(measured: table.Measured) -> None:
    swapped = broken(measured, shapes=measured.shapes[::-1])
    assert not swapped["simulated mode shapes against sines, largest deviation"]
    off = measured.frequencies * (1 + 2e-5 * (np.arange(4) == 2))
    failed = [name for name, passed in broken(measured, frequencies=off).items() if not passed]
    assert "N = 4, line 3 (Hz, relative error)" in failed
    assert len([name for name in failed if "relative error" in name]) == 1


def test_an_energy_that_drifts_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    chain = Chain(3)
    assert abs(energy.drift(chain, 50_000).slope) < 1e-6
    launch = chains.launch

    def damped(*arguments: Any) -> Any:
        context = launch(*arguments)
        integrator = context.getIntegrator()
        step = integrator.step

        def losing(steps: int) -> None:
            step(steps)
            context.setVelocities(context.getState(velocities=True).getVelocities(asNumpy=True) * (1 - 1e-9 * steps))

        monkeypatch.setattr(integrator, "step", losing)
        monkeypatch.setattr(context, "getIntegrator", lambda: integrator)
        return context

    monkeypatch.setattr(energy, "launch", damped)
    assert energy.drift(chain, 50_000).slope == pytest.approx(-1e-3, rel=0.05)


# What a run leaves ----------------------------------------------------------------------------------------------------


def test_a_quick_run_writes_what_it_promises(results: Path) -> None:
    files = {file.name for file in results.iterdir()}
    assert {
        "summary.json",
        "table_2_1.csv",
        "amplitude.csv",
        "timestep.csv",
        "continuum.csv",
        "mass_spring.wav",
    } <= files
    assert {"spectra.png", "mode_shapes.png", "convergence.png", "continuum.png"} <= files
    assert ("animation.mp4" in files) == ("still.png" in files) == of.rendering.available()
    summary = json.loads((results / "summary.json").read_text())
    assert summary["terms"] == ["CustomBondForce"]
    assert {"tension_N", "stiffness_N_per_m", "bead_mass_kg", "length_m"} <= set(summary["filament"])
    exact = [check for check in summary["checks"] if check["kind"] == "exact"]
    assert all(check["passed"] for check in exact)
    assert sum("relative error" in check["name"] for check in exact) == 31
    assert sum(check["kind"] == "thesis" and not check["passed"] for check in summary["checks"]) == 2  # errata
    assert sum("Erratum" in line for line in summary["findings"]) == 2
    assert all(line.endswith(".") for line in summary["findings"])


def test_the_table_of_a_quick_run_holds_simulated_lines(results: Path) -> None:
    with (results / "table_2_1.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 31
    simulated, exact = (np.array([float(row[name]) for row in rows]) for name in ("simulated_Hz", "exact_Hz"))
    errors = simulated / exact - 1
    assert np.abs(errors).max() < table.LIMIT
    assert len(set(errors)) == 31  # a copy of the formula would have none


def test_the_trajectory_starts_at_the_pluck_and_keeps_its_ends(results: Path) -> None:
    frames = of.load(results / "trajectory.dcd")
    assert isinstance(frames, mdtraj.Trajectory)
    assert 100 <= frames.n_frames <= 400
    spacing = chains.LENGTH / 10 * 1e9
    assert frames.xyz[0, 3, 1] == pytest.approx(spacing, rel=tol.MDTRAJ)
    assert np.ptp(frames.xyz[:, [0, -1]], axis=0).max() == 0
    assert frames.time[-1] == pytest.approx(4e12 / Chain(9).frequencies[0], rel=0.05)


# Refusals -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--seconds", "0.1"], "`seconds` must be at least 0.204 to tell apart lines 19.6 Hz"),
        (["--seconds", "-1"], "`seconds` must be positive"),
        (["--seconds", "nan"], "`seconds` must be finite, but is nan"),
        (["--stiffness-ratio", "1"], "`ratio` must be above 1"),
        (["--stiffness-ratio", "nan"], "`ratio` must be finite"),
    ],
)
def test_bad_options_are_refused_before_anything_runs(
    arguments: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(table, "measure", None)
    assert command.main(["mass_spring", "--output", str(tmp_path / "out"), *arguments]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_bad_starts_and_steps_are_refused() -> None:
    chain = Chain(2)
    dt = 0.1 / chain.cutoff
    with pytest.raises(ValueError, match="`masses` must be at least 1"):
        Chain(0)
    with pytest.raises(ValueError, match="`start` must have shape"):
        chains.play(chain, np.zeros(4), 0.1, timestep=dt)  # the fixed ends are not to be moved
    with pytest.raises(ValueError, match="`start` must be finite"):
        chains.play(chain, np.array([0, np.nan]), 0.1, timestep=dt)
    with pytest.raises(ValueError, match="stability limit"):
        chains.play(chain, np.zeros(2), 0.1, timestep=30 * dt)
    with pytest.raises(ValueError, match="`mass` must be at most 2"):
        chain.pluck(3)
    with pytest.raises(ValueError, match="`masses` must be 1"):
        chain.frequency_at(0.1)


def test_options_are_parsed_with_defaults_that_run() -> None:
    parser = argparse.ArgumentParser()
    mass_spring.options(parser.add_argument_group("options"))
    given = parser.parse_args([])
    for masses in table.THESIS:
        table.refuse_short(Chain(masses, given.stiffness_ratio), given.seconds)
