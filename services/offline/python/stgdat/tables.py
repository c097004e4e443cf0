"""Tables of columns, as pandas and Arrow hold them."""

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING, Any, Dict, Type

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    import pandas
    import pyarrow

Columns = Dict[str, npt.NDArray[Any]]


def names(numbers: npt.NDArray[Any], of: Type[IntEnum]) -> npt.NDArray[Any]:
    """The names of numbers, as in files: `vehicle`."""
    known = np.full(256, "unknown", dtype="U32")
    for member in of:
        known[member.value] = member.name.lower().replace("_", " ")
    found: npt.NDArray[Any] = known[np.minimum(numbers, 255)]
    return found


def to_pandas(columns: Columns) -> pandas.DataFrame:
    """The columns as a data frame."""
    try:
        import pandas
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError("to_pandas needs pandas: pip install 'stgdat[pandas]'") from error
    return pandas.DataFrame(columns)


def to_arrow(columns: Columns) -> pyarrow.Table:
    """The columns as a table of Arrow."""
    try:
        import pyarrow
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError("to_arrow needs pyarrow: pip install 'stgdat[pandas]'") from error
    return pyarrow.table({name: pyarrow.array(column) for name, column in columns.items()})
