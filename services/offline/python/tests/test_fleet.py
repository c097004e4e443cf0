"""Tests of `stgdat.fleet`: `check.sh` runs them. Those that need Ray run if it is installed."""

from __future__ import annotations

import importlib.util
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import unittest
import unittest.mock
from pathlib import Path
from typing import Any, Dict, Iterator, List, Optional, Tuple

try:
    import fsspec
    import pyarrow.parquet
except ModuleNotFoundError as missing:
    print(f"skipped: tests of stgdat.fleet need {missing.name}")
    sys.exit(0)

import stgdat
import stgdat.fleet
from stgdat import _stgdat
from stgdat.fleet import Finished, Options, Place, driver, executors, inputs, schedule, work
from stgdat.fleet.inputs import Input
from stgdat.fleet.jobs import Job, Report, table
from stgdat.fleet.jobs.audit import Audit
from stgdat.fleet.jobs.priors import FILE, Priors
from stgdat.fleet.progress import Progress
from stgdat.fleet.store import Result, Store

if importlib.util.find_spec("ray") is None:
    print("skipped: tests on a cluster need ray")

HEAD = "stamp_s,id,type,x_m,y_m,heading_rad,speed_mps\n"
QUIET = Place(processes=0, progress=None)


def drive(seconds: float = 8.0, speed_mps: float = 8.0, agents: int = 3) -> str:
    """Cars in lanes of their own and a pedestrian, at 10 Hz."""
    rows: List[str] = []
    for k in range(round(10 * seconds)):
        t = k / 10
        for agent in range(agents):
            v = speed_mps + agent
            rows.append(f"{t},{agent + 1},vehicle,{v * t:.2f},{4 * agent},0,{v}\n")
        rows.append(f"{t},99,pedestrian,{1.4 * t:.2f},-8,0,1.4\n")
    return HEAD + "".join(rows)


class Count(Job):
    """Counts the bytes of recordings, and behaves as the content of a file demands."""

    name = "count"
    columns = {"length": "int64"}

    def work(self, recording: Input, path: str, key: str, store: Store) -> Result:
        content = Path(path).read_bytes()
        tries = Path(os.environ["STGDAT_TEST_TRIES"])
        mark = tries / f"{Path(path).name}.{time.monotonic_ns()}"
        mark.touch()
        if content.startswith(b"raise"):
            raise ValueError(f"{path}: bad")
        if content.startswith(b"die"):
            os.kill(os.getpid(), signal.SIGKILL)
        if content.startswith(b"once") and len(list(tries.glob(f"{Path(path).name}.*"))) == 1:
            os.kill(os.getpid(), signal.SIGKILL)
        return {"row": {"length": len(content)}, "state": len(content)}

    def merge(self, results: Iterator[Result]) -> Report:
        rows = [[of["name"], str(of.get("state", "-")), of["error"] or ""] for of in results]
        return Report(table("Lengths", ["name", "length", "error"], rows), len(rows))


class InFolder(unittest.TestCase):
    """A test with a folder of its own."""

    def setUp(self) -> None:
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = Path(folder.name)
        self.tries = self.folder / "tries"
        self.tries.mkdir()
        os.environ["STGDAT_TEST_TRIES"] = str(self.tries)

    def write(self, files: Dict[str, str], under: str = "drives") -> Path:
        for name, content in files.items():
            path = self.folder / under / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(content)
        return self.folder / under

    def tried(self, name: str) -> int:
        return len(list(self.tries.glob(f"{name}.*")))

    def content(self, finished: Finished) -> List[bytes]:
        """The files that people read."""
        names = ["tables.md", "figures.json", "recordings.parquet"]
        return [(Path(finished.output) / name).read_bytes() for name in names]


class Inputs(InFolder):
    def test_folders_lists_and_patterns(self) -> None:
        root = self.write({"b/2.csv": "22", "a/1.csv": "1", "a/notes.md": "no", "c.mcap": "333"})
        found = inputs.find(root)
        self.assertEqual([of.name for of in found], ["drives/a/1.csv", "drives/b/2.csv", "drives/c.mcap"])
        self.assertEqual([of.size for of in found], [1, 2, 3])
        self.assertEqual([of.name for of in inputs.find(root, ["*.md"])], ["drives/a/notes.md"])
        one = inputs.find(root / "a" / "notes.md")
        self.assertEqual([of.name for of in one], ["a/notes.md"])
        listed = self.folder / "list.txt"
        listed.write_text(f"# two\n{root}/c.mcap\n\n{root}/a\n")
        self.assertEqual([of.name for of in inputs.find(f"@{listed}")], ["a/1.csv", "drives/c.mcap"])
        # A path that is given twice is one recording.
        self.assertEqual(len(inputs.find([root, root])), 3)
        with self.assertRaises(FileNotFoundError):
            inputs.find(self.folder / "nowhere")
        with self.assertRaisesRegex(FileNotFoundError, "no recording"):
            driver.run(Count(Options()), self.tries, self.folder / "out", QUIET)

    def test_a_recording_without_a_file_is_stored(self) -> None:
        made = stgdat.generate(agents=4, ticks=60, complete=True)
        path = self.folder / "made.csv"
        made.save(path)
        tables: List[Any] = []
        for recordings in ([made], [str(path)]):
            finished = driver.run(Audit(Options()), recordings, self.folder / f"out{len(tables)}", QUIET)
            self.assertEqual([of.error for of in finished.done], [None])
            tables.append(finished.report.figures)
        self.assertEqual(tables[0], tables[1])

    def test_options_are_checked_before_the_first_task(self) -> None:
        root = self.write({"a/1.csv": "1"})
        out = self.folder / "out"
        for options, kind in (
            (Options(weights="none.safetensors"), FileNotFoundError),
            (Options(format="xml"), stgdat.InputError),
            (Options(settings={"tracker.fov": "wide"}), stgdat.InputError),
        ):
            with self.assertRaises(kind):
                driver.run(Count(options), root, out, QUIET)
        command = [sys.executable, "-m", "stgdat.fleet", "audit", str(root), "--output", str(out), "--format", "xml"]
        done = subprocess.run(command, capture_output=True, text=True)
        self.assertEqual((done.returncode, done.stderr.count("\n")), (65, 1), done.stderr)
        self.assertTrue(done.stderr.startswith("error: ") and "xml" in done.stderr, done.stderr)
        self.assertFalse((out / "results").exists())
        driver.run(Count(Options(weights="onboard-free")), root, out, QUIET)

    def test_recordings_and_results_at_an_address(self) -> None:
        fs = fsspec.filesystem("memory")
        fs.pipe({"/fleet/a/1.csv": b"one", "/fleet/b.csv": b"raise"})
        self.addCleanup(fs.rm, "/fleet", True)
        finished = driver.run(Count(Options()), "memory://fleet", "memory://fleet/out", QUIET)
        text = fs.cat_file("/fleet/out/tables.md").decode()
        self.assertIn("| fleet/a/1.csv | 3 |  |", text)
        # The error names the recording, and not its copy on this machine.
        self.assertIn("| fleet/b.csv | - | ValueError: fleet/b.csv: bad |", text)
        self.assertEqual(len(finished.failed), 1)

    def test_tasks_are_bounded_in_bytes_and_number(self) -> None:
        recordings = [Input(f"{place:03}", "", 10) for place in range(100)]
        for limit, cores in [(35, 1), (1, 1), (10**9, 1), (10**9, 4)]:
            tasks = work.tasks(recordings, limit, cores)
            places = [place for task in tasks for place, _ in task.recordings]
            self.assertEqual(places, list(range(100)))
            self.assertTrue(all(task.size <= limit or len(task.recordings) == 1 for task in tasks))
            self.assertGreaterEqual(len(tasks), 8 * cores)


class Jobs(InFolder):
    FILES = {f"{place:02}.csv": "x" * place for place in range(1, 20)}

    def run_count(self, out: str, place: Place = QUIET) -> Finished:
        return driver.run(Count(Options()), self.folder / "drives", self.folder / out, place)

    def test_any_split_gives_the_same_bytes(self) -> None:
        self.write({**self.FILES, "bad.csv": "raise"})
        alone = self.content(self.run_count("alone"))
        for name, place in {
            "small": Place(processes=3, task_mib=1e-6, progress=None),
            "large": Place(processes=2, progress=None),
        }.items():
            self.assertEqual(self.content(self.run_count(name, place)), alone, name)
        rows = pyarrow.parquet.read_table(self.folder / "alone" / "recordings.parquet").to_pylist()
        self.assertEqual([row["length"] for row in rows], [*range(1, 20), None])
        self.assertIn("ValueError", rows[-1]["error"])

    def test_a_recording_that_fails_is_set_aside_after_two_tries(self) -> None:
        self.write({"a.csv": "fine", "b.csv": "raise"})
        finished = self.run_count("out")
        self.assertEqual((self.tried("a.csv"), self.tried("b.csv")), (1, 2))
        self.assertEqual([done.error is None for done in finished.done], [True, False])

    def test_a_recording_that_kills_workers_is_set_aside_and_others_are_done(self) -> None:
        self.write({**self.FILES, "10.csv": "die"})
        finished = self.run_count("out", Place(processes=2, progress=None))
        (failed,) = finished.failed
        self.assertEqual(failed.error, "a worker died on it 2 times")
        rows = pyarrow.parquet.read_table(self.folder / "out" / "recordings.parquet").to_pylist()
        self.assertEqual([row["length"] for row in rows], [None if place == 10 else place for place in range(1, 20)])

    def test_a_worker_that_dies_once_changes_nothing(self) -> None:
        files = {**self.FILES, "10.csv": "once"}
        self.write(files)
        finished = self.run_count("out", Place(processes=2, progress=None))
        self.assertEqual(finished.failed, [])
        self.assertEqual(self.tried("10.csv"), 2)
        self.assertEqual(self.content(finished), self.content(self.run_count("again")))

    def test_the_death_of_a_node_is_not_the_fault_of_a_recording(self) -> None:
        self.write({"a.csv": "fine"})

        class Unlucky(executors.Here):
            left = 5

            def wait(self, timeout_s: float) -> List[executors.Outcome]:
                if self.left == 0:
                    return super().wait(timeout_s)
                self.left -= 1
                return [(self._tasks.popleft(), executors.Lost("the node died", is_of_worker=False))]

        finished = driver.run(Count(Options()), self.folder / "drives", self.folder / "out", QUIET, Unlucky)
        self.assertEqual(finished.failed, [])

    def test_a_job_that_was_broken_off_resumes(self) -> None:
        self.write({**self.FILES, "bad.csv": "raise"})
        whole = self.content(self.run_count("whole"))
        shutil.rmtree(self.tries)
        self.tries.mkdir()

        class BrokenOff(executors.Here):
            left = 7

            def wait(self, timeout_s: float) -> List[executors.Outcome]:
                if self.left == 0:
                    raise KeyboardInterrupt
                self.left -= 1
                return super().wait(timeout_s)

        with self.assertRaises(KeyboardInterrupt):
            driver.run(Count(Options()), self.folder / "drives", self.folder / "out", QUIET, BrokenOff)
        before = len(list(self.tries.iterdir()))
        finished = self.run_count("out")
        self.assertEqual(self.content(finished), whole)
        self.assertEqual(sum(done.is_found for done in finished.done), before)
        # Every recording was computed once, and the bad one twice.
        self.assertEqual(len(list(self.tries.iterdir())), len(self.FILES) + 2)
        again = self.run_count("out")
        self.assertTrue(all(done.is_found for done in again.done))
        self.assertEqual(len(again.failed), 1)

    def test_other_content_options_and_names_are_computed(self) -> None:
        root = self.write({"a.csv": "one"})

        def done(options: Options = Options()) -> work.Done:
            job = Count(options)
            # The weights of this test are no weights.
            with unittest.mock.patch.object(job, "check"):
                return driver.run(job, root, self.folder / "out", QUIET).done[0]

        first = done()
        self.assertTrue(done().is_found)
        second = done(Options(settings={"sampler.evidence": "false"}))
        weights = self.folder / "weights"
        weights.write_text("1")
        third = done(Options(weights=str(weights)))
        weights.write_text("2")
        fourth = done(Options(weights=str(weights)))
        self.write({"a.csv": "two"})
        fifth = done()
        keys = {of.key for of in (first, second, third, fourth, fifth)}
        self.assertEqual(len(keys), 5)
        self.assertFalse(any(of.is_found for of in (second, third, fourth, fifth)))

    def test_a_worker_with_another_build_ends_the_job(self) -> None:
        spec = work.Spec(Count(Options()), Store(str(self.folder / "out")), "another")
        with self.assertRaises(work.OtherBuild):
            work.run(spec, work.Task(()))

    def test_results_are_whole_or_absent(self) -> None:
        store = Store(str(self.folder / "out"))
        store.write_result("abc", {"name": "a"})
        store.write_result("abc", {"name": "a"})
        self.assertEqual(store.result("abc"), {"name": "a"})
        self.assertFalse(store.has_result("abd"))
        files = [path.name for path in (self.folder / "out").rglob("*") if path.is_file()]
        self.assertEqual(files, ["abc.json.gz"])

    def test_tasks_in_flight_are_bounded(self) -> None:
        most = 0

        class Watched(executors.Here):
            cores = 3

            def submit(self, task: work.Task) -> None:
                nonlocal most
                super().submit(task)
                most = max(most, len(self._tasks))

        self.write(self.FILES)
        driver.run(Count(Options()), self.folder / "drives", self.folder / "out", QUIET, Watched)
        self.assertEqual(most, 3 * schedule.IN_FLIGHT)

    def test_progress_shows_rate_and_time_left(self) -> None:
        now = 0.0
        output = io.StringIO()
        progress = Progress(4, 400, output, lambda: now)
        progress.add(100, True, False)
        now = 20.0
        progress.add(100, False, False)
        self.assertEqual(progress.line(), "2/4 recordings, 0.05/s, 0:40 left, 1 done before")
        now = 40.0
        progress.lost += 1
        progress.add(200, False, True)
        self.assertEqual(output.getvalue().count("\n"), 2)


class Recordings(InFolder):
    """The jobs themselves, on small recordings."""

    def test_audit_counts_doubts_and_sets_aside_what_is_no_recording(self) -> None:
        degrees = drive().replace(",0,8.0\n", ",90,8.0\n").replace(",0,9.0\n", ",90,9.0\n")
        whole = drive()
        self.write(
            {
                "a/good.csv": whole,
                "a/degrees.csv": degrees,
                "a/empty.csv": "",
                "a/broken.csv": whole.replace("vehicle", "vehicle,", 3).replace("vehicle,", "vehicle", 2),
                "a/cut.csv": whole[: len(whole) // 2 + 3],
            }
        )
        finished = stgdat.fleet.audit(self.folder / "drives", self.folder / "out", place=QUIET)
        figures = finished.report.figures
        self.assertEqual((figures["recordings"], figures["doubtful"]), (3, 2))
        kinds = {"cut_off": ["drives/a/cut.csv"], "headings_in_degrees": ["drives/a/degrees.csv"]}
        self.assertEqual(figures["kinds"], kinds)
        self.assertEqual([of["name"] for of in figures["set_aside"]], ["drives/a/broken.csv", "drives/a/empty.csv"])
        self.assertNotIn(str(self.folder), finished.report.text)

    def test_evaluate_gives_the_figures_of_a_single_evaluation(self) -> None:
        root = self.write({"a.csv": drive(12.0), "b.csv": drive(12.0, 11.0), "empty.csv": "", "short.csv": drive(2.0)})
        options = Options(rows=True)
        finished = stgdat.fleet.evaluate(root, self.folder / "out", options, place=QUIET)
        self.assertEqual([done.error is None for done in finished.done], [True, True, False, True])
        whole = stgdat.evaluate([root / name for name in ("a.csv", "b.csv", "short.csv")])
        figures = finished.report.figures
        self.assertEqual(figures["figures"], whole.figures)
        self.assertEqual(figures["left_out"], whole.left_out)
        self.assertEqual(figures["failed"], ["drives/empty.csv: InputError: drives/empty.csv: no rows"])
        self.assertTrue(finished.report.text.startswith(whole.table[: whole.table.index("Left out")]))
        rows = pyarrow.parquet.read_table(self.folder / "out" / "recordings.parquet").to_pylist()
        of_a = [of for of in whole.figures if of["part"] == "drives/a" and of["subset"] == "all"]
        steady = [of for of in of_a if (of["method"], of["measure"]) == ("constant velocity", "K = 1")]
        last = max(of["horizon_s"] for of in steady)
        (ade_m,) = [of["value"] for of in steady if of["horizon_s"] == last and of["quantity"] == "ADE, m"]
        self.assertEqual(rows[0]["constant_velocity_ade_m"], ade_m)
        self.assertGreater(rows[0]["best_ade_m"], 0.0)
        self.assertEqual([row["agents"] for row in rows[2:]], [None, 0])
        table = pyarrow.parquet.read_table(self.folder / "out" / "rows").to_pylist()
        self.assertGreater(sum(row["recording"] == "drives/a.csv" and row["ade_m"] is not None for row in table), 100)
        with self.assertRaisesRegex(stgdat.InputError, "sampler.evidence"):
            stgdat.fleet.evaluate(root, self.folder / "out", Options(settings={"sampler.evidence": "false"}))

    def test_replay_shows_what_other_settings_change(self) -> None:
        self.write({"a.csv": drive(12.0), "b.csv": drive(12.0, 11.0)})
        root = self.folder / "drives"
        same = stgdat.fleet.replay(root, self.folder / "same", place=QUIET).report.figures
        vehicles = same["types"]["vehicle"]
        self.assertGreater(vehicles["matured"], 100)
        self.assertEqual((vehicles["different"], vehicles["better"], vehicles["worse"]), (0, 0, 0))
        options = Options(settings={"sampler.evidence": "false"}, rows=True)
        finished = stgdat.fleet.replay(root, self.folder / "other", options, place=QUIET)
        vehicles = finished.report.figures["types"]["vehicle"]
        self.assertGreater(vehicles["different"], 100)
        changed = vehicles["better"] + vehicles["worse"]
        self.assertTrue(100 < changed <= vehicles["matured"], changed)
        pages = sorted((self.folder / "other" / "pages").iterdir())
        self.assertEqual({page.name[2:] for page in pages}, {"-a.html", "-b.html"})
        page = pages[0].read_bytes()
        # Both runs with their scenes, and the option that differs.
        self.assertEqual(page.count(b'"scrub":'), 2)
        self.assertTrue(b'"sampler.evidence":"false"' in page)
        self.assertFalse((self.folder / "same" / "pages").exists())
        files = sorted((self.folder / "other" / "rows").rglob("*.parquet"))
        self.assertEqual(len(files), 2)
        rows = pyarrow.parquet.read_table(files[0]).to_pylist()
        of_vehicles = [row for row in rows if row["type"] == "vehicle" and row["before_ade_m"] is not None]
        self.assertEqual({row["recording"] for row in rows} - {"drives/a.csv", "drives/b.csv"}, set())
        self.assertGreater(len(of_vehicles), 50)

    def test_replay_compares_with_the_forecasts_of_a_record(self) -> None:
        program = os.environ.get("STGDAT_PROGRAM")
        if program is None:
            self.skipTest("STGDAT_PROGRAM is not set")
        root = self.write({"a.csv": drive(12.0)})
        record = root / "a.mcap"
        command = [program, "run", str(root / "a.csv"), "--speed", "max", "--record", str(record)]
        subprocess.run(command, check=True, capture_output=True, stdin=subprocess.DEVNULL)
        finished = stgdat.fleet.replay(record, self.folder / "out", place=QUIET)
        (done,) = finished.done
        self.assertIsNone(done.error)
        vehicles = finished.report.figures["types"]["vehicle"]
        self.assertGreater(vehicles["matured"], 100)
        self.assertEqual(vehicles["different"], 0)
        of_record = stgdat.fleet.evaluate(record, self.folder / "record", place=QUIET).report.figures
        of_file = stgdat.fleet.evaluate(root / "a.csv", self.folder / "file", place=QUIET).report.figures
        self.assertEqual(of_record["figures"], of_file["figures"])
        # The detections of the record are the recording.
        self.assertEqual(stgdat.open(record).agents["id"].tolist(), [1, 2, 3, 99])

    def test_priors_make_a_file_that_the_sampler_takes(self) -> None:
        self.write({f"road_{place % 2}/{place}.csv": drive(20.0, 6.0 + place, 5) for place in range(4)})
        finished = stgdat.fleet.priors(self.folder / "drives", self.folder / "out", place=QUIET)
        self.assertEqual(finished.failed, [])
        self.assertEqual(finished.report.figures["sources"], {"drives/road_0": 2, "drives/road_1": 2})
        file = self.folder / "out" / FILE
        self.assertEqual(sorted(json.loads(file.read_text())["sources"]), ["drives/road_0", "drives/road_1"])
        recording = self.folder / "drives" / "road_0" / "0.csv"
        last = [list(stgdat.Predictor(settings=of).run(recording, 60))[-1] for of in ({"sampler.prior": file}, {})]
        self.assertNotEqual(last[0].best_m.tobytes(), last[1].best_m.tobytes())
        with self.assertRaisesRegex(stgdat.InputError, "a.json"):
            stgdat.Predictor(settings={"sampler.prior": self.write({"a.json": "{}"}, "bad") / "a.json"})

    def test_mine_cuts_out_the_near_collision(self) -> None:
        # A car drives up to a standing one, and stops in time.
        rows = []
        for k in range(150):
            t = k / 10
            x, v = (10 * t, 10.0) if t < 5 else (50 + 10 * (t - 5) - 2.5 * (t - 5) ** 2, 10 - 5 * (t - 5))
            x, v = (x, v) if t < 7 else (60.0, 0.0)
            rows.append(f"{t},1,vehicle,{x:.3f},0,0,{max(v, 0):.2f},4.5,1.8\n")
            rows.append(f"{t},2,vehicle,66,0,0,0,4.5,1.8\n")
        head = HEAD.replace("\n", ",length_m,width_m\n")
        self.write({"calm.csv": drive(15.0), "stop.csv": head + "".join(rows)})
        root, out = self.folder / "drives", self.folder / "out"
        finished = stgdat.fleet.mine(root, out, count=2, before_s=2.0, after_s=3.0, place=QUIET)
        self.assertEqual(finished.failed, [])
        near = [of for of in finished.report.figures["scenes"] if of["criterion"] == "near-collision"]
        self.assertEqual((near[0]["recording"], {near[0]["agent"], near[0]["other"]}), ("drives/stop.csv", {1, 2}))
        # At 5.0 s the bumpers are 11.5 m apart, at 10 m/s: v² / (2 · 11.5 m). Later it brakes harder than it must.
        self.assertAlmostEqual(near[0]["value"], 10**2 / (2 * 11.5), delta=0.1)
        scene = stgdat.open(self.folder / "out" / near[0]["file"])
        middle = near[0]["stamp_ns"]
        self.assertGreaterEqual(scene.stamps_ns[0], middle - 2_000_000_000)
        self.assertLessEqual(scene.stamps_ns[-1], middle + 3_000_000_000)
        self.assertEqual(len(scene), 51)
        worst = [of for of in finished.report.figures["scenes"] if of["criterion"] == "error"][0]
        self.assertEqual(worst["recording"], "drives/stop.csv")

    def test_the_command_line_prints_the_tables_and_its_exit_code_shows_failures(self) -> None:
        root = self.write({"a.csv": drive(2.0)})
        command = [
            sys.executable,
            "-m",
            "stgdat.fleet",
            "audit",
            str(root),
            "--output",
            str(self.folder / "out"),
            "--processes",
            "1",
        ]
        done = subprocess.run(command, capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual(done.stdout.rstrip(), (self.folder / "out" / "tables.md").read_text().rstrip())
        self.assertIn("1/1 recordings", done.stderr)
        self.write({"b.csv": ""})
        done = subprocess.run(command, capture_output=True, text=True)
        self.assertEqual(done.returncode, 65)
        self.assertIn("1 done before", done.stderr)


@unittest.skipUnless(importlib.util.find_spec("ray"), "Ray is not installed")
class OnRay(InFolder):
    """Two nodes on this machine. `examples/fleet_on_ray.py` has the larger trials."""

    def test_a_cluster_gives_the_bytes_of_one_process_and_outlives_its_workers(self) -> None:
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        import ray

        self.write({**Jobs.FILES, "10.csv": "once", "11.csv": "die"})
        ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
        self.addCleanup(ray.shutdown)
        finished = driver.run(
            Count(Options()), self.folder / "drives", self.folder / "out", Place("auto", progress=None)
        )
        (failed,) = finished.failed
        self.assertEqual(failed.error, "a worker died on it 2 times")
        rows = pyarrow.parquet.read_table(self.folder / "out" / "recordings.parquet").to_pylist()
        self.assertEqual(
            [row["length"] for row in rows],
            [
                None if place == 11 else len(Jobs.FILES[f"{place:02}.csv"]) if place != 10 else 4
                for place in range(1, 20)
            ],
        )


if __name__ == "__main__":
    unittest.main()
