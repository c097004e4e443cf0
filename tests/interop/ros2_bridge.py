#!/usr/bin/env python3
"""Holds the bridge to ROS 2 to Eclipse Cyclone DDS (PyPI's `cyclonedds`), in a network namespace of its own.

Cyclone sends DetectedObjects at 12.5 Hz and receives the PredictedObjects of the run. Nothing leaves the loopback
interface of the namespace. Exit code 77: a module, `unshare` or the right to a namespace is missing.

    python3 tests/interop/ros2_bridge.py PROGRAMS round-trip 8 [SECONDS]    one number of objects
    python3 tests/interop/ros2_bridge.py PROGRAMS stopped-reader            a reader is stopped, killed, started again
    python3 tests/interop/ros2_bridge.py PROGRAMS domains                   a reader in another domain receives nothing
    python3 tests/interop/ros2_bridge.py PROGRAMS table                     all of them, as the tables of docs/results

PROGRAMS is the folder of `stgdat` and `stgdat-ros2`, such as target/release.
"""

import json
import math
import os
import signal
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

try:
    from cdr_by_cyclonedds import DETECTED, Types, definitions
    from cyclonedds.core import Policy, Qos, ReadCondition, SampleState, ViewState, InstanceState, WaitSet
    from cyclonedds._clayer import ddspy_take, ddspy_write
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.pub import DataWriter
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic
    from cyclonedds.util import duration
    from mcap.reader import make_reader
except ImportError as error:
    print(f"skipped: {error}: pip install cyclonedds mcap")
    sys.exit(77)

INTERVAL_S = 0.08
NAMESPACE = "STGDAT_IN_NAMESPACE"
# Autoware's own settings of Cyclone, with the socket buffer that this kernel allows.
CYCLONEDDS = """<CycloneDDS><Domain Id="any"><General><Interfaces><NetworkInterface name="lo" multicast="true"/></Interfaces>
<AllowMulticast>true</AllowMulticast><MaxMessageSize>65500B</MaxMessageSize></General><Discovery>
<ParticipantIndex>none</ParticipantIndex></Discovery></Domain></CycloneDDS>"""
DETECTIONS = "rt/perception/object_recognition/detection/objects"
PREDICTIONS = "rt/perception/object_recognition/objects"
QOS = Qos(Policy.Reliability.Reliable(duration(milliseconds=100)), Policy.Durability.Volatile, Policy.History.KeepLast(1),
          Policy.DataRepresentation(use_cdrv0_representation=True))
PATHS, POSES = 3, 13


class Cdr:
    """Plain CDR, little-endian."""

    def __init__(self):
        self.bytes = bytearray(b"\0\1\0\0")

    def put(self, kind, *values):
        size = struct.calcsize("<" + kind)
        for value in values:
            self.bytes += b"\0" * ((4 - len(self.bytes)) % size)
            self.bytes += struct.pack("<" + kind, value)

    def text(self, text):
        self.put("I", len(text) + 1)
        self.bytes += text.encode() + b"\0"


def place(number, at_s):
    """Position, heading and speed of an object: lanes 5 m apart, of vehicles and of pedestrians in turn."""
    lane, slot = number // 8, number % 8
    speed_mps = 1.3 if lane % 2 else 8.0
    towards = 1 if slot % 2 else -1
    return (slot - 4) * 25.0 + towards * speed_mps * at_s, lane * 5.0 - 40.0, 0.0 if towards > 0 else math.pi, speed_mps


def detected_objects(stamp_ns, count, at_s):
    """A message with this many objects, as bytes."""
    cdr = Cdr()
    cdr.put("i", stamp_ns // 10**9)
    cdr.put("I", stamp_ns % 10**9)
    cdr.text("map")
    cdr.put("I", count)
    for number in range(count):
        x, y, heading, speed_mps = place(number, at_s)
        is_person = number // 8 % 2
        cdr.put("f", 0.9)
        cdr.put("I", 1)
        cdr.put("B", 7 if is_person else 1)
        cdr.put("f", 1.0)
        covariance = [0.0] * 36
        covariance[0] = covariance[7] = 0.04
        cdr.put("d", x, y, 0.8, 0.0, 0.0, math.sin(heading / 2), math.cos(heading / 2), *covariance)
        cdr.put("B", 1, 2)
        cdr.put("d", speed_mps, 0.0, 0.0, 0.0, 0.0, 0.0, *[0.0] * 36)
        cdr.put("B", 1, 0, 0)
        cdr.put("I", 0)
        cdr.put("d", *((0.6, 0.6, 1.7) if is_person else (4.5, 1.8, 1.6)))
    return bytes(cdr.bytes)


def types_of(programs):
    """Cyclone's types, from the schemas of a recording."""
    texts = dict(DETECTED)
    with tempfile.TemporaryDirectory() as folder:
        recording = f"{folder}/run.mcap"
        subprocess.run([programs / "stgdat", "run", "--ticks", "5", "--record", recording, "--for", "autoware"], check=True,
                       stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, stdin=subprocess.DEVNULL)
        with open(recording, "rb") as file:
            for schema, channel, _ in make_reader(file).iter_messages():
                if channel.message_encoding == "cdr":
                    texts |= definitions(schema)
    return Types(texts)


class Reader:
    """Takes PredictedObjects as bytes, with the time of receipt."""

    def __init__(self, types, domain=0):
        self.type = types.of("autoware_perception_msgs/PredictedObjects")
        participant = DomainParticipant(domain)
        self.reader = DataReader(participant, Topic(participant, PREDICTIONS, self.type), qos=QOS)
        self.waitset = WaitSet(participant)
        self.waitset.attach(ReadCondition(self.reader, ViewState.Any | SampleState.NotRead | InstanceState.Any))

    def take(self, wait_s=0.1):
        """[(received_ns, stamp_ns, number of objects, bytes)]"""
        self.waitset.wait(timeout=duration(seconds=wait_s))
        received_ns, found = time.time_ns(), []
        for data, info in ddspy_take(self.reader._ref, SampleState.Any | ViewState.Any | InstanceState.Any, 16):
            if info.valid_data:
                sec, nanosec, text_len = struct.unpack_from("<iII", data, 4)
                (objects,) = struct.unpack_from("<I", data, 4 + (12 + text_len + 3) // 4 * 4)
                found.append((received_ns, sec * 10**9 + nanosec, objects, data))
        return found


class Writer:
    def __init__(self, types, domain=0):
        self.type = types.of("autoware_perception_msgs/DetectedObjects")
        participant = DomainParticipant(domain)
        self.writer = DataWriter(participant, Topic(participant, DETECTIONS, self.type), qos=QOS)

    def matched(self):
        return len(self.writer.get_matched_subscriptions())

    def write(self, data):
        assert ddspy_write(self.writer._ref, data.ljust((len(data) + 3) & ~3, b"\0")) >= 0


def pipeline(programs, folder, options="", is_source=True):
    """The shipped pipeline with the bridge in place of the source, and as an added stage."""
    text = (Path(__file__).parents[2] / "launch/pipeline.toml").read_text()
    bridge = f'command = ["{programs / "stgdat-ros2"}"]'
    if is_source:
        text = text.replace('name = "source"', f'name = "source"\n{bridge}\noptions = {{ {options} }}')
    text += f'\n[[stage]]\nname = "ros2"\n{bridge}\nreads = ["tracks", "forecasts"]\noptions = {{ {options} }}\n'
    path = Path(folder, "ros2.toml")
    path.write_text(text)
    return path


def start_run(programs, path, *arguments):
    command = [programs / "stgdat", "run", "--pipeline", path, "--quiet", *arguments]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, stdin=subprocess.DEVNULL, text=True)


def end_run(run):
    """Ends a run as Ctrl-C does; returns its log."""
    run.send_signal(signal.SIGINT)
    return run.communicate(timeout=30)[1]


def send(writer, count, seconds):
    """Sends this many objects at 12.5 Hz. Returns the stamps."""
    begin, stamps = time.time(), []
    for tick in range(round(seconds / INTERVAL_S)):
        time.sleep(max(0.0, begin + tick * INTERVAL_S - time.time()))
        stamp_ns = time.time_ns()
        writer.write(detected_objects(stamp_ns, count, tick * INTERVAL_S))
        stamps.append(stamp_ns)
    return stamps


def child(role, *arguments):
    """Starts this script again in this namespace."""
    return subprocess.Popen([sys.executable, __file__, sys.argv[1], role, *map(str, arguments)], stdout=subprocess.PIPE,
                            stdin=subprocess.DEVNULL, text=True)


def read_until_killed(types, path, domain):
    """The reader's process: a line for each message."""
    reader = Reader(types, domain)
    with open(path, "a", buffering=1) as lines:
        while os.getppid() != 1:
            for received_ns, stamp_ns, objects, data in reader.take():
                lines.write(f"{received_ns} {stamp_ns} {objects} {len(data)}\n")


def percentile(values, share):
    values = sorted(values)
    return values[min(len(values) - 1, int(share * len(values)))] if values else math.nan


def until(condition, limit_s, what):
    begun = time.time()
    while not condition():
        if time.time() - begun > limit_s:
            raise SystemExit(f"failed: {what} within {limit_s} s")
        time.sleep(0.05)


def wait_for_bridge(writer, run):
    def matched():
        if run.poll() is not None:
            raise SystemExit(f"failed: the run has ended: {run.stderr.read()}")
        return writer.matched() > 0
    until(matched, 60, "the bridge reads no detections")


def lines_of(path):
    return [tuple(map(int, line.split())) for line in Path(path).read_text().splitlines() if line.count(" ") == 3]


def round_trip(programs, types, count, seconds):
    """Detections in, forecasts out. Returns the figures."""
    with tempfile.TemporaryDirectory() as folder:
        report = f"{folder}/report.json"
        run = start_run(programs, pipeline(programs, folder), "--report", report)
        writer, reader, received = Writer(types), Reader(types), []
        wait_for_bridge(writer, run)
        import threading
        is_over = threading.Event()
        take = threading.Thread(target=lambda: [received.extend(reader.take()) for _ in iter(is_over.is_set, True)])
        take.start()
        stamps = send(writer, count, seconds)
        time.sleep(1)
        is_over.set()
        take.join()
        log = end_run(run)
        figures = json.loads(Path(report).read_text())
    print(log)
    by_stamp = {stamp: (received_ns, objects) for received_ns, stamp, objects, _ in received}
    answered = [stamp for stamp in stamps if stamp in by_stamp]
    latency_ms = [(by_stamp[stamp][0] - stamp) / 1e6 for stamp in answered]
    print(len(stamps), len(received), len(answered), percentile(latency_ms, .5), percentile(latency_ms, .99), [o for _, _, o, _ in received][-5:])
    if received:
        last = types.of("autoware_perception_msgs/PredictedObjects").deserialize(received[-1][3])
        print(last.header, len(last.objects), [(len(p.path), p.confidence) for p in last.objects[0].kinematics.predicted_paths])
    return figures


def main(programs, scenario, *arguments):
    programs = Path(programs).resolve()
    if NAMESPACE not in os.environ:
        setup = 'ip link set lo up && ip link set lo multicast on && ip route add 224.0.0.0/4 dev lo && exec "$0" "$@"'
        command = ["unshare", "--net", "--map-root-user", "sh", "-c", setup, sys.executable, __file__, str(programs), scenario, *arguments]
        try:
            ended = subprocess.run(command, env=os.environ | {NAMESPACE: "1", "CYCLONEDDS_URI": CYCLONEDDS})
        except FileNotFoundError as error:
            print(f"skipped: {error}: install util-linux and iproute2")
            return 77
        return ended.returncode
    types = types_of(programs)
    if scenario == "round-trip":
        round_trip(programs, types, int(arguments[0]), float(arguments[1]) if len(arguments) > 1 else 6)
    return 0


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    sys.exit(main(*sys.argv[1:]))
