"""Tests of `stgdat.datasets`, on files that are written here in the published layouts.

`STGDAT_FIXTURES` is the folder of fixtures of the crate stgdat-data.
"""

from __future__ import annotations

import json
import os
import pickle
import shutil
import sqlite3
import struct
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path
from typing import Any, Dict, List, Tuple

import numpy as np

import stgdat
from stgdat import datasets
from stgdat.datasets import _waymo

try:
    import pandas
    import pyarrow
    from pyarrow import feather
except ModuleNotFoundError:
    pandas = None

FIXTURES = Path(os.environ.get("STGDAT_FIXTURES", ""))


def line(*points: Tuple[float, float]) -> List[Dict[str, float]]:
    return [{"x": 5000.0 + x, "y": 2000.0 + y, "z": 1.0} for x, y in points]


def segment(number: int, x: float, y: float, **others: Any) -> Dict[str, Any]:
    """A lane of 30 m towards +x, 3.5 m wide."""
    return {
        "id": number,
        "is_intersection": False,
        "lane_type": "VEHICLE",
        "left_lane_boundary": line((x, y + 1.75), (x + 15, y + 1.75), (x + 30, y + 1.75)),
        "left_lane_mark_type": "SOLID_WHITE",
        "right_lane_boundary": line((x, y - 1.75), (x + 30, y - 1.75)),
        "right_lane_mark_type": "NONE",
        "successors": [],
        "predecessors": [],
        "left_neighbor_id": None,
        "right_neighbor_id": None,
        **others,
    }


#: Lane 11 follows lane 10, a bit beside its end. Lane 20 is to the right of lane 10. Lane 30 is not in the map.
LANES = [
    segment(10, 0, 0, successors=[11, 30], right_neighbor_id=20, right_lane_mark_type="DASHED_WHITE"),
    segment(11, 30.02, 0.01, predecessors=[10], lane_type="BIKE"),
    segment(20, 0, -3.5, left_neighbor_id=10, left_lane_mark_type="DASHED_WHITE"),
]
CROSSING = {"id": 10, "edge1": line((40, -4), (40, 4)), "edge2": line((44, -4), (44, 4))}


def map_text(lanes: List[Dict[str, Any]]) -> str:
    segments = {str(lane["id"]): lane for lane in lanes}
    return json.dumps({"pedestrian_crossings": {"10": CROSSING}, "lane_segments": segments, "drivable_areas": {}})


def rows() -> List[Dict[str, Any]]:
    """A car that follows the recording vehicle for 11 s, a pedestrian that walks sideways, a cone and a new car."""
    found = []

    def add(track: str, kind: str, step: int, position: Tuple[float, float], velocity: Tuple[float, float]) -> None:
        found.append(
            {
                "observed": step < 50,
                "track_id": track,
                "object_type": kind,
                "object_category": 3 if track == "9001" else 1,
                "timestep": step,
                "position_x": 5000.0 + position[0],
                "position_y": 2000.0 + position[1],
                "heading": 0.0,
                "velocity_x": velocity[0],
                "velocity_y": velocity[1],
                "scenario_id": "0a1e6f0a",
                "start_timestamp": 315966070559696000,
                "end_timestamp": 315966081459696000,
                "num_timestamps": 110,
                "focal_track_id": "9001",
                "city": "austin",
            }
        )

    for step in range(110):
        add("9001", "vehicle", step, (0.5 * step, 0.3), (5.0, 0.0))
        add("AV", "vehicle", step, (20.0 + 0.5 * step, 0.0), (5.0, 0.0))
        add("77", "pedestrian", step, (42.0, 0.12 * step - 4), (0.0, 1.2))
        add("5", "static", step, (3.0, 5.0), (0.0, 0.0))
        if step >= 60:
            add("8", "motorcyclist", step, (0.6 * step - 36, -3.5), (6.0, 0.0))
    return found


class InFolder(unittest.TestCase):
    def setUp(self) -> None:
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = Path(folder.name)


@unittest.skipIf(pandas is None, "needs pandas and pyarrow")
class Argoverse2(InFolder):
    def scenario(self, found: List[Dict[str, Any]], lanes: Any = LANES) -> Path:
        folder = self.folder / "0a1e6f0a"
        folder.mkdir(exist_ok=True)
        pandas.DataFrame(found).to_parquet(folder / "scenario_0a1e6f0a.parquet")
        if lanes is not None:
            (folder / "log_map_archive_0a1e6f0a.json").write_text(map_text(lanes))
        return folder

    def test_a_scenario_has_its_agents_and_the_recording_vehicle_as_sensor(self) -> None:
        folder = self.scenario(rows())
        scenario = datasets.argoverse2(folder)
        recording = scenario.recording
        self.assertEqual((scenario.scenario_id, scenario.city, recording.name), ("0a1e6f0a", "austin", "0a1e6f0a"))
        self.assertEqual(scenario.left_out, {"static": 1})
        self.assertEqual(scenario.history_end_ns, 4_900_000_000)
        self.assertEqual((len(recording), recording.interval_ns), (110, 100_000_000))
        self.assertEqual(sorted(scenario.track_ids.values()), ["77", "8", "9001"])
        focal = recording.detections[recording.detections["id"] == scenario.focal_id]
        self.assertEqual(scenario.track_ids[scenario.focal_id or 0], "9001")
        self.assertTrue(np.allclose(focal["x_m"], 5000 + 0.5 * np.arange(110)) and np.all(focal["speed_mps"] == 5))
        walker = recording.detections[recording.types == stgdat.AgentType.PEDESTRIAN][0]
        self.assertAlmostEqual(float(walker["heading_rad"]), np.pi / 2, places=5)
        self.assertAlmostEqual(float(walker["speed_mps"]), 1.2, places=5)
        tick = next(recording.ticks())
        self.assertEqual(tick.header["ego_m"].tolist(), [5020.0, 2000.0])
        self.assertEqual(recording.doubts, [])
        again = datasets.argoverse2(folder / "scenario_0a1e6f0a.parquet")
        self.assertEqual(again.recording.detections.tobytes(), recording.detections.tobytes())
        self.assertEqual(pickle.loads(pickle.dumps(scenario)).osm, scenario.osm)

    def test_lanes_keep_their_links_and_markings(self) -> None:
        scenario = datasets.argoverse2(self.scenario(rows()))
        site = scenario.save_lanes(self.folder / "site.osm")
        lanes = scenario.recording.lanes(site)
        first, cycles, right = lanes[:3]
        self.assertEqual((first.successors, first.left, first.right), ((1,), None, 2))
        self.assertEqual((right.successors, right.left, right.right), ((), 0, None))
        self.assertEqual((cycles.types, cycles.right), ((stgdat.AgentType.CYCLIST,), None))
        self.assertEqual({lane.types for lane in lanes[3:]}, {(stgdat.AgentType.PEDESTRIAN,)})
        self.assertTrue(np.allclose(first.centre_m[0], [5000, 2000], atol=0.01))
        self.assertTrue(np.allclose(first.half_width_m, 1.75, atol=0.01))
        self.assertTrue(np.allclose(first.left_m[-1], cycles.left_m[0]))
        forecasts = list(stgdat.Predictor(lanes=site).run(scenario.recording))
        without = list(stgdat.Predictor().run(scenario.recording))
        self.assertEqual(len(forecasts), 110)
        self.assertFalse(np.array_equal(forecasts[-1].modes_m, without[-1].modes_m))
        solid = [dict(LANES[0], right_lane_mark_type="SOLID_DASH_WHITE"), *LANES[1:]]
        solid[2] = dict(solid[2], left_lane_mark_type="SOLID_DASH_WHITE")
        site = datasets.argoverse2(self.scenario(rows(), solid)).save_lanes(self.folder / "solid.osm")
        self.assertIsNone(scenario.recording.lanes(site)[0].right)

    def test_a_scenario_without_a_map_is_read(self) -> None:
        scenario = datasets.argoverse2(self.scenario(rows()[:200], None))
        self.assertIsNone(scenario.osm)
        with self.assertRaisesRegex(stgdat.InputError, "no log_map_archive_"):
            scenario.save_lanes(self.folder / "site.osm")

    def test_errors_name_the_file_and_the_value(self) -> None:
        with self.assertRaises(stgdat.MissingFileError):
            datasets.argoverse2(self.folder / "none")
        with self.assertRaisesRegex(stgdat.InputError, "0 files scenario_"):
            datasets.argoverse2(self.folder)
        strange = [dict(row, object_type="tram") for row in rows()]
        with self.assertRaisesRegex(stgdat.InputError, "parquet: object_type = 'tram': expected vehicle"):
            datasets.argoverse2(self.scenario(strange))
        lacks = [{key: value for key, value in row.items() if key != "heading"} for row in rows()]
        with self.assertRaisesRegex(stgdat.InputError, "parquet: needs a column heading; it has observed"):
            datasets.argoverse2(self.scenario(lacks))
        lost = rows()
        lost[0]["position_x"] = float("nan")
        with self.assertRaisesRegex(stgdat.InputError, "0a1e6f0a: row .*x_m"):
            datasets.argoverse2(self.scenario(lost))
        with self.assertRaisesRegex(stgdat.InputError, "json: not a map of Argoverse 2: KeyError: 'lane_type'"):
            datasets.argoverse2(self.scenario(rows(), [{k: v for k, v in LANES[0].items() if k != "lane_type"}]))
        (self.folder / "0a1e6f0a" / "scenario_0a1e6f0a.parquet").write_text("no")
        with self.assertRaisesRegex(stgdat.InputError, "parquet: not a Parquet file"):
            datasets.argoverse2(self.folder / "0a1e6f0a")

    @unittest.skipUnless((FIXTURES / "argoverse2").is_dir(), "needs STGDAT_FIXTURES")
    def test_a_log_of_the_sensor_data_set_is_read(self) -> None:
        for name, found in json.loads((FIXTURES / "argoverse2" / "log.json").read_text()).items():
            feather.write_feather(pyarrow.Table.from_pylist(found), str(self.folder / f"{name}.feather"))
        recording = datasets.argoverse2_sensor(self.folder)
        self.assertEqual((len(recording), len(recording.agents)), (3, 2))


@unittest.skipUnless((FIXTURES / "nuscenes").is_dir(), "needs STGDAT_FIXTURES")
class Others(InFolder):
    def test_scenes_of_nuscenes_are_read(self) -> None:
        scenes = list(datasets.nuscenes(FIXTURES / "nuscenes"))
        self.assertEqual([scene.name for scene in scenes], ["scene-0001", "scene-0002"])
        (only,) = datasets.nuscenes(FIXTURES / "nuscenes", ["scene-0001"])
        self.assertEqual((len(only), len(only.agents), only.origin_m), (3, 3, (0.0, 0.0)))
        self.assertEqual(only.detections.tobytes(), scenes[0].detections.tobytes())
        with self.assertRaisesRegex(stgdat.InputError, "scene.json: no scene scene-9"):
            list(datasets.nuscenes(FIXTURES / "nuscenes", ["scene-9"]))
        shutil.copytree(FIXTURES / "nuscenes", self.folder / "broken")
        (self.folder / "broken" / "sample.json").write_text("[")
        with self.assertRaisesRegex(stgdat.InputError, "sample.json:1:"):
            list(datasets.nuscenes(self.folder / "broken"))

    def test_the_command_writes_what_the_function_reads(self) -> None:
        command = [sys.executable, "-m", "stgdat.datasets", "nuscenes", str(FIXTURES / "nuscenes"), "--out"]
        subprocess.run([*command, str(self.folder)], check=True, capture_output=True)
        for scene in datasets.nuscenes(FIXTURES / "nuscenes"):
            written = stgdat.open(self.folder / f"{scene.name}.csv")
            self.assertEqual(written.detections.tobytes(), scene.detections.tobytes())

    def test_a_log_of_nuplan_is_read_about_its_first_pose(self) -> None:
        log = self.folder / "log.db"
        data = sqlite3.connect(log)
        data.executescript((FIXTURES / "nuplan" / "log.sql").read_text())
        data.commit()
        data.close()
        recording = datasets.nuplan(log, every=2)
        self.assertEqual((recording.name, len(recording), recording.origin_m), ("log", 2, (664_430.0, 3_996_050.0)))
        car = recording.detections[recording.types == stgdat.AgentType.VEHICLE][-1]
        self.assertTrue(np.allclose([car["x_m"], car["y_m"], car["speed_mps"]], [21.2, 3.7, 8.0], atol=1e-3))

    def test_scenarios_of_waymo_are_read(self) -> None:
        def number(key: int, value: int) -> bytes:
            return bytes([key << 3, value])

        def of(key: int, content: bytes) -> bytes:
            head = [key << 3 | 2, len(content)] if len(content) < 128 else [key << 3 | 2, len(content) % 128 | 128, len(content) // 128]
            return bytes(head) + content

        def state(x_m: float) -> bytes:
            at = struct.pack("<BdBd", 2 << 3 | 1, x_m, 3 << 3 | 1, 2.0)
            return of(3, at + struct.pack("<BfBf", 5 << 3 | 5, 4.5, 6 << 3 | 5, 1.9) + number(11, 1))

        def track(identity: int, first_m: float) -> bytes:
            return of(2, number(1, identity) + number(2, 1) + b"".join(state(first_m + k) for k in range(3)))

        def record(name: str) -> bytes:
            data = of(1, struct.pack("<3d", 0.0, 0.1, 0.2)) + track(7, 100.0) + track(9, 80.5) + number(6, 1)
            data += of(5, name.encode())
            length = struct.pack("<Q", len(data))
            sums = [struct.pack("<I", _waymo.masked_crc(part)) for part in (length, data)]
            return length + sums[0] + data + sums[1]

        file = self.folder / "a.tfrecord"
        file.write_bytes(record("a") + record("b"))
        recordings = list(datasets.waymo(file))
        self.assertEqual([recording.name for recording in recordings], ["a", "b"])
        self.assertEqual((len(recordings[0]), recordings[0].origin_m), (3, (80.0, 2.0)))
        self.assertEqual(recordings[0].detections["x_m"].tolist(), [20.0, 21.0, 22.0])
        self.assertEqual(len(list(datasets.waymo(file, ["b"]))), 1)
        with self.assertRaisesRegex(stgdat.InputError, "no scenario c in .*a.tfrecord"):
            list(datasets.waymo(file, ["c"]))
        file.write_bytes(record("a")[:-3])
        with self.assertRaisesRegex(stgdat.InputError, "the file ends within a record"):
            list(datasets.waymo(file))


if __name__ == "__main__":
    unittest.main()
