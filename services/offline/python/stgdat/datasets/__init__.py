"""Recordings of public data sets.

    import stgdat
    from stgdat import datasets

    scenario = datasets.argoverse2("val/0a1e6f0a-1817-4a98-b02e-db8c9327d151")
    predictor = stgdat.Predictor(lanes=scenario.save_lanes("site.osm"))
    for forecasts in predictor.run(scenario.recording):
        print(forecasts.ids)

`python -m stgdat.datasets NAME` writes recordings as CSV, for the program `stgdat`. No data set is part of the package.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Callable, Iterator, Sequence, TypeVar

from . import _argoverse2, _argoverse2_sensor, _nuplan, _nuscenes, _rows, _waymo
from ._argoverse2 import Scenario

if TYPE_CHECKING:
    from ..arguments import Path
    from ..recording import Recording

__all__ = ["Scenario", "argoverse2", "argoverse2_sensor", "nuplan", "nuscenes", "waymo"]

T = TypeVar("T")


def argoverse2(path: Path) -> Scenario:
    """Reads a scenario of Argoverse 2 motion forecasting, with its map if there is one beside it.

    `path` is the folder of a scenario, or its `scenario_*.parquet`. Needs `stgdat[pandas]`.

    Raises `InputError` that names the file, and `FileNotFoundError` for a missing one.
    """
    return _checked(lambda: _argoverse2.read(path))


def argoverse2_sensor(folder: Path) -> Recording:
    """Reads a log of the Argoverse 2 sensor data set: `annotations.feather` and `city_SE3_egovehicle.feather`.

    Needs `stgdat[pandas]`.
    """
    return _recording(_checked(lambda: _argoverse2_sensor.log(_existing(folder), "none")))


def nuplan(path: Path, *, every: int = 1) -> Recording:
    """Reads a log of nuPlan, a data base `*.db`, with every `every`-th sweep."""
    return _recording(_checked(lambda: _nuplan.log(_existing(path), "first", every)))


def nuscenes(folder: Path, scenes: Sequence[str] = ()) -> Iterator[Recording]:
    """Reads the scenes of a version of nuScenes, such as the folder `v1.0-mini`, or these scenes only."""
    rows = _nuscenes.scenes_of(_existing(folder), scenes, "none", _rows.Strict())
    return map(_recording, _each(rows))


def waymo(path: Path, scenarios: Sequence[str] = ()) -> Iterator[Recording]:
    """Reads the scenarios of a TFRecord file of Waymo Open Motion, or these scenarios only."""
    return map(_recording, _each(_waymo.wanted(_existing(path), scenarios)))


def _existing(path: Path) -> str:
    from ..checks import existing

    return existing(path)


def _checked(read: Callable[[], T]) -> T:
    from .._stgdat import InputError

    try:
        return read()
    except _rows.Failed as failure:
        raise InputError(str(failure)) from failure


def _each(rows: Iterator[_rows.Rows]) -> Iterator[_rows.Rows]:
    while True:
        found = _checked(lambda: next(rows, None))
        if found is None:
            return
        yield found


def _recording(rows: _rows.Rows) -> Recording:
    from ..recording import parsed

    text = _checked(lambda: rows.text((0.0, 0.0)))
    return parsed(text.encode(), os.path.basename(rows.name), {}, rows.origin_m)
