"""The import graph flows one way; importing is cheap; every public name exists and is documented."""

from __future__ import annotations

import ast
import importlib
import inspect
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import pytest
import tolerances as tol

import openmm_filament as of

PACKAGE = Path(of.__file__).parent

LAYERS: tuple[tuple[str, ...], ...] = (
    ("_checks",),
    ("units", "geometry", "wlc.numerics", "analysis.spectra"),
    (
        "_term",
        "wlc.reduced",
        "wlc.bonds",
        "wlc.joints",
        "wlc.moments",
        "analysis.peaks",
        "analysis.projection",
        "analysis.averages",
    ),
    ("wlc.chain", "wlc.interpolations", "wlc.limits", "wlc.flexible", "wlc.tangents"),
    (
        "wlc.planar",
        "wlc.spatial",
        "wlc.continuous",
        "analysis.ringing",
        "analysis.pitch",
        "analysis.chains",
        "analysis.solid_angles",
    ),
    (
        "wlc.discrete",
        "analysis.sizes",
        "analysis.tangents",
        "analysis.entanglement",
        "analysis.contacts",
        "analysis.curves",
        "analysis.least_squares",
    ),
    ("stretching", "bending", "torsion", "electrostatics", "contact", "traps", "loads", "shapes", "wlc"),
    ("filament", "analysis.extension_models"),
    ("analysis.force_extension",),
    ("analysis",),
    ("sound",),
    ("binding",),
    ("reference", "rods", "model"),
    ("evaluation", "hessian", "refusals"),
    ("_drawing", "_opengl", "_stage", "rendering"),
)
"""From the ground up: a module imports from lower layers, or from its own layer as long as there is no circle.

Modules not named here (time steps, integrators, sampling, files) stand above all of these.
"""

MODULES = {
    ".".join(path.relative_to(PACKAGE).with_suffix("").parts).removesuffix(".__init__"): path
    for path in PACKAGE.rglob("*.py")
}
"""The path of each module; a package goes by its own name, the outermost one by "__init__"."""


def imported(path: Path) -> set[str]:
    """Every module that a file names in an import, wherever it stands."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name} has a relative import"
            names.update(f"{node.module}.{alias.name}" for alias in node.names)
    return names


def siblings(module: str) -> set[str]:
    """The modules of the package that `module` imports."""
    found = set()
    for name in imported(MODULES[module]):
        parts = name.split(".")
        if parts[0] == "openmm_filament":
            dotted = [".".join(parts[1:i]) for i in range(len(parts), 1, -1)]
            found.update([d for d in dotted if d in MODULES][:1])
    return found - {module}


def run(code: str) -> str:
    return subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout


def test_every_named_layer_exists() -> None:
    assert {name for layer in LAYERS for name in layer} <= set(MODULES)


def test_imports_flow_one_way() -> None:
    height = {name: i for i, layer in enumerate(LAYERS) for name in layer}
    above = len(LAYERS)
    upward = [
        f"{module} imports {other}"
        for module in MODULES
        for other in siblings(module)
        if height.get(other, above) > height.get(module, above)
    ]
    assert upward == []


def test_imports_make_no_circle() -> None:
    graph = {module: siblings(module) for module in MODULES}
    assert len(list(TopologicalSorter(graph).static_order())) == len(MODULES)  # raises CycleError on a circle


def test_the_package_does_not_import_its_users() -> None:
    outside = {f"{module}: {name}" for module, path in MODULES.items() for name in imported(path)}
    assert not [line for line in outside if line.split(": ")[1].split(".")[0] in {"systems", "tests", "conftest"}]


@pytest.mark.parametrize(
    "module", [m for m in MODULES if m.startswith(("wlc", "analysis", "_checks", "geometry", "_drawing"))]
)
def test_theory_and_geometry_name_no_heavy_package(module: str) -> None:
    heavy = {"openmm", "mdtraj", "matplotlib", "pyvista", "xarray", "rich", "arviz_stats"}
    assert not {name.split(".")[0] for name in imported(MODULES[module])} & heavy


@pytest.mark.parametrize("module", ["wlc", "analysis"])
def test_theory_and_analysis_load_no_heavy_package(module: str) -> None:
    loaded = run(f"import sys, openmm_filament.{module}; print(*{{m.split('.')[0] for m in sys.modules}})").split()
    assert not {"openmm", "mdtraj", "matplotlib", "xarray", "simtk"} & set(loaded)


def test_the_package_itself_loads_nothing_until_asked() -> None:
    loaded = run("import sys, openmm_filament; print(*{m.split('.')[0] for m in sys.modules})").split()
    assert not {"openmm", "mdtraj", "matplotlib", "xarray", "scipy", "numpy"} & set(loaded)


def test_building_loads_neither_mdtraj_nor_matplotlib() -> None:
    code = "import sys, openmm_filament as of; of.build, of.torsion; print(*{m.split('.')[0] for m in sys.modules})"
    assert not {"mdtraj", "matplotlib", "xarray", "arviz_stats", "rich"} & set(run(code).split())


def test_importing_costs_little_beyond_openmm() -> None:
    """The shortest of alternating runs; what openmm itself takes tells how busy the machine is."""
    timer = "import time; t = time.perf_counter(); import {}; print(time.perf_counter() - t)"
    codes = [timer.format(names) for names in ("openmm", "openmm_filament, openmm", "openmm_filament.model")]
    runs = [[float(run(code)) for code in codes] for _ in range(4)]
    openmm, package, build = (min(times) for times in zip(*runs, strict=True))
    assert package - openmm <= tol.IMPORT_SECONDS * max(1.0, openmm / 0.3)
    assert build <= tol.IMPORT_OF_BUILD * openmm


# Public names -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", of.__all__)
def test_every_public_name_resolves(name: str) -> None:
    assert getattr(of, name) is not None
    assert name in dir(of)


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'bogus'"):
        _ = of.bogus


@pytest.mark.parametrize("module", [m for m in MODULES if m != "__init__"])
def test_what_a_module_exports_exists_and_is_documented(module: str) -> None:
    loaded = importlib.import_module(f"openmm_filament.{module}")
    assert loaded.__doc__
    public = [getattr(loaded, name) for name in loaded.__all__]
    own = [thing for thing in public if inspect.isfunction(thing) or inspect.isclass(thing)]
    for thing in own:
        documented = thing.__doc__ and not thing.__doc__.startswith(f"{thing.__name__}(")  # what dataclasses write
        assert documented, f"{module}.{thing.__name__} has no docstring"


def test_modules_say_what_they_export() -> None:
    for module in MODULES:
        loaded = importlib.import_module(f"openmm_filament.{module}" if module != "__init__" else "openmm_filament")
        assert len(set(loaded.__all__)) == len(loaded.__all__), module
