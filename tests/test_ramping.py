"""Work of ramps of Gaussian chains, exact at the very time step and jumps that are run, and of clamps by quadrature."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
import tolerances as tol
from conftest import KJ, NM, Array
from openmm import unit
from scipy import stats

import openmm_filament as of
from openmm_filament import ramping
from openmm_filament.divergence import DivergedError
from openmm_filament.ramping import Ramp, run_ramp

KELVIN = 300.0
KT = of.units.BOLTZMANN * KELVIN
BOND, MASS, TRAP = 40.0, 30.0, 15.0  # kJ/mol/nm^2, Da
REST = 1e-7  # nm: the mean force of a spring is off by BOND REST in the direction of its bond
STEP = 0.7 * 2 / np.sqrt(3 * BOND / MASS)  # ps, of two bonds' stiffest mode
RATE, JUMPS, STRIDE = 0.4, 20, 3

ENDS = {"force": (0.0, 60.0), "extension": (0.2, 4.5), "trap": (0.3, 6.0)}


def gaussian(bonds: int = 2) -> of.Filament:
    """Bonds of hardly any rest length: springs."""
    terms = (of.stretching.Harmonic(BOND * KJ / NM**2, REST * NM),)
    return of.Filament(of.shapes.line(bonds, 1 * NM), MASS * unit.dalton, terms)


def ramp(control: Any, replicas: int, **changes: Any) -> Ramp:
    first, last = ENDS[control]
    values = np.linspace(first, last, JUMPS + 1)
    stiffness = np.full(3, TRAP if control == "trap" else np.nan)
    settings: dict[str, Any] = {
        "filament": gaussian(),
        "control": control,
        "values": values,
        "stiffness": stiffness,
        "tensions": (first if control == "force" else 3.0, last),
        "temperature": KELVIN,
        "replicas": replicas,
        "seed": 7,
        "timestep": STEP,
        "friction": RATE,
        "warm_up": 200,
        "stride": STRIDE,
        "every": 4,
        "back": True,
    }
    return Ramp(**(settings | changes))


@cache
def ran(control: str) -> tuple[Ramp, ramping.RampResult]:
    task = ramp(control, 1500)
    return task, run_ramp(task)


def springs(control: str) -> tuple[Array, Callable[[float], Array], Callable[[float, float, Array], float], float]:
    """Stiffness matrix of the free z, force on them at a value, work of a jump at their mean, and free energy of both ends."""
    first, last = ENDS[control]
    if control == "extension":
        return (
            np.array([[2 * BOND]]),
            lambda value: np.array([BOND * value]),
            lambda old, new, z: BOND / 2 * ((new - z[0]) ** 2 - (old - z[0]) ** 2),
            BOND / 4 * (last**2 - first**2),
        )
    matrix = np.array([[2 * BOND, -BOND], [-BOND, BOND]])
    if control == "force":
        return (
            matrix,
            lambda value: np.array([0.0, value]),
            lambda old, new, z: -(new - old) * z[1],
            -(last**2 - first**2) / BOND,
        )
    series = 1 / (1 / TRAP + 2 / BOND)
    return (
        matrix + np.diag([0.0, TRAP]),
        lambda value: np.array([0.0, TRAP * value]),
        lambda old, new, z: TRAP / 2 * ((new - z[1]) ** 2 - (old - z[1]) ** 2),
        series / 2 * (last**2 - first**2),
    )


def mean_work(control: str, values: Array) -> float:
    """By the motion of the means under the symmetric splitting: half kicks, drifts about the damping, half kicks."""
    matrix, push, work, _ = springs(control)
    z = np.linalg.solve(matrix, push(values[0]))
    v = np.zeros_like(z)
    total = 0.0
    for old, new in itertools.pairwise(values):
        total += work(old, new, z)
        for _ in range(STRIDE):
            v = v + STEP / 2 / MASS * (push(new) - matrix @ z)
            z = z + STEP / 2 * v
            v = np.exp(-RATE * STEP) * v
            z = z + STEP / 2 * v
            v = v + STEP / 2 / MASS * (push(new) - matrix @ z)
    return total


@pytest.mark.parametrize("control", ENDS)
def test_the_work_of_a_gaussian_chain_is_normal_with_the_exact_mean_and_variance(control: str) -> None:
    """Mean by the equations of motion; variance, by the fluctuation theorem, 2 k_B T times what is dissipated."""
    task, result = ran(control)
    change = springs(control)[3]
    for works, values, sign in zip(result.work[:, :, -1], (task.values, task.values[::-1]), (1, -1), strict=True):
        mean = mean_work(control, values)
        dissipated = mean - sign * change
        assert dissipated > 0.5 * KT
        deviation = (works.mean() - mean) / np.sqrt(2 * KT * dissipated / len(works))
        assert abs(deviation) < tol.SIGMAS
        squares = len(works) * works.var() / (2 * KT * dissipated)
        assert tol.CHI_SQUARED / 2 < stats.chi2.cdf(squares, len(works) - 1) < 1 - tol.CHI_SQUARED / 2
        assert stats.kstest((works - mean) / np.sqrt(2 * KT * dissipated), "norm").pvalue > tol.CHI_SQUARED


@pytest.mark.parametrize("control", ENDS)
def test_without_the_half_kicks_the_work_would_be_wrong(control: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a script that only sets the parameter between OpenMM's steps gets."""
    begin = ramping._Led.__init__

    def kickless(self: Any, task: Ramp) -> None:
        begin(self, task)
        self.kick = 0 * self.kick

    monkeypatch.setattr(ramping._Led, "__init__", kickless)
    task = ramp(control, 1500)
    works = run_ramp(task).work[0, :, -1]
    error = works.std() / np.sqrt(len(works))
    assert abs(works.mean() - mean_work(control, task.values)) > 2 * tol.SIGMAS * error


@pytest.mark.parametrize("control", ENDS)
def test_records_begin_in_equilibrium_and_tell_force_and_extension(control: str) -> None:
    task, result = ran(control)
    assert result.work.shape == result.force.shape == result.extension.shape == (2, 1500, JUMPS // 4 + 1)
    assert not result.work[:, :, 0].any()
    matrix, push, _, _ = springs(control)
    for direction, value in enumerate(ENDS[control]):
        z = np.linalg.solve(matrix, push(value))[-1] if control != "extension" else value
        forces = {"force": value, "extension": BOND / 2 * value, "trap": TRAP * (value - z)}
        for found, exact in ((result.extension, z), (result.force, forces[control])):
            first = found[direction, :, 0]
            error = first.std() / np.sqrt(len(first))
            assert abs(first.mean() - exact) < tol.SIGMAS * error + BOND * REST
    if control == "trap":
        led = np.stack([task.values[::4], task.values[::-4]])[:, None]
        np.testing.assert_allclose(result.force, TRAP * (led - result.extension), rtol=0, atol=1e-10)


def test_a_trap_one_per_cent_stiffer_would_be_seen() -> None:
    task = ramp("trap", 1500, stiffness=np.full(3, 1.01 * TRAP))
    works = run_ramp(task).work[0, :, -1]
    error = works.std() / np.sqrt(len(works))
    assert abs(works.mean() - mean_work("trap", task.values)) > tol.SIGMAS * error


def test_jarzynski_averages_to_one_for_a_fast_ramp() -> None:
    works = ran("trap")[1].work[:, :, -1]
    change = springs("trap")[3]
    for work, sign in zip(works, (1, -1), strict=True):
        weights = np.exp(-(work - sign * change) / KT)
        assert abs(weights.mean() - 1) < tol.SIGMAS * weights.std() / np.sqrt(len(weights))


def test_a_scaled_model_does_the_same_work() -> None:
    """A chain a hundred times smaller with bonds 1e4 times stiffer is the same one in other units."""
    small = of.Filament(
        of.shapes.line(2, 0.01 * NM),
        MASS * unit.dalton,
        (of.stretching.Harmonic(1e4 * BOND * KJ / NM**2, 1e-9 * NM),),
    )
    task = ramp("trap", 300)
    scaled = ramp(
        "trap",
        300,
        filament=small,
        values=task.values / 100,
        stiffness=task.stiffness * 1e4,
        tensions=tuple(100 * f for f in task.tensions),
        timestep=STEP / 100,
        friction=RATE * 100,
    )
    assert not ramping.controlled_model(small, "trap", 0.0, 0.0, task.stiffness, 1).scale.is_identity
    works = run_ramp(scaled).work[0, :, -1]
    mean = mean_work("trap", task.values)
    assert abs(works.mean() - mean) < tol.SIGMAS * works.std() / np.sqrt(len(works))


def test_a_run_that_diverges_says_so() -> None:
    with pytest.raises(DivergedError):
        run_ramp(ramp("force", 4, timestep=4 * STEP))
