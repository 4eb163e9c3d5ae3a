"""The state of a force-extension curve while it is sampled: runs, rounds and estimates.

A point's rounds follow from its samples alone, in whatever order its runs end their blocks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from openmm_filament.blocks import Block, BlockResult
from openmm_filament.discretisation import FEWEST_SAMPLES, Choice
from openmm_filament.divergence import DivergedError
from openmm_filament.trajectory import TrajectoryWriter

__all__ = ["FIRST_ROUND", "Point", "Run"]

Array = NDArray[np.float64]

FIRST_ROUND = 20
"""Samples a chain in the first round."""

_GROWTH = 3.0
"""A round may make a run at most so many times longer: early estimates of the error are themselves uncertain."""

_MARGIN = 1.05
"""Samples taken over those that the estimated error asks for."""

_APART, _SCATTER, _LONG = 1.01, 6.0, 100
"""R-hat, and variance of the chains' means over the one that each chain's own error explains, from which chains are said to
stay in shapes of their own; samples a chain from which that is said while they run. R-hat alone will not do: on DNA it was
up to 1.17 where 20 to 100 samples a chain were enough, while the variance was at most 3.4 times the explained one in 120
points, and 4.5 in 50 of short chains (chi-squared of 7 degrees of freedom over 7 exceeds 6 once in two million)."""


@dataclass(eq=False)
class Run:
    """One group of replicas at one force: its next block, and what it has sampled."""

    block: Block
    wanted: int
    extensions: list[Array] = field(default_factory=list)

    @property
    def done(self) -> int:
        return sum(part.shape[1] for part in self.extensions)

    @property
    def weight(self) -> float:
        """Beads times steps for one more sample."""
        return self.block.replicas * len(self.block.filament) * self.block.stride

    def next_block(self, bead_steps: float) -> Block:
        """The block to run next, of so many beads times steps at most."""
        most = max(1, int(bead_steps / self.weight))
        return replace(self.block, samples=min(self.wanted - self.done, most))


@dataclass(eq=False)
class Point:
    """One force of the curve."""

    force: float
    relative_error: float
    choice: Choice
    runs: list[Run]
    writer: TrajectoryWriter | None = None
    frames: int = 0
    mean: float = math.nan
    error: float = math.nan
    samples: float = math.nan
    r_hat: float = math.nan
    finished: bool = False
    scatter: float = math.nan
    failure: DivergedError | None = None
    told: bool = False

    @property
    def is_apart(self) -> bool:
        """Whether chains stay in shapes of their own, so that the estimate rests on where they began."""
        return self.r_hat > _APART and self.scatter > _SCATTER

    def fail(self, error: DivergedError) -> None:
        """Give the point up, and its estimate, with the first error of its runs."""
        self.failure = self.failure or error
        self.mean = self.error = self.samples = self.r_hat = self.scatter = math.nan
        self.finished = False

    @property
    def is_stuck(self) -> bool:
        """Whether it is to be told of, while it runs, that chains stay in shapes of their own."""
        return not self.told and not self.finished and self.is_apart and max(run.done for run in self.runs) >= _LONG

    def take(self, run: Run, result: BlockResult) -> None:
        """Keep what a block of a run has sampled; its frames go into the trajectory."""
        if self.writer is not None and result.frames is not None:
            self._write(self.writer, run.block, result)
        run.extensions.append(result.extensions)
        run.block = replace(run.block, checkpoint=result.checkpoint)

    def _write(self, writer: TrajectoryWriter, block: Block, result: BlockResult) -> None:
        assert result.frames is not None
        if result.start is not None:
            axis = 2 if block.dimension == 3 else 0
            span = float(result.start[-1, axis] - result.start[0, axis])
            writer.write(result.start, 0, 0.0, extension_nm=span * writer.length_nm)
        for frame, extension in zip(result.frames, result.extensions[0], strict=True):
            self.frames += 1
            step = block.warm_up + self.frames * block.stride
            writer.write(frame, step, step * block.timestep / writer.time_ps, extension_nm=float(extension))

    def due_after(self, run: Run) -> list[Run]:
        """The runs that need another block now that this one has ended a block."""
        if run.done < run.wanted:
            return [run]
        if any(run.done < run.wanted for run in self.runs):
            return []
        self.end_round()
        return [] if self.finished else self.runs

    @property
    def weight(self) -> float:
        """Beads times steps for one more sample of every run."""
        return sum(run.weight for run in self.runs)

    def end_round(self) -> None:
        """Estimate, and either finish or say how many samples the runs are to have after the next round."""
        have = min(run.done for run in self.runs)
        if have < 4:
            return
        self._estimate(have)
        target = (self.relative_error - self.choice.known) * abs(self.mean) / 2
        if self.error <= target and self.samples >= FEWEST_SAMPLES:
            self.finished = True
            return
        asked = have * max(_MARGIN * (self.error / max(target, 1e-300)) ** 2, FEWEST_SAMPLES / self.samples)
        wanted = math.ceil(min(max(asked, 1.2 * have), _GROWTH * have))
        for run in self.runs:
            run.wanted = wanted

    def stop(self) -> None:
        """Estimate from what there is, after an interruption: the runs that have come furthest."""
        if not self.finished and self.failure is None:
            self.runs = [run for run in self.runs if run.done >= FIRST_ROUND] or self.runs
            if (have := min(run.done for run in self.runs)) >= FIRST_ROUND:
                self._estimate(have)

    def _estimate(self, have: int) -> None:
        from arviz_stats.base import array_stats

        chains = np.concatenate([np.concatenate(run.extensions, axis=1)[:, :have] for run in self.runs])
        self.mean = float(chains.mean())
        # samples that undo one another's deviations may count as more than they are; short runs cannot tell how far
        self.samples = min(float(array_stats.ess(chains, chain_axis=0, draw_axis=1, method="mean")), float(chains.size))
        self.error = float(chains.std(ddof=1)) / math.sqrt(self.samples)
        self.r_hat = float(array_stats.rhat(chains, chain_axis=0, draw_axis=1))
        alone = [array_stats.mcse(chain[None], chain_axis=0, draw_axis=1, method="mean") for chain in chains]
        self.scatter = float(chains.mean(axis=1).var(ddof=1) / np.mean(np.square(alone)))

    def expected(self) -> int:
        """Samples a run that the point will have taken in all, as far as is known."""
        have = min(run.done for run in self.runs)
        if self.finished or math.isnan(self.error):
            return max(run.wanted for run in self.runs)
        target = (self.relative_error - self.choice.known) * abs(self.mean) / 2
        return max(self.runs[0].wanted, math.ceil(have * (self.error / max(target, 1e-300)) ** 2))
