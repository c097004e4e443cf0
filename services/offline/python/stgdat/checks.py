"""Checks of arguments before they become numbers of a fixed width, which would hide mistakes."""

from __future__ import annotations

import errno
import os
from typing import Any, Union

import numpy as np
import numpy.typing as npt

from ._stgdat import InputError

#: Largest extent of an agent, in metres.
_EXTENT_MAX_M = 100.0
#: Largest time in nanoseconds: the year 2116.
_STAMP_MAX_NS = 1 << 62


class MissingFileError(FileNotFoundError, InputError):
    """A file that does not exist. `path` names it."""


def existing(path: Union[str, "os.PathLike[str]"]) -> str:
    """The path as text, if there is a file or folder."""
    name = os.fspath(path)
    if not isinstance(name, str):
        raise TypeError(f"a path is text, not {type(name).__name__}")
    if not os.path.exists(name):
        error = MissingFileError(errno.ENOENT, os.strerror(errno.ENOENT), name)
        error.path = name
        raise error
    return name


def unmasked(name: str, values: npt.ArrayLike) -> Any:
    """The values as an array, if none is masked."""
    if np.ma.is_masked(values):
        raise InputError(f"{name} has masked values: leave these rows out, or write NaN if they are unknown")
    return np.asarray(values)


def whole(name: str, values: npt.ArrayLike, low: int, high: int) -> Any:
    """The values as whole numbers of a range."""
    array = unmasked(name, values)
    if array.size == 0:
        return array.astype(np.int64)
    if array.dtype.kind not in "iuf":
        raise TypeError(f"{name} are numbers, not {array.dtype}")
    wrong = ~np.isfinite(array) | (array != np.floor(array)) if array.dtype.kind == "f" else np.zeros(array.shape, bool)
    wrong = wrong | (array < low) | (array > high)
    if np.any(wrong):
        raise InputError(f"{name} has {array[wrong].flat[0]}: expected whole numbers from {low} to {high}")
    return array


def identities(values: npt.ArrayLike) -> Any:
    """Identities, each once."""
    ids = np.atleast_1d(whole("ids", values, 0, (1 << 64) - 1))
    numbers, counts = np.unique(ids, return_counts=True)
    if np.any(counts > 1):
        raise InputError(f"ids has {numbers[counts > 1][0]} twice: a tick has at most one detection of an agent")
    return ids


def sizes(values: npt.ArrayLike, rows: int) -> Any:
    """Lengths and widths. NaN in both is an unknown size."""
    array = unmasked("sizes_m", values).astype(np.float32).reshape(rows, 2)
    known = ~np.isnan(array)
    wrong = known & ~((array > 0.0) & (array <= _EXTENT_MAX_M))
    if np.any(wrong):
        raise InputError(f"sizes_m has {array[wrong][0]}: expected metres up to {_EXTENT_MAX_M:g}, or NaN if unknown")
    if np.any(known[:, 0] != known[:, 1]):
        raise InputError("sizes_m has one of length and width: write both, or NaN for both")
    return array


def times(stamp_ns: int, interval_ns: int, offsets_ns: npt.ArrayLike) -> Any:
    """The offsets of a tick with this stamp and interval."""
    for name, value, low in (("stamp_ns", stamp_ns, 0), ("interval_ns", interval_ns, 1)):
        if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, np.integer)):
            raise TypeError(f"{name} is a whole number of nanoseconds, not {type(value).__name__}")
        if not low <= value <= _STAMP_MAX_NS:
            raise InputError(f"{name} = {value}: expected nanoseconds from {low} to {_STAMP_MAX_NS}")
    return whole("offsets_ns", offsets_ns, -_STAMP_MAX_NS, 0)
