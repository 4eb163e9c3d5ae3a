"""Filaments and their loads put together: checked against one another, and their terms as interactions of the whole."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from openmm_filament._term import Interaction, Term
from openmm_filament.filament import Filament
from openmm_filament.loads import Load, Loads, resolve

__all__ = ["bound_together", "checked"]


def checked(filaments: Any, loads: Any) -> tuple[tuple[Filament, ...], tuple[Loads, ...]]:
    """One filament or several, and the resolved loads of each.

    Raises ValueError or TypeError for what is no filament, and for loads that do not match the filaments.
    """
    single = isinstance(filaments, Filament)
    chains: tuple[Any, ...] = (filaments,) if single else tuple(filaments) if isinstance(filaments, Sequence) else ()
    if not chains or not all(isinstance(chain, Filament) for chain in chains):
        raise TypeError(f"Argument `filaments` must be a Filament or a sequence of them, but is {filaments!r}.")
    if isinstance(loads, Load):
        name = type(loads).__name__
        raise TypeError(f"Argument `loads` must be a sequence of loads, but is one {name}: write [{name}(...)].")
    if not isinstance(loads, Sequence):
        raise TypeError(f"Argument `loads` must be a sequence, such as [Hold(0)], but is {loads!r}.")
    given = (loads,) if single else tuple(loads) if len(loads) else ((),) * len(chains)
    if any(isinstance(entry, Load) for entry in given):
        raise TypeError(
            f"Argument `loads` must hold one sequence of loads per filament, {len(chains)}, but holds a bare load: write "
            "[[Hold(0)], [Hold(0)], ...]."
        )
    if len(given) != len(chains):
        raise ValueError(
            f"Argument `loads` must hold one sequence of loads per filament, {len(chains)}, but holds {len(given)}."
        )
    return chains, tuple(resolve(entry, len(chain)) for entry, chain in zip(given, chains, strict=True))


def bound_together(chains: Sequence[Filament], loads: Sequence[Loads]) -> list[Interaction]:
    """The terms of all filaments, those of one class joined into one interaction, in nm and kJ/mol."""
    parts: dict[type[Term], list[Interaction]] = {}
    start = 0
    for chain, load in zip(chains, loads, strict=True):
        own = load.tightened(chain.interactions(), chain.rest._value)
        for interaction in [*own, load.traps] if len(load.traps.beads) else own:
            parts.setdefault(interaction.term, []).append(interaction.shifted(start))
        start += len(chain)
    return [group[0].joined(group) for group in parts.values()]
