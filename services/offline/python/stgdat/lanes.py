"""The lanes of a site as arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, List, Optional, Tuple

import numpy as np

from . import _stgdat
from .arguments import Path, written
from .numbers import AgentType

if TYPE_CHECKING:
    import numpy.typing as npt


@dataclass(frozen=True)
class Lane:
    """A lanelet in one direction. Positions are in the world frame of a recording."""

    id: int
    """Number of the lanelet in the file. Both directions of a road without lanes have the same number."""
    types: Tuple[AgentType, ...]
    """Types of agents that use it."""
    limit_mps: Optional[float]
    """Speed limit; `None` if neither the map nor the kind of road has one."""
    centre_m: npt.NDArray[np.float32]
    """Points along the middle, at most 1 m apart, [point, xy]."""
    half_width_m: npt.NDArray[np.float32]
    """Half of the width at each point, [point]."""
    left_m: npt.NDArray[np.float32]
    """The left bound in the direction of the lane, [point of the bound, xy]."""
    right_m: npt.NDArray[np.float32]
    """The right bound, [point of the bound, xy]."""
    successors: Tuple[int, ...]
    """Places in the list of the lanes that begin where this one ends."""
    left: Optional[int]
    """Place of the lane to the left that an agent may change to."""
    right: Optional[int]
    """Place of the lane to the right that an agent may change to."""


def read_lanes(recording: _stgdat.Recording, path: Path, lanes_origin: Optional[str]) -> List[Lane]:
    """The lanes of a map in the frame of a recording."""
    found = _stgdat.lanes(recording, written(lanes=path, lanes_origin=lanes_origin))
    return [
        Lane(
            id=number,
            types=tuple(AgentType(of) for of in types),
            limit_mps=limit_mps,
            centre_m=_points(lines[0]),
            half_width_m=np.frombuffer(lines[1], np.float32),
            left_m=_points(lines[2]),
            right_m=_points(lines[3]),
            successors=tuple(successors),
            left=beside[0],
            right=beside[1],
        )
        for number, types, limit_mps, lines, successors, beside in found
    ]


def _points(values: bytes) -> npt.NDArray[np.float32]:
    return np.frombuffer(values, np.float32).reshape(-1, 2)
