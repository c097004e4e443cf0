"""Scenarios of the Argoverse 2 motion forecasting data set."""

from __future__ import annotations

import glob
import json
import os
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Dict, List, Optional, Tuple

from ._lanelet2 import LaneLine, Point, written
from ._rows import HEADING_SPEED_MPS, Failed

if TYPE_CHECKING:
    import pandas

    from ..arguments import Path
    from ..recording import Recording

#: Time between two steps.
STEP_NS = 100_000_000
#: The track of the recording vehicle.
OWN = "AV"
KINDS = {
    "vehicle": "vehicle",
    "bus": "vehicle",
    "motorcyclist": "vehicle",
    "cyclist": "cyclist",
    "pedestrian": "pedestrian",
}
OTHERS = ("background", "construction", "riderless_bicycle", "static", "unknown")
COLUMNS = ("observed", "track_id", "object_type", "timestep", "position_x", "position_y", "heading") + (
    "velocity_x",
    "velocity_y",
    "scenario_id",
    "focal_track_id",
    "city",
)
SUBTYPES = {"VEHICLE": "road", "BUS": "bus_lane", "BIKE": "bicycle_lane"}


@dataclass(frozen=True)
class Scenario:
    """A scenario of Argoverse 2: its recording, and its lanes as a map."""

    recording: Recording
    """The agents at 10 Hz in the city's frame. The recording vehicle is the sensor (`ego`) and no agent."""
    scenario_id: str
    city: str
    track_ids: Dict[int, str]
    """The data set's identity of each agent, by the identity in the recording."""
    focal_id: Optional[int]
    """The identity of the focal agent in the recording; `None` if it is left out."""
    history_end_ns: int
    """The stamp of the last observed step. Scenarios of the test part have no later ones."""
    left_out: Dict[str, int]
    """The tracks that are no road users, counted by their type."""
    osm: Optional[str] = field(repr=False)
    """The lanes and crosswalks as a Lanelet2 map in the recording's frame; `None` without a map beside the file."""

    def save_lanes(self, path: Path) -> str:
        """Writes the map, for `Predictor(lanes=…)` and `recording.lanes(…)`. Returns its path."""
        from .._stgdat import InputError

        if self.osm is None:
            raise InputError(f"scenario {self.scenario_id} has no map: no log_map_archive_*.json is beside its file")
        with open(path, "w", encoding="utf-8") as file:
            file.write(self.osm)
        return os.fspath(path)


def read(path: Path) -> Scenario:
    """The scenario of a folder or of its Parquet file."""
    from ..checks import existing

    name = existing(path)
    name = _only(name, "scenario_*.parquet") if os.path.isdir(name) else name
    maps = glob.glob(os.path.join(glob.escape(os.path.dirname(os.path.abspath(name))), "log_map_archive_*.json"))
    if len(maps) > 1:
        mine = os.path.basename(name).replace("scenario_", "log_map_archive_").replace(".parquet", ".json")
        maps = [path for path in maps if os.path.basename(path) == mine]
    return scenario(name, table(name), read_map(maps[0]) if maps else None)


def _only(folder: str, pattern: str) -> str:
    found = sorted(glob.glob(os.path.join(glob.escape(folder), pattern)))
    if len(found) != 1:
        raise Failed(f"{folder}: {len(found)} files {pattern}, expected 1")
    return found[0]


def table(path: str) -> pandas.DataFrame:
    """The rows of a scenario's file."""
    try:
        import pandas
        import pyarrow
    except ModuleNotFoundError as error:
        needed = f"Argoverse 2 needs pandas and pyarrow: pip install 'stgdat[pandas]' ({error})"
        raise ModuleNotFoundError(needed) from error
    try:
        frame = pandas.read_parquet(path)
    except (pyarrow.ArrowException, OSError) as error:
        raise Failed(f"{path}: not a Parquet file: {error}") from error
    for column in COLUMNS:
        if column not in frame.columns:
            raise Failed(f"{path}: needs a column {column}; it has {', '.join(map(str, frame.columns))}")
    if frame.empty:
        raise Failed(f"{path}: no rows")
    return frame


def scenario(path: str, frame: pandas.DataFrame, osm: Optional[str]) -> Scenario:
    """The scenario of such rows."""
    import numpy as np
    import pandas

    from ..recording import Recording

    own = (frame["track_id"] == OWN).to_numpy()
    types = frame["object_type"]
    for unknown in set(types) - set(KINDS) - set(OTHERS):
        raise Failed(f"{path}: object_type = {unknown!r}: expected {', '.join([*KINDS, *OTHERS])}")
    tracks = frame[~own & types.isin(OTHERS).to_numpy()].drop_duplicates("track_id")["object_type"]
    left_out = {str(kind): int(count) for kind, count in tracks.value_counts().items()}
    frame = frame[own | types.isin(KINDS).to_numpy()].sort_values(["timestep", "track_id"], kind="stable")
    own = (frame["track_id"] == OWN).to_numpy()
    names = frame["track_id"][~own].unique().tolist()
    numbers = {name: number for number, name in enumerate(names, 1)}
    if not numbers:
        raise Failed(f"{path}: no road users in it")
    kind = np.where(own, "ego", frame["object_type"].map(KINDS))
    vx, vy = frame["velocity_x"].to_numpy(), frame["velocity_y"].to_numpy()
    speed, heading = np.hypot(vx, vy), frame["heading"].to_numpy()
    # Pedestrians walk in any direction, so their heading is that of the velocity.
    walks = kind == "pedestrian"
    direction = np.where(speed >= HEADING_SPEED_MPS, np.arctan2(vy, vx), np.nan)
    rows = pandas.DataFrame(
        {
            "stamp_ns": frame["timestep"].to_numpy() * STEP_NS,
            "id": frame["track_id"].map(numbers).to_numpy(),
            "type": kind,
            "x_m": frame["position_x"].to_numpy(),
            "y_m": frame["position_y"].to_numpy(),
            "heading_rad": np.where(walks, direction, heading),
            "speed_mps": np.where(walks, speed, vx * np.cos(heading) + vy * np.sin(heading)),
        }
    )
    first = frame.iloc[0]
    return Scenario(
        recording=Recording.from_pandas(rows, name=str(first["scenario_id"])),
        scenario_id=str(first["scenario_id"]),
        city=str(first["city"]),
        track_ids={number: str(name) for name, number in numbers.items()},
        focal_id=numbers.get(first["focal_track_id"]),
        history_end_ns=int(frame["timestep"][frame["observed"]].max()) * STEP_NS,
        left_out=left_out,
        osm=osm,
    )


def read_map(path: str) -> str:
    """The lanes and crosswalks of a map as Lanelet2."""
    try:
        with open(path, encoding="utf-8") as file:
            content = json.load(file)
        lanes = [_lane(segment) for segment in content["lane_segments"].values()]
        lanes += [_crosswalk(crossing) for crossing in content.get("pedestrian_crossings", {}).values()]
    except ValueError as error:
        raise Failed(f"{path}: not a map of Argoverse 2: {error}") from error
    except (KeyError, TypeError, AttributeError) as error:
        raise Failed(f"{path}: not a map of Argoverse 2: {type(error).__name__}: {error}") from error
    return written(lanes)


def _lane(segment: Dict[str, Any]) -> LaneLine:
    left, right = segment["left_neighbor_id"], segment["right_neighbor_id"]
    return LaneLine(
        id=segment["id"],
        bounds_m=(_points(segment["left_lane_boundary"]), _points(segment["right_lane_boundary"])),
        lines=(_line(segment["left_lane_mark_type"]), _line(segment["right_lane_mark_type"])),
        tags={"subtype": SUBTYPES[segment["lane_type"]], "location": "urban", "one_way": "yes"},
        successors=segment["successors"],
        neighbours=(left, right),
    )


def _crosswalk(crossing: Dict[str, Any]) -> LaneLine:
    edges = (_points(crossing["edge1"]), _points(crossing["edge2"]))
    # Crosswalks and lanes are numbered separately.
    return LaneLine(-1 - crossing["id"], edges, ({"type": "virtual"}, {"type": "virtual"}), {"subtype": "crosswalk"})


def _points(points: List[Dict[str, float]]) -> List[Point]:
    found: List[Tuple[float, float]] = [(float(point["x"]), float(point["y"])) for point in points]
    if len(found) < 2:
        raise ValueError(f"a line of {len(found)} points")
    return found


def _line(mark: str) -> Dict[str, str]:
    """The tags of a marking. A line that is dashed on one side only counts as solid."""
    if mark in ("NONE", "UNKNOWN"):
        return {"type": "virtual"}
    dashed = mark.startswith(("DASHED", "DOUBLE_DASH"))
    return {"type": "line_thin", "subtype": "dashed" if dashed else "solid"}
