"""Seeded chains, quantities and hypothesis strategies that several test modules share."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from openmm import unit

Array = NDArray[np.float64]

# Machines in use are shared: no deadline. Examples are the same in every run, so a failure is never a matter of luck.
settings.register_profile(
    "openmm_filament",
    deadline=None,
    derandomize=True,
    max_examples=25,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("openmm_filament")

KJ = unit.kilojoule_per_mole
NM = unit.nanometer


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave the tests marked slow out unless a `-m` expression chooses."""
    if config.option.markexpr:
        return
    slow = [item for item in items if item.get_closest_marker("slow")]
    if slow:
        config.hook.pytest_deselected(items=slow)
        items[:] = [item for item in items if item not in slow]


def random_chain(rng: np.random.Generator, beads: int) -> Array:
    """A freely jointed chain (beads, 3) with segments of 0.5 to 2 in all directions."""
    directions = rng.normal(size=(beads, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    return np.cumsum(rng.uniform(0.5, 2.0, (beads, 1)) * directions, axis=0)


def chain_from_angles(lengths: Array, bends: Array, torsions: Array) -> Array:
    """The chain (n + 1, 3) with these n lengths, n - 1 bending angles and n - 2 right-handed torsions.

    A frame (tangent, normal to the plane of the last two segments) is carried along: independent of `geometry`.
    """
    tangent, binormal = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
    beads = [np.zeros(3), lengths[0] * tangent]
    for i, (length, bend) in enumerate(zip(lengths[1:], bends, strict=True)):
        if i:
            binormal = _turn(binormal, tangent, torsions[i - 1])
        tangent = _turn(tangent, binormal, bend)
        beads.append(beads[-1] + length * tangent)
    return np.array(beads)


def _turn(vector: Array, axis: Array, angle: float) -> Array:
    """`vector` turned about the unit vector `axis`, counter-clockwise seen against it (Rodrigues)."""
    along = axis * (axis @ vector)
    return along + np.cos(angle) * (vector - along) + np.sin(angle) * np.cross(axis, vector)


def random_rotation(rng: np.random.Generator) -> Array:
    """A proper rotation matrix."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q *= np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


def magnitudes(low: float = 1e-3, high: float = 1e3) -> st.SearchStrategy[float]:
    """Positive floats, uniform in the exponent."""
    return st.floats(np.log(low), np.log(high)).map(lambda x: float(np.exp(x)))


def chains(min_beads: int = 2, max_beads: int = 12) -> st.SearchStrategy[Array]:
    """Random chains without coincident or collinear beads."""
    size, seed = st.integers(min_beads, max_beads), st.integers(0, 2**32 - 1)
    return st.builds(lambda n, s: random_chain(np.random.default_rng(s), n), size, seed)


def bent_chains(
    min_segments: int = 3, max_segments: int = 10, margin: float = 0.01
) -> st.SearchStrategy[tuple[Array, ...]]:
    """Lengths, bends and torsions, `margin` away from straight, folded back and the seam of the torsion."""

    def parts(n: int) -> st.SearchStrategy[tuple[Array, ...]]:
        def numbers(count: int, low: float, high: float) -> st.SearchStrategy[Array]:
            return st.lists(st.floats(low, high), min_size=count, max_size=count).map(np.array)

        return st.tuples(
            numbers(n, 0.5, 2.0), numbers(n - 1, margin, np.pi - margin), numbers(n - 2, margin - np.pi, np.pi - margin)
        )

    return st.integers(min_segments, max_segments).flatmap(parts)


@pytest.fixture
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    """A generator seeded by the name of the test."""
    return np.random.default_rng(list(request.node.name.encode()))
