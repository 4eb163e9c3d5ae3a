"""Force-extension curves: the exact discrete chain, the same numbers for a seed, and what is kept and refused."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tolerances as tol
from conftest import KJ, NM
from openmm import unit
from scipy.stats import chi2

import openmm_filament as of
from openmm_filament import bending, blocks, sampling, stretching, wlc
from openmm_filament.blocks import Block, run_block
from openmm_filament.discretisation import exact_chain
from openmm_filament.divergence import DivergedError
from openmm_filament.sampling import Progress

PN = unit.piconewton
WARM = 298 * unit.kelvin
KT = of.units.BOLTZMANN * 298 / 0.602214076
"""pN nm."""
CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def filament(
    count: int = 8, alpha: float = 10.0, k: float = 150.0, beta: float | None = None, form: Any = None
) -> of.Filament:
    """Bonds of 4 nm; alpha in kJ/mol, k in kJ/mol/nm^2."""
    angle = form(alpha * KJ) if form else bending.Harmonic(alpha * KJ, None if beta is None else beta * unit.radian)
    heading = (beta or 0.0) / 2 * (-1) ** np.arange(count)  # a zigzag with these bends
    steps = 4 * np.stack([np.sin(heading), 0 * heading, np.cos(heading)], axis=-1)
    rest = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    return of.Filament(rest[:, [2, 0, 1]] * NM, 100 * unit.dalton, (stretching.Harmonic(k * KJ / NM**2), angle))


class InProcess:
    """Stands for the pool of processes: runs each block when it is submitted, in this process."""

    def __init__(self, *_: Any, **__: Any) -> None: ...

    def __enter__(self) -> InProcess:
        return self

    def __exit__(self, *_: object) -> None: ...

    def shutdown(self, **_: Any) -> None: ...

    def submit(self, function: Callable[[Block], Any], block: Block) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(function(block))
        except Exception as error:
            future.set_exception(error)
        return future


@pytest.fixture
def in_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without worker processes, which take seconds to start."""
    monkeypatch.setattr(sampling, "ProcessPoolExecutor", InProcess)


CURVES: dict[str, tuple[of.Filament, tuple[float, ...], int]] = {
    "4 segments": (filament(4), (0.5, 5.0, 40.0), 3),
    "soft": (filament(10, alpha=3.0), (0.5, 2.0, 20.0), 3),
    "stiff": (filament(12, alpha=40.0), (0.3, 3.0), 3),
    "soft bonds": (filament(8, alpha=10.0, k=8.0), (1.0, 15.0), 3),
    "cosine": (filament(10, alpha=10.0, form=bending.Cosine), (0.5, 5.0), 3),
    "soft cosine": (filament(16, alpha=2.0, form=bending.Cosine), (2.0, 20.0), 3),
    "bent": (filament(8, beta=0.8), (1.0, 10.0), 3),
    "planar": (filament(8), (0.5, 5.0), 2),
    "planar cosine": (filament(12, alpha=15.0, form=bending.Cosine), (0.5, 5.0), 2),
    "planar, bent": (filament(6, alpha=5.0, beta=0.5), (1.0, 10.0), 2),
    "24 segments": (filament(24, alpha=25.0), (5.0,), 3),
}
"""Filament, forces in pN, dimension; in the plane, bent joints are soft enough to flip."""


def exact(chain: of.Filament, forces: Any, dimension: int) -> Any:
    """From the numbers of the terms, not from the sampler's own way to them."""
    bound = {i.term: i.parameters for i in chain.interactions()}
    form = "cosine" if bending.Cosine in bound else "harmonic"
    joint = bound[bending.Cosine if form == "cosine" else bending.Harmonic]
    return wlc.extension_discrete(
        np.array(forces), segments=len(chain) - 1, bond_length=4.0, kT=KT, dimension=dimension, bending_form=form,
        bending=joint["alpha"] / 0.602214076, stretching=bound[stretching.Harmonic]["k"][0] / 0.602214076,
        rest_angles=joint.get("beta0", 0.0),
    )  # fmt: skip


def deviations(relative_error: float, seed: int, **options: Any) -> np.ndarray:
    """(sampled - exact) in standard errors, of all points of all curves."""
    found = []
    for chain, forces, dimension in CURVES.values():
        curve = of.force_extension(chain, forces * PN, WARM, relative_error, seed=seed, dimension=dimension, **options)
        wanted = exact(chain, forces, dimension)
        assert curve.finished.all()
        assert (2 * curve.extension_error <= relative_error * curve.extension * (1 + 1e-12)).all()
        found.append((curve.extension.values - wanted) / curve.extension_error.values)
    return np.concatenate(found)


def test_curves_are_those_of_the_exact_discrete_chains(in_process: None) -> None:
    z = deviations(0.07, seed=1, processes=1)
    assert np.abs(z).max() <= tol.SIGMAS
    assert chi2.sf((z**2).sum(), len(z)) > tol.CHI_SQUARED
    assert chi2.cdf((z**2).sum(), len(z)) > tol.CHI_SQUARED  # error bars are not far too large either


def test_a_straight_rest_shape_with_bent_joints_is_sampled_too(in_process: None) -> None:
    """Where the rest shape is not at the minimum, nor smooth there: beta = 0 is the tip of a cone."""
    terms = (stretching.Harmonic(150 * KJ / NM**2), bending.Harmonic(10 * KJ, 0.8 * unit.radian))
    chain = of.Filament(of.shapes.line(8, 4 * NM), 100 * unit.dalton, terms)
    curve = of.force_extension(chain, [5.0] * PN, WARM, 0.06, seed=1, processes=1)
    assert np.abs((curve.extension - exact(chain, [5.0], 3)) / curve.extension_error).max() <= tol.SIGMAS


@pytest.mark.slow
def test_curves_are_exact_to_a_per_cent() -> None:
    """In about six minutes; to five per cent, in a small part of that, where OPENMM_FILAMENT_SHORT is set."""
    error = 0.05 if os.environ.get("OPENMM_FILAMENT_SHORT") else 0.012
    z = np.concatenate([deviations(error, seed=seed) for seed in (1, 2)])
    assert np.abs(z).max() <= tol.SIGMAS
    assert chi2.sf((z**2).sum(), len(z)) > tol.CHI_SQUARED
    assert chi2.cdf((z**2).sum(), len(z)) > tol.CHI_SQUARED


def test_a_wrong_stiffness_would_be_noticed(in_process: None) -> None:
    """A chain 30 % stiffer than said is far off at the errors asked for."""
    curve = of.force_extension(filament(10, alpha=13.0), [2.0, 4.0] * PN, WARM, 0.02, seed=1, processes=1)
    z = (curve.extension - exact(filament(10, alpha=10.0), [2.0, 4.0], 3)) / curve.extension_error
    assert np.abs(z).max() > tol.SIGMAS


def test_a_wormlike_chain_gets_its_segments_and_meets_its_error(in_process: None) -> None:
    """Against the continuous chain, with the bias known: |bias| + 2 errors within what was asked."""
    chain = of.WormlikeChain(300 * NM, 53 * NM, 1000 * PN)
    forces = np.array([1.0, 20.0])
    curve = of.force_extension(chain, forces * PN, WARM, [0.06, 0.03], seed=2, processes=1)
    continuous = wlc.extension_exact(forces, 53.0, 300.0, KT, stretch_modulus=1000.0, finite=True)
    z = (curve.extension - curve.bias - continuous) / curve.extension_error
    assert np.abs(z).max() <= tol.SIGMAS
    assert (np.abs(curve.bias) + 2 * curve.extension_error <= np.array([0.06, 0.03]) * curve.extension * 1.001).all()
    assert (curve.bias != 0).all()
    assert (curve.segments >= 4).all()


# The dataset --------------------------------------------------------------------------------------------------------


def test_the_dataset_says_what_was_done(in_process: None) -> None:
    reports: list[Progress] = []
    curve = of.force_extension(
        filament(6), [2.0, 10.0] * PN, WARM, [0.1, 0.05], seed=4, processes=1, progress=reports.append
    )
    assert curve.extension.dims == ("force",)
    np.testing.assert_allclose(curve.force, [2.0, 10.0])
    assert curve.force.attrs["units"] == "pN"
    for name, its_unit in {
        "extension": "nm", "extension_error": "nm", "bias": "nm", "effective_samples": "1", "r_hat": "1", "segments": "1",
        "bond_length": "nm", "time_step": "ps", "friction": "1/ps", "steps": "1", "finished": "1",
    }.items():  # fmt: skip
        assert name in curve
        assert curve[name].attrs["units"] == its_unit, name
    assert np.isnan(curve.bias).all()
    assert (curve.effective_samples > 20).all()
    assert (np.abs(curve.r_hat - 1) < 0.2).all()
    assert (curve.segments == 6).all()
    np.testing.assert_allclose(curve.bond_length, 4.0)
    for key, value in {
        "temperature_K": 298,
        "seed": 4,
        "dimension": 3,
        "platform": "Reference",
        "interrupted": 0,
    }.items():
        assert curve.attrs[key] == value
    assert {"openmm_version", "numpy_version", "openmm_filament_version", "integrator"} <= set(curve.attrs)
    assert reports[-1].finished == 2
    assert reports[-1].fraction == pytest.approx(1)
    assert all(0 < report.fraction <= 1 for report in reports)
    assert sorted({round(report.force, 9) for report in reports}) == [2.0, 10.0]


def test_a_single_force_and_other_units_are_taken(in_process: None) -> None:
    one = of.force_extension(filament(4), 5e-12 * unit.newton, 298 * unit.kelvin, 0.2, seed=1, processes=1)
    same = of.force_extension(filament(4), [5.0] * PN, WARM, 0.2, seed=1, processes=1)
    assert one.extension.shape == (1,)
    np.testing.assert_allclose(one.extension, same.extension, rtol=1e-9)


# Seeds, processes and blocks ----------------------------------------------------------------------------------------


def test_a_seed_gives_the_same_numbers_however_a_planar_run_is_cut(
    in_process: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Shorter blocks, as on another machine's pool: the noise goes on where it stopped."""
    curves = []
    for size in (2e7, 3e3):
        monkeypatch.setattr(sampling, "_BLOCK_BEAD_STEPS", size)
        curves.append(of.force_extension(filament(6), 3 * PN, WARM, 0.2, seed=2, dimension=2, processes=1))
    np.testing.assert_array_equal(curves[0].extension, curves[1].extension)


def test_a_planar_run_lays_its_chain_into_the_plane() -> None:
    """A rest shape along z, where `shapes.line` has it, serves two dimensions as well; one in no plane does not."""
    terms = (stretching.Harmonic(150 * KJ / NM**2), bending.Harmonic(10 * KJ))
    upright = of.Filament(of.shapes.line(5, 4 * NM), 100 * unit.dalton, terms)
    curve = of.force_extension(upright, 3 * PN, WARM, 0.1, seed=2, dimension=2, processes=1)
    z = (curve.extension - curve.exact_discrete) / curve.extension_error
    assert abs(float(z[0])) < tol.SIGMAS
    coil = of.Filament(of.shapes.helix(9, radius=3 * NM, pitch=4 * NM, turns=1), 100 * unit.dalton, terms[:1])
    with pytest.raises(ValueError, match="`chain` must have a rest shape in one plane for dimension 2, but it leaves"):
        of.force_extension(coil, 3 * PN, WARM, 0.1, dimension=2)


def test_a_seed_gives_the_same_numbers_with_one_process_and_with_two(
    in_process: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And without worker processes at all, whatever the order in which blocks end."""

    def sampled(seed: int, **options: Any) -> Any:
        return of.force_extension(filament(6), [1.0, 8.0] * PN, WARM, 0.12, seed=seed, **options)

    here, other = (sampled(seed, processes=1) for seed in (5, 6))
    monkeypatch.undo()
    curves = [sampled(5, processes=n) for n in ((1, 2) if CORES > 1 else (1,))]
    for curve in curves:
        for name in curve:
            np.testing.assert_array_equal(curve[name], here[name], err_msg=name)
    assert (other.extension != here.extension).all()


def block(**changes: Any) -> Block:
    arguments: dict[str, Any] = {
        "filament": filament(6), "force": 3.0, "temperature": 298.0, "dimension": 3, "replicas": 2, "seed": 11,
        "timestep": 0.1, "friction": 0.05, "stride": 20, "samples": 30, "warm_up": 50, "platform": "Reference",
        "keep_frames": True,
    }  # fmt: skip
    return Block(**{**arguments, **changes})


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("cuts", [(10, 20), (29, 1), (7, 8, 15)])
def test_a_block_in_parts_is_the_whole_block_bit_for_bit(cuts: tuple[int, ...], dimension: int) -> None:
    whole = run_block(block(dimension=dimension))
    parts, checkpoint = [], None
    for samples in cuts:
        parts.append(run_block(block(samples=samples, dimension=dimension, checkpoint=checkpoint)))
        checkpoint = parts[-1].checkpoint
        run_block(block(samples=3, seed=99))  # another run of the same process in between does no harm
    np.testing.assert_array_equal(np.concatenate([p.extensions for p in parts], axis=1), whole.extensions)
    np.testing.assert_array_equal(np.concatenate([p.frames for p in parts]), whole.frames)


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_block_that_heats_up_is_stopped_on_the_way(dimension: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not at its end: a block of a million samples, whose thermostat stands at a hundred times what it should."""
    real = blocks.internal_langevin
    monkeypatch.setattr(blocks, "internal_langevin", lambda model, kelvin, *rest: real(model, 100 * kelvin, *rest))
    with pytest.raises(DivergedError, match="heated up to") as caught:
        run_block(block(dimension=dimension, samples=1_000_000, keep_frames=False, friction=1.0))
    assert caught.value.step < 1e5


def test_a_block_has_the_shapes_it_says() -> None:
    result = run_block(block())
    assert result.extensions.shape == (2, 30)
    assert result.frames.shape == (30, 7, 3)
    assert result.frames.dtype == np.float32
    assert result.seconds > 0
    np.testing.assert_allclose(
        result.frames[:, -1, 2] - result.frames[:, 0, 2], result.extensions[0], rtol=1e-6, atol=1e-5
    )
    assert run_block(block(keep_frames=False)).frames is None
    planar = run_block(block(dimension=2))
    assert not planar.frames[..., 2].any()
    np.testing.assert_allclose(
        planar.frames[:, -1, 0] - planar.frames[:, 0, 0], planar.extensions[0], rtol=1e-6, atol=1e-5
    )


def diverges(bad: Callable[[Block], bool]) -> Callable[[Block], Any]:
    """`run_block`, but for blocks that are bad."""

    def run(given: Block) -> Any:
        if bad(given):
            raise DivergedError(f"The run diverged at seed {given.seed}.", 3, "stretching", 7, np.zeros((7, 3)) * NM)
        return run_block(given)

    return run


def test_where_every_force_diverges_the_error_is_raised(in_process: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sampling, "run_block", diverges(lambda given: True))
    for forces in ([1.0], [1.0, 2.0, 3.0]):
        with pytest.raises(DivergedError, match="diverged"):
            of.force_extension(filament(6), forces * PN, WARM, 0.1, processes=1)


@pytest.mark.parametrize("late", [False, True], ids=["at once", "in a later round"])
def test_a_force_that_diverges_leaves_the_others(
    in_process: None, monkeypatch: pytest.MonkeyPatch, late: bool, tmp_path: Path
) -> None:
    """They get the numbers that they get without it; it gets none, a warning and a mark."""
    reports: list[Progress] = []
    paths = {i: tmp_path / f"{i}.dcd" for i in range(3)}

    def sampled(**options: Any) -> Any:
        return of.force_extension(filament(6), [1.0, 4.0, 9.0] * PN, WARM, 0.1, seed=3, processes=1, **options)

    whole = sampled()
    force = 4 * 0.602214076
    monkeypatch.setattr(
        sampling, "run_block", diverges(lambda b: math.isclose(b.force, force) and (b.checkpoint is None) != late)
    )
    with pytest.warns(UserWarning, match=r"The run at 4 pN is given up: The run diverged at seed \d+\.") as caught:
        curve = sampled(progress=reports.append, trajectories=paths)
    assert len(caught) == 1
    assert curve.diverged.values.tolist() == [0, 1, 0]
    assert curve.finished.values.tolist() == [1, 0, 1]
    for name in ("extension", "extension_error", "effective_samples", "r_hat"):
        assert np.isnan(curve[name][1]), name
        np.testing.assert_array_equal(curve[name][[0, 2]], whole[name][[0, 2]], err_msg=name)
    assert not whole.diverged.any()
    assert curve.attrs["interrupted"] == 0
    assert reports[-1].finished == 2
    assert reports[-1].fraction == pytest.approx(1)
    assert all(0 <= report.fraction <= 1 for report in reports)
    assert all(of.load(paths[i]).n_frames > 20 for i in (0, 2))


def test_ctrl_c_after_a_force_has_diverged_keeps_the_others(in_process: None, monkeypatch: pytest.MonkeyPatch) -> None:
    def progress(report: Progress) -> None:
        if report.finished:
            raise KeyboardInterrupt

    monkeypatch.setattr(sampling, "run_block", diverges(lambda b: b.force > 4))
    with pytest.warns(UserWarning, match="The run at 9 pN is given up"):
        curve = of.force_extension(filament(6), [4.0, 9.0] * PN, WARM, 0.1, processes=1, progress=progress)
    assert curve.attrs["interrupted"] == 1
    assert np.isnan(curve.extension[1])
    assert np.isfinite(curve.extension[0])


def test_a_force_that_diverges_in_a_worker_leaves_the_others() -> None:
    """A helix under a dihedral: at 2000 pN its joints come into line, where no step is short enough."""
    rest = of.shapes.helix(20, radius=3 * NM, pitch=5 * NM, turns=2)
    terms = (stretching.Harmonic(500 * KJ / NM**2), bending.Harmonic(200 * KJ), of.torsion.Harmonic(100 * KJ))
    chain = of.Filament(rest, 300 * unit.dalton, terms)
    step = 0.2 * of.stable_timestep(of.build(chain))
    with pytest.warns(UserWarning, match=r"The run at 2000 pN is given up: .*(diverged|heated up)"):
        curve = of.force_extension(chain, [2.0, 2000.0] * PN, WARM, 0.2, timestep=step, processes=1)
    assert curve.diverged.values.tolist() == [0, 1]
    assert np.isfinite(curve.extension[0])


# Chains in shapes of their own --------------------------------------------------------------------------------------


def double_well() -> of.Filament:
    """In the plane, four stiff bent joints flip once in a long while, over 44 k_B T; three soft ones move."""
    alpha, beta = np.repeat([150.0, 3.0], [4, 3]), np.repeat([1.2, 0.0], [4, 3])
    terms = (stretching.Harmonic(150 * KJ / NM**2), bending.Harmonic(alpha * KJ, beta * unit.radian))
    return of.Filament(of.shapes.line(8, 4 * NM)[:, [2, 0, 1]], 100 * unit.dalton, terms)


def test_chains_stuck_in_separate_wells_are_told_of(in_process: None) -> None:
    """While they run, as the error that is asked for would take very long."""

    with pytest.raises(
        UserWarning, match=r"in shapes of their own at 1 pN \(R-hat 1\.\d+\): the error falls only as fast"
    ):
        of.force_extension(double_well(), 1 * PN, WARM, 0.03, seed=1, dimension=2, processes=1)


def test_forces_that_end_with_chains_apart_are_told_of(in_process: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sampling._Point, "is_apart", property(lambda point: point.force > 3))
    with pytest.warns(
        UserWarning, match=r"at 4 pN \(R-hat 1\.\d+\), 9 pN \(R-hat .*\): the estimate .* rest"
    ) as caught:
        of.force_extension(filament(6), [1.0, 4.0, 9.0] * PN, WARM, 0.2, seed=1, processes=1)
    assert len(caught) == 1


@pytest.mark.parametrize(("samples", "correlation"), [(20, 0.0), (200, 0.0), (80, 0.8), (400, 0.8)])
def test_chains_about_one_mean_are_not_told_apart_and_those_about_two_are(samples: int, correlation: float) -> None:
    """Random numbers in 100 trials; R-hat of short correlated chains about one mean is above 1.05 in most."""
    rng = np.random.default_rng(1)
    found, r_hats = {0.0: 0, 3.0: 0}, []
    for _ in range(100):
        noise = rng.normal(size=(8, samples + 30))
        for i in range(1, noise.shape[1]):
            noise[:, i] = correlation * noise[:, i - 1] + math.sqrt(1 - correlation**2) * noise[:, i]
        for apart in found:
            chains = noise[:, 30:] + apart * np.repeat([-0.5, 0.5], 4)[:, None]
            runs = [sampling._Run(block(), samples, [chains[i : i + 2]]) for i in range(0, 8, 2)]
            point = sampling._Point(1.0, 0.1, 0.0, runs)
            point._estimate(samples)
            found[apart] += point.is_apart
            r_hats += [point.r_hat] if not apart else []
    assert found[0.0] <= 1
    assert found[3.0] >= 90
    assert (np.median(r_hats) > 1.05) == (samples == 80)


# Trajectories -------------------------------------------------------------------------------------------------------


def test_trajectories_hold_the_samples_of_one_chain(in_process: None, tmp_path: Path) -> None:
    forces = [1.0, 10.0]
    paths = {1: tmp_path / "trajectory_10pN.dcd"}
    curve = of.force_extension(filament(6), forces * PN, WARM, 0.1, seed=1, processes=1, trajectories=paths)
    back = of.load(paths[1])
    lines = paths[1].with_suffix(".jsonl").read_text().splitlines()
    header, frames = json.loads(lines[0]), [json.loads(line) for line in lines[1:]]
    said = np.array([frame["extension_nm"] for frame in frames])
    extensions = back.xyz[:, -1, 2].astype(float) - back.xyz[:, 0, 2]
    np.testing.assert_allclose(extensions, said, rtol=0, atol=tol.MDTRAJ * np.abs(back.xyz).max())
    assert header["loads"][0]["held"] == [0]
    np.testing.assert_allclose(header["loads"][0]["pulls_kJ_per_mol_nm"]["6"], [0, 0, 6.02214076])
    assert back.time[0] == 0  # the start, which is no sample; then the warm-up
    assert not set(said[:1]) & set(said[1:])
    stride = np.diff(back.time[1:])
    np.testing.assert_allclose(stride, stride[0], rtol=1e-9)
    np.testing.assert_allclose(back.time, [frame["step"] * float(curve.time_step[1]) for frame in frames], rtol=1e-9)
    assert stride[0] * (back.n_frames - 1) == pytest.approx(float(curve.steps[1] * curve.time_step[1]))
    spread = said.std() / math.sqrt(len(said) / 10)
    assert abs(said.mean() - float(curve.extension[1])) < 5 * spread
    assert {f.suffix for f in tmp_path.iterdir()} == {".dcd", ".jsonl", ".pdb"}
    with pytest.raises(FileExistsError, match="pass overwrite=True"):
        of.force_extension(filament(6), forces * PN, WARM, 0.1, processes=1, trajectories=paths)
    of.force_extension(filament(6), forces * PN, WARM, 0.3, processes=1, trajectories=paths, overwrite=True)


def test_keeping_a_trajectory_changes_no_number(in_process: None, tmp_path: Path) -> None:
    kept, bare = (
        of.force_extension(filament(4), 5 * PN, WARM, 0.2, seed=1, processes=1, trajectories=paths)
        for paths in ({0: tmp_path / "run.dcd"}, None)
    )
    np.testing.assert_array_equal(kept.extension, bare.extension)


# Ctrl-C -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("after", [1, 9])
def test_ctrl_c_keeps_what_is_done(in_process: None, after: int, tmp_path: Path) -> None:
    seen: list[Progress] = []

    def progress(report: Progress) -> None:
        seen.append(report)
        if len(seen) == after:
            raise KeyboardInterrupt

    curve = of.force_extension(
        filament(10),
        [0.3, 5.0] * PN,
        WARM,
        0.02,
        seed=1,
        processes=1,
        progress=progress,
        trajectories={0: tmp_path / "run.dcd"},
    )
    assert curve.attrs["interrupted"] == 1
    assert not curve.finished.all()
    assert curve.extension.shape == (2,)
    if after > 1:
        assert np.isfinite(curve.extension).any()
        assert of.load(tmp_path / "run.dcd").n_frames >= 20
        done = np.isfinite(curve.extension)
        z = (curve.extension - exact(filament(10), [0.3, 5.0], 3)) / curve.extension_error
        assert (np.abs(z[done]) < 6).all()


def test_ctrl_c_keeps_what_is_done_with_processes() -> None:
    def progress(report: Progress) -> None:
        raise KeyboardInterrupt

    curve = of.force_extension(filament(6), [2.0] * PN, WARM, 0.005, processes=1, progress=progress)
    assert curve.attrs["interrupted"] == 1


# Refused ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"relative_error": 0.0}, ValueError, r"`relative_error` must lie in \(0, 1\), but is 0\.0"),
        ({"relative_error": 1.0}, ValueError, r"`relative_error` must lie in \(0, 1\), but is 1\.0"),
        ({"relative_error": -0.1}, ValueError, r"`relative_error` must lie in \(0, 1\), but is -0\.1"),
        ({"relative_error": math.nan}, ValueError, "`relative_error` must be finite, but is nan"),
        ({"relative_error": [0.1, 0.1]}, ValueError, r"`relative_error` must have shape \(1,\), but has shape \(2,\)"),
        ({"relative_error": "fine"}, TypeError, "`relative_error` must be numeric, but is 'fine'"),
        ({"forces": -1 * PN}, ValueError, "`forces` must be positive, but is -"),
        ({"forces": [1.0, 0.0] * PN}, ValueError, r"`forces` must be positive, but is 0\.0 at index 1"),
        (
            {"forces": [1.0, 3.0, 1.0] * PN},
            ValueError,
            "`forces` must hold no value twice, but holds 1 pN at index 0 and at index 2",
        ),
        ({"forces": [] * PN}, ValueError, "`forces` must hold at least one force, but is empty"),
        ({"forces": 1.0}, TypeError, r"`forces` must be a Quantity of force .* but is 1\.0 without a unit"),
        ({"forces": 1 * NM}, TypeError, "`forces` must have a unit of force"),
        ({"temperature": 298}, TypeError, "`temperature` must be a Quantity of temperature"),
        ({"temperature": 0 * unit.kelvin}, ValueError, r"`temperature` must be positive, but is 0\.0"),
        ({"seed": -1}, ValueError, "`seed` must be at least 0, but is -1"),
        ({"seed": 1.0}, TypeError, r"`seed` must be a whole number, but is 1\.0"),
        ({"dimension": 4}, ValueError, "`dimension` must be one of 2, 3, but is 4"),
        ({"platform": "Abacus"}, ValueError, "`platform` must be one of 'Reference'.*, but is 'Abacus'"),
        ({"processes": 0}, ValueError, "`processes` must be at least 1, but is 0"),
        ({"trajectories": {1: "run.dcd"}}, ValueError, "`trajectories` must be at most 0, but is 1"),
        ({"trajectories": {0: "run.xtc"}}, ValueError, r"`path` must end in \.dcd, but is run\.xtc"),
        ({"chain": "DNA"}, TypeError, "`chain` must be a WormlikeChain or a Filament, but is 'DNA'"),
        (
            {"chain": of.WormlikeChain(300 * NM, 53 * NM), "dimension": 2},
            ValueError,
            "`dimension` must be 3 for a WormlikeChain",
        ),
        (
            {"chain": of.Filament(of.shapes.ring(6, 4 * NM), 100 * unit.dalton, filament().terms, closed=True)},
            ValueError,
            "`chain` must be an open filament",
        ),
        (
            {"chain": of.WormlikeChain(300 * NM, 53 * NM), "relative_error": 1e-7},
            ValueError,
            r"`relative_error` must be well above the discretisation error .*, but is 1e-07",
        ),
    ],
)
def test_bad_arguments_are_refused_before_anything_runs(
    change: dict[str, Any], error: type[Exception], message: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)

    def run(*_: Any, **__: Any) -> None:
        raise AssertionError("something ran")

    monkeypatch.setattr(sampling, "_sample", run)
    arguments = {"chain": filament(6), "forces": 1 * PN, "temperature": WARM, "relative_error": 0.1, **change}
    with pytest.raises(error, match=message):
        of.force_extension(**arguments)
    assert not list(tmp_path.iterdir())


def test_more_processes_than_cores_are_warned_of(in_process: None) -> None:
    with pytest.warns(
        UserWarning, match=rf"`processes` is {CORES + 3}, but this process may use {CORES} cores: running {CORES}"
    ):
        of.force_extension(filament(4), 5 * PN, WARM, 0.3, processes=CORES + 3)


# The exact chain ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", CURVES)
def test_the_exact_chain_of_a_filament_has_its_numbers(name: str) -> None:
    chain, forces, dimension = CURVES[name]
    np.testing.assert_allclose(
        exact_chain(chain, WARM).extension(forces, dimension), exact(chain, forces, dimension), rtol=1e-9
    )


def test_filaments_without_exact_theory_have_none() -> None:
    two = (stretching.Harmonic(150 * KJ / NM**2), bending.Harmonic(10 * KJ))
    uneven = stretching.Harmonic(np.linspace(100, 200, 6) * KJ / NM**2)
    line = of.shapes.line(6, 4 * NM)
    for rest, terms, closed in (
        (line, two[:1], False), (line, two[1:], False), (line, (*two, of.torsion.Weighted(1 * KJ)), False),
        (line, (uneven, two[1]), False), (line, (two[0], two[0], two[1]), False), (of.shapes.ring(6, 4 * NM), two, True),
    ):  # fmt: skip
        assert exact_chain(of.Filament(rest, 1 * unit.dalton, terms, closed=closed), WARM) is None


def test_blocks_know_their_checkpoint_alone() -> None:
    """Two blocks are told apart by identity; a copy with a checkpoint is another block."""
    first = block()
    assert replace(first, checkpoint=b"x") != first


def test_one_file_for_two_forces_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.dcd"
    with pytest.raises(ValueError, match="`trajectories` must name a file for each force, but names one twice"):
        of.force_extension(filament(4), [1, 2] * PN, WARM, 0.1, trajectories={0: path, 1: str(path)})
    assert not path.exists()


def test_an_inextensible_chain_is_sampled_at_forces_that_soft_bonds_would_not_stand() -> None:
    chain = of.WormlikeChain(200 * NM, 53 * NM)
    curve = of.force_extension(chain, [10, 60] * PN, WARM, 0.05, seed=1)
    exact = wlc.extension_exact(
        [10, 60], 53, 200, WARM.value_in_unit(unit.kelvin) * of.units.BOLTZMANN / 0.602214076, finite=True
    )
    assert (np.abs(curve.extension / exact - 1) < 0.05).all()
