"""The choice of a platform: Reference for small chains, properties for GPUs alone, and OpenCL held against Reference."""

from __future__ import annotations

import warnings

import numpy as np
import openmm as mm
import pytest
import tolerances as tol
from conftest import KJ, NM, random_chain
from openmm import unit

import openmm_filament as of
from openmm_filament import bending, platforms, stretching, torsion
from openmm_filament.inspection import PreflightError, PreflightWarning

GPU = ("CUDA", "HIP", "OpenCL")
AVAILABLE = [mm.Platform.getPlatform(i).getName() for i in range(mm.Platform.getNumPlatforms())]
TERMS = (stretching.Harmonic(200 * KJ / NM**2), bending.Harmonic(20 * KJ), torsion.Harmonic(3 * KJ))


def chain(beads: int, stiffness: float = 20.0) -> of.Filament:
    terms = (stretching.Harmonic(200 * KJ / NM**2), bending.Harmonic(stiffness * KJ))
    return of.Filament(of.shapes.line(beads - 1, 1 * NM), 10 * unit.dalton, terms)


@pytest.fixture
def opencl() -> mm.Platform:
    """OpenCL, where a device of it can run a Context in double precision."""
    if "OpenCL" not in AVAILABLE:
        pytest.skip("OpenMM has no OpenCL platform here")
    platform = mm.Platform.getPlatformByName("OpenCL")
    try:
        mm.Context(of.build(chain(3)).system, mm.VerletIntegrator(0.001), platform, {"Precision": "double"})
    except mm.OpenMMException as error:
        pytest.skip(f"OpenCL has no device with double precision here: {error}")
    return platform


def opencl_context(model: of.Model, platform: mm.Platform, precision: str, x: unit.Quantity) -> mm.Context:
    context = mm.Context(model.system, mm.VerletIntegrator(1e-4), platform, {"Precision": precision})
    context.setPositions(x)
    return context


def test_a_small_chain_runs_on_reference() -> None:
    assert of.fastest_platform(of.build(chain(10))).getName() == "Reference"
    assert of.fastest_platform(of.build(chain(10)), 298 * unit.kelvin).getName() == "Reference"


def test_no_other_platform_is_started_where_it_cannot_win(monkeypatch: pytest.MonkeyPatch) -> None:
    measured = []

    def seconds(model: of.Model, name: str, properties: dict[str, str]) -> float:
        measured.append(name)
        return 2e-6

    monkeypatch.setattr(platforms, "_seconds_per_step", seconds)
    monkeypatch.setattr(platforms, "_measured", {})
    assert of.fastest_platform(of.build(chain(10))).getName() == "Reference"
    assert measured == ["Reference"]


def test_the_platform_that_is_fastest_is_chosen_and_the_measurement_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    measured = []

    def seconds(model: of.Model, name: str, properties: dict[str, str]) -> float:
        measured.append((name, properties))
        return {"Reference": 1e-2, "CPU": 1e-3}.get(name, 1e-1)

    monkeypatch.setattr(platforms, "_seconds_per_step", seconds)
    monkeypatch.setattr(platforms, "_measured", {})
    for _ in range(2):
        assert of.fastest_platform(of.build(chain(5000))).getName() == "CPU"
    assert [name for name, _ in measured] == ["Reference", *(name for name in AVAILABLE if name != "Reference")]
    assert all(properties == ({"Precision": "double"} if name in GPU else {}) for name, properties in measured)


def test_a_platform_that_cannot_run_the_model_is_passed_over_with_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    def seconds(model: of.Model, name: str, properties: dict[str, str]) -> float:
        if name == "Reference":
            return 1.0
        raise mm.OpenMMException("no such device")

    monkeypatch.setattr(platforms, "_seconds_per_step", seconds)
    monkeypatch.setattr(platforms, "_measured", {})
    with pytest.warns(UserWarning, match=r"Platform \w+ cannot run this model .*no such device") as caught:
        assert of.fastest_platform(of.build(chain(5000))).getName() == "Reference"
    assert len(caught) == len(AVAILABLE) - 1


def test_choosing_leaves_the_defaults_of_platforms_alone() -> None:
    """A Platform is one object per process: what is set on it would reach every other Context."""
    before = {n: _defaults(n) for n in AVAILABLE}
    of.fastest_platform(of.build(chain(300)))
    assert {n: _defaults(n) for n in AVAILABLE} == before


def _defaults(name: str) -> dict[str, str]:
    platform = mm.Platform.getPlatformByName(name)
    return {key: platform.getPropertyDefaultValue(key) for key in platform.getPropertyNames()}


@pytest.mark.parametrize("name", AVAILABLE)
def test_properties_are_for_gpus_alone(name: str) -> None:
    properties = of.platform_properties(of.build(chain(10)), mm.Platform.getPlatformByName(name))
    assert properties == ({"Precision": "double"} if name in GPU else {})


@pytest.mark.parametrize(
    ("stiffness", "kelvin", "precision"),
    [(20.0, None, "double"), (20.0, 298, "mixed"), (1e5, 298, "double"), (20.0, 1e-3, "double")],
)
def test_small_angles_need_double_precision(stiffness: float, kelvin: float | None, precision: str) -> None:
    """At rest a straight chain has none but the smallest angles; warm, its angles are sqrt(k_B T/alpha)."""
    temperature = None if kelvin is None else kelvin * unit.kelvin
    assert platforms.needed_precision(of.build(chain(10, stiffness)), temperature) == precision


def test_a_warm_bent_chain_and_one_without_bending_need_no_double_precision_and_a_cold_one_does() -> None:
    bent = of.Filament(of.shapes.ring(12, 1 * NM), 10 * unit.dalton, TERMS[:2])
    springs = of.Filament(of.shapes.line(12, 1 * NM), 10 * unit.dalton, TERMS[:1])
    for filament in (bent, springs):
        assert platforms.needed_precision(of.build(filament), 298 * unit.kelvin) == "mixed"
        assert platforms.needed_precision(of.build(filament)) == "double"


# OpenCL -------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_opencl_in_double_precision_agrees_with_reference(opencl: mm.Platform, rng: np.random.Generator) -> None:
    x = random_chain(rng, 20) * NM
    model = of.build(of.Filament(x, 10 * unit.dalton, TERMS), [of.loads.Pull(-1, (1, 2, 3) * unit.piconewton)])
    moved = (x.value_in_unit(NM) + 0.1 * rng.normal(size=(20, 3))) * NM
    context = opencl_context(model, opencl, "double", moved)
    found = context.getState(forces=True).getForces(asNumpy=True).value_in_unit(KJ / NM)
    expected = of.forces(model, moved)
    np.testing.assert_allclose(found, expected, rtol=0, atol=tol.OPENCL * np.abs(expected).max())
    assert of.preflight(model, context).force_errors["bending"] < tol.OPENCL


@pytest.mark.slow
def test_single_precision_at_rest_on_a_straight_chain_is_warned_of(opencl: mm.Platform) -> None:
    """All forces vanish there, so that nothing but the angles tells."""
    model = of.build(chain(12))
    with pytest.warns(PreflightWarning, match="in single precision: below 3e-4 rad the bending force is lost there"):
        of.preflight(model, opencl_context(model, opencl, "single", model.positions))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        of.preflight(model, opencl_context(model, opencl, "double", model.positions))


@pytest.mark.slow
@pytest.mark.parametrize("size", [1e-5, 4e-4])
def test_single_precision_with_tiny_angles_is_refused_or_warned_of(opencl: mm.Platform, size: float) -> None:
    model = of.build(chain(12))
    x = model.positions.value_in_unit(NM).copy()
    x[:, 0] = size * np.sin(np.arange(12.0))
    single = opencl_context(model, opencl, "single", x * NM)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises((PreflightError, PreflightWarning), match="OpenCL in single precision"):
            of.preflight(model, single)
    double = opencl_context(model, opencl, "double", x * NM)
    if size > 1e-4:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            of.preflight(model, double)
    else:  # strains of 1e-10, and forces summed in steps of 2e-10 kJ/mol/nm
        with pytest.warns(PreflightWarning, match="Forces of stretching .* on OpenCL in double precision"):
            of.preflight(model, double)


@pytest.mark.slow
def test_properties_suit_a_context(opencl: mm.Platform) -> None:
    model = of.build(chain(10))
    context = mm.Context(model.system, mm.VerletIntegrator(1e-3), opencl, of.platform_properties(model, opencl))
    assert opencl.getPropertyValue(context, "Precision") == "double"


def test_a_platform_may_be_named() -> None:
    model = of.build(chain(10))
    for i in range(mm.Platform.getNumPlatforms()):
        platform = mm.Platform.getPlatform(i)
        assert of.platform_properties(model, platform.getName()) == of.platform_properties(model, platform)
    with pytest.raises(ValueError, match="`platform` must be one of .*, but is 'Abacus'"):
        of.platform_properties(model, "Abacus")
