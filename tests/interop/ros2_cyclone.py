"""The other side of the bridge to ROS 2: Eclipse Cyclone DDS sends detections and reads forecasts."""

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
    from cyclonedds.idl import IdlStruct, types as idl_types
    from cyclonedds.pub import DataWriter
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic
    from cyclonedds.util import duration
    from mcap.reader import make_reader
except ImportError as error:
    print(f"skipped: {error}: pip install cyclonedds mcap")
    sys.exit(77)

INTERVAL_S = 0.08
NAMESPACE, SCHEMAS = "STGDAT_IN_NAMESPACE", "STGDAT_SCHEMAS"
# Autoware's own settings of Cyclone, with the socket buffer that this kernel allows.
CYCLONEDDS = """<CycloneDDS><Domain Id="any"><General><Interfaces><NetworkInterface name="lo" multicast="true"/></Interfaces>
<AllowMulticast>true</AllowMulticast><MaxMessageSize>65500B</MaxMessageSize></General><Discovery>
<ParticipantIndex>none</ParticipantIndex></Discovery></Domain></CycloneDDS>"""
DETECTIONS = "rt/perception/object_recognition/detection/objects"
PREDICTIONS = "rt/perception/object_recognition/objects"
REST = (Policy.Reliability.Reliable(duration(milliseconds=100)), Policy.History.KeepLast(1),
        Policy.DataRepresentation(use_cdrv0_representation=True))
QOS, LATCHED = Qos(Policy.Durability.Volatile, *REST), Qos(Policy.Durability.TransientLocal, *REST)
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


def detected_objects(stamp_ns, count, at_s, frame="map", shift_m=0.0):
    """A message with this many objects, as bytes. They are `shift_m` nearer to the frame's origin along x."""
    cdr = Cdr()
    cdr.put("i", stamp_ns // 10**9)
    cdr.put("I", stamp_ns % 10**9)
    cdr.text(frame)
    cdr.put("I", count)
    for number in range(count):
        x, y, heading, speed_mps = place(number, at_s)
        x -= shift_m
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
    """Cyclone's types, from the schemas of a recording. A child process has them from its parent."""
    if SCHEMAS in os.environ:
        return Types(json.loads(os.environ[SCHEMAS]))
    texts = dict(DETECTED)
    with tempfile.TemporaryDirectory() as folder:
        recording = f"{folder}/run.mcap"
        subprocess.run([programs / "stgdat", "run", "--ticks", "5", "--record", recording, "--for", "autoware"], check=True,
                       stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, stdin=subprocess.DEVNULL)
        with open(recording, "rb") as file:
            for schema, channel, _ in make_reader(file).iter_messages():
                if channel.message_encoding == "cdr":
                    texts |= definitions(schema)
    os.environ[SCHEMAS] = json.dumps(texts)
    return Types(texts)


class Reader:
    """Takes PredictedObjects as bytes, with the time of receipt."""

    def __init__(self, types, domain=0, topic=PREDICTIONS):
        self.type = types.of("autoware_perception_msgs/PredictedObjects")
        participant = DomainParticipant(domain)
        self.reader = DataReader(participant, Topic(participant, topic, self.type), qos=QOS)
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
        self.written = 0

    def matched(self):
        return len(self.writer.get_matched_subscriptions())

    def write(self, data):
        assert ddspy_write(self.writer._ref, data.ljust((len(data) + 3) & ~3, b"\0")) >= 0
        self.written += 1


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
    return run.communicate(timeout=60)[1]


def send(writer, count, seconds):
    """Sends this many objects at 12.5 Hz. Returns the stamps."""
    begin, stamps = time.time(), []
    for tick in range(1, round(seconds / INTERVAL_S) + 1):
        time.sleep(max(0.0, begin + tick * INTERVAL_S - time.time()))
        stamp_ns = time.time_ns()
        writer.write(detected_objects(stamp_ns, count, writer.written * INTERVAL_S))
        stamps.append(stamp_ns)
    return stamps


class ReaderProcess:
    """A reader in its own process, which can be stopped and killed. It writes a line for each message."""

    def __init__(self, programs, folder, name, domain=0, topic=PREDICTIONS):
        self.path = Path(folder, name)
        self.path.touch()
        self.process = subprocess.Popen([sys.executable, Path(__file__).with_name("ros2_bridge.py"), programs, "reader", self.path, str(domain), topic],
                                        stdin=subprocess.DEVNULL)

    def signal(self, number):
        self.process.send_signal(number)

    def end(self):
        self.process.kill()
        self.process.wait()

    def messages(self):
        """[(received_ns, stamp_ns, number of objects, bytes)]"""
        lines = (line.split() for line in self.path.read_text().splitlines())
        return [tuple(map(int, line)) for line in lines if len(line) == 4 and line[0] != "ready"]

    def is_ready(self):
        return self.path.read_text().startswith("ready")


def read_until_killed(types, path, domain, topic):
    """The reader's process: a line for each message."""
    reader = Reader(types, int(domain), topic)
    with open(path, "a", buffering=1) as lines:
        lines.write("ready\n")
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
    until(matched, 120, "the bridge reads no detections")
    # The writer may match before the stages are linked.
    time.sleep(3)


def figures(stamps, messages):
    """Latency from the object's stamp, and losses."""
    by_stamp = {stamp_ns: received_ns for received_ns, stamp_ns, *_ in messages}
    latency_ms = [(by_stamp[stamp] - stamp) / 1e6 for stamp in stamps if stamp in by_stamp]
    return {"sent": len(stamps), "answered": len(latency_ms), "lost": len(stamps) - len(latency_ms),
            "p50_ms": percentile(latency_ms, 0.5), "p99_ms": percentile(latency_ms, 0.99),
            "max_ms": max(latency_ms, default=math.nan), "bytes": max((size for *_, size in messages), default=0),
            "objects": messages[-1][2] if messages else 0}


def ticks_of(report):
    """Ticks and late ticks of a report."""
    found = json.loads(Path(report).read_text())
    end_to_end_ms = found["end_to_end_ms"]
    # As the bridge has measured it; none if it was not a stage.
    since_stamp_ms = next((of["since_stamp_ms"] for of in found["stages"] if "since_stamp_ms" in of), {})
    return {"ticks": found["ticks"], "late": found["late_ticks"], "end_to_end_p50_ms": end_to_end_ms["p50"],
            "end_to_end_p99_ms": end_to_end_ms["p99"], "published_p50_ms": since_stamp_ms.get("p50"),
            "published_p99_ms": since_stamp_ms.get("p99"), "published_max_ms": since_stamp_ms.get("max")}


def root_of(run):
    """The folder of a run, which its launcher holds open."""
    for link in Path(f"/proc/{run.pid}/fd").iterdir():
        for part in Path(os.readlink(link)).parts:
            if part.startswith("stgdat_") and Path("/tmp", part).is_dir():
                return Path("/tmp", part)
    return None


def process_of(run, stage):
    """The process of a stage. Each thread of the launcher has its own children."""
    lists = Path(f"/proc/{run.pid}/task").glob("*/children")
    for pid in " ".join(of.read_text() for of in lists).split():
        if f"STGDAT_STAGE={stage}".encode() in Path(f"/proc/{pid}/environ").read_bytes().split(b"\0"):
            return int(pid)
    raise SystemExit(f"failed: there is no process of {stage}")
