"""The forecasts behind the tables of an evaluation."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Dict, Iterable, List, Optional

import numpy as np

from .numbers import AgentType

if TYPE_CHECKING:
    from numpy.typing import NDArray

SUBSETS = ("all", "moving", "vehicle", "cyclist", "pedestrian")


@dataclass(frozen=True)
class MethodForecasts:
    """The forecasts of one method; a row of NaN where it has none."""

    single_m: Optional[NDArray[np.float64]]
    """(row, step, xy); `None` if the method has no single best forecast."""
    modes_m: Optional[NDArray[np.float64]]
    """(row, mode, step, xy); `None` if the method has no modes."""
    probabilities: Optional[NDArray[np.float64]]
    """(row, mode); `None` if the modes have no probabilities."""


@dataclass(frozen=True)
class JudgedForecasts:
    """Every forecast that a table counts, beside its truth: a row per agent and time."""

    recordings: List[str]
    """Name of the recording of each row."""
    stamps_ns: NDArray[np.int64]
    agents: NDArray[np.uint64]
    """Identities in the recording."""
    types: List[AgentType]
    speeds_mps: NDArray[np.float64]
    """Speed at the last observed step."""
    subsets: Dict[str, NDArray[np.bool_]]
    """Which rows a subset of the tables counts: `all`, `moving` and the types."""
    truth_m: NDArray[np.float64]
    """(row, step, xy); NaN where the recording has no position."""
    methods: Dict[str, MethodForecasts]
    """The forecasts by the name of their method in the tables."""

    def __len__(self) -> int:
        return len(self.recordings)


def judged(lines: Iterable[str]) -> JudgedForecasts:
    """The arrays of lines of `stgdat evaluate --forecasts`."""
    rows: List[Dict[str, Any]] = [json.loads(line) for line in lines]
    names = list(dict.fromkeys(name for row in rows for name in row["forecasts"]))
    return JudgedForecasts(
        recordings=[row["recording"] for row in rows],
        stamps_ns=np.array([row["stamp_ns"] for row in rows], np.int64),
        agents=np.array([row["agent"] for row in rows], np.uint64),
        types=[AgentType[row["type"].upper()] for row in rows],
        speeds_mps=np.array([row["speed_mps"] for row in rows], np.float64),
        subsets={name: np.array([name in row["subsets"] for row in rows], np.bool_) for name in SUBSETS},
        truth_m=np.array([[[np.nan] * 2 if at is None else at for at in row["truth_m"]] for row in rows], np.float64),
        methods={
            name: MethodForecasts(*(_stacked(rows, name, part) for part in ("single_m", "modes_m", "probabilities")))
            for name in names
        },
    )


def _stacked(rows: List[Dict[str, Any]], name: str, part: str) -> Optional[NDArray[np.float64]]:
    """A part of a method's forecasts, by row."""
    parts = [row["forecasts"].get(name, {}).get(part) for row in rows]
    known = next((part for part in parts if part is not None), None)
    if known is None:
        return None
    missing = np.full(np.shape(known), np.nan)
    return np.array([missing if part is None else part for part in parts], np.float64)
