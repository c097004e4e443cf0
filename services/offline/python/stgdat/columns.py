"""Columns of arrays and data frames as the rows of a recording."""

from __future__ import annotations

from typing import Any, Dict, List, Mapping, Optional, Tuple

import numpy as np

from . import _stgdat
from .numbers import AgentType

#: Words of the column `type`: the types in the order of their numbers, then the poses of sensors.
WORDS = [of.name.lower() for of in AgentType] + ["ego", "above"]
_NEEDED = ("type", "x_m", "y_m")
#: The identity that stands for none.
_NO_ID = (1 << 64) - 1


def named(names: List[str], columns: Mapping[str, Any]) -> Dict[str, str]:
    """The frame's column for each column of a recording. `columns` replaces the names of the CSV format."""
    known = _stgdat.column_of
    for key, column in columns.items():
        if key != "stamp_ns" and known(key)[0] != key:
            raise _stgdat.InputError(f"columns has {key!r}: no such column of a recording")
        if column is not None and str(column) not in names:
            raise _stgdat.InputError(f"columns[{key!r}] = {column!r}: the frame has {', '.join(names)}")
    found = {key: str(column) for key, column in columns.items() if column is not None}
    given, meant = set(found.values()), {}
    for name in names:
        column, suggested = ("stamp_ns", None) if name == "stamp_ns" else known(name)
        if name in given or column in columns:
            continue
        if column is not None:
            if column in found or names.count(name) > 1:
                raise _stgdat.InputError(f"column {name!r} stands twice beside {found.get(column, name)!r}")
            found[column] = name
        elif suggested is not None:
            meant[suggested] = name
    for key, name in meant.items():
        has_time = key == "stamp_s" and "stamp_ns" in found
        if key not in found and key not in columns and not has_time:
            raise _stgdat.InputError(
                f"column {name!r}: did you mean {key}? Write columns={{{key!r}: {name!r}}} if it has this unit, and "
                f"columns={{{key!r}: None}} to leave it out"
            )
    return {key: name for key, name in found.items() if key in _READ}


def written(name: str, columns: Mapping[str, Any], labels: Mapping[str, str]) -> bytes:
    """The columns as the text of a recording."""
    if ("stamp_s" in columns) == ("stamp_ns" in columns):
        raise _stgdat.InputError(f"{name}: needs either stamp_s or stamp_ns")
    for needed in _NEEDED:
        if needed not in columns:
            raise _stgdat.InputError(f"{name}: needs a column {needed}")
    rows = len(np.atleast_1d(np.asarray(columns["x_m"])))
    made: List[Tuple[str, str, bytes]] = []
    for key, values in columns.items():
        label = f"{name}: {labels.get(key, key)}"
        kind, array = _column(key, label, values)
        if key == "type" and array.shape == ():
            array = np.full(rows, array)
        if array.shape != (rows,):
            raise _stgdat.InputError(f"{label} has the shape {array.shape}, and x_m has {rows} values")
        made.append(("stamp_s" if key == "stamp_ns" else key, kind, array.tobytes()))
    return _stgdat.write_columns(made, WORDS)


def _column(key: str, label: str, values: Any) -> Tuple[str, Any]:
    if key == "type":
        return "u1", _types(label, values)
    array = _present(label, values)
    if key == "stamp_ns":
        return "i8", _whole(label, _time(array), -(1 << 63), (1 << 63) - 1, None).astype("<i8")
    if key == "id":
        return "u8", _whole(label, array, 0, _NO_ID - 1, _NO_ID).astype("<u8")
    if key == "stamp_s" and array.dtype.kind == "f" and array.dtype.itemsize < 8:
        raise TypeError(f"{label} are {array.dtype}, which is too coarse for times: use float64 or stamp_ns")
    return "f8", _numbers(label, array).astype("<f8")


def _present(label: str, values: Any) -> Any:
    """The values as an array. Missing ones of a masked array or of pandas are `None`."""
    if np.ma.is_masked(values):
        masked: Any = values
        return masked.astype(object).filled(None)
    return np.asarray(values)


def _is_missing(value: Any) -> bool:
    return value is None or type(value).__name__ in ("NAType", "NaTType") or bool(value != value)


def _time(array: Any) -> Any:
    """Times of numpy and pandas in nanoseconds. They know their unit."""
    if array.dtype.kind not in "mM":
        return array
    whole = array.astype(f"{array.dtype.kind}8[ns]").astype(np.int64)
    return np.where(np.isnat(array), None, whole) if np.isnat(array).any() else whole


def _numbers(label: str, array: Any) -> Any:
    if array.dtype.kind in "iuf":
        return array
    if array.dtype.kind != "O":
        more = ": dates are stamp_ns" if array.dtype.kind in "mM" else ""
        raise TypeError(f"{label} are numbers, not {array.dtype}{more}")
    return np.array([_number(label, row, value, float("nan")) for row, value in enumerate(array.tolist())], float)


def _number(label: str, row: int, value: Any, missing: Any) -> Any:
    if _is_missing(value):
        return missing
    if isinstance(value, (bool, np.bool_, str, bytes)) or not hasattr(value, "__float__"):
        raise TypeError(f"row {row}: {label} = {value!r}: expected a number, not {type(value).__name__}")
    return value


def _whole(label: str, array: Any, low: int, high: int, missing: Optional[int]) -> Any:
    """Whole numbers of a range, and `missing` for those that are missing if they may be."""
    if array.dtype.kind not in "iufO":
        more = ": number the identities, as pandas.factorize does" if array.dtype.kind in "US" else ""
        raise TypeError(f"{label} are whole numbers, not {array.dtype}{more}")
    if array.dtype.kind in "iu":
        wrong = (array < low) | (array > high)
        if not wrong.any():
            return array
    found = []
    for row, value in enumerate(array.tolist()):
        number = _number(label, row, value, missing)
        if number is None or number != missing and (number != number // 1 or not low <= number <= high):
            shown = "nothing" if number is None else number
            raise _stgdat.InputError(f"{label}: row {row} has {shown}: expected a whole number from {low} to {high}")
        found.append(int(number))
    return np.array(found, "<i8" if low < 0 else "<u8")


def _types(label: str, values: Any) -> Any:
    array = np.asarray(values)
    codes: Dict[Any, int] = {word: code for code, word in enumerate(WORDS)}
    codes.update({int(of): int(of) for of in AgentType})

    def code(row: int, value: Any) -> int:
        key = value.strip().lower() if isinstance(value, str) else value
        found = None if _is_missing(value) or isinstance(value, bool) else codes.get(key)
        if found is None:
            raise _stgdat.InputError(
                f"{label}: row {row} has {value!r}: expected {', '.join(WORDS)}, or the number of an AgentType"
            )
        return found

    if array.shape == ():
        return np.uint8(code(0, array.item()))
    return np.array([code(row, value) for row, value in enumerate(array.tolist())], np.uint8)


#: Columns that a recording has.
_READ = ("stamp_s", "stamp_ns", "id", "type", "x_m", "y_m", "heading_rad", "speed_mps", "length_m", "width_m") + (
    "score",
    "sigma_m",
    "sensor",
)
