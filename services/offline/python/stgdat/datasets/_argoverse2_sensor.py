"""Converts logs of the Argoverse 2 sensor data set to stgdat's own CSV, a file per log at 10 Hz.

    python -m stgdat.datasets argoverse2_sensor /data/av2/sensor/val/adcf7d18-0510-35b0-a2fa-b4cea13a6d76 --out csv

Reads annotations.feather and city_SE3_egovehicle.feather of a log's folder, for which it needs pyarrow
(`pip install pyarrow`). Boxes are in the ego's frame of their sweep and come out in the city's. Speeds are not
annotated and stay empty. Cycles beside their riders, strollers, animals and static objects are left out and
counted. A log that can't be converted is named, and the others are converted; the exit code is 65 then.
"""

from __future__ import annotations

import argparse
import math
import os
from typing import Any, List, Tuple

from ._rows import Failed, Origin, Parts, Rows, parser, run, yaw_rad

KINDS = {
    "ARTICULATED_BUS": "vehicle",
    "BICYCLIST": "cyclist",
    "BOX_TRUCK": "vehicle",
    "BUS": "vehicle",
    "LARGE_VEHICLE": "vehicle",
    "MOTORCYCLIST": "vehicle",
    "OFFICIAL_SIGNALER": "pedestrian",
    "PEDESTRIAN": "pedestrian",
    "RAILED_VEHICLE": "vehicle",
    "REGULAR_VEHICLE": "vehicle",
    "SCHOOL_BUS": "vehicle",
    "TRUCK": "vehicle",
    "TRUCK_CAB": "vehicle",
    "VEHICULAR_TRAILER": "vehicle",
    "WHEELCHAIR": "pedestrian",
    "WHEELED_RIDER": "cyclist",
}
OTHERS = {
    "ANIMAL",
    "BICYCLE",
    "BOLLARD",
    "CONSTRUCTION_BARREL",
    "CONSTRUCTION_CONE",
    "DOG",
    "MESSAGE_BOARD_TRAILER",
    "MOBILE_PEDESTRIAN_CROSSING_SIGN",
    "MOTORCYCLE",
    "SIGN",
    "STOP_SIGN",
    "STROLLER",
    "TRAFFIC_LIGHT_TRAILER",
    "WHEELED_DEVICE",
}
POSE = ("timestamp_ns", "qw", "qx", "qy", "qz", "tx_m", "ty_m")
BOX = POSE + ("track_uuid", "category", "length_m", "width_m")


def read(path: str, columns: Tuple[str, ...]) -> List[Tuple[Any, ...]]:
    """The rows of a feather file as tuples of these columns."""
    try:
        from pyarrow import ArrowException, feather
    except ImportError:
        raise Failed("Argoverse 2 needs pyarrow: pip install pyarrow") from None
    try:
        table = feather.read_table(path)
    except ArrowException as error:
        raise Failed(f"{path}: not a feather file: {error}") from error
    except OSError as error:
        raise Failed(f"{path}: {error}") from error
    missing = [name for name in columns if name not in table.column_names]
    if missing:
        raise Failed(f"{path}: needs a column {missing[0]}; it has {', '.join(table.column_names)}")
    rows = list(zip(*(table.column(name).to_pylist() for name in columns)))
    for number, row in enumerate(rows):
        if None in row:
            raise Failed(f"{path}: row {number}: {columns[row.index(None)]} is empty")
    return rows


def log(folder: str, origin: Origin) -> Rows:
    """The rows of a log."""
    poses_path = os.path.join(folder, "city_SE3_egovehicle.feather")
    annotations_path = os.path.join(folder, "annotations.feather")
    poses = {}
    for stamp_ns, qw, qx, qy, qz, x_m, y_m in read(poses_path, POSE):
        poses[stamp_ns] = (x_m, y_m, yaw_rad(qw, qx, qy, qz))
    rows = sorted(read(annotations_path, BOX), key=lambda row: row[0])
    name = os.path.basename(os.path.normpath(folder))
    recording = Rows(annotations_path, name, origin)
    last_ns = None
    for stamp_ns, qw, qx, qy, qz, x_m, y_m, track, category, length_m, width_m in rows:
        if stamp_ns not in poses:
            raise Failed(f"{poses_path}: no pose at timestamp_ns {stamp_ns} of {annotations_path}")
        ego_x_m, ego_y_m, ego_rad = poses[stamp_ns]
        if stamp_ns != last_ns:
            recording.ego(stamp_ns, ego_x_m, ego_y_m, ego_rad)
            last_ns = stamp_ns
        if category not in KINDS:
            if category not in OTHERS:
                raise Failed(f"{annotations_path}: category = {category!r}: no category of Argoverse 2")
            recording.leave_out(category)
            continue
        cos, sin = math.cos(ego_rad), math.sin(ego_rad)
        recording.agent(
            stamp_ns,
            track,
            KINDS[category],
            ego_x_m + cos * x_m - sin * y_m,
            ego_y_m + sin * x_m + cos * y_m,
            math.remainder(ego_rad + yaw_rad(qw, qx, qy, qz), math.tau),
            size=(length_m, width_m),
        )
    return recording


def convert(arguments: argparse.Namespace, parts: Parts) -> None:
    """Writes the logs that the arguments name."""
    for folder in arguments.logs:
        parts.convert(lambda: log(folder, arguments.origin).write(arguments.out))


def main() -> None:
    """Runs the command."""
    options = parser(__doc__, "none")
    options.add_argument("logs", nargs="+", metavar="LOG", help="folder of a log")
    run(convert, options)
