"""Converts scenes of nuScenes to stgdat's own CSV, a file per scene: annotated key frames at 2 Hz.

    python -m stgdat.datasets nuscenes /data/nuscenes/v1.0-mini --out csv [--scene scene-0061 ...]

Reads the tables of the data set (JSON, one folder per version): scene, sample, sample_annotation, instance,
category, attribute, sample_data, ego_pose, calibrated_sensor, sensor. Needs nothing but Python. The sensor's
pose is the ego pose of the key frame of LIDAR_TOP. Speeds are not annotated and stay empty. Bicycles and
motorcycles without a rider, strollers, animals and static objects are left out and counted. A scene or record
that can't be converted is named, and the other scenes are converted; the exit code is 65 then.
"""

from __future__ import annotations

import argparse
import json
import os
from typing import Any, Dict, Iterator, List, Optional, Sequence, Tuple

from ._rows import Failed, Origin, Parts, Rows, parser, run, yaw_rad

Row = Dict[str, Any]

KINDS = {
    "human.pedestrian.adult": "pedestrian",
    "human.pedestrian.child": "pedestrian",
    "human.pedestrian.construction_worker": "pedestrian",
    "human.pedestrian.personal_mobility": "cyclist",
    "human.pedestrian.police_officer": "pedestrian",
    "human.pedestrian.wheelchair": "pedestrian",
    "vehicle.bicycle": "cyclist",
    "vehicle.bus.bendy": "vehicle",
    "vehicle.bus.rigid": "vehicle",
    "vehicle.car": "vehicle",
    "vehicle.construction": "vehicle",
    "vehicle.emergency.ambulance": "vehicle",
    "vehicle.emergency.police": "vehicle",
    "vehicle.motorcycle": "vehicle",
    "vehicle.trailer": "vehicle",
    "vehicle.truck": "vehicle",
}
OTHERS = ("animal", "human.pedestrian.stroller", "movable_object.", "static_object.", "vehicle.ego")
SENSOR = "LIDAR_TOP"


class Tables:
    """The tables of a version, by token."""

    def __init__(self, folder: str, parts: Parts) -> None:
        self.folder = folder
        self.parts = parts

    def read(self, name: str) -> Table:
        """The table of this name."""
        path = os.path.join(self.folder, f"{name}.json")
        try:
            with open(path, encoding="utf-8") as file:
                rows = json.load(file)
        except json.JSONDecodeError as error:
            raise Failed(f"{path}:{error.lineno}:{error.colno}: not JSON: {error.msg}") from error
        except UnicodeDecodeError as error:
            raise Failed(f"{path}: not JSON: byte {error.start} is not UTF-8") from error
        if not isinstance(rows, list):
            raise Failed(f"{path}: expected a list of records")
        return Table(path, rows, self.parts)


class Table:
    """The records of a table."""

    def __init__(self, path: str, rows: List[Row], parts: Parts) -> None:
        self.path = path
        self.by_token: Dict[str, Row] = {}
        for row in rows:
            parts.convert(self.add, row)
        self.rows = list(self.by_token.values())

    def add(self, row: Row) -> None:
        """Adds a record."""
        self.by_token[self.text(row, "token")] = row

    def get(self, row: Row, key: str) -> Any:
        """A value of a record."""
        if not isinstance(row, dict) or key not in row:
            token = row.get("token", "?") if isinstance(row, dict) else row
            raise Failed(f"{self.path}: record {token}: needs {key}")
        return row[key]

    def record(self, token: str) -> Row:
        """The record of a token."""
        if token not in self.by_token:
            raise Failed(f"{self.path}: no record {token}")
        return self.by_token[token]

    def numbers(self, row: Row, key: str, count: int) -> List[float]:
        """Numbers of a record."""
        values = self.get(row, key)
        is_list = isinstance(values, list) and len(values) == count
        if not is_list or not all(isinstance(value, (int, float)) for value in values):
            raise self.wrong(row, key, f"{count} numbers")
        return list(values)

    def text(self, row: Row, key: str) -> str:
        """A text of a record."""
        if not isinstance(self.get(row, key), str):
            raise self.wrong(row, key, "a text")
        return str(row[key])

    def stamp_ns(self, row: Row) -> int:
        """The time of a record."""
        if not isinstance(self.get(row, "timestamp"), int):
            raise self.wrong(row, "timestamp", "whole microseconds")
        return int(row["timestamp"]) * 1000

    def wrong(self, row: Row, key: str, expected: str) -> Failed:
        """The error of a value."""
        where = f"{self.path}: record {row.get('token', '?')}"
        return Failed(f"{where}: {key} = {row[key]!r}: expected {expected}")


def kind_of(category: str, attributes: Sequence[str], path: str) -> Optional[str]:
    """The type of an annotation; None where it is no road user."""
    if category in KINDS:
        return None if "cycle.without_rider" in attributes else KINDS[category]
    if category.startswith(OTHERS):
        return None
    raise Failed(f"{path}: name = {category!r}: no category of nuScenes")


def key_frame_poses(tables: Tables, parts: Parts) -> Dict[str, Tuple[float, float, float]]:
    """The ego pose of each sample's key frame."""
    sensors, calibrated = tables.read("sensor"), tables.read("calibrated_sensor")
    data, poses = tables.read("sample_data"), tables.read("ego_pose")
    found: Dict[str, Tuple[float, float, float]] = {}

    def add(row: Row) -> None:
        if not data.get(row, "is_key_frame"):
            return
        sensor = calibrated.record(data.text(row, "calibrated_sensor_token"))
        if sensors.get(sensors.record(calibrated.text(sensor, "sensor_token")), "channel") != SENSOR:
            return
        pose = poses.record(data.text(row, "ego_pose_token"))
        x_m, y_m, _ = poses.numbers(pose, "translation", 3)
        found[data.text(row, "sample_token")] = (x_m, y_m, yaw_rad(*poses.numbers(pose, "rotation", 4)))

    for row in data.rows:
        parts.convert(add, row)
    return found


def grouped(table: Table, key: str, parts: Parts) -> Dict[Optional[str], List[Row]]:
    """The records of a table by a token of another one."""
    groups: Dict[Optional[str], List[Row]] = {}
    for row in table.rows:
        token = parts.convert(table.text, row, key)
        groups.setdefault(token, []).append(row)
    return groups


def scenes_of(folder: str, wanted: Sequence[str], origin: Origin, parts: Parts) -> Iterator[Rows]:
    """The rows of these scenes, or of all."""
    tables = Tables(folder, parts)
    scenes, samples = tables.read("scene"), tables.read("sample")
    instances, categories, attributes = (tables.read(name) for name in ("instance", "category", "attribute"))
    annotations = tables.read("sample_annotation")
    poses = key_frame_poses(tables, parts)
    names = {parts.convert(scenes.text, row, "name"): row for row in scenes.rows}
    names.pop(None, None)
    for name in wanted:
        if name not in names:
            raise Failed(f"{scenes.path}: no scene {name}")
    of_scene, of_sample = grouped(samples, "scene_token", parts), grouped(annotations, "sample_token", parts)

    def scene(name: str) -> Rows:
        frames = of_scene.get(names[name]["token"])
        if not frames:
            raise Failed(f"{samples.path}: no sample of scene {name}")
        recording = Rows(scenes.path, name, origin)
        for sample in sorted(frames, key=samples.stamp_ns):
            stamp_ns = samples.stamp_ns(sample)
            if sample["token"] not in poses:
                path = os.path.join(tables.folder, "sample_data.json")
                raise Failed(f"{path}: no key frame of {SENSOR} for sample {sample['token']}")
            recording.ego(stamp_ns, *poses[sample["token"]])
            for row in of_sample.get(sample["token"], []):
                instance = annotations.text(row, "instance_token")
                category = categories.record(instances.text(instances.record(instance), "category_token"))
                tokens = annotations.get(row, "attribute_tokens")
                named = [attributes.get(attributes.record(token), "name") for token in tokens]
                kind = kind_of(categories.text(category, "name"), named, categories.path)
                if kind is None:
                    recording.leave_out(category["name"])
                    continue
                x_m, y_m, _ = annotations.numbers(row, "translation", 3)
                width_m, length_m, _ = annotations.numbers(row, "size", 3)
                heading_rad = yaw_rad(*annotations.numbers(row, "rotation", 4))
                recording.agent(stamp_ns, instance, kind, x_m, y_m, heading_rad, size=(length_m, width_m))
        return recording

    def named(name: str) -> Rows:
        try:
            return scene(name)
        except Failed as failure:
            raise Failed(f"scene {name}: {failure}") from failure

    for name in wanted or sorted(filter(None, names)):
        rows = parts.convert(named, name)
        if rows is not None:
            yield rows


def convert(arguments: argparse.Namespace, parts: Parts) -> None:
    """Writes the scenes that the arguments name."""
    for rows in scenes_of(arguments.folder, arguments.scene, arguments.origin, parts):
        parts.convert(rows.write, arguments.out)


def main() -> None:
    """Runs the command."""
    options = parser(__doc__, "none")
    options.add_argument("folder", metavar="VERSION", help="folder with the tables, such as v1.0-mini")
    only = "only this one; repeatable"
    options.add_argument("--scene", action="append", default=[], metavar="NAME", help=only)
    run(convert, options)
