"""A whole curve in one Context: the exact answers, on OpenCL where there is one, and going on from a checkpoint."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import openmm as mm
import pytest
import tolerances as tol
from openmm import unit
from scipy.stats import chi2
from test_resume import TORN, Killed, killed_after, same, same_files
from test_sampling import CURVES, KJ, NM, PN, WARM, exact, filament

import openmm_filament as of
from openmm_filament import own_steps, sampling, wide, wlc
from openmm_filament.divergence import DivergedError
from openmm_filament.planning import plan_curve
from openmm_filament.platforms import GPUS
from openmm_filament.progress import Progress
from openmm_filament.starts import equilibrium_starts

PLATFORMS = [mm.Platform.getPlatform(i).getName() for i in range(mm.Platform.getNumPlatforms())]


def works(name: str) -> bool:
    """Whether a Context can be made there: OpenMM's OpenCL plugin loads without any device."""
    if name not in PLATFORMS:
        return False
    system = mm.System()
    system.addParticle(1.0)
    try:
        mm.Context(system, mm.VerletIntegrator(0.001), mm.Platform.getPlatformByName(name))
    except mm.OpenMMException:
        return False
    return True


OPENCL = pytest.mark.skipif(not works("OpenCL"), reason="no OpenCL device")


@pytest.fixture(autouse=True)
def narrow(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reference runs as a GPU does, and a System is small."""
    monkeypatch.setattr(sampling, "GPUS", (*GPUS, "Reference"))
    monkeypatch.setattr(wide, "_BEADS", 400)


def deviations(names: Any, relative_error: float, platform: str, **options: Any) -> np.ndarray:
    found = []
    for name in names:
        chain, forces, dimension = CURVES[name]
        curve = of.force_extension(
            chain, forces * PN, WARM, relative_error, dimension=dimension, platform=platform, **options
        )
        assert curve.finished.all()
        assert (2 * curve.extension_error <= relative_error * curve.extension * (1 + 1e-12)).all()
        found.append((curve.extension.values - exact(chain, forces, dimension)) / curve.extension_error.values)
    return np.concatenate(found)


def test_all_forces_in_one_context_come_to_the_exact_chains() -> None:
    z = deviations(["soft", "soft bonds", "planar cosine", "planar, bent"], 0.1, "Reference", seed=3)
    assert np.abs(z).max() <= tol.SIGMAS
    assert chi2.sf((z**2).sum(), len(z)) > tol.CHI_SQUARED
    assert chi2.cdf((z**2).sum(), len(z)) > tol.CHI_SQUARED


@OPENCL
def test_opencl_comes_to_the_exact_chains_too() -> None:
    z = deviations(["4 segments", "planar, bent"], 0.15, "OpenCL", seed=1)
    assert np.abs(z).max() <= tol.SIGMAS


@OPENCL
@pytest.mark.slow
def test_opencl_agrees_with_processes_on_a_wormlike_chain(monkeypatch: pytest.MonkeyPatch) -> None:
    """And both with the continuous chain; forces over two decades, each with segments, step and friction of its own."""
    chain, forces = of.WormlikeChain(300 * NM, 53 * NM, 1000 * PN), np.array([0.3, 3.0, 30.0])
    one = of.force_extension(chain, forces * PN, WARM, 0.03, seed=1, platform="OpenCL")
    monkeypatch.undo()
    many = of.force_extension(chain, forces * PN, WARM, 0.03, seed=1)
    kt = 298 * of.units.BOLTZMANN / 0.602214076
    continuous = wlc.extension_exact(forces, 53.0, 300.0, kt, stretch_modulus=1000.0, finite=True)
    for curve in (one, many):
        assert (np.abs((curve.extension - curve.bias - continuous) / curve.extension_error) <= tol.SIGMAS).all()
    both = np.hypot(one.extension_error, many.extension_error)
    assert (np.abs(one.extension - many.extension) <= tol.SIGMAS * both).all()
    np.testing.assert_array_equal(one.time_step, many.time_step)


def test_replicas_follow_the_steps_that_a_force_needs() -> None:
    plans = plan_curve(filament(10, alpha=3.0), np.array([0.5, 20.0]), 298.0, np.array([0.02, 0.02]), 3, None)
    low, high = wide.replicas(plans, 298.0, 3)
    assert low > high == wide._FEWEST
    bare = of.Filament(filament(6).rest, 100 * unit.dalton, filament(6).terms[:1])
    plans = plan_curve(bare, np.array([1.0, 2.0]), 298.0, np.array([0.02, 0.02]), 3, None)
    assert len(set(wide.replicas(plans, 298.0, 3))) == 1  # no exact answer: alike


@TORN
@pytest.mark.parametrize("platform", ["Reference", pytest.param("OpenCL", marks=OPENCL)])
def test_one_context_goes_on_from_its_checkpoint(
    platform: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(wide, "_BLOCK_BEAD_STEPS", 1e5)

    def sampled(name: str, **options: Any) -> Any:
        paths = {0: tmp_path / f"{name}.dcd"}
        return of.force_extension(
            filament(6), [1.0, 8.0] * PN, WARM, 0.08, seed=2, platform=platform, trajectories=paths, **options
        )

    reports: list[Progress] = []
    whole = sampled("whole", progress=reports.append)
    assert [r.fraction for r in reports] == sorted(r.fraction for r in reports)
    kept = tmp_path / "kept.checkpoint"
    for blocks, torn in ((2, None), (5, 300)):  # of two records each: the second end is in the middle of one
        with monkeypatch.context() as patch:
            killed_after(patch, blocks, torn=torn)
            with pytest.raises(Killed):
                sampled("kept", checkpoint=kept)
    curve = sampled("kept", checkpoint=kept)
    if platform == "Reference":
        same(curve, whole)
        same_files(tmp_path, "kept", "whole")
    else:
        np.testing.assert_allclose(curve.extension, whole.extension, rtol=0.1)
    times = of.load(tmp_path / "kept.dcd").time
    np.testing.assert_allclose(np.diff(times[1:]), times[2] - times[1], rtol=1e-9)
    curve.to_netcdf(tmp_path / "curve.nc", engine="scipy")


def test_ctrl_c_keeps_what_one_context_has_done(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[Progress] = []

    def progress(report: Progress) -> None:
        seen.append(report)
        if len(seen) == 2:
            raise KeyboardInterrupt

    curve = of.force_extension(filament(10), [0.3, 5.0] * PN, WARM, 0.01, seed=1, progress=progress)
    assert curve.attrs["interrupted"] == 1
    assert np.isfinite(curve.extension).all()


def test_a_curve_that_diverges_in_one_context_is_told_of(monkeypatch: pytest.MonkeyPatch) -> None:
    real = wide._integrator

    def hot(model: Any, points: Any, heat: float, seed: int) -> Any:
        return real(model, points, 100 * heat, seed)

    monkeypatch.setattr(wide, "_integrator", hot)
    with warnings.catch_warnings(), pytest.raises(DivergedError, match="heated up to|diverged"):
        warnings.simplefilter("ignore")
        of.force_extension(filament(6), [1.0, 5.0] * PN, WARM, 0.1)


FORCES = [1.0, 4.0, 9.0]


def spoilt(monkeypatch: pytest.MonkeyPatch, which: int, column: int, factor: float) -> None:
    """The chains of one force get a time step (column 0) or a noise (2) that is so much larger than planned."""
    real = wide._integrator

    def integrator(model: Any, points: Any, heat: float, seed: int) -> Any:
        made = real(model, points, heat, seed)
        counts = [p.runs[0].block.replicas * len(p.runs[0].block.filament) for p in points]
        values = own_steps.values_of(made)
        values[column, sum(counts[:which]) : sum(counts[: which + 1])] *= factor
        own_steps.set_values(made, values)
        return made

    monkeypatch.setattr(wide, "_integrator", integrator)


def curve_of(folder: Path, **options: Any) -> Any:
    paths = {i: folder / f"{i}.dcd" for i in range(3)}
    return of.force_extension(
        filament(6), FORCES * PN, WARM, 0.1, seed=3, trajectories=paths, overwrite=True, **options
    )


SPOILT = {"hot": (2, 12.0, "heated up to"), "unstable": (0, 12.0, r"diverged at step \d+ .* by the force of")}


@pytest.mark.parametrize("how", SPOILT)
def test_a_force_that_diverges_in_one_context_leaves_the_others(
    how: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """From the checkpoint too: it stays given up, and the others go on as they would have."""
    whole = curve_of(tmp_path)
    monkeypatch.setattr(wide, "_BLOCK_BEAD_STEPS", 1e5)
    column, factor, message = SPOILT[how]
    spoilt(monkeypatch, 1, column, factor)
    reports: list[Progress] = []
    with pytest.warns(UserWarning, match=rf"The run at 4 pN is given up: The run .*{message}") as caught:
        curve = curve_of(tmp_path, progress=reports.append)
    assert len(caught) == 1
    assert curve.diverged.values.tolist() == [0, 1, 0]
    assert curve.finished.values.tolist() == [1, 0, 1]
    assert np.isnan(curve.extension[1])
    both = np.hypot(curve.extension_error, whole.extension_error)
    assert (np.abs(curve.extension - whole.extension) <= tol.SIGMAS * both)[[0, 2]].all()
    assert reports[-1].finished == 2
    assert reports[-1].fraction == pytest.approx(1)

    kept = tmp_path / "kept.checkpoint"
    with monkeypatch.context() as patch:
        killed_after(patch, 2 * 3)
        with pytest.raises(Killed):
            curve_of(tmp_path, checkpoint=kept)
    with pytest.warns(UserWarning, match="The run at 4 pN is given up: By its checkpoint the run has diverged"):
        again = curve_of(tmp_path, checkpoint=kept)
    same(again, curve)


@OPENCL
def test_opencl_gives_up_one_force_alone_too(monkeypatch: pytest.MonkeyPatch) -> None:
    spoilt(monkeypatch, 1, 0, 12.0)
    with pytest.warns(UserWarning, match=r"The run at 4 pN is given up: The run (diverged|has heated up)"):
        curve = of.force_extension(filament(6), FORCES * PN, WARM, 0.2, seed=3, platform="OpenCL")
    assert curve.diverged.values.tolist() == [0, 1, 0]
    z = (curve.extension - exact(filament(6), FORCES, 3)) / curve.extension_error
    assert (np.abs(z[[0, 2]]) <= tol.SIGMAS).all()


def test_what_is_given_up_stands_still_and_leaves_the_numbers_of_the_others() -> None:
    """Bit for bit on Reference, though the report on it repeats its steps."""
    plans = plan_curve(filament(6), np.array(FORCES), 298.0, np.full(3, 0.1), 3, None)

    def ran(bad: bool) -> list[Any]:
        run = wide.WideRun(wide.wide_points(plans, 298.0, 3, 1, "Reference"), 1)
        parts = [run.advance(10)]
        own, good = run._point == 1, run._good[0].copy()
        if bad:
            values = own_steps.values_of(run._integrator)
            values[0, own] *= 12
            own_steps.set_values(run._integrator, values)
        parts += [run.advance(10), run.advance(5)]
        assert list(run.failures) == [1] * bad
        assert (run._good[0][own] == good[own]).all() == bad
        return parts

    well, ill = ran(False), ran(True)
    for one, other in zip(well, ill, strict=True):
        for i in (0, 2):
            np.testing.assert_array_equal(other[i].extensions, one[i].extensions)
    assert [np.isnan(part[1].extensions).all() for part in ill] == [False, True, True]


def test_a_platform_that_stops_at_once_is_told_of(monkeypatch: pytest.MonkeyPatch) -> None:
    real = wide._integrator

    def integrator(model: Any, points: Any, heat: float, seed: int) -> Any:
        made = real(model, points, heat, seed)

        def step(_: int) -> None:
            raise mm.OpenMMException("Particle coordinate is NaN.")

        made.step = step
        return made

    monkeypatch.setattr(wide, "_integrator", integrator)
    with pytest.raises(DivergedError, match=r"stops the whole Context for it \(Particle .*leave `platform` out"):
        of.force_extension(filament(6), FORCES * PN, WARM, 0.1)


def test_starts_with_dihedrals_are_calmed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Starts with tens of times the thermal energy in their torsions: a thousand steps of strong friction take it out."""
    rest = of.shapes.helix(12, radius=3 * NM, pitch=5 * NM, turns=1.5)
    terms = (of.stretching.Harmonic(500 * KJ / NM**2), of.bending.Harmonic(200 * KJ), of.torsion.Harmonic(100 * KJ))
    chain = of.Filament(rest, 300 * unit.dalton, terms)
    plans = plan_curve(chain, np.array([2.0, 5.0]), 298.0, np.full(2, 0.2), 3, None)

    def stored() -> float:
        """Potential energy of the torsions over that of so many oscillators, after a step."""
        points = wide.wide_points([replace(plan, warm_up=1) for plan in plans], 298.0, 3, 1, "Reference")
        run = wide.WideRun(points, 1)
        assert run._ticks == 0
        group = run._model.groups["torsion"]
        energy = run._context.getState(energy=True, groups=1 << group).getPotentialEnergy()
        elements = next(len(i.beads) for i in run._model.interactions if i.term.family == "torsion")
        return float(energy / KJ) / (elements * of.units.BOLTZMANN * 298 / 2)

    def rough(filament: Any, force: float, kelvin: float, count: int, rng: Any, dimension: int) -> Any:
        return equilibrium_starts(filament, force, kelvin, count, rng, dimension) + 0.4 * rng.normal(
            size=(count, 13, 3)
        )

    monkeypatch.setattr(wide, "equilibrium_starts", rough)
    assert stored() < 2
    monkeypatch.setattr(wide, "needs_calm", lambda model: False)
    assert stored() > 10


@pytest.mark.parametrize("beside", [{"processes": 2}, {"executor": object()}])
def test_workers_are_refused_beside_one_context(beside: dict[str, Any]) -> None:
    with pytest.raises(
        ValueError, match="`executor` and `processes` must be left out on Reference, where the whole curve"
    ):
        of.force_extension(filament(6), 1 * PN, WARM, 0.1, **beside)
