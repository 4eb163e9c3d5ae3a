"""Force-extension curves as arrays, from files and from the datasets of `force_extension`."""

from __future__ import annotations

import csv
import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from openmm_filament import _checks as check

__all__ = ["Curve", "as_curve", "read_curve"]

Array = NDArray[np.float64]

_EXACT, _STEP = ("exact_discrete_nm", "exact_continuous_nm"), "time_step_bias_nm"


@dataclass(frozen=True, eq=False)
class Curve:
    """Extensions against forces, and their standard errors where they are known.

    Parameters
    ----------
    force : (M,) array_like
        pN, positive.
    extension : (M,) array_like
        nm, finite.
    extension_error : array_like, optional
        One standard error in nm, positive, (M,) or one number for all.
    force_error : array_like, optional
        The same of the forces, in pN.
    temperature : float, optional
        K, where the curve brings it.
    dimension : int
        3 or 2.

    Raises
    ------
    ValueError
        If a number is out of its range or the shapes differ.
    """

    force: Array
    extension: Array
    extension_error: Array | None = None
    force_error: Array | None = None
    temperature: float | None = None
    dimension: int = 3

    def __post_init__(self) -> None:
        force = check.shape("force", check.positive("force", self.force), (None,))
        extension = check.shape("extension", check.finite("extension", self.extension), force.shape)
        checked: dict[str, Any] = {"force": force, "extension": extension}
        for name in ("extension_error", "force_error"):
            if (given := getattr(self, name)) is not None:
                values = check.positive(name, given)
                checked[name] = np.broadcast_to(
                    values if values.ndim == 0 else check.shape(name, values, force.shape), force.shape
                )
        if self.temperature is not None:
            checked["temperature"] = float(
                check.shape("temperature", check.positive("temperature", self.temperature), ())
            )
        check.one_of("dimension", self.dimension, (2, 3))
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return len(self.force)


def read_curve(
    path: str | os.PathLike[str],
    *,
    force: str = "force_pN",
    extension: str = "extension_nm",
    extension_error: str | None = None,
    force_error: str | None = None,
    pN: float = 1.0,
    nm: float = 1.0,
    where: Mapping[str, str] | None = None,
    temperature: float | None = None,
    dimension: int = 3,
) -> Curve:
    r"""A curve from a CSV file with one line of column names; by default the columns that the systems write.

    Where such a file has the exact extensions of the discrete chain that was run and of the continuous one, their
    difference, the known bias, is taken off, and the "time_step_bias_nm" beside them.

    Parameters
    ----------
    path : path
    force, extension : str
        Names of the columns.
    extension_error, force_error : str, optional
        Columns of standard errors. By default "extension_error_nm" and "force_error_pN" where the file has them.
    pN, nm : float
        What one unit of the file's forces is in pN, of its lengths in nm: `nm=1000` for micrometres.
    where : mapping of str to str, optional
        Columns and the text that rows must have there, for a file with several curves.
    temperature, dimension
        Of the `Curve`.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If a column is missing, no row is left, or a cell is not a number.

    Examples
    --------
    >>> from tempfile import NamedTemporaryFile
    >>> with NamedTemporaryFile("w", suffix=".csv") as file:
    ...     _ = file.write("F,z\n0.1,0.5\n1.0,0.8\n")
    ...     file.flush()
    ...     read_curve(file.name, force="F", extension="z", nm=1000).extension
    array([500., 800.])
    """
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file)
            names = list(reader.fieldnames or ())
            rows = list(reader)
    except UnicodeDecodeError:
        raise ValueError(f"Argument `path` must name a text file in UTF-8, but {path} is not.") from None
    if len(set(names)) < len(names):
        raise ValueError(f"Argument `path` must name a file whose columns differ, but {path} has {names}.")
    spread = extension_error or ("extension_error_nm" if "extension_error_nm" in names else None)
    shift = force_error or ("force_error_pN" if "force_error_pN" in names else None)
    for name in (force, extension, spread, shift, *(where or {})):
        if name is not None and name not in names:
            raise ValueError(f"Argument `path` must name a file with a column {name!r}, but {path} has {names}.")
    rows = [row for row in rows if all(row[name] == text for name, text in (where or {}).items())]
    if not rows:
        raise ValueError(
            f"Argument `path` must name a file with rows{f' where {dict(where)}' if where else ''}, but {path} has none."
        )

    def column(name: str, unit: float) -> Array:
        return unit * np.array([_number(row[name], name, path) for row in rows])

    lengths = column(extension, nm)
    if extension == "extension_nm" and {*_EXACT} <= set(names):
        discrete, continuous = (column(name, nm) for name in _EXACT)
        lengths = lengths - np.nan_to_num(discrete - continuous)
        if _STEP in names:
            lengths = lengths - np.nan_to_num(column(_STEP, nm))
    return Curve(
        column(force, pN),
        lengths,
        None if spread is None else column(spread, nm),
        None if shift is None else column(shift, pN),
        temperature,
        dimension,
    )


def _number(text: str | None, name: str, path: str | os.PathLike[str]) -> float:
    try:
        return float(text or "")
    except ValueError:
        raise ValueError(
            f"Argument `path` must name a file of numbers, but {path} has {text!r} under {name!r}."
        ) from None


def as_curve(data: Any) -> Curve:
    """A `Curve` as it is, the path of a CSV file, or a dataset of `force_extension`.

    Of a dataset, forces whose run was given up are left out, and the known bias of the discrete chain (exact discrete
    minus exact continuous, where the dataset has it) and the estimated one of the time step are taken off the extensions.

    Raises
    ------
    TypeError
        For anything else.
    """
    if isinstance(data, Curve):
        return data
    if isinstance(data, (str, os.PathLike)):
        return read_curve(data)
    if not hasattr(data, "data_vars") or not {"extension", "extension_error"} <= set(data.data_vars):
        raise TypeError(
            "Argument `data` must be a Curve, the path of a CSV file or a dataset of force_extension, "
            f"but is a {type(data).__name__}."
        )
    extension, error = (np.asarray(data[name], dtype=np.float64) for name in ("extension", "extension_error"))
    for bias in ("bias", "time_step_bias"):
        if bias in data.data_vars:
            extension = extension - np.nan_to_num(np.asarray(data[bias], dtype=np.float64))
    kept = np.isfinite(extension) & np.isfinite(error)
    return Curve(
        np.asarray(data["force"], dtype=np.float64)[kept],
        extension[kept],
        error[kept],
        temperature=data.attrs.get("temperature_K"),
        dimension=int(data.attrs.get("dimension", 3)),
    )
