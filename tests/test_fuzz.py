"""Random scenes: built or refused in words, forces right or told of, and no silent NaN in a run."""

from __future__ import annotations

import os
import re
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import openmm as mm
import pytest
import tolerances as tol
from conftest import KJ, NM, Array, chain_from_angles, magnitudes
from hypothesis import event, given, settings
from hypothesis import strategies as st
from openmm import app, unit

import openmm_filament as of
from openmm_filament import bending, contact, electrostatics, stretching, torsion
from openmm_filament.divergence import DivergedError
from openmm_filament.inspection import PreflightError, PreflightWarning

GRAMMAR = re.compile(r"(`[\w.]+` must|must (not |be |agree|exist|stand|stay|move)|diverged|heated up|is not finite)")
SAID = re.compile(r"Forces of .*? carry an error of ([\d.e+-]+)")
REFERENCE = mm.Platform.getPlatformByName("Reference")
STEPS = 20


@dataclass(frozen=True)
class Scene:
    """Numbers that hypothesis draws and prints; `filament` and `loads` make objects of them."""

    lengths: list[float]
    bends: list[float]
    torsions: list[float]
    scale: float
    closed: bool
    stretch: float | None
    bend: tuple[str, float] | None
    twist: tuple[str, float] | None
    charge: float | None
    touch: tuple[float, float] | None
    mass: float
    spread: float
    amplitude: float
    load: str
    pull: float
    kelvin: float | None
    part: float
    seed: int

    def filament(self) -> of.Filament:
        """The chain, lengths in units of `scale` nm, energies in kJ/mol."""
        if self.bends:
            rest = chain_from_angles(np.array(self.lengths), np.array(self.bends), np.array(self.torsions))
        else:
            rest = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, self.lengths[0]]])
        terms: list[Any] = []
        if self.stretch is not None:
            terms.append(stretching.Harmonic(self.stretch / self.scale**2 * KJ / NM**2))
        if self.bend is not None:
            form, alpha = self.bend
            terms.append(bending.Cosine(alpha * KJ) if form == "cosine" else bending.Harmonic(alpha * KJ, form=form))
        if self.twist is not None:
            form, c = self.twist
            terms.append(
                {"harmonic": torsion.Harmonic, "periodic": torsion.Periodic, "weighted": torsion.Weighted}[form](c * KJ)
            )
        if self.charge is not None:
            terms.append(electrostatics.Neighbour(self.charge * unit.elementary_charge))
        if self.touch is not None:
            diameter, k = self.touch
            terms.append(contact.Repulsion(diameter * self.scale * NM, k / self.scale**2 * KJ / NM**2))
        rng = np.random.default_rng(self.seed)
        masses = self.mass * self.spread ** rng.uniform(0, 1, len(rest))
        return of.Filament(rest * self.scale * NM, masses * unit.dalton, tuple(terms), closed=self.closed)

    def loads(self) -> list[Any]:
        """What holds and pulls."""
        force = self.pull / self.scale * np.random.default_rng(self.seed + 1).normal(size=3) * KJ / NM
        kinds = {
            "none": [], "hold": [of.loads.Hold(0)], "pull": [of.loads.Hold(0), of.loads.Pull(-1, force)],
            "clash": [of.loads.Hold(-1), of.loads.Pull(-1, force)], "plane": [of.loads.Plane()],
            "tension": [of.loads.Hold([0, -1]), of.loads.Tension(self.pull / self.scale * KJ / NM)],
        }  # fmt: skip
        return list(kinds[self.load])


def angles(low: float, high: float) -> st.SearchStrategy[float]:
    """Anything between, and often just beside its ends and zero."""
    beside = st.tuples(st.sampled_from([0.0, low, high]), magnitudes(1e-14, 0.1), st.sampled_from([-1, 0, 1]))
    return st.one_of(st.floats(low, high), beside.map(lambda v: float(np.clip(v[0] + v[1] * v[2], low, high))))


@st.composite
def scenes(draw: st.DrawFn) -> Scene:
    beads = draw(st.integers(2, 12))
    flawed = draw(st.integers(0, 9)) == 0  # most scenes are to be built: one in ten may ask for what cannot be
    seldom = st.none() if flawed else st.nothing()
    alike = draw(st.booleans())  # one bend and one torsion: straight, helix, planar, folded
    bend, twist = angles(0.0, np.pi), angles(-np.pi, np.pi)
    bends = [draw(bend)] * (beads - 2) if alike else [draw(bend) for _ in range(beads - 2)]
    turns = [draw(twist)] * max(beads - 3, 0) if alike else [draw(twist) for _ in range(beads - 3)]
    size = magnitudes(1e-3, 1e6)
    forms = st.sampled_from(["arccosine", "arctangent", "cosine"])
    turning = st.sampled_from(["harmonic", "periodic", "weighted", "weighted"])
    loads = ["none", "hold", "pull", "plane", *["clash", "tension"] * flawed]
    steps = [0.01, 0.1, 0.3, *[0.9, 1.5] * flawed]
    kelvins = [st.none(), magnitudes(1e-3, 1e6), *[st.just(0.0)] * flawed]
    return Scene(
        lengths=[1.0] * (beads - 1) if alike else [draw(magnitudes(0.1, 10)) for _ in range(beads - 1)],
        bends=bends,
        torsions=turns,
        scale=draw(magnitudes(0.1, 1e9)),
        closed=beads > 2 and draw(st.sampled_from([False] * 5 + [True])),
        stretch=draw(st.one_of(seldom, size)),
        bend=draw(st.one_of(st.none(), st.tuples(forms, size))) if flawed or beads > 2 else None,
        twist=draw(st.one_of(st.none(), st.tuples(turning, size))) if flawed or beads > 3 else None,
        charge=draw(st.sampled_from([None, None, None, 0.3])),
        touch=draw(st.one_of(st.none(), st.none(), st.tuples(st.floats(0.5, 3.0), size))),
        mass=draw(magnitudes(1e-2, 1e6)),
        spread=draw(st.sampled_from([1.0, 1.0, 1e3, 1e6])),
        amplitude=draw(st.one_of(st.just(0.0), magnitudes(1e-10, 1.0))),
        load=draw(st.sampled_from(loads)),
        pull=draw(magnitudes(1e-3, 1e6)),
        kelvin=draw(st.one_of(*kelvins)),
        part=draw(st.sampled_from(steps)),
        seed=draw(st.integers(0, 1000)),
    )


def check(scene: Scene) -> str:
    """What came of a scene in a word; AssertionError where it is wrong, and any other exception is a crash."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("error")  # a division by zero on the way is no clear message
        warnings.simplefilter("always", UserWarning)
        try:
            filament = scene.filament()
            model = of.build(filament, scene.loads())
            step = scene.part * of.stable_timestep(model)
            if scene.kelvin is None:
                integrator = of.verlet(model, timestep=step)
            else:
                rate = 0.1 / of.stable_timestep(model)
                # the trial of a second that `langevin` makes of dihedrals is left to the tests of its own
                of.units.number("temperature", scene.kelvin * unit.kelvin, "temperature")
                integrator = langevin(model, scene.kelvin, step, rate)
            simulation = app.Simulation(model.topology, model.system, integrator, REFERENCE)
            x = model.positions.value_in_unit(NM) + shift(scene, model)
            simulation.context.setPositions(x)
            of.preflight(model, simulation.context)
        except (ValueError, TypeError) as error:
            assert GRAMMAR.search(str(error)), f"unclear: {error!r}"
            return "refused at the start" if isinstance(error, PreflightError) else "refused"
        told = [str(entry.message) for entry in caught if issubclass(entry.category, PreflightWarning)]
        compare(scene, model, filament, simulation, x, told)
        simulation.reporters.append(of.watch(model, 5))
        try:
            simulation.step(STEPS)
        except DivergedError as error:
            assert GRAMMAR.search(str(error)), f"unclear: {error!r}"
            return f"stopped: {str(error)[:20]}"
    at = simulation.context.getState(positions=True).getPositions(asNumpy=True).value_in_unit(NM)
    assert np.isfinite(at).all(), "a NaN that nobody saw"
    return "told of" if told else "right"


def langevin(model: of.Model, kelvin: float, step: unit.Quantity, rate: unit.Quantity) -> mm.Integrator:
    """`of.langevin`; of a model with dihedrals without its trial, which takes a second."""
    if not any(interaction.term.needs_bends for interaction in model.interactions) or kelvin <= 0:
        return of.langevin(model, kelvin * unit.kelvin, timestep=step, friction=rate, seed=1)
    return of.verlet(model, timestep=step)


def shift(scene: Scene, model: of.Model) -> Array:
    """Random displacements of the beads that are free, in internal units."""
    rest = model.positions.value_in_unit(NM)
    moved = scene.amplitude * np.random.default_rng(scene.seed + 2).normal(size=rest.shape)
    moved *= np.linalg.norm(np.diff(rest, axis=0), axis=-1).min()
    moved[model.held] = 0
    if model.planar:
        moved[:, 2] = 0
    return moved


def compare(scene: Scene, model: of.Model, filament: of.Filament, simulation: Any, x: Array, told: list[str]) -> None:
    """Forces of each term against NumPy in physical units: equal, or an error that was told of."""
    physical = model.to_physical(x, "length")
    state = simulation.context.getState(forces=True)
    found = state.getForces(asNumpy=True).value_in_unit(KJ / NM) * model.scale.factor("force")
    assert np.isfinite(found).all(), "forces that are not finite"
    right = of.reference.forces(filament, physical, scene.loads())
    scale = max(float(np.abs(i.forces(x)).max()) for i in model.interactions) * model.scale.factor("force")
    scale = max(scale, float(np.abs(right).max()))
    natural = max(i.stored_energy(1.0) for i in model.interactions) * model.scale.factor("force")
    error = float(np.abs(found - right).max())
    lost = max((float(said) for message in told for said in SAID.findall(message)), default=0.0)
    assert error <= max(tol.FUZZ, 2 * lost) * scale + tol.FUZZ_AT_REST * natural * (1 + np.abs(x).max()), (
        f"wrong by {error} of {scale}"
    )


@given(scenes())
@settings(max_examples=150)
def test_random_scenes_are_right_or_refused_or_stopped(scene: Scene) -> None:
    event(check(scene))


@pytest.mark.slow
@given(scenes())
@settings(max_examples=300 if os.environ.get("OPENMM_FILAMENT_SHORT") else 10_000)
def test_ten_thousand_random_scenes_are_right_or_refused_or_stopped(scene: Scene) -> None:
    event(check(scene))
