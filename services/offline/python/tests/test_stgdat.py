"""Tests of the installed package: `check.sh` runs them.

`STGDAT_PROGRAM` is the executable `stgdat` of the same sources.
"""

from __future__ import annotations

import doctest
import gc
import importlib
import json
import math
import os
import pickle
import subprocess
import sys
import tempfile
import threading
import unittest
from pathlib import Path
from typing import Any, Callable, List
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt

import stgdat
from stgdat import _stgdat

PROGRAM = os.environ.get("STGDAT_PROGRAM", "stgdat")
EXAMPLES = Path(__file__).parent.with_name("examples")
HEAD = "stamp_s,id,type,x_m,y_m,heading_rad,speed_mps\n"


def rounded(values: npt.NDArray[Any], decimals: int) -> npt.NDArray[Any]:
    """The numbers of forecasts.jsonl: rounded half away from zero."""
    scaled = values.astype(np.float64) * 10.0**decimals
    whole = np.trunc(scaled)
    nearest: npt.NDArray[Any] = whole + np.where(np.abs(scaled - whole) >= 0.5, np.sign(scaled), 0)
    return nearest / 10.0**decimals + 0.0


def walk(shift_m: float = 0.0) -> str:
    """Two cars and two pedestrians for 8 s at 10 Hz."""
    rows: List[str] = []
    for k in range(80):
        t = k / 10
        rows.append(f"{t},1,vehicle,{shift_m + 8 * t - 30:.2f},-2,0,8\n")
        rows.append(f"{t},2,vehicle,{shift_m - 2:.2f},{30 - 6 * t:.2f},-1.5708,6\n")
        rows.append(f"{t},3,pedestrian,{shift_m + 1.4 * t - 6:.2f},8,0,1.4\n")
        rows.append(f"{t},4,pedestrian,{shift_m + 9:.2f},{1.2 * t - 5:.2f},1.5708,1.2\n")
    return HEAD + "".join(rows)


def predicted(*arguments: str) -> List[bytes]:
    """The lines of `stgdat predict`."""
    done = subprocess.run([PROGRAM, "predict", *arguments], check=True, capture_output=True)
    return done.stdout.splitlines(keepends=True)


class InFolder(unittest.TestCase):
    """A test with a folder of its own."""

    def setUp(self) -> None:
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = Path(folder.name)

    def write(self, name: str, text: str) -> Path:
        path = self.folder / name
        path.write_text(text)
        return path


class Forecasts(InFolder):
    def same(self, forecasts: List[stgdat.Forecasts], lines: List[bytes]) -> None:
        """Each line has the bytes of the forecasts, and each number is the array's."""
        self.assertEqual([of.to_json() for of in forecasts], lines)
        for of, line in zip(forecasts, lines):
            agents = json.loads(line)["agents"]
            self.assertEqual(of.ids.tolist(), [agent["id"] for agent in agents])
            origin = np.array(of.origin_m)
            for row, agent in enumerate(agents):
                modes = len(agent["probability"])
                self.assertEqual(rounded(of.probabilities[row, :modes], 6).tolist(), agent["probability"])
                self.assertFalse(of.probabilities[row, modes:].any())
                self.assertEqual(rounded(of.covariances_m2[row], 6).tolist(), agent["covariance_m2"])
                for array, name in [(of.best_m[row], "best_m"), (of.mean_m[row], "mean_m")]:
                    self.assertEqual(rounded(array + origin, 4).tolist(), agent[name])
                self.assertEqual(rounded(of.modes_m[row, :modes] + origin, 4).tolist(), agent["modes_m"])
                position = rounded(of.positions_m[row] + origin, 4).tolist()
                self.assertEqual(position, [agent["x_m"], agent["y_m"]])
                self.assertEqual(stgdat.Quality(of.quality[row]).name.lower(), agent["quality"])
                self.assertEqual(stgdat.Cause(of.cause[row]).name.lower(), agent["cause"])
                self.assertEqual(stgdat.AgentType(of.types[row]).name.lower(), agent["type"])
                weights = {expert: rounded(weight, 4) for expert, weight in enumerate(of.evidence[row]) if weight > 0}
                agent_type = stgdat.AgentType(of.types[row])
                names = {stgdat.Expert(of).name_for(agent_type): float(w) for of, w in weights.items()}
                self.assertEqual(names, agent["experts"])

    def test_generated_scene_equals_predict(self) -> None:
        forecasts = list(stgdat.Predictor().run(stgdat.generate(ticks=90)))
        self.assertGreater(len(forecasts[-1]), 8)
        self.same(forecasts, predicted("--ticks", "90"))

    def test_csv_with_origin_equals_predict(self) -> None:
        path = self.write("walk.csv", walk(458_000))
        recording = stgdat.open(path, origin=(458_000, -5.5))
        forecasts = list(stgdat.Predictor().run(recording))
        self.assertEqual(forecasts[-1].origin_m, (458_000.0, -5.5))
        self.same(forecasts, predicted(str(path), "--origin", "458000,-5.5"))

    def test_options_reach_the_stages(self) -> None:
        path = self.write("walk.csv", walk())
        kinematic = {"tracker.prior": "kinematic"}
        predictor = stgdat.Predictor(map="none", retrieval=False, associate=True, settings=kinematic)
        options = ["--map", "none", "--no-retrieval", "--associate", "--set", "tracker.prior=kinematic"]
        settings = {"tracker.fov": (np.float64(90), 80), "sampler.retrieval": np.bool_(False)}
        self.same(
            list(stgdat.Predictor(origin=(np.float64(0), 0), settings=settings).run(path, ticks=30)),
            predicted(str(path), "--ticks", "30", "--set", "tracker.fov=90,80", "--set", "sampler.retrieval=false"),
        )
        self.same(list(predictor.run(path, ticks=60)), predicted(str(path), "--ticks", "60", *options))

    @unittest.skipUnless("STGDAT_CASES" in os.environ, "STGDAT_CASES is not set")
    def test_cases_equal_predict(self) -> None:
        compared = 0
        for path in sorted(Path(os.environ["STGDAT_CASES"]).rglob("*.csv")):
            with self.subTest(path=path.name):
                done = subprocess.run([PROGRAM, "predict", str(path)], capture_output=True)
                if done.returncode != 0:
                    with self.assertRaises(stgdat.InputError) as raised:
                        stgdat.open(path)
                    self.assertIn(str(raised.exception), done.stderr.decode())
                    continue
                self.same(list(stgdat.Predictor().run(path)), done.stdout.splitlines(keepends=True))
                compared += 1
        if not compared:
            self.skipTest("no case in STGDAT_CASES")

    def test_lanes_are_arrays(self) -> None:
        # A lane of two parts, 4 m wide, that turns left by 90 degrees at (20, 0).
        nodes = {1: (0, 2), 2: (18, 2), 3: (18, 20), 4: (0, -2), 5: (22, -2), 6: (22, 20)}
        lanelets = {11: ((1, 2), (4, 5)), 12: ((2, 3), (5, 6))}
        text = "<osm>"
        for number, (x, y) in nodes.items():
            text += f'<node id="{number}" lat="0" lon="0"><tag k="local_x" v="{x}"/><tag k="local_y" v="{y}"/></node>'
        for number, sides in lanelets.items():
            for side, ends in enumerate(sides):
                refs = "".join(f'<nd ref="{end}"/>' for end in ends)
                text += f'<way id="{10 * number + side}">{refs}<tag k="type" v="line_thin"/></way>'
        for number in lanelets:
            members = f'<member type="way" ref="{10 * number}" role="left"/>'
            members += f'<member type="way" ref="{10 * number + 1}" role="right"/>'
            tags = "".join(
                f'<tag k="{key}" v="{value}"/>'
                for key, value in (("type", "lanelet"), ("subtype", "road"), ("location", "urban"), ("one_way", "yes"))
            )
            text += f'<relation id="{number}">{members}{tags}</relation>'
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "site.osm"
            path.write_text(text + "</osm>")
            recording = stgdat.Recording.from_arrays("vehicle", [0.0, 1.0], [0.0, 0.0], stamp_s=[0, 0.1], ids=[1, 1])
            first, second = recording.lanes(path)
            self.assertEqual((first.id, second.id), (11, 12))
            self.assertEqual((first.successors, second.successors), ((1,), ()))
            self.assertEqual((first.left, first.right), (None, None))
            self.assertIn(stgdat.AgentType.VEHICLE, first.types)
            np.testing.assert_allclose(first.centre_m[0], [0, 0], atol=1e-4)
            np.testing.assert_allclose(first.centre_m[-1], second.centre_m[0], atol=1e-4)
            np.testing.assert_allclose(second.centre_m[-1], [20, 20], atol=1e-4)
            np.testing.assert_allclose(first.left_m, [[0, 2], [18, 2]], atol=1e-4)
            np.testing.assert_allclose(first.half_width_m[0], 2.0, atol=1e-3)
            self.assertLess(np.linalg.norm(np.diff(first.centre_m, axis=0), axis=1).max(), 1.01)
            with self.assertRaises(stgdat.MissingFileError):
                recording.lanes("none.osm")
            path.write_text("no map")
            with self.assertRaisesRegex(stgdat.InputError, "site.osm"):
                recording.lanes(path)

    @unittest.skipUnless((Path(os.environ.get("STGDAT_CASES", ".")) / "maps/local.osm").exists(), "no case with lanes")
    def test_lanes_equal_predict(self) -> None:
        maps = Path(os.environ["STGDAT_CASES"]) / "maps"
        path, lanes = maps / "1_km_from_the_lane.csv", maps / "local.osm"
        lines = predicted(str(path), "--ticks", "40", "--lanes", str(lanes))
        self.same(list(stgdat.Predictor(lanes=lanes).run(path, ticks=40)), lines)
        with self.assertRaisesRegex(stgdat.InputError, "none.osm"):
            stgdat.Predictor(lanes=maps / "none.osm")

    def test_steps_equal_a_run(self) -> None:
        recording = stgdat.generate(agents=8, ticks=60)
        predictor = stgdat.Predictor()
        played = [of.to_json() for of in predictor.run(recording)]
        predictor.reset()
        self.assertEqual([predictor.step(tick).to_json() for tick in recording.ticks()], played)
        # The same detections as arrays.
        predictor.reset()
        for tick, line in zip(recording.ticks(), played):
            rows = tick.records
            flags = stgdat.DetectionFlags.HAS_HEADING, stgdat.DetectionFlags.HAS_SIZE
            known = [(rows["flags"] & flag) > 0 for flag in flags]
            sizes_m = np.stack([rows["length_m"], rows["width_m"]], 1)
            made = stgdat.detections(
                tick.stamp_ns,
                rows["agent_type"],
                rows["x_m"],
                rows["y_m"],
                headings_rad=np.where(known[0], rows["heading_rad"], np.nan),
                sizes_m=np.where(known[1][:, None], sizes_m, np.nan),
                scores=rows["score"],
                sigmas_m=rows["sigma_m"],
                ego=(*tick.header["ego_m"].tolist(), float(tick.header["ego_heading_rad"])),
                # The noise is learned by the distance from the sensor.
                seen_from_ego=True,
            )
            self.assertEqual(rows["flags"].tolist(), made.records["flags"].tolist())
            self.assertEqual(predictor.step(made).to_json(), line)

    def test_detections_name_their_sensor(self) -> None:
        tick = stgdat.detections(0, [0, 0], [1.0, 9.0], [2.0, 2.0], sensors=[1, 8])
        self.assertEqual(tick.records["sensor"].tolist(), [1, 8])
        with self.assertRaisesRegex(stgdat.InputError, "sensors has 9"):
            stgdat.detections(0, [0], [1.0], [2.0], sensors=[9])
        recording = stgdat.Recording.from_arrays("vehicle", [0.0, 9.0], [0.0, 0.0], stamp_s=[0.0, 0.0], sensors=[2, 0])
        self.assertEqual(recording.detections["sensor"].tolist(), [2, 0])
        path = self.folder / "sensors.csv"
        recording.save(path)
        self.assertEqual(stgdat.open(path).detections["sensor"].tolist(), [2, 0])
        with self.assertRaisesRegex(stgdat.InputError, "sensors = 9"):
            stgdat.Recording.from_arrays("vehicle", [0.0], [0.0], stamp_s=[0.0], sensors=[9])

    def test_agents_of_a_complete_scene_have_no_gap(self) -> None:
        for agents in (3, 40):
            recording = stgdat.generate(agents=agents, ticks=50, seed=2, complete=True)
            self.assertTrue(recording.has_identities)
            self.assertTrue((recording.detections["flags"] & stgdat.DetectionFlags.HAS_ID).all())
            known = recording.agents
            frames = (known["last_ns"] - known["first_ns"]) // recording.interval_ns + 1
            self.assertEqual(known["rows"].tolist(), frames.tolist())
            self.assertGreaterEqual(np.diff(recording.offsets).min(), agents - 2)
        with self.assertRaisesRegex(stgdat.InputError, "agents"):
            stgdat.generate(agents=129, complete=True)

    def test_arrays_are_views_of_the_frame(self) -> None:
        *_, last = stgdat.Predictor().run(stgdat.generate(agents=8, ticks=50))
        start = last._frame.elements().__array_interface__["data"][0]
        end = start + last.records.nbytes
        fields = last.records.dtype.fields
        assert fields is not None
        names = {"modes_m": "modes", "probabilities": "probability", "covariances_m2": "covariance", "best_m": "best"}
        names.update(mean_m="mean", quality="quality", cause="cause", evidence="expert_weights", positions_m="x_m")
        for name, field in names.items():
            array = getattr(last, name)
            address = array.__array_interface__["data"][0]
            self.assertEqual(address, start + fields[field][1], name)
            self.assertLess(address, end)
            with self.assertRaises(ValueError):
                array[...] = 0
        modes, before = last.modes_m, last.modes_m.copy()
        del last, array
        gc.collect()
        self.assertTrue((modes == before).all(), "the array keeps its memory")

    def test_two_threads_share_the_processor(self) -> None:
        """A step releases the global lock: another thread runs while it computes."""
        turns: List[int] = []
        done = threading.Event()

        def count() -> None:
            while not done.is_set():
                turns.append(1)
                done.wait(0.0001)

        interval = sys.getswitchinterval()
        self.addCleanup(sys.setswitchinterval, interval)
        sys.setswitchinterval(100)  # A thread gives the lock away only when it releases it.
        counter = threading.Thread(target=count)
        counter.start()
        predictor, ticks = stgdat.Predictor(), list(stgdat.generate(ticks=40).ticks())
        before = len(turns)
        for tick in ticks:
            predictor.step(tick)
        during = len(turns) - before
        done.set()
        counter.join()
        self.assertGreater(during, 10)

    def test_agents_are_rows(self) -> None:
        *_, last = stgdat.Predictor().run(stgdat.generate(agents=8, ticks=50))
        self.assertEqual([agent.id for agent in last], last.ids.tolist())
        for row, agent in enumerate(last):
            self.assertEqual(agent.source_id, last.source_ids[row])
            numbers = [agent.type, agent.quality, agent.cause]
            self.assertEqual(numbers, [last.types[row], last.quality[row], last.cause[row]])
            self.assertEqual(len(agent.modes_m), last.records["modes_len"][row])
            self.assertAlmostEqual(float(agent.probabilities.sum()), 1.0, places=4)
            for name in ("best_m", "mean_m", "covariances_m2"):
                self.assertTrue((getattr(agent, name) == getattr(last, name)[row]).all())
            self.assertEqual(agent.position_m.tolist(), last.positions_m[row].tolist())
        self.assertRegex(repr(last), r"<Forecasts 49 at .* s: \d+ agents \(.*vehicle.*; .*learned.*\), to 4.8 s>")
        self.assertRegex(repr(agent), r"<Agent \w+ \d+ at \(")

    def test_forecasts_have_pictures(self) -> None:
        recording = stgdat.generate(agents=40, ticks=50, complete=True)
        first, *_, last = stgdat.Predictor().run(recording)
        for of in (first, last):
            found = of._repr_html_()
            ElementTree.fromstring(f"<div>{found}</div>")
            self.assertEqual(found.count("<circle"), len(of))
            self.assertNotIn("nan", found)
        self.assertIn("<polyline", last._repr_html_())
        self.assertIn("more", last._repr_html_())
        try:
            import matplotlib
        except ModuleNotFoundError as error:
            self.skipTest(str(error))
        matplotlib.use("Agg")
        axes: Any = stgdat.plot(last, recording)
        # Modes, the best one and the position of each agent; both sides of the recording; a line per type.
        lines = int(last.records["modes_len"].sum()) + 2 * len(last) + 2 + len(set(last.types.tolist()))
        self.assertEqual(len(axes.lines), lines)
        self.assertIs(stgdat.plot(last, ax=axes), axes)
        axes.figure.savefig(self.folder / "x.png")

    def test_tables(self) -> None:
        try:
            import pandas  # noqa: F401
            import pyarrow  # noqa: F401
        except ModuleNotFoundError as error:
            self.skipTest(str(error))
        *_, last = stgdat.Predictor().run(stgdat.generate(agents=4, ticks=50))
        frame = last.to_pandas()
        modes = int(last.records["modes_len"].sum())
        self.assertEqual(len(frame), 12 * modes)
        row = frame.iloc[13]
        agent = last.ids.tolist().index(row["id"])
        self.assertEqual((row["mode"], row["time_s"]), (1, 0.8))
        self.assertEqual([row["mode_x_m"], row["mode_y_m"]], last.modes_m[agent, 1, 1].tolist())
        self.assertEqual(last.to_arrow().num_rows, len(frame))


class Recordings(InFolder):
    def test_columns_of_a_csv(self) -> None:
        recording = stgdat.open(self.write("walk.csv", walk()))
        self.assertEqual((len(recording), recording.interval_ns, recording.has_identities), (80, 100_000_000, True))
        self.assertEqual(recording.stamps_ns[:3].tolist(), [0, 100_000_000, 200_000_000])
        self.assertEqual(recording.offsets[:3].tolist(), [0, 4, 8])
        self.assertEqual(sorted(recording.detections["id"][:4].tolist()), [1, 2, 3, 4])
        self.assertEqual(recording.times_ns[4], 100_000_000)
        agents = {int(of["id"]): of for of in recording.agents}
        self.assertEqual(agents[1]["agent_type"], stgdat.AgentType.VEHICLE)
        self.assertEqual(agents[3]["agent_type"], stgdat.AgentType.PEDESTRIAN)
        self.assertEqual((agents[3]["first_ns"], agents[3]["last_ns"], agents[3]["rows"]), (0, 7_900_000_000, 80))
        self.assertEqual(recording.doubts, [])
        rows = "".join(f"{t / 10},,pedestrian,{t / 10},0,,\n" for t in range(9))
        unnamed = stgdat.open(self.write("unnamed.csv", HEAD + rows))
        self.assertEqual((unnamed.has_identities, len(unnamed.agents)), (False, 0))
        self.assertFalse(recording.detections.flags.writeable)

    def test_bad_input_names_file_line_and_value(self) -> None:
        path = self.write("b.csv", HEAD + "0,1,pedestrian,1,2,,\n0.1,1,car,1,2,,\n")
        with self.assertRaises(stgdat.InputError) as raised:
            stgdat.open(path)
        error = raised.exception
        self.assertTrue(str(error).startswith(f'{path}:3:7: type = "car": expected vehicle'), str(error))
        self.assertEqual((error.path, error.line, error.value), (str(path), 3, "car"))
        self.assertIsInstance(error, ValueError)
        with self.assertRaises(stgdat.InputError) as raised:
            stgdat.open(self.folder / "none.csv")
        self.assertIn("none.csv", str(raised.exception))
        self.assertIsNone(raised.exception.line)
        with self.assertRaisesRegex(stgdat.InputError, "b.csv:3:7"):
            stgdat.evaluate(path)

    def test_bad_arguments_are_refused(self) -> None:
        path = self.write("weights.safetensors", "nothing")
        with self.assertRaisesRegex(stgdat.InputError, "weights.safetensors"):
            stgdat.Predictor(path)
        with self.assertRaisesRegex(stgdat.InputError, "tracker.fov"):
            stgdat.Predictor(settings={"tracker.fov": "wide"})
        with self.assertRaisesRegex(stgdat.InputError, "xml"):
            stgdat.open(self.write("a.csv", walk()), format="xml")

    def test_bad_detections_name_row_and_value(self) -> None:
        predictor = stgdat.Predictor()
        with self.assertRaisesRegex(stgdat.InputError, r"detections\[1\]: .*position is not finite"):
            stgdat.detections(0, [0, 0], [1.0, math.nan], [0.0, 0.0])
        with self.assertRaisesRegex(stgdat.InputError, r"detections\[0\]: .*7"):
            stgdat.detections(0, [7], [1.0], [0.0])
        with self.assertRaises(stgdat.InputError):
            stgdat.detections(0, np.zeros(600), np.zeros(600), np.zeros(600))
        tick = stgdat.detections(2_000_000_000, [0], [1.0], [0.0])
        self.assertEqual(len(predictor.step(tick)), 0)
        for stages in (predictor, stgdat.Tracker(), stgdat.Tracker(prior="learned")):
            with self.assertRaisesRegex(stgdat.InputError, "2.000 s") as raised:
                for _ in range(2):
                    stages.step(tick)
            self.assertIsNone(raised.exception.line)

    def test_tracker_alone(self) -> None:
        path = self.write("walk.csv", walk())
        *_, tracks = stgdat.Tracker().run(path)
        self.assertEqual(sorted(tracks.source_ids.tolist()), [1, 2, 3, 4])
        car = tracks.source_ids.tolist().index(1)
        self.assertAlmostEqual(tracks.positions_m[car, 0], 8 * 7.9 - 30, delta=0.5)
        self.assertAlmostEqual(tracks.velocities_mps[car, 0], 8, delta=0.5)
        self.assertEqual(tracks.history["x_m"].shape[0], 4)
        predictor = stgdat.Predictor()
        *_, forecasts = predictor.run(path)
        *_, learned = stgdat.Tracker(prior="learned").run(path)
        self.assertEqual(learned.records.tobytes(), predictor.tracks.records.tobytes())

    def test_evaluate_equals_the_program(self) -> None:
        path = self.write("walk.csv", walk())
        evaluation = stgdat.evaluate([path])
        lab = Path(PROGRAM).with_name("stgdat-lab")
        if not lab.exists():
            self.skipTest("stgdat-lab is not built")
        out = self.folder / "figures.json"
        done = subprocess.run([lab, "evaluate", path, "--json", out], check=True, capture_output=True, text=True)
        self.assertEqual(json.loads(out.read_text())["figures"], evaluation.figures)
        self.assertTrue(done.stdout.startswith(evaluation.table))
        state = self.folder / "walk.state"
        subprocess.run([lab, "evaluate", path, "--state", state], check=True, capture_output=True)
        self.assertEqual(state.read_bytes(), stgdat.evaluate_state(path))
        merged = subprocess.run([lab, "evaluate", "--merge", state], check=True, capture_output=True, text=True)
        printed = merged.stdout
        self.assertEqual(printed, evaluation.text)
        self.assertEqual(printed, done.stdout)
        example = [sys.executable, str(EXAMPLES / "figures.py"), str(path)]
        printed = subprocess.run(example, check=True, capture_output=True, text=True).stdout
        self.assertEqual(printed, evaluation.table + "\n")

    def test_forecasts_give_the_figures_again(self) -> None:
        path = self.write("walk.csv", walk())
        evaluation = stgdat.evaluate([stgdat.open(path), path], forecasts=True)
        self.assertIsNone(stgdat.evaluate(path).forecasts)
        rows = evaluation.forecasts
        assert rows is not None
        figures = {
            (figure["method"], figure["measure"], figure["quantity"]): figure
            for figure in evaluation.figures
            if figure["subset"] == "moving" and figure["horizon_s"] > 4.5
        }
        counted = rows.subsets["moving"]
        self.assertEqual(len(rows), len(counted))
        for name, method in rows.methods.items():
            for measure, paths in ("K = 1", method.single_m), ("minADE₂₀ / minFDE₂₀", method.modes_m):
                if paths is None:
                    continue
                truth = rows.truth_m if measure == "K = 1" else rows.truth_m[:, None]
                errors = np.linalg.norm(paths - truth, axis=-1)[counted]
                means = [errors.mean(-1), errors[..., -1]]
                if measure != "K = 1":
                    means = [error.min(1) for error in means]
                for quantity, error in zip(("ADE, m", "FDE, m"), means):
                    figure = figures[name, measure, quantity]
                    self.assertAlmostEqual(figure["value"], error.mean(), places=5)

    def test_overhead_writes_its_table_between_the_marks(self) -> None:
        page = self.write("page.md", "a\n<!-- begin overhead.py -->\nold\n<!-- end overhead.py -->\nb\n")
        options = ["--agents", "1,8", "--rounds", "1", "--ticks", "10", "--kernels", "", "--table", str(page)]
        done = subprocess.run([sys.executable, str(EXAMPLES / "overhead.py"), *options], check=True, capture_output=True)
        head, *rows = done.stdout.decode().splitlines()
        self.assertEqual([row.split("|")[1:3] for row in rows[1:]], [[" fastest ", " 1 "], [" fastest ", " 8 "]])
        lines = ["a", "<!-- begin overhead.py -->", head, *rows, "<!-- end overhead.py -->", "b"]
        self.assertEqual(page.read_text().splitlines(), lines)

    def test_states_merge_to_the_figures_of_all_recordings(self) -> None:
        paths = [self.write(f"walk{number}.csv", walk(number)) for number in range(3)]
        broken = self.write("broken.csv", "stamp_s,type,x_m,y_m\n0,car,1,2\n")
        evaluator = stgdat.Evaluator(threads=1)
        states = [evaluator.state(path) for path in paths]
        with self.assertRaisesRegex(stgdat.InputError, "broken.csv:2") as raised:
            evaluator.state(broken)
        failures = [(str(broken), str(raised.exception))]
        whole = stgdat.evaluate([*paths, broken])
        self.assertEqual(stgdat.merge_states(iter(states), failures), whole)
        self.assertEqual(len(whole.failed), 1)
        self.assertIn("Failed: ", whole.text)
        named = stgdat.merge_states([evaluator.state(paths[0], name="day/walk")])
        self.assertEqual({figure["part"] for figure in named.figures}, {"day/walk"})
        part = stgdat.combine_states([states[2], states[0]], failures)
        self.assertEqual(stgdat.merge_states([part, states[1]]), whole)
        self.assertEqual(stgdat.combine_states([states[1], part]), stgdat.combine_states(states, failures))
        many = stgdat.merge_states(states[number % 3] for number in range(600))
        self.assertEqual({figure["part"] for figure in many.figures}, {"all"})
        with self.assertRaisesRegex(stgdat.InputError, r"states\[1\]: map none, but states\[0\] has online"):
            stgdat.merge_states([states[0], stgdat.evaluate_state(paths[0], map="none")])
        with self.assertRaisesRegex(stgdat.InputError, r"states\[2\]: the state is damaged"):
            stgdat.merge_states([*states[:2], states[2][:-1]])
        with self.assertRaisesRegex(stgdat.InputError, "no state"):
            stgdat.merge_states([])
        with self.assertRaisesRegex(stgdat.InputError, "map = 'site'"):
            stgdat.Evaluator(map="site")


class Runs(InFolder):
    def test_record_and_live_run(self) -> None:
        path = self.folder / "run.mcap"
        run = subprocess.Popen(
            [PROGRAM, "run", "--ticks", "150", "--agents", "6", "--speed", "real", "--record", str(path)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        try:
            attached = self.attach(run)
            example = [sys.executable, str(EXAMPLES / "planner.py"), attached.root]
            planner = subprocess.Popen(example, stdout=subprocess.PIPE, text=True)
            frames = list(attached.frames("tracks", "forecasts"))
        finally:
            output, _ = run.communicate(timeout=120)
        self.assertEqual(run.returncode, 0, output)
        printed, _ = planner.communicate(timeout=60)
        self.assertEqual(planner.returncode, 0)
        self.assertRegex(printed, r"tick \d+: track \d+ comes within \d")
        live = {of.seq: of for of in frames if isinstance(of, stgdat.Forecasts)}
        self.assertGreater(len(live), 20)
        record = stgdat.read_record(path)
        self.assertIsNone(record.incomplete)
        self.assertEqual(record.damages(), [])
        self.assertEqual(record.about["run"]["lockstep"], False)
        kept = {of.seq: of for of in record.frames("forecasts") if isinstance(of, stgdat.Forecasts)}
        self.assertTrue(130 <= len(kept) <= 150, len(kept))  # a busy machine loses ticks
        for seq, forecasts in live.items():
            self.assertEqual(forecasts.modes_m.tobytes(), kept[seq].modes_m.tobytes())
            self.assertEqual(forecasts.ids.tolist(), kept[seq].ids.tolist())
        self.assertTrue(any("ended" in json.dumps(event).lower() for event in record.events()))
        # The record leaves out the controls, which do not end the fields before them.
        self.assertNotIn("controls", kept[max(kept)].records.dtype.names or ())
        self.assertIn("controls", live[max(live)].records.dtype.names or ())

    def attach(self, run: subprocess.Popen[str]) -> stgdat.Run:
        """The run's own process, not another one on this machine."""
        for _ in range(600):
            assert run.poll() is None, run.communicate()[0]
            for root in Path("/tmp").glob("stgdat_????????"):
                try:
                    launcher = (root / "tap").exists() and self.is_of(root, run.pid)
                except OSError:
                    continue
                if launcher:
                    return stgdat.Run.attach(root)
            threading.Event().wait(0.05)
        raise AssertionError("no run")

    @staticmethod
    def is_of(root: Path, pid: int) -> bool:
        """Whether a process of this run has that parent."""
        for status in Path("/proc").glob("[0-9]*/environ"):
            try:
                found = status.read_bytes()
                parent = (status.parent / "stat").read_text().rsplit(")", 1)[1].split()[1]
            except OSError:
                continue
            if os.fsencode(root) in found and parent == str(pid):
                return True
        return False

    def test_missing_runs_and_records_are_refused(self) -> None:
        with self.assertRaisesRegex(stgdat.InputError, "no run /nowhere"):
            stgdat.Run.attach("/nowhere")
        with self.assertRaisesRegex(stgdat.InputError, "a.mcap"):
            stgdat.read_record(self.write("a.mcap", "no record"))


class Package(InFolder):
    def test_enumerations_are_those_of_the_wire(self) -> None:
        wire = _stgdat.numbers()
        for enumeration in [stgdat.AgentType, stgdat.TrackStatus, stgdat.Quality, stgdat.Cause, stgdat.Expert]:
            names = {member.value: member.name.lower().replace("_", " ") for member in enumeration}
            self.assertEqual(names, wire[enumeration.__name__], enumeration)
        bits = _stgdat.constants()
        for flag in stgdat.DetectionFlags:
            self.assertEqual(flag.value, bits[flag.name or ""])

    def test_examples_in_the_documentation(self) -> None:
        examples = 0
        for name in ["", ".arguments", ".frames", ".recording", ".stages"]:
            result = doctest.testmod(importlib.import_module(f"stgdat{name}"))
            self.assertEqual(result.failed, 0, name)
            examples += result.attempted
        self.assertGreater(examples, 15)

    def test_errors_can_be_sent_to_other_processes(self) -> None:
        path = self.write("b.csv", HEAD + "0,1,car,1,2,,\n")
        for name, kind in ((path, stgdat.InputError), ("/nowhere/a.csv", stgdat.MissingFileError)):
            with self.assertRaises(stgdat.InputError) as raised:
                stgdat.open(name)
            copied = pickle.loads(pickle.dumps(raised.exception))
            self.assertEqual((type(copied), str(copied)), (kind, str(raised.exception)))

    def test_missing_files_and_wrong_types_have_their_own_errors(self) -> None:
        missing = str(self.folder / "none.csv")
        missing_files: List[Callable[[], object]] = [
            lambda: stgdat.open(missing),
            lambda: stgdat.Predictor(missing),
            lambda: stgdat.Predictor(lanes=missing),
            lambda: stgdat.Tracker(weights=missing),
            lambda: stgdat.Evaluator(missing),
            lambda: stgdat.Evaluator().state(missing),
        ]
        for call in missing_files:
            with self.assertRaisesRegex(FileNotFoundError, "none.csv"):
                call()
        predictor: Any = stgdat.Predictor()
        unknown: Any = 3.5
        wrong_types: List[Callable[[], object]] = [
            lambda: stgdat.open(unknown),
            lambda: stgdat.Predictor(unknown),
            lambda: stgdat.Predictor(seed=unknown),
            lambda: predictor.step(unknown),
            lambda: predictor.step([1, 2]),
            lambda: predictor.run(unknown),
            lambda: stgdat.evaluate(unknown),
            lambda: stgdat.detections(unknown, [0], [0.0], [0.0]),
            lambda: stgdat.detections(0, ["car"], [0.0], [0.0]),
            lambda: stgdat.detections(0, [0], [0.0], [0.0], ids=["a"]),
        ]
        for call in wrong_types:
            with self.assertRaises(TypeError):
                call()

    def test_detections_that_cannot_be_are_refused(self) -> None:
        two: Any = {"types": [0, 0], "x_m": [0.0, 9.0], "y_m": [0.0, 0.0]}
        masked: Any = np.ma.MaskedArray([0.0, 9.0], [False, True])
        wrong: List[Any] = [
            ({"ids": [7, 7]}, "7 twice"),
            ({"ids": [1.5, 2]}, "1.5: expected whole"),
            ({"ids": [-1, 2]}, "-1: expected whole"),
            ({"ids": [math.nan, 2]}, "nan: expected whole"),
            ({"types": [0, 0.5]}, "0.5: expected whole"),
            ({"x_m": masked}, "x_m has masked values"),
            ({"headings_rad": masked}, "heading_rad has masked values"),
            ({"ids": np.ma.MaskedArray([1, 2], [True, False])}, "ids has masked values"),
            ({"sizes_m": [[0.0, 1.0], [4.0, 2.0]]}, "sizes_m has 0"),
            ({"sizes_m": [[-4.0, 1.0], [4.0, 2.0]]}, "sizes_m has -4"),
            ({"sizes_m": [[4.0, math.inf], [4.0, 2.0]]}, "sizes_m has inf"),
            ({"sizes_m": [[4.0, math.nan], [4.0, 2.0]]}, "one of length and width"),
            ({"interval_ns": 0}, "interval_ns = 0"),
            ({"stamp_ns": -1}, "stamp_ns = -1"),
            ({"stamp_ns": 1 << 63}, "stamp_ns = "),
            ({"offsets_ns": [0, 5]}, "offsets_ns has 5"),
        ]
        for change, message in wrong:
            arguments: Any = {"stamp_ns": 0, **two, **change}
            with self.assertRaisesRegex(stgdat.InputError, message):
                stgdat.detections(**arguments)
        unknown = stgdat.detections(0, **two, sizes_m=[[math.nan, math.nan], [4.0, 2.0]], ids=np.array([0, 2**64 - 1], np.uint64))
        self.assertEqual(unknown.records["length_m"].tolist(), [0.0, 4.0])
        self.assertEqual(int(unknown.records["id"][1]), 2**64 - 1)

    def test_detections_have_an_origin(self) -> None:
        origin = (691_608.25, 5_334_763.5)
        predictor = stgdat.Predictor()
        for tick in range(20):
            x_m = origin[0] + 0.8 * tick
            made = stgdat.detections(tick * 100_000_000, [0], [x_m], [origin[1] + 2.0], ids=[1], origin=origin)
            self.assertAlmostEqual(float(made.records["x_m"][0]), 0.8 * tick, places=5)
            forecasts = predictor.step(made)
        self.assertEqual((made.origin_m, forecasts.origin_m), (origin, origin))
        self.assertAlmostEqual(float(forecasts.velocities_mps[0, 0]), 8.0, places=1)
        with self.assertRaisesRegex(stgdat.InputError, "the stages have the origin"):
            predictor.step(stgdat.detections(3_000_000_000, [0], [9.0], [0.0], origin=(5.0, 5.0)))
        with self.assertRaisesRegex(stgdat.InputError, "not finite, or too far"):
            stgdat.detections(0, [0], [0.0], [0.0], origin=(math.nan, 0.0))

    def test_agents_beyond_the_limit_are_counted(self) -> None:
        predictor = stgdat.Predictor()
        places = 6.0 * np.arange(140)
        for tick in range(5):
            made = stgdat.detections(tick * 100_000_000, [0] * 140, places, places * 0.0, ids=np.arange(140))
            forecasts = predictor.step(made)
        self.assertEqual((len(forecasts), forecasts.left_out), (128, 12))

    def test_doubts_about_live_detections(self) -> None:
        predictor = stgdat.Predictor()
        for tick in range(64):
            # Headings in degrees.
            made = stgdat.detections(
                tick * 100_000_000, [0, 0], [0.8 * tick, 9.0], [0.0, 0.8 * tick], ids=[1, 2], headings_rad=[0.0, 90.0]
            )
            predictor.step(made)
        self.assertEqual(len(predictor.doubts), 1, predictor.doubts)
        self.assertIn("degrees", predictor.doubts[0])
        predictor.reset()
        self.assertEqual(predictor.doubts, [])

    def test_a_clock_that_is_set_starts_a_new_session(self) -> None:
        for step_s in (-0.5, -40.0, 60.0):
            predictor = stgdat.Predictor()
            counts = []
            for tick in range(80):
                stamp_ns = round((100.0 + 0.1 * tick + (step_s if tick >= 40 else 0.0)) * 1e9)
                made = stgdat.detections(stamp_ns, [0, 0], [0.8 * tick, 40 - 0.6 * tick], [0.0, 8.0], ids=[1, 2])
                if step_s < 0 and tick == 40:
                    with self.assertRaisesRegex(stgdat.InputError, "is not after"):
                        predictor.step(made)
                else:
                    forecasts = predictor.step(made)
                    counts.append(len(forecasts))
            # The first tick of a session publishes nothing.
            self.assertEqual(counts[:40], [0] + [2] * 39, step_s)
            self.assertEqual((counts[40], set(counts[41:])), (0, {2}), step_s)
            np.testing.assert_allclose(forecasts.velocities_mps, [(8, 0), (-6, 0)], atol=0.1)
            self.assertEqual(["go back" in doubt for doubt in predictor.doubts], [True] if step_s < 0 else [])

    def test_the_noise_of_a_recording_is_a_doubt_if_it_changes(self) -> None:
        random = np.random.default_rng(4)
        rows = []
        for k in range(900):
            sigma = 0.1 if k < 450 else 0.5
            for car in range(8):
                x, y = 0.6 * k + random.normal(0, sigma), 8 * car + random.normal(0, sigma)
                rows.append(f"{k / 10},{car + 1},vehicle,{x:.3f},{y:.3f},,\n")
        recording = stgdat.open(self.write("noisy.csv", HEAD + "".join(rows)))
        self.assertTrue(any("noise of vehicles rose" in doubt for doubt in recording.doubts), recording.doubts)

    def test_shipped_weights_have_names(self) -> None:
        self.write("a.csv", walk())
        free = [line.to_json() for line in stgdat.Predictor("onboard-free").run(self.folder / "a.csv")]
        own = [line.to_json() for line in stgdat.Predictor().run(self.folder / "a.csv")]
        self.assertNotEqual(free, own)
        self.assertEqual(free, predicted(str(self.folder / "a.csv"), "--weights", "onboard-free"))

    def test_objects_can_be_pickled(self) -> None:
        recording = stgdat.open(self.write("a.csv", walk()))
        predictor = stgdat.Predictor()
        *_, tick = recording.ticks()
        *_, forecasts = predictor.run(recording)
        for frame in (tick, forecasts, predictor.tracks):
            copied = pickle.loads(pickle.dumps(frame))
            self.assertIs(type(copied), type(frame))
            self.assertEqual(copied.header.tobytes(), frame.header.tobytes())
            self.assertEqual(copied.records.tobytes(), frame.records.tobytes())
        self.assertEqual(pickle.loads(pickle.dumps(forecasts)).to_json(), forecasts.to_json())
        for made in (recording, stgdat.generate(agents=4, ticks=5), stgdat.generate(agents=4, ticks=5, complete=True)):
            copy = pickle.loads(pickle.dumps(made))
            self.assertEqual((copy.name, copy.sha256, len(copy)), (made.name, made.sha256, len(made)))
            self.assertEqual(copy.detections.tobytes(), made.detections.tobytes())
        evaluator = stgdat.Evaluator(positions=True)
        again = pickle.loads(pickle.dumps(evaluator))
        self.assertEqual(again.state(recording), evaluator.state(recording))
        stored = pickle.dumps(recording)
        self.write("a.csv", walk(1.0))
        with self.assertRaisesRegex(stgdat.InputError, "has changed"):
            pickle.loads(stored)

    @unittest.skipUnless(hasattr(os, "fork"), "needs fork")
    def test_stages_from_before_a_fork_are_refused(self) -> None:
        predictor, tracker = stgdat.Predictor(), stgdat.Tracker()
        tick = stgdat.detections(0, [0], [0.0], [0.0])
        predictor.step(tick)
        read, write = os.pipe()
        child = os.fork()
        if child == 0:
            said = []
            for call in (lambda: predictor.step(tick), lambda: tracker.step(tick), predictor.reset, lambda: predictor.tracks):
                try:
                    call()
                    said.append("nothing")
                except RuntimeError as error:
                    said.append(str(error)[:21])
            os.write(write, ", ".join(said).encode())
            os._exit(0)
        os.close(write)
        with os.fdopen(read) as pipe:
            self.assertEqual(pipe.read(), ", ".join(["these stages belong t"] * 4))
        os.waitpid(child, 0)
        predictor.step(stgdat.detections(100_000_000, [0], [0.0], [0.0]))


class DataFrames(InFolder):
    def setUp(self) -> None:
        super().setUp()
        try:
            import pandas
        except ModuleNotFoundError as error:
            self.skipTest(str(error))
        self.pandas = pandas

    def lines(self, recording: stgdat.Recording) -> List[bytes]:
        return [of.to_json() for of in stgdat.Predictor().run(recording)]

    def test_a_frame_equals_its_file(self) -> None:
        full = "stamp_s,id,type,x_m,y_m,heading_rad,speed_mps,length_m,width_m,score,sigma_m\n1700000000,,ego,1,2,0.5,,,,,\n"
        random = np.random.default_rng(1)
        for k in range(60):
            for car in range(3):
                x, y, score = 0.83 * k + random.normal(0, 0.1), 8 * car + random.normal(0, 0.1), random.random()
                size, speed = ("4.5,1.8", f"{8.3:.1f}") if car else (",", "")
                full += f"{1700000000.1 + k / 10:.3f},{car + 1},vehicle,{x},{y},{'' if car == 2 else 0.01},{speed},{size},{score},0.2\n"
        other = walk().replace("stamp_s,id", "Time_s,track_id").replace(",1,vehicle", ",,vehicle")
        for name, text in [("walk", walk()), ("full", full), ("other", other)]:
            path = self.write(f"{name}.csv", text)
            opened = stgdat.open(path)
            made = stgdat.Recording.from_pandas(self.pandas.read_csv(path))
            with self.subTest(name=name):
                self.assertEqual(made.detections.tobytes(), opened.detections.tobytes())
                self.assertEqual(made.stamps_ns.tolist(), opened.stamps_ns.tolist())
                self.assertEqual(made.doubts, opened.doubts)
                lines = self.lines(made)
                self.assertEqual(lines, self.lines(opened))
                self.assertGreater(len(lines), 50)
                made.save(self.folder / "saved.csv")
                self.assertEqual(self.lines(stgdat.open(self.folder / "saved.csv")), lines)

    def test_arrays_and_frames_go_wherever_files_go(self) -> None:
        path = self.write("walk.csv", walk())
        opened = stgdat.open(path)
        columns = self.pandas.read_csv(path)
        made = stgdat.Recording.from_arrays(
            columns["type"],
            columns["x_m"].to_numpy(),
            columns["y_m"].tolist(),
            stamp_ns=(columns["stamp_s"] * 1e9).round().astype("int64"),
            ids=columns["id"],
            headings_rad=columns["heading_rad"],
            speeds_mps=np.ma.masked_invalid(columns["speed_mps"]),
        )
        self.assertEqual((made.path, made.name, len(made.sha256)), (None, "arrays", 64))
        copy = pickle.loads(pickle.dumps(made))
        for recording in (made, copy):
            self.assertEqual(self.lines(recording), self.lines(opened))
        tracks, expected = stgdat.Tracker().run(made), stgdat.Tracker().run(path)
        self.assertEqual([of.records.tobytes() for of in tracks], [of.records.tobytes() for of in expected])
        self.assertEqual(stgdat.evaluate([made, path]).table, stgdat.evaluate([opened, opened]).table)
        evaluator = stgdat.Evaluator()
        table = stgdat.merge_states([evaluator.state(made)]).table
        self.assertEqual(table, evaluator.evaluate(path).table)
        self.assertEqual(evaluator.evaluate(made).table, table)

    def test_columns_are_named_not_guessed(self) -> None:
        path = self.write("walk.csv", walk())
        frame = self.pandas.read_csv(path)
        own = frame.rename(columns={"x_m": "east", "type": "kind", "speed_mps": "v"})
        own["stamp_s"] = self.pandas.to_datetime(frame["stamp_s"].round(3), unit="s").astype("datetime64[ns]")
        own["weather"] = "rain"
        given = {"stamp_ns": "stamp_s", "x_m": "east", "type": "kind", "speed_mps": "v"}
        made = stgdat.Recording.from_pandas(own, given)
        self.assertEqual(made.detections.tobytes(), stgdat.open(path).detections.tobytes())
        without = stgdat.Recording.from_pandas(own, {**given, "speed_mps": None})
        self.assertFalse(without.detections["speed_mps"].any())
        for change, message in [
            ({"speed_mps": "speed"}, "columns\\['speed_mps'\\] = 'speed': the frame has stamp_s, id"),
            ({"velocity": "v"}, "no such column of a recording"),
        ]:
            with self.assertRaisesRegex(stgdat.InputError, message):
                stgdat.Recording.from_pandas(own, {**given, **change})
        with self.assertRaisesRegex(stgdat.InputError, "column 'v': did you mean speed_mps"):
            stgdat.Recording.from_pandas(own, {"stamp_ns": "stamp_s", "x_m": "east", "type": "kind"})
        with self.assertRaisesRegex(stgdat.InputError, "needs a column type"):
            stgdat.Recording.from_pandas(frame.drop(columns="type"))
        with self.assertRaisesRegex(stgdat.InputError, "needs either stamp_s or stamp_ns"):
            stgdat.Recording.from_pandas(frame.assign(stamp_ns=0))

    def test_bad_values_name_row_and_column(self) -> None:
        frame = self.pandas.read_csv(self.write("walk.csv", walk()))
        wrong: List[Any] = [
            ("type", "car", stgdat.InputError, "type: row 5 has 'car': expected vehicle"),
            ("type", 7, stgdat.InputError, "type: row 5 has 7"),
            ("type", None, stgdat.InputError, "type: row 5 has None"),
            ("x_m", 99_999.0, stgdat.InputError, "row 5: x_m = 99999.0: "),
            ("x_m", math.nan, stgdat.InputError, "row 5: x_m = nothing: "),
            ("x_m", math.inf, stgdat.InputError, "row 5: x_m = inf"),
            ("x_m", "far", TypeError, "row 5: data frame: x_m = 'far': expected a number, not str"),
            ("id", 1.5, stgdat.InputError, "id: row 5 has 1.5: expected a whole number"),
            ("id", -1, stgdat.InputError, "id: row 5 has -1"),
            ("id", "a7", TypeError, "row 5: data frame: id = 'a7': expected a number"),
            ("id", 1, stgdat.InputError, "row 5: id 1 stands in this frame already, in row 4"),
            ("speed_mps", 1e9, stgdat.InputError, "row 5: speed_mps = 1000000000.0"),
            ("stamp_s", math.nan, stgdat.InputError, "row 5: stamp_s = nothing: expected seconds"),
        ]
        for column, value, kind, message in wrong:
            changed = frame.astype({column: object})
            changed.loc[5, column] = value
            if column == "id" and value == 1:
                changed.loc[5, "stamp_s"], changed.loc[4, "stamp_s"] = 0.1, 0.1
                changed.loc[4, "id"] = 1
            with self.subTest(column=column, value=value), self.assertRaisesRegex(kind, message):
                stgdat.Recording.from_pandas(changed)
        with self.assertRaisesRegex(TypeError, "float32, which is too coarse"):
            stgdat.Recording.from_pandas(frame.astype({"stamp_s": "float32"}))
        with self.assertRaisesRegex(stgdat.InputError, "shape"):
            stgdat.Recording.from_arrays("vehicle", [0.0, 1.0], [0.0], stamp_s=[0.0, 0.1])
        with self.assertRaisesRegex(stgdat.InputError, "no rows"):
            stgdat.Recording.from_pandas(frame.iloc[:0])

    def test_the_audit_examines_frames(self) -> None:
        frame = self.pandas.read_csv(self.write("walk.csv", walk()))
        frame["heading_rad"] = np.degrees(frame["heading_rad"])
        self.assertTrue(any("degrees" in doubt for doubt in stgdat.Recording.from_pandas(frame).doubts))

    def test_parquet_names_the_lines_that_read_it(self) -> None:
        try:
            import pyarrow  # noqa: F401
        except ModuleNotFoundError as error:
            self.skipTest(str(error))
        path = self.write("walk.csv", walk())
        expected = self.lines(stgdat.open(path))
        self.pandas.read_csv(path).to_parquet(self.folder / "x.parquet")
        with self.assertRaisesRegex(stgdat.InputError, "a Parquet file") as raised:
            stgdat.open(self.folder / "x.parquet")
        done = subprocess.run([PROGRAM, "predict", str(self.folder / "x.parquet")], capture_output=True, text=True)
        self.assertIn("read_parquet", done.stderr)
        for message in (str(raised.exception), done.stderr):
            program = "\n".join(line.strip() for line in message.splitlines() if line.startswith("    "))
            self.assertEqual(program.count("\n"), 1, message)
            subprocess.run([sys.executable, "-c", program], check=True, cwd=self.folder)
            self.assertEqual(self.lines(stgdat.open(self.folder / "x.csv")), expected)
            (self.folder / "x.csv").unlink()


if __name__ == "__main__":
    unittest.main()
