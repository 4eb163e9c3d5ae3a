"""Starting shapes drawn from equilibrium: chains grown bond by bond under the pulling force.

Lengths, bending angles and torsions of a free chain are independent of one another, so each is drawn from its own
Boltzmann weight; what couples them (the force, and terms that see several of them) enters as weights of a population
that is resampled as it grows, with the torque of the part still to come estimated ahead (sequential Monte Carlo).
The shapes are starts, not samples: they are exact for large populations, nearly so for these.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import ive

from openmm_filament import units
from openmm_filament._term import Interaction
from openmm_filament.filament import Filament
from openmm_filament.geometry import cross, unit_vectors

__all__ = ["equilibrium_starts"]

Array = NDArray[np.float64]

_POPULATION = 64
"""Chains grown for each start that is returned."""

_GRID = 1001
"""Points of the tables that angles and lengths are drawn from."""

Table = tuple[Array, Array]
"""Values, and the probability to be below each."""


def equilibrium_starts(
    filament: Filament, force: float, temperature: float, count: int, rng: np.random.Generator, dimension: int = 3
) -> Array:
    """Shapes (count, N, 3) in nm of an open filament with bead 0 at the origin.

    Parameters
    ----------
    force : float
        Magnitude in kJ/mol/nm of the pull on the last bead, along z in three dimensions, along x in two.
    temperature : float
        K.
    dimension : int
        3, or 2 for shapes in the xy plane.
    """
    kt = units.BOLTZMANN * temperature
    tables = _Tables(filament, force, kt, dimension)
    coupled = [i for i in filament.interactions() if i.term.span == 4 and not i.term.needs_bends]
    segments = len(filament) - 1
    axis = np.array([0.0, 0.0, 1.0]) if dimension == 3 else np.array([1.0, 0.0, 0.0])
    population = (count, _POPULATION)
    rows = np.arange(count)[:, None]

    torque = _torque_ahead(tables, segments, force / kt, dimension)
    direction = _isotropic(population, dimension, rng)
    normal = unit_vectors(cross(direction, _isotropic(population, 3, rng)))
    log_weights = np.zeros(population)
    steps: list[Array] = []
    parents: list[NDArray[np.int64] | None] = []
    recent = np.zeros((*population, 1, 3))
    for i in range(segments):
        if i:
            log_weights = log_weights - torque[i - 1] * (direction @ axis)
            beta = _draw(tables.angle(i - 1), population, rng)
            if dimension == 2:
                beta = beta * rng.choice([-1.0, 1.0], population)
                normal = np.broadcast_to([0.0, 0.0, 1.0], direction.shape)
            else:
                tau = _draw(tables.torsion(i - 2), population, rng)[..., None]
                normal = np.cos(tau) * normal + np.sin(tau) * cross(direction, normal)
            turned = np.cos(beta)[..., None] * direction + np.sin(beta)[..., None] * cross(normal, direction)
            direction = unit_vectors(turned)
        length = _draw(tables.length(i), population, rng)
        along = direction @ axis
        log_weights = log_weights + force * length * (along - 1) / kt + torque[i] * along
        steps.append(length[..., None] * direction)
        recent = np.concatenate([recent[..., -3:, :], recent[..., -1:, :] + steps[-1][..., None, :]], axis=-2)
        for term in coupled if i >= 2 else ():
            log_weights = log_weights - _element_energy(term, i - 2, recent) / kt
        parents.append(_resampled(log_weights, rng))
        if parents[-1] is not None:
            direction, normal, recent = (values[rows, parents[-1]] for values in (direction, normal, recent))
            log_weights = np.zeros(population)
    weights = np.exp(log_weights - log_weights.max(axis=1, keepdims=True))
    chosen = np.array([rng.choice(_POPULATION, p=w / w.sum()) for w in weights])
    return _traced_back(steps, parents, chosen)


def _traced_back(steps: list[Array], parents: list[NDArray[np.int64] | None], chosen: NDArray[np.int64]) -> Array:
    """Positions (count, N, 3) of the chains whose last bond is the `chosen` one of each population."""
    each = np.arange(len(chosen))
    path = []
    for step, parent in zip(reversed(steps), reversed(parents), strict=True):
        if parent is not None:
            chosen = parent[each, chosen]
        path.append(step[each, chosen])
    bonds = np.stack(path[::-1], axis=1)
    return np.concatenate([np.zeros((len(each), 1, 3)), np.cumsum(bonds, axis=1)], axis=1)


class _Tables:
    """Values and distribution functions of each bond length, bending angle and torsion; alike elements share one."""

    def __init__(self, filament: Filament, force: float, kt: float, dimension: int) -> None:
        bound = filament.interactions()
        self.bonds = [i for i in bound if i.term.span == 2]
        self.bends = [i for i in bound if i.term.span == 3]
        self.twists = [i for i in bound if i.term.needs_bends]
        self.rest = np.linalg.norm(np.diff(units.numbers("rest", filament.rest, "length"), axis=0), axis=-1)
        self.force, self.kt, self.dimension = force, kt, dimension
        self._known: dict[tuple[float, ...], Table] = {}

    def length(self, element: int) -> Table:
        """Lengths of a bond that lies along the force, weighted with s^(d-1); at rest where no term holds it."""
        stiffness = sum(float(i.parameters["k"][element]) for i in self.bonds if "k" in i.parameters)
        rest = float(self.rest[element])
        if not stiffness:
            return np.array([rest, rest]), np.array([0.0, 1.0])
        key = (2.0, rest, *(float(v[element]) for t in self.bonds for v in t.parameters.values()))
        if key not in self._known:
            reach = 10 * math.sqrt(self.kt / stiffness)
            longest = rest + reach + self.force / stiffness
            length = np.linspace(max(longest - 2 * reach, 1e-6 * rest), longest, _GRID)
            pairs = np.zeros((_GRID, 2, 3))
            pairs[:, 1, 2] = length
            energy = _sum(self.bonds, element, pairs) - self.force * length
            self._known[key] = length, _distribution(energy / self.kt, length ** (self.dimension - 1))
        return self._known[key]

    def angle(self, element: int) -> Table:
        """Bending angles, weighted with sin(beta) in three dimensions."""
        key = (3.0, *(float(v[element]) for t in self.bends for v in t.parameters.values()))
        if key not in self._known:
            stiffest = max((float(i.parameters["alpha"][element]) for i in self.bends), default=0.0)
            around = [float(i.parameters["beta0"][element]) if "beta0" in i.parameters else 0.0 for i in self.bends]
            reach = 10 * math.sqrt(self.kt / stiffest) if stiffest else math.pi
            beta = np.linspace(
                max(min(around or [0.0]) - reach, 0.0), min(max(around or [0.0]) + reach, math.pi), _GRID
            )
            triples = np.zeros((_GRID, 3, 3))
            triples[:, 0] = [-1.0, 0.0, 0.0]
            triples[:, 2] = np.stack([np.cos(beta), np.sin(beta), np.zeros(_GRID)], axis=-1)
            measure = np.sin(beta) if self.dimension == 3 else np.ones(_GRID)
            self._known[key] = beta, _distribution(_sum(self.bends, element, triples) / self.kt, measure)
        return self._known[key]

    def torsion(self, element: int) -> Table:
        """Torsions; any is as likely where no term holds them, and about the first segment."""
        if element < 0 or not self.twists:
            return np.array([-np.pi, np.pi]), np.array([0.0, 1.0])
        key = (4.0, *(float(v[element]) for t in self.twists for v in t.parameters.values()))
        if key not in self._known:
            tau = np.linspace(-np.pi, np.pi, _GRID)
            quads = np.zeros((_GRID, 4, 3))  # right angles between the segments
            quads[:, 0] = [1.0, 0.0, 0.0]
            quads[:, 2] = [0.0, 0.0, 1.0]
            quads[:, 3] = np.stack([np.cos(tau), np.sin(tau), np.ones(_GRID)], axis=-1)
            self._known[key] = tau, _distribution(_sum(self.twists, element, quads) / self.kt, np.ones(_GRID))
        return self._known[key]


def _isotropic(shape: tuple[int, ...], dimension: int, rng: np.random.Generator) -> Array:
    vectors = rng.normal(size=(*shape, 3))
    if dimension == 2:
        vectors[..., 2] = 0.0
    return unit_vectors(vectors)


def _sum(terms: list[Interaction], element: int, x: Array) -> Array:
    return sum((_element_energy(term, element, x) for term in terms), np.zeros(len(x)))


def _element_energy(interaction: Interaction, element: int, x: Array) -> Array:
    """Energies of one element of a term at positions (..., span, 3)."""
    flat = x.reshape(-1, *x.shape[-2:])
    parameters = {name: np.broadcast_to(values[element], len(flat)) for name, values in interaction.parameters.items()}
    return interaction.term.energy(flat, parameters).reshape(x.shape[:-2])


def _distribution(energy: Array, measure: Array) -> Array:
    """Distribution function of a Boltzmann weight on a grid."""
    density = np.exp(-(energy - energy.min())) * measure
    total = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2)])
    return np.asarray(total / total[-1])


def _draw(table: Table, shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    values, distribution = table
    return np.interp(rng.random(shape), distribution, values)


def _torque_ahead(tables: _Tables, segments: int, pull: float, dimension: int) -> Array:
    """kappa_i such that the rest of the chain weighs direction t_i about as exp(kappa_i t_i . F/|F|): (segments,).

    A von Mises-Fisher distribution of concentration kappa' stays about one when a joint blurs it, its mean cosine
    A(kappa') being multiplied by the joint's `<cos beta>`. `pull` is the force over k_B T.
    """
    kappa = np.zeros(segments)
    for i in range(segments - 1, 0, -1):
        beta, distribution = tables.angle(i - 1)
        cosine = float(np.sum(np.diff(distribution) * (np.cos(beta[1:]) + np.cos(beta[:-1])) / 2))
        concentration = pull * float(tables.rest[i]) + kappa[i]
        kappa[i - 1] = _inverse_mean(max(cosine, 0.0) * _mean(concentration, dimension), dimension)
    return kappa


def _mean(kappa: float, dimension: int) -> float:
    """Mean cosine of a von Mises-Fisher distribution."""
    if kappa < 1e-4:
        return kappa / dimension
    if dimension == 2:
        return float(ive(1, kappa) / ive(0, kappa))
    return 1 / math.tanh(kappa) - 1 / kappa


def _inverse_mean(mean: float, dimension: int) -> float:
    """Concentration of a von Mises-Fisher distribution by its mean cosine (Banerjee et al. 2005), to a few per cent."""
    return mean * (dimension - mean**2) / (1 - mean**2)


def _resampled(log_weights: Array, rng: np.random.Generator) -> NDArray[np.int64] | None:
    """Systematic resampling of each population (count, M) whose effective size is small; None where all are large."""
    weights = np.exp(log_weights - log_weights.max(axis=1, keepdims=True))
    weights /= weights.sum(axis=1, keepdims=True)
    size = weights.shape[1]
    if (1 / (weights**2).sum(axis=1)).min() > size / 2:
        return None
    targets = (rng.random((len(weights), 1)) + np.arange(size)) / size
    cumulative = np.cumsum(weights, axis=1)
    picks = [np.minimum(np.searchsorted(c, t), size - 1) for c, t in zip(cumulative, targets, strict=True)]
    return np.array(picks)
