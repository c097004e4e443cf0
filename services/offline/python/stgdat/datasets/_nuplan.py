"""Converts logs of nuPlan to stgdat's own CSV, a file per log: tracked boxes at 20 Hz.

    python -m stgdat.datasets nuplan /data/nuplan/mini/2021.05.12.22.28.35_veh-35_00620_01164.db --out csv [--every 2]

Reads a log's SQLite data base: lidar_pc, ego_pose, lidar_box, track, category. Needs nothing but Python.
Positions are UTM, from which the first pose of the ego is subtracted unless --origin says otherwise; the file's
second line has it. Cones, barriers, signs and generic objects are left out and counted. A log that can't be
converted is named, and the others are converted; the exit code is 65 then.
"""

from __future__ import annotations

import argparse
import os
import sqlite3
from typing import Any, List
from urllib.request import pathname2url

from ._rows import Failed, Origin, Parts, Rows, motion, parser, run, yaw_rad

KINDS = {"vehicle": "vehicle", "bicycle": "cyclist", "pedestrian": "pedestrian"}
OTHERS = ("traffic_cone", "barrier", "czone_sign", "generic_object", "ego")

SWEEPS = """SELECT lidar_pc.token, lidar_pc.timestamp, ego_pose.x, ego_pose.y,
    ego_pose.qw, ego_pose.qx, ego_pose.qy, ego_pose.qz
    FROM lidar_pc JOIN ego_pose ON lidar_pc.ego_pose_token = ego_pose.token ORDER BY lidar_pc.timestamp"""
BOXES = """SELECT lidar_box.track_token, category.name, lidar_box.x, lidar_box.y, lidar_box.yaw, lidar_box.vx,
    lidar_box.vy, lidar_box.length, lidar_box.width
    FROM lidar_box JOIN track ON lidar_box.track_token = track.token
    JOIN category ON track.category_token = category.token
    WHERE lidar_box.lidar_pc_token = ? ORDER BY lidar_box.token"""


def log(path: str, origin: Origin, every: int) -> Rows:
    """The rows of a log, of every `every`-th sweep."""
    if not os.path.isfile(path):
        raise Failed(f"{path}: no such file")
    recording = Rows(path, os.path.splitext(os.path.basename(path))[0], origin)
    try:
        connection = sqlite3.connect(f"file:{pathname2url(os.path.abspath(path))}?mode=ro", uri=True)
        with connection:
            sweeps = connection.execute(SWEEPS).fetchall()
            for token, stamp_us, x_m, y_m, *rotation in sweeps[::every]:
                check(path, "ego_pose", [stamp_us, x_m, y_m, *rotation])
                stamp_ns = round(stamp_us) * 1000
                recording.ego(stamp_ns, x_m, y_m, yaw_rad(*rotation))
                for track, category, *box in connection.execute(BOXES, (token,)):
                    if category not in KINDS:
                        if category not in OTHERS:
                            raise Failed(f"{path}: category.name = {category!r}: no category of nuPlan")
                        recording.leave_out(category)
                        continue
                    x_m, y_m, yaw, vx_mps, vy_mps, length_m, width_m = check(path, "lidar_box", box)
                    kind = KINDS[category]
                    moves = motion(kind, yaw, vx_mps, vy_mps)
                    recording.agent(stamp_ns, track, kind, x_m, y_m, *moves, size=(length_m, width_m))
        connection.close()
    except sqlite3.Error as error:
        raise Failed(f"{path}: not a log of nuPlan: {error}") from error
    return recording


def check(path: str, table: str, values: List[Any]) -> List[Any]:
    """The values, which must be numbers."""
    wrong = [value for value in values if not isinstance(value, (int, float))]
    if wrong:
        raise Failed(f"{path}: {table}: {wrong[0]!r}: expected a number")
    return values


def every_of(text: str) -> int:
    """The value of --every."""
    if not text.isdigit() or not 1 <= int(text) <= 100:
        raise argparse.ArgumentTypeError(f"{text}: expected 1 to 100")
    return int(text)


def convert(arguments: argparse.Namespace, parts: Parts) -> None:
    """Writes the logs that the arguments name."""
    for path in arguments.logs:
        parts.convert(lambda: log(path, arguments.origin, arguments.every).write(arguments.out))


def main() -> None:
    """Runs the command."""
    options = parser(__doc__, "first")
    options.add_argument("logs", nargs="+", metavar="LOG", help="data base of a log, .db")
    options.add_argument("--every", type=every_of, default=1, metavar="N", help="keep every Nth sweep")
    run(convert, options)
