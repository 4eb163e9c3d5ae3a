"""Argument checks with one grammar: "Argument `name` must <rule>, but is <value>."

Every function returns the checked value as NumPy or a plain number, so a caller checks and converts in one line.
This module knows nothing of units: `units.py` turns Quantities into numbers first.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Collection

    from numpy.typing import ArrayLike, NDArray

__all__ = ["array", "distinct", "finite", "index", "integer", "non_negative", "one_of", "positive", "shape", "within"]


def fail(name: str, rule: str, value: object) -> ValueError:
    """The error that says which argument breaks which rule, and with what value."""
    return ValueError(f"Argument `{name}` must {rule}, but is {value}.")


def array(name: str, value: ArrayLike) -> NDArray[np.float64]:
    """`value` as a float array; anything that is not numeric, and what is complex, raises TypeError."""
    try:
        given = np.asarray(value)
        if not np.iscomplexobj(given):
            return np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError):
        raise TypeError(f"Argument `{name}` must be numeric, but is {value!r}.") from None
    raise TypeError(f"Argument `{name}` must be real, but is complex.")


def _first(values: NDArray[np.float64], bad: NDArray[np.bool_]) -> str:
    """The first offending entry, with its place where there is more than one."""
    if values.ndim == 0:
        return f"{values[()]}"
    place = tuple(int(i) for i in np.argwhere(bad)[0])
    return f"{values[place]} at index {place[0] if len(place) == 1 else place}"


def finite(name: str, value: ArrayLike) -> NDArray[np.float64]:
    """A float array without NaN or infinity."""
    values = array(name, value)
    bad = ~np.isfinite(values)
    if bad.any():
        raise fail(name, "be finite", _first(values, bad))
    return values


def positive(name: str, value: ArrayLike, *, unit: str = "") -> NDArray[np.float64]:
    """A finite float array above zero everywhere."""
    values = finite(name, value)
    if (bad := values <= 0).any():
        raise fail(name, "be positive", f"{_first(values, bad)} {unit}".rstrip())
    return values


def non_negative(name: str, value: ArrayLike, *, unit: str = "") -> NDArray[np.float64]:
    """A finite float array with no entry below zero."""
    values = finite(name, value)
    if (bad := values < 0).any():
        raise fail(name, "not be negative", f"{_first(values, bad)} {unit}".rstrip())
    return values


def distinct(name: str, values: NDArray[np.float64], *, unit: str = "") -> NDArray[np.float64]:
    """Values (M,) of which no two are the same."""
    seen: dict[float, int] = {}
    for i, value in enumerate(values.tolist()):
        if value in seen:
            raise ValueError(
                f"Argument `{name}` must hold no value twice, but holds {f'{value:.6g} {unit}'.rstrip()} at index "
                f"{seen[value]} and at index {i}."
            )
        seen[value] = i
    return values


def within(
    name: str, value: ArrayLike, low: float, high: float, *, open_ends: bool = False, unit: str = ""
) -> NDArray[np.float64]:
    """A finite float array in [low, high], or in (low, high) with `open_ends`."""
    values = finite(name, value)
    bad = (values <= low) | (values >= high) if open_ends else (values < low) | (values > high)
    if bad.any():
        interval = f"({low}, {high})" if open_ends else f"[{low}, {high}]"
        raise fail(name, f"lie in {interval}{' ' + unit if unit else ''}", _first(values, bad))
    return values


def shape(name: str, value: NDArray[np.float64], wanted: tuple[int | None, ...]) -> NDArray[np.float64]:
    """An array of shape `wanted`, where None stands for any length."""
    if value.ndim != len(wanted) or any(w is not None and w != n for w, n in zip(wanted, value.shape, strict=True)):
        pattern = (
            "(" + ", ".join("n" if w is None else str(w) for w in wanted) + ("," if len(wanted) == 1 else "") + ")"
        )
        raise ValueError(f"Argument `{name}` must have shape {pattern}, but has shape {value.shape}.")
    return value


def integer(name: str, value: Any, *, low: int | None = None, high: int | None = None) -> int:
    """A whole number (not a bool) in [low, high]."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        raise TypeError(f"Argument `{name}` must be a whole number, but is {value!r}.")
    if low is not None and value < low:
        raise fail(name, f"be at least {low}", value)
    if high is not None and value > high:
        raise fail(name, f"be at most {high}", value)
    return int(value)


def index(name: str, value: Any, length: int) -> int:
    """A bead index in [-length, length), returned counted from the front."""
    number = integer(name, value)
    if not -length <= number < length:
        raise fail(name, f"be a bead index from {-length} to {length - 1}", number)
    return number % length


def one_of(name: str, value: Any, allowed: Collection[Any]) -> Any:
    """One of the `allowed` values; the error lists them."""
    if value not in allowed:
        raise fail(name, f"be one of {', '.join(repr(a) for a in allowed)}", repr(value))
    return value
