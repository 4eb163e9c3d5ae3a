"""Trajectories: what is written comes back with true times and lengths, even from a run that was killed."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path
from typing import Any

import numpy as np
import openmm as mm
import pytest
import tolerances as tol
from conftest import KJ, NM, Array
from openmm import app, unit

import openmm_filament as of
from openmm_filament import bending, stretching
from openmm_filament.loads import Hold, Plane, Pull
from openmm_filament.trajectory import TrajectoryWriter

PS = unit.picosecond
WARM = 298 * unit.kelvin
REFERENCE = mm.Platform.getPlatformByName("Reference")
TERMS = (stretching.Harmonic(200 * KJ / NM**2), bending.Harmonic(20 * KJ))


def helix() -> of.Filament:
    return of.Filament(of.shapes.helix(11, radius=2 * NM, pitch=3 * NM, turns=1.3), 10 * unit.dalton, TERMS)


def wire() -> of.Filament:
    """1 m of steel."""
    terms = of.rod_terms(2e11 * unit.pascal, None, 0.5 * unit.millimeter, 5 * unit.centimeter)
    return of.Filament(of.shapes.line(20, 5 * unit.centimeter), 0.3 * unit.gram, terms)


class Recorder:
    """A reporter of its own: the step, time and internal positions in double precision, at the start and as asked."""

    def __init__(self, interval: int) -> None:
        self.interval = interval
        self.frames: list[tuple[int, float, Array]] = []

    def describeNextReport(self, simulation: app.Simulation) -> dict[str, Any]:
        if not self.frames:
            self.report(simulation, simulation.context.getState(positions=True))
        return {
            "steps": self.interval - simulation.currentStep % self.interval,
            "periodic": None,
            "include": ["positions"],
        }

    def report(self, simulation: app.Simulation, state: mm.State) -> None:
        x = state.getPositions(asNumpy=True).value_in_unit(NM)
        self.frames.append((simulation.currentStep, state.getTime().value_in_unit(PS), x))


def simulation(model: of.Model, seed: int = 1) -> app.Simulation:
    integrator = of.langevin(model, WARM, seed=seed) if model.scale.is_identity else of.verlet(model)
    made = app.Simulation(model.topology, model.system, integrator, REFERENCE)
    made.context.setPositions(model.positions)
    return made


def recorded(model: of.Model, path: Path, interval: int, steps: int) -> list[tuple[int, float, Array]]:
    run = simulation(model)
    recorder = Recorder(interval)
    reporter = of.trajectory_reporter(model, path, interval)
    run.reporters += [recorder, reporter]
    run.step(steps)
    reporter.close()
    return recorder.frames


def test_the_example_of_the_package_runs_as_it_stands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first lines that a user sees, with fewer steps."""
    monkeypatch.chdir(tmp_path)
    example = """
        import openmm as mm
        from openmm import app, unit
        import openmm_filament as of

        dna = of.WormlikeChain(contour_length=1*unit.micrometer, persistence_length=53*unit.nanometer, stretch_modulus=1000*unit.piconewton)
        model = of.build(dna.filament(segments=40, temperature=298*unit.kelvin),
                         loads=[of.loads.Hold(0), of.loads.Pull(-1, (0, 0, 5)*unit.piconewton)])

        integrator = of.langevin(model, temperature=298*unit.kelvin)            # time step and friction chosen from the model
        platform = of.fastest_platform(model)
        simulation = app.Simulation(model.topology, model.system, integrator, platform, of.platform_properties(model, platform))
        simulation.context.setPositions(model.positions)
        of.preflight(model, simulation.context)
        simulation.reporters.append(of.trajectory_reporter(model, "dna.dcd", 1000))
        simulation.step(10_000)
    """
    names: dict[str, Any] = {}
    exec(textwrap.dedent(example), names)
    back = of.load("dna.dcd")
    assert (back.n_frames, back.n_atoms) == (11, 41)
    x = names["simulation"].context.getState(positions=True).getPositions(asNumpy=True).value_in_unit(NM)
    np.testing.assert_allclose(back.xyz[-1], x, rtol=0, atol=tol.SINGLE * np.abs(x).max())
    assert back.time[-1] == pytest.approx(names["simulation"].context.getTime().value_in_unit(PS), rel=1e-12)


@pytest.mark.parametrize("make", [helix, wire], ids=["nm", "scaled"])
def test_frames_times_and_lengths_come_back(make: Any, tmp_path: Path) -> None:
    """Frame 0 among them; a metre comes back as 1e9 nm and its times as milliseconds in ps."""
    model = of.build(make(), [Hold(0), Pull(-1, (0.1, 0, 0) * unit.piconewton)])
    frames = recorded(model, tmp_path / "run.dcd", 30, 100)
    back = of.load(tmp_path / "run.dcd")
    assert [step for step, _, _ in frames] == [0, 30, 60, 90]
    assert back.n_frames == 4
    times = [model.to_physical(t, "time").value_in_unit(PS) for _, t, _ in frames]
    np.testing.assert_allclose(back.time, times, rtol=tol.ROUNDING)
    assert back.time[0] == 0
    dt = model.to_physical(simulation(model).integrator.getStepSize(), "time").value_in_unit(PS)
    assert back.time[1] == pytest.approx(30 * dt)
    for k, (_, _, x) in enumerate(frames):
        physical = model.to_physical(x, "length").value_in_unit(NM)
        np.testing.assert_allclose(back.xyz[k], physical, rtol=0, atol=tol.SINGLE * np.abs(physical).max())
    if make is wire:
        assert back.xyz[0, -1, 2] == pytest.approx(1e9, rel=tol.SINGLE)


@pytest.mark.parametrize("make", [helix, wire], ids=["nm", "scaled"])
def test_end_to_end_distances_of_mdtraj_are_those_of_the_state(make: Any, tmp_path: Path) -> None:
    import mdtraj

    model = of.build(make(), [Hold(0)])
    frames = recorded(model, tmp_path / "run.dcd", 25, 200)
    back = of.load(tmp_path / "run.dcd")
    found = mdtraj.compute_distances(back, [[0, back.n_atoms - 1]], periodic=False)[:, 0]
    exact = np.array([np.linalg.norm(x[-1] - x[0]) for _, _, x in frames]) * model.scale.length
    largest = max(np.abs(x).max() for _, _, x in frames) * model.scale.length
    np.testing.assert_allclose(found, exact, rtol=0, atol=tol.MDTRAJ * largest)


def test_the_files_stand_beside_one_another(tmp_path: Path) -> None:
    model = of.build([helix(), helix()], [[Hold(0), Pull(-1, (1, 2, 3) * unit.piconewton), Plane()], [Plane()]])
    recorded(model, tmp_path / "trajectory_2pN.dcd", 10, 20)
    assert {f.name for f in tmp_path.iterdir()} == {"trajectory_2pN.dcd", "topology_2pN.pdb", "trajectory_2pN.jsonl"}
    header, *frames = (json.loads(line) for line in (tmp_path / "trajectory_2pN.jsonl").read_text().splitlines())
    assert header["topology"] == "topology_2pN.pdb"
    assert header["scale"] == {"length_nm": 1.0, "mass_Da": 1.0, "energy_kJ_per_mol": 1.0}
    assert header["beads"] == [12, 12]
    assert [load["held"] for load in header["loads"]] == [[0], []]
    assert [load["plane"] for load in header["loads"]] == [True, True]
    np.testing.assert_allclose(header["loads"][0]["pulls_kJ_per_mol_nm"]["11"], 0.602214076 * np.array([1, 2, 3]))
    assert [frame["step"] for frame in frames] == [0, 10, 20]
    back = of.load(tmp_path / "trajectory_2pN.dcd")
    assert (back.topology.n_chains, back.topology.n_atoms, back.topology.n_bonds) == (2, 24, 22)


def test_results_may_be_moved(tmp_path: Path) -> None:
    model = of.build(helix())
    recorded(model, tmp_path / "run.dcd", 10, 20)
    (tmp_path / "else").mkdir()
    for file in list(tmp_path.glob("run.*")):
        file.rename(tmp_path / "else" / file.name)
    assert of.load(str(tmp_path / "else" / "run.dcd")).n_frames == 3


@pytest.mark.parametrize("suffix", [".dcd", ".pdb", ".jsonl"])
def test_none_of_the_files_is_overwritten(suffix: str, tmp_path: Path) -> None:
    model = of.build(helix())
    there = tmp_path / f"run{suffix}"
    there.write_text("mine")
    with pytest.raises(FileExistsError, match=rf"run{suffix} exists: pass overwrite=True"):
        of.trajectory_reporter(model, tmp_path / "run.dcd", 10)
    assert there.read_text() == "mine"
    assert list(tmp_path.iterdir()) == [there]
    of.trajectory_reporter(model, tmp_path / "run.dcd", 10, overwrite=True).close()


def test_overwriting_leaves_nothing_of_the_old_run(tmp_path: Path) -> None:
    model = of.build(helix())
    recorded(model, tmp_path / "run.dcd", 10, 100)
    run = simulation(model)
    reporter = of.trajectory_reporter(model, tmp_path / "run.dcd", 10, overwrite=True)
    run.reporters.append(reporter)
    run.step(20)
    reporter.close()
    assert of.load(tmp_path / "run.dcd").n_frames == 3


def test_another_suffix_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"`path` must end in \.dcd, but is .*run\.xtc"):
        of.trajectory_reporter(of.build(helix()), tmp_path / "run.xtc", 10)


def test_missing_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"run\.dcd does not exist"):
        of.load(tmp_path / "run.dcd")
    recorded(of.build(helix()), tmp_path / "run.dcd", 10, 20)
    (tmp_path / "run.jsonl").unlink()
    with pytest.raises(FileNotFoundError, match=r"run\.jsonl does not exist"):
        of.load(tmp_path / "run.dcd")


def test_a_sidecar_with_too_few_times_is_refused(tmp_path: Path) -> None:
    recorded(of.build(helix()), tmp_path / "run.dcd", 10, 40)
    sidecar = tmp_path / "run.jsonl"
    sidecar.write_text("".join(sidecar.read_text().splitlines(keepends=True)[:-2]))
    with pytest.raises(ValueError, match="must have a time for each of 5 frames, but has 3"):
        of.load(tmp_path / "run.dcd")


# Cut short ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("cut", [1, 100, 200])
def test_a_dcd_cut_short_loads_up_to_its_last_whole_frame(cut: int, tmp_path: Path) -> None:
    model = of.build(helix())
    frames = recorded(model, tmp_path / "run.dcd", 10, 50)
    dcd = tmp_path / "run.dcd"
    os.truncate(dcd, dcd.stat().st_size - cut)
    back = of.load(dcd)
    whole = 5 if cut < 12 * 12 else 4
    assert back.n_frames == whole
    np.testing.assert_allclose(back.xyz[whole - 1], frames[whole - 1][2], rtol=0, atol=tol.SINGLE * 20)
    np.testing.assert_allclose(back.time, [t for _, t, _ in frames[:whole]], rtol=tol.ROUNDING)


def test_a_sidecar_cut_in_its_last_line_still_loads(tmp_path: Path) -> None:
    """A frame is written before its line: a run killed between them leaves one line that is not whole."""
    recorded(of.build(helix()), tmp_path / "run.dcd", 10, 50)
    sidecar, dcd = tmp_path / "run.jsonl", tmp_path / "run.dcd"
    os.truncate(sidecar, sidecar.stat().st_size - 7)
    back = of.load(dcd)
    assert back.n_frames >= 5
    assert np.isfinite(back.time).all()


KILLED = """
    import sys, openmm as mm
    from openmm import app, unit
    import openmm_filament as of
    chain = of.WormlikeChain(400*unit.nanometer, 53*unit.nanometer, 1000*unit.piconewton).filament(16, 298*unit.kelvin)
    model = of.build(chain, [of.loads.Hold(0)])
    run = app.Simulation(model.topology, model.system, of.langevin(model, 298*unit.kelvin, seed=1),
                         mm.Platform.getPlatformByName("Reference"))
    run.context.setPositions(model.positions)
    run.reporters.append(of.trajectory_reporter(model, sys.argv[1], 100))
    run.step(10_000_000)
"""


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no SIGKILL on this system")
def test_a_killed_run_still_loads(tmp_path: Path) -> None:
    dcd = tmp_path / "run.dcd"
    process = subprocess.Popen([sys.executable, "-c", textwrap.dedent(KILLED), str(dcd)])
    try:
        begun = time.monotonic()
        while time.monotonic() - begun < 60 and not (dcd.exists() and dcd.stat().st_size > 20_000):
            time.sleep(0.02)
            assert process.poll() is None
    finally:
        process.kill()
        process.wait()
    back = of.load(dcd)
    assert back.n_frames > 50
    assert np.isfinite(back.xyz).all()
    steps = np.diff(back.time)
    np.testing.assert_allclose(steps, steps[0], rtol=1e-6)


# Appended by hand ---------------------------------------------------------------------------------------------------


def test_a_run_that_goes_on_has_its_true_times(tmp_path: Path) -> None:
    """A reporter that is added late starts with the frame it finds, at the time it finds."""
    model = of.build(helix())
    run = simulation(model)
    run.step(35)
    reporter = of.trajectory_reporter(model, tmp_path / "run.dcd", 10)
    run.reporters.append(reporter)
    run.step(25)
    reporter.close()
    dt = run.integrator.getStepSize().value_in_unit(PS)
    np.testing.assert_allclose(of.load(tmp_path / "run.dcd").time, dt * np.array([35, 40, 50, 60]), rtol=1e-12)


def test_a_writer_takes_more_numbers_and_then_no_frames(tmp_path: Path) -> None:
    model = of.build(helix())
    writer = TrajectoryWriter(model, tmp_path / "run.dcd")
    x = model.positions.value_in_unit(NM)
    writer.write(x, 5, 0.25, extension_nm=1.5)
    writer.close()
    _, frame = (json.loads(line) for line in (tmp_path / "run.jsonl").read_text().splitlines())
    assert frame == {"step": 5, "time_ps": 0.25, "extension_nm": 1.5}
    with pytest.raises(ValueError, match="closed file"):
        writer.write(x, 6, 0.3)


def test_old_files_stay_until_the_first_frame(tmp_path: Path) -> None:
    """A run that fails before loses nothing."""
    names = ("run.dcd", "run.pdb", "run.jsonl")
    for name in names:
        (tmp_path / name).write_text("old")
    model = of.build(of.Filament(of.shapes.line(4, 1 * unit.nanometer), 1 * unit.dalton, ()))
    of.trajectory_reporter(model, tmp_path / "run.dcd", 5, overwrite=True).close()
    writer = TrajectoryWriter(model, tmp_path / "run.dcd", overwrite=True)
    assert all((tmp_path / name).read_text() == "old" for name in names)
    writer.write(np.zeros((5, 3)), 0, 0.0)
    writer.close()
    assert of.load(tmp_path / "run.dcd").n_frames == 1


def test_files_that_cannot_be_written_are_refused_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model = of.build(of.Filament(of.shapes.line(4, 1 * unit.nanometer), 1 * unit.dalton, ()))
    monkeypatch.setattr("os.access", lambda path, mode: False)
    with pytest.raises(PermissionError, match="`path` must name files that can be written, but .*run.dcd cannot"):
        of.trajectory_reporter(model, tmp_path / "run.dcd", 5)
