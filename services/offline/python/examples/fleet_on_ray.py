"""Trials of `stgdat.fleet` on a cluster of Ray on this machine: `python fleet_on_ray.py RECORDINGS OUTPUT`.

Evaluates the recordings in one process and on three nodes; then again while a worker, a node and the driver are
killed. All tables must have the same bytes. Run it in a namespace with loopback only, because Ray does not find itself
on a machine with several interfaces: `unshare -rn sh -c 'ip link set lo up; python fleet_on_ray.py …'`.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any, Callable, List, Optional

os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
os.environ.setdefault("RAY_AUTH_MODE", "token")
os.environ.setdefault("RAY_AUTH_TOKEN", os.urandom(16).hex())

from ray.cluster_utils import Cluster

FILES = ("tables.md", "figures.json", "recordings.parquet")


def job(arguments: argparse.Namespace, output: Path, *place: str) -> subprocess.Popen[str]:
    """Starts the job."""
    command = [sys.executable, "-m", "stgdat.fleet", arguments.job, str(arguments.recordings)]
    log = (arguments.output / f"{output.name}.log").open("a")
    return subprocess.Popen(
        [*command, "--output", str(output), *place], stdout=subprocess.DEVNULL, stderr=log, text=True
    )


def results(output: Path) -> int:
    """Recordings that are done."""
    return sum(1 for _ in output.glob("results/*/*.json.gz"))


def workers() -> List[int]:
    """Processes that compute a task of Ray now."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            if path.read_bytes().startswith(b"ray::run"):
                found.append(int(path.parent.name))
        except OSError:
            continue
    return found


def content(output: Path) -> List[bytes]:
    """The files that people read."""
    return [(output / name).read_bytes() for name in FILES]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recordings", type=Path)
    parser.add_argument("output", type=Path)
    parser.add_argument("--job", default="evaluate")
    parser.add_argument("--nodes", type=int, default=3)
    parser.add_argument("--cores", type=int, default=1, help="of a node")
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    begin = time.monotonic()
    alone = arguments.output / "alone"
    job(arguments, alone, "--processes", "1").wait()
    print(f"one process: {results(alone)} recordings in {time.monotonic() - begin:.1f} s", flush=True)

    begin = time.monotonic()
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": arguments.cores, "include_dashboard": False})
    for _ in range(arguments.nodes - 1):
        cluster.add_node(num_cpus=arguments.cores)
    print(
        f"{arguments.nodes} nodes with {arguments.cores} cores each started in {time.monotonic() - begin:.1f} s",
        flush=True,
    )

    def kill_worker() -> None:
        for pid in workers()[:1]:
            os.kill(pid, signal.SIGKILL)

    def kill_node() -> None:
        node: Any = list(cluster.worker_nodes)[0]
        cluster.remove_node(node, allow_graceful=False)

    def trial(name: str, fault: Optional[Callable[[], None]]) -> None:
        begin, output = time.monotonic(), arguments.output / name
        running = job(arguments, output, "--address", cluster.address)
        while fault is not None and running.poll() is None and results(output) < results(alone) // 3:
            time.sleep(0.1)
        if fault is not None:
            fault()
            print(f"{name}: after {results(output)} recordings", flush=True)
        code = running.wait()
        same = content(output) == content(alone)
        print(f"{name}: {time.monotonic() - begin:.1f} s, exit code {code}, same bytes: {same}", flush=True)
        print("  " + (arguments.output / f"{name}.log").read_text().splitlines()[-1], flush=True)
        assert same

    try:
        trial("cluster", None)
        trial("worker-killed", kill_worker)
        trial("node-killed", kill_node)
        output = arguments.output / "driver-killed"
        driver = job(arguments, output, "--address", cluster.address)
        while driver.poll() is None and results(output) < results(alone) // 2:
            time.sleep(0.1)
        driver.kill()
        driver.wait()
        print(f"driver killed after {results(output)} recordings", flush=True)
        trial("driver-killed", None)
    finally:
        watchdog = threading.Timer(60.0, os._exit, (1,))
        watchdog.daemon = True
        watchdog.start()
        cluster.shutdown()  # type: ignore[no-untyped-call,unused-ignore]


if __name__ == "__main__":
    main()
