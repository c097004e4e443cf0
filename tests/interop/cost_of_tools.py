#!/usr/bin/env python3
"""Measures the cost of tools for a run: late ticks, overhead and shared memory. The tools are none, a reader at the tap,
`record`, a flight recorder, `top`, and six readers at the tap at once. They alternate, so other load affects all of them.

    python3 tests/interop/cost_of_tools.py target/release/stgdat [--agents 32] [--ticks 150] [--turns 3]

Prints a table in Markdown. Needs only Python.
"""

import argparse
import json
import os
import pathlib
import socket
import statistics
import subprocess
import tempfile
import threading
import time

DEFAULT = ["detections", "tracks", "forecasts"]
ALL = DEFAULT + ["context", "features", "encodings", "controls", "heartbeats", "truth"]
# Time between two measurements of the shared memory.
LOOK_INTERVAL_S = 0.5


def root_of(launcher):
    """The folder of a launcher's run, by its tap's arguments."""
    for process in pathlib.Path("/proc").glob("[0-9]*"):
        try:
            words = (process / "cmdline").read_bytes().split(b"\0")
            parent = int((process / "stat").read_text().rsplit(")", 1)[1].split()[1])
        except (OSError, IndexError):
            continue
        if parent == launcher and len(words) > 3 and words[1:3] == [b"tap", b"--run"]:
            return pathlib.Path(words[3].decode()).parent
    return None


def read(root, topics):
    """Takes a place at the tap, and all frames until the run ends."""
    connection = socket.socket(socket.AF_UNIX)
    connection.connect(str(root / "tap"))
    request = {"tool": "cost_of_tools", "topics": topics, "events": True}
    connection.sendall((json.dumps(request) + "\n").encode())
    while connection.recv(1 << 20):
        pass


def shared_mib(root):
    """Shared memory of a run that is in RAM."""
    used_bytes = 0
    for file in pathlib.Path("/dev/shm").glob(root.name + "_*"):
        try:
            used_bytes += file.stat().st_blocks * 512
        except FileNotFoundError:
            pass
    return used_bytes / 2**20


def play(arguments, tool, folder):
    """A run with a tool: its report, and its shared memory in MiB."""
    report = folder / "report.json"
    file = folder / "x.mcap"
    more = {
        "record": ["--record", file],
        "flight recorder": ["--record", file, "--last", "5s"],
    }.get(tool, [])
    scene = ["--agents", str(arguments.agents), "--ticks", str(arguments.ticks), "--quiet", "--report", report]
    run = subprocess.Popen([arguments.stgdat, "run", *scene, *more], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    root = None
    while root is None or not (root / "tap").exists():
        time.sleep(0.05)
        if run.poll() is not None:
            raise SystemExit("the run has ended before its time")
        root = root_of(run.pid)
    topics, readers = {"reader": (DEFAULT, 1), "six readers, all topics": (ALL, 6)}.get(tool, ([], 0))
    for _ in range(readers):
        threading.Thread(target=read, args=(root, topics), daemon=True).start()
    top = None
    if tool == "top":
        command = [arguments.stgdat, "top", "--json", "--interval", "1", "--run", root.name]
        top = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    memory_mib = 0.0
    while run.poll() is None:
        memory_mib = max(memory_mib, shared_mib(root))
        time.sleep(LOOK_INTERVAL_S)
    if top is not None:
        top.wait()
    for left in folder.glob("*.mcap"):
        left.unlink()
    return json.loads(report.read_text()), memory_mib


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("stgdat")
    parser.add_argument("--agents", type=int, default=32)
    parser.add_argument("--ticks", type=int, default=150)
    parser.add_argument("--turns", type=int, default=3)
    arguments = parser.parse_args()
    arguments.stgdat = os.path.abspath(arguments.stgdat)
    tools = ["none", "reader", "record", "flight recorder", "top", "six readers, all topics"]
    measured = {tool: [] for tool in tools}
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(arguments.turns):
            for tool in tools:
                measured[tool].append(play(arguments, tool, pathlib.Path(folder)))
    print(f"{arguments.agents} agents, {arguments.turns} runs of {arguments.ticks} ticks each, by turns; medians of the runs.\n")
    print("| tool | late ticks | overhead p50, ms | p99, ms | end to end p50, ms | p99, ms | shared memory, MiB |")
    print("|---|---:|---:|---:|---:|---:|---:|")
    for tool, runs in measured.items():
        late = "+".join(str(report["late_ticks"]) for report, _ in runs)
        times = [
            statistics.median(report[of][quantile] for report, _ in runs)
            for of in ("overhead_ms", "end_to_end_ms")
            for quantile in ("p50", "p99")
        ]
        memory = statistics.median(memory_mib for _, memory_mib in runs)
        print(f"| {tool} | {late} | " + " | ".join(f"{time:.2f}" for time in times) + f" | {memory:.0f} |")


if __name__ == "__main__":
    main()
