"""Trajectories: DCD and PDB out, with a sidecar that holds what a DCD cannot, and mdtraj in.

The DCD holds internal units (nm unless the model is scaled) in single precision; frame 0 is the state when the first
steps are taken. The sidecar `<name>.jsonl` has a first line with the scale, loads and names of the other files, and
one line a frame with its step and true time, written with the frame: a run that is killed leaves all three readable.
"""

from __future__ import annotations

import json
import os
from contextlib import suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np
import openmm as mm
from numpy.typing import NDArray
from openmm import app, unit

from openmm_filament import _checks as check
from openmm_filament.divergence import Watch
from openmm_filament.model import Model

if TYPE_CHECKING:
    import mdtraj

__all__ = ["TrajectoryReporter", "TrajectoryWriter", "load", "trajectory_reporter"]

Array = NDArray[np.float64]


class TrajectoryWriter:
    """Frames of a model into `path` (DCD), a PDB of its topology and the sidecar.

    Parameters
    ----------
    model : Model
    path : path
        Of the DCD. The sidecar stands beside it with the suffix .jsonl, and the PDB with the suffix .pdb, "topology"
        standing for "trajectory" in its name.
    overwrite : bool
        Whether files that exist may be replaced, which happens when the first frame is written; otherwise
        FileExistsError.
    """

    def __init__(self, model: Model, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        self._model = model
        self.length_nm, self.time_ps = model.scale.length, model.scale.factor("time")
        self.path = Path(path)
        if not self.path.parent.is_dir():
            raise FileNotFoundError(f"Argument `path` must lie in a folder that exists, but {path} does not.")
        if self.path.suffix != ".dcd":
            raise check.fail("path", "end in .dcd", str(path))
        pdb = self.path.with_name(self.path.stem.replace("trajectory", "topology") + ".pdb")
        sidecar = self.path.with_suffix(".jsonl")
        for file in (self.path, pdb, sidecar):
            if file.exists() and not overwrite:
                raise FileExistsError(
                    f"Argument `path` must not name an existing trajectory, but {file} exists: pass overwrite=True."
                )
            if not os.access(file if file.exists() else file.parent, os.W_OK):
                raise PermissionError(f"Argument `path` must name files that can be written, but {file} cannot.")
        self._pdb, self._sidecar_path = pdb, sidecar
        self._files: tuple[IO[bytes], IO[str]] | None = None
        self._closed = False

    def write(self, positions: NDArray[np.floating], step: int, time: float, **more: float) -> None:
        """Append a frame: internal positions (N, 3), its step and internal time; `more` goes into the sidecar."""
        if self._closed:
            raise ValueError(f"A frame must go into an open file, but {self.path} is a closed file.")
        if self._files is None:
            self._begin()
        assert self._files is not None
        self._dcd.writeModel(positions * unit.nanometer)
        self._files[0].flush()
        self._say({"step": step, "time_ps": time * self._model.scale.factor("time"), **more})

    def close(self) -> None:
        """Close the files; a closed writer takes no frames."""
        self._closed = True
        for file in self._files or ():
            with suppress(OSError):  # frames were flushed when they were written, or that has failed and was told
                file.close()

    def _begin(self) -> None:
        """Open the files, which ends those that were there."""
        with self._pdb.open("w") as out:
            app.PDBFile.writeFile(self._model.topology, self._model.positions, out, keepIds=True)
        self._files = self.path.open("wb"), self._sidecar_path.open("w")
        self._dcd = app.DCDFile(self._files[0], self._model.topology, 1.0 * unit.picosecond)
        self._say(_header(self._model, os.path.relpath(self._pdb, self.path.parent)))

    def _say(self, entry: dict[str, Any]) -> None:
        assert self._files is not None
        self._files[1].write(json.dumps(entry) + "\n")
        self._files[1].flush()


def _header(model: Model, topology: str) -> dict[str, Any]:
    scale = model.scale
    return {
        "topology": topology,
        "scale": {"length_nm": scale.length, "mass_Da": scale.mass, "energy_kJ_per_mol": scale.energy},
        "beads": [len(filament) for filament in model.filaments],
        "loads": [
            {
                "held": load.held,
                "pulls_kJ_per_mol_nm": {str(bead): force.tolist() for bead, force in load.pulls.items()},
                "plane": load.plane,
                "trapped": load.traps.beads[:, 0].tolist(),
                "stiffness_kJ_per_mol_nm2": np.stack([load.traps.parameters[f"k{a}"] for a in "xyz"], -1).tolist(),
                "trap_nm": np.stack([load.traps.parameters[f"{a}0"] for a in "xyz"], -1).tolist(),
            }
            for load in model.loads
        ],
    }


def trajectory_reporter(
    model: Model, path: str | os.PathLike[str], interval: int, *, overwrite: bool = False
) -> TrajectoryReporter:
    """A reporter for `Simulation.reporters` that writes a frame every `interval` steps, and frame 0 before the first.

    A coordinate that is not finite stops the run with `DivergedError` before it is written.
    """
    return TrajectoryReporter(model, path, interval, overwrite=overwrite)


class TrajectoryReporter(Watch):
    """The reporter behind `trajectory_reporter`."""

    def __init__(self, model: Model, path: str | os.PathLike[str], interval: int, *, overwrite: bool = False) -> None:
        super().__init__(model, interval)
        self._writer = TrajectoryWriter(model, path, overwrite=overwrite)

    def look(self, simulation: app.Simulation, state: mm.State) -> Array:
        """Write the frame of this state after checking it."""
        positions = super().look(simulation, state)
        self._writer.write(positions, simulation.currentStep, state.getTime().value_in_unit(unit.picosecond))
        return positions

    def close(self) -> None:
        """Close the files; frames are complete on disk even without it."""
        self._writer.close()

    def __del__(self) -> None:
        if hasattr(self, "_writer"):
            self._writer.close()


def load(path: str | os.PathLike[str]) -> mdtraj.Trajectory:
    """The trajectory at `path` (the DCD) as an `mdtraj.Trajectory` with true times in ps and physical lengths in nm.

    Raises
    ------
    FileNotFoundError
        If the DCD or its sidecar is missing.
    ValueError
        If frames but the last have no time in the sidecar.
    """
    import mdtraj

    dcd = Path(path)
    sidecar = dcd.with_suffix(".jsonl")
    for file in (dcd, sidecar):
        if not file.exists():
            raise FileNotFoundError(
                f"Argument `path` must name a trajectory with its sidecar, but {file} does not exist."
            )
    header, *frames = _entries(sidecar)
    trajectory = mdtraj.load_dcd(str(dcd), top=str(dcd.parent / header["topology"]))
    if len(frames) == trajectory.n_frames - 1:  # a run was stopped between writing the frame and its time
        trajectory = trajectory[:-1]
    if len(frames) < trajectory.n_frames:
        raise ValueError(
            f"Argument `path` must have a time for each of {trajectory.n_frames} frames, but has {len(frames)}."
        )
    trajectory.xyz *= header["scale"]["length_nm"]
    trajectory.time = np.array([frame["time_ps"] for frame in frames[: trajectory.n_frames]])
    return trajectory


def _entries(sidecar: Path) -> list[dict[str, Any]]:
    """The lines of a sidecar; a last one that was cut off in writing is left out."""
    lines = sidecar.read_text().split("\n")
    return [json.loads(line) for line in lines[:-1]]
