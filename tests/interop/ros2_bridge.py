#!/usr/bin/env python3
"""Holds the bridge to ROS 2 to Eclipse Cyclone DDS (PyPI's `cyclonedds`), in a network namespace of its own.

Cyclone sends DetectedObjects at 12.5 Hz and receives the PredictedObjects of the run. Nothing leaves the loopback
interface of the namespace. Exit code 77: a module, `unshare` or the right to a namespace is missing.

    python3 tests/interop/ros2_bridge.py PROGRAMS round-trip 8 [SECONDS]    one number of objects
    python3 tests/interop/ros2_bridge.py PROGRAMS stopped-reader            a reader is stopped, killed, started again
    python3 tests/interop/ros2_bridge.py PROGRAMS transforms                objects in the frame of a moving sensor
    python3 tests/interop/ros2_bridge.py PROGRAMS killed-bridge             the bridge is killed and comes back
    python3 tests/interop/ros2_bridge.py PROGRAMS domains                   a reader in another domain receives nothing
    python3 tests/interop/ros2_bridge.py PROGRAMS attached                  `stgdat ros2` publishes a running pipeline
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
        self.process = subprocess.Popen([sys.executable, __file__, programs, "reader", self.path, str(domain), topic],
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
    return {"ticks": found["ticks"], "late": found["late_ticks"], "end_to_end_p50_ms": end_to_end_ms["p50"],
            "end_to_end_p99_ms": end_to_end_ms["p99"]}


def round_trip(programs, types, count, seconds):
    """Detections in, forecasts out."""
    with tempfile.TemporaryDirectory() as folder:
        report = f"{folder}/report.json"
        run = start_run(programs, pipeline(programs, folder), "--report", report)
        writer, reader = Writer(types), ReaderProcess(programs, folder, "reader")
        wait_for_bridge(writer, run)
        until(reader.is_ready, 60, "the reader does not start")
        # The last message is read whole.
        whole = Reader(types)
        stamps = send(writer, count, seconds)
        last = whole.take(5)[-1]
        time.sleep(1)
        reader.end()
        end_run(run)
        found = figures(stamps, reader.messages()) | ticks_of(report)
    predicted = whole.type.deserialize(last[3])
    paths = [of.kinematics.predicted_paths for of in predicted.objects]
    assert predicted.header.frame_id == "map" and len(predicted.objects) == last[2]
    for of_object in paths:
        # A kinematic forecast has a single path.
        assert 1 <= len(of_object) <= PATHS and all(len(path.path) == POSES for path in of_object)
        confidences = [path.confidence for path in of_object]
        assert confidences == sorted(confidences, reverse=True) and all(path.time_step.nanosec > 0 for path in of_object)
    positions = sorted((p.position.x, p.position.y) for o in predicted.objects
                       for p in [o.kinematics.initial_pose_with_covariance.pose])
    tick = stamps.index(last[1])
    expected = sorted(place(number, tick * INTERVAL_S)[:2] for number in range(count))
    far_m = [min(math.dist(position, other) for other in expected) for position in positions]
    assert max(far_m) < 2.0, f"a forecast {max(far_m):.1f} m from every object"
    return found | {"paths": max(map(len, paths))}


def stopped_reader(programs, types, count=32):
    """A reader is stopped for 5 s, continued, killed and started again, beside one that runs."""
    with tempfile.TemporaryDirectory() as folder:
        report = f"{folder}/report.json"
        run = start_run(programs, pipeline(programs, folder), "--report", report)
        writer = Writer(types)
        steady, bad = (ReaderProcess(programs, folder, name) for name in ("steady", "bad"))
        wait_for_bridge(writer, run)
        until(lambda: steady.is_ready() and bad.is_ready(), 60, "the readers do not start")
        stamps, messages = {}, {}
        stamps["both run"] = send(writer, count, 4)
        bad.signal(signal.SIGSTOP)
        stamps["one is stopped"] = send(writer, count, 5)
        bad.signal(signal.SIGCONT)
        stamps["continued"] = send(writer, count, 3)
        bad.end()
        stamps["killed"] = send(writer, count, 3)
        again = ReaderProcess(programs, folder, "again")
        stamps["started again"] = send(writer, count, 5)
        time.sleep(1)
        steady.end()
        again.end()
        log = end_run(run)
        found = {phase: figures(sent, steady.messages()) for phase, sent in stamps.items()}
        found["run"] = ticks_of(report)
        found["after"] = figures(stamps["continued"], bad.messages())
        found["again"] = figures(stamps["started again"], again.messages())
    return found | {"log": log}


def domains(programs, types):
    """The bridge is in domain 7. A reader in domain 0 receives nothing, and one in domain 7 everything."""
    with tempfile.TemporaryDirectory() as folder:
        run = start_run(programs, pipeline(programs, folder, "domain = 7"))
        same, other = ReaderProcess(programs, folder, "same", 7), ReaderProcess(programs, folder, "other", 0)
        writer = Writer(types, 7)
        foreign = Writer(types, 0)
        wait_for_bridge(writer, run)
        until(lambda: same.is_ready() and other.is_ready(), 60, "the readers do not start")
        assert foreign.matched() == 0, "a writer of domain 0 has found the bridge"
        stamps = send(writer, 8, 4)
        time.sleep(1)
        same.end()
        other.end()
        end_run(run)
        return {"same": figures(stamps, same.messages()), "other": len(other.messages())}


def transforms(programs, types):
    """Objects in the frame of a sensor: /tf_static was published before the bridge came, and /tf moves."""
    of = {name.split("/")[1]: types.of(name) for name in (
        "tf2_msgs/TFMessage", "geometry_msgs/TransformStamped", "geometry_msgs/Transform", "geometry_msgs/Vector3",
        "geometry_msgs/Quaternion", "std_msgs/Header", "builtin_interfaces/Time")}

    def message(stamp_ns, parent, child, x):
        header = of["Header"](of["Time"](stamp_ns // 10**9, stamp_ns % 10**9), parent)
        transform = of["Transform"](of["Vector3"](x, 0.0, 0.0), of["Quaternion"](0.0, 0.0, 0.0, 1.0))
        return of["TFMessage"]([of["TransformStamped"](header, child, transform)])

    with tempfile.TemporaryDirectory() as folder:
        writer, whole, participant = Writer(types), Reader(types), DomainParticipant(0)
        fixed = DataWriter(participant, Topic(participant, "rt/tf_static", of["TFMessage"]), qos=LATCHED)
        moving = DataWriter(participant, Topic(participant, "rt/tf", of["TFMessage"]), qos=QOS)
        fixed.write(message(0, "base_link", "lidar", 2.0))
        run = start_run(programs, pipeline(programs, folder, "max_age_ms = 60000"))
        wait_for_bridge(writer, run)
        sent, far_m, received = {}, [], 0
        for tick in range(60):
            time.sleep(INTERVAL_S)
            # The vehicle drives at 20 m/s: its pose is published for the stamp of the objects, after they are.
            stamp_ns, x_m, at_s = time.time_ns(), 10.0 + 20.0 * tick * INTERVAL_S, tick * INTERVAL_S
            writer.write(detected_objects(stamp_ns, 4, at_s, "lidar", x_m + 2.0))
            moving.write(message(stamp_ns, "map", "base_link", x_m))
            sent[stamp_ns] = [place(number, at_s)[:2] for number in range(4)]
            for _, stamp, objects, data in whole.take(0.01):
                received += objects > 0
                for o in whole.type.deserialize(data).objects:
                    p = o.kinematics.initial_pose_with_covariance.pose.position
                    far_m.append(min(math.dist((p.x, p.y), other) for other in sent[stamp]))
        end_run(run)
        return {"answered": received, "farthest_m": max(far_m, default=math.nan)}


def process_of(run, stage):
    """The process of a stage."""
    for pid in Path(f"/proc/{run.pid}/task/{run.pid}/children").read_text().split():
        if f"STGDAT_STAGE={stage}".encode() in Path(f"/proc/{pid}/environ").read_bytes().split(b"\0"):
            return int(pid)
    raise SystemExit(f"failed: there is no process of {stage}")


def killed_bridge(programs, types):
    """Both processes of the bridge are killed, one after the other. The run starts them again."""
    with tempfile.TemporaryDirectory() as folder:
        run = start_run(programs, pipeline(programs, folder))
        writer, reader = Writer(types), ReaderProcess(programs, folder, "reader")
        wait_for_bridge(writer, run)
        until(reader.is_ready, 60, "the reader does not start")
        stamps = {"before": send(writer, 8, 3)}
        for stage in ("source", "ros2"):
            os.kill(process_of(run, stage), signal.SIGKILL)
            send(writer, 8, 4)
            stamps[f"after the {stage} was killed"] = send(writer, 8, 3)
        time.sleep(1)
        reader.end()
        end_run(run)
        return {phase: figures(sent, reader.messages()) for phase, sent in stamps.items()}


def root_of(run):
    """The folder of a run, which its launcher holds open."""
    for link in Path(f"/proc/{run.pid}/fd").iterdir():
        for part in Path(os.readlink(link)).parts:
            if part.startswith("stgdat_") and Path("/tmp", part).is_dir():
                return Path("/tmp", part)
    return None


def attached(programs, types):
    """`stgdat ros2` attaches to a run of a generated scene, with a topic of another name, and ends with it."""
    with tempfile.TemporaryDirectory() as folder:
        command = [programs / "stgdat", "run", "--agents", "8", "--ticks", "200", "--quiet"]
        quiet = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        run = subprocess.Popen(command, **quiet)
        until(lambda: root_of(run), 60, "the run has no folder")
        reader = ReaderProcess(programs, folder, "reader", 3, "rt/objects")
        until(reader.is_ready, 60, "the reader does not start")
        bridge = subprocess.run([programs / "stgdat", "ros2", "--run", root_of(run), "--domain", "3", "--remap",
                                 "/perception/object_recognition/objects:=/objects"], stdin=subprocess.DEVNULL,
                                capture_output=True, text=True, timeout=120)
        run.wait(60)
        reader.end()
        return {"exit": bridge.returncode, "log": bridge.stderr, "messages": len(reader.messages())}


def without_and_with(programs, count, seconds):
    """Late ticks of a generated scene, without and with the bridge; the same scene, one after the other."""
    found = {}
    for name in ("without", "with"):
        with tempfile.TemporaryDirectory() as folder:
            report = f"{folder}/report.json"
            path = [] if name == "without" else ["--pipeline", pipeline(programs, folder, is_source=False)]
            subprocess.run([programs / "stgdat", "run", *path, "--agents", str(count), "--ticks", str(round(seconds / INTERVAL_S)),
                            "--quiet", "--report", report], check=True, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                           stderr=subprocess.DEVNULL)
            found[name] = ticks_of(report)
    return found


def main(programs, scenario, *arguments):
    programs = Path(programs).resolve()
    if NAMESPACE not in os.environ:
        return in_namespace(programs, scenario, *arguments)
    types = types_of(programs)
    if scenario == "reader":
        read_until_killed(types, *arguments)
    elif scenario == "round-trip":
        seconds = float(arguments[1]) if len(arguments) > 1 else 6.0
        print(json.dumps(round_trip(programs, types, int(arguments[0]), seconds)))
    elif scenario == "stopped-reader":
        print(json.dumps(stopped_reader(programs, types)))
    elif scenario == "transforms":
        print(json.dumps(transforms(programs, types)))
    elif scenario == "killed-bridge":
        print(json.dumps(killed_bridge(programs, types)))
    elif scenario == "attached":
        print(json.dumps(attached(programs, types)))
    elif scenario == "domains":
        print(json.dumps(domains(programs, types)))
    elif scenario == "table":
        from ros2_table import table
        print(table(programs, types, *arguments))
    else:
        sys.exit(__doc__)
    return 0


def in_namespace(programs, *arguments):
    """Runs this script in a network namespace with nothing but its loopback interface."""
    setup = ('ip link set lo up && ip link set lo multicast on && ip route add 224.0.0.0/4 dev lo || exit 77; '
             'exec "$0" "$@"')
    command = ["unshare", "--net", "--map-root-user", "sh", "-c", setup, sys.executable, __file__, programs, *arguments]
    try:
        ended = subprocess.run(command, env=os.environ | {NAMESPACE: "1", "CYCLONEDDS_URI": CYCLONEDDS}).returncode
    except FileNotFoundError as error:
        print(f"skipped: {error}: install util-linux")
        return 77
    if ended == 77 or ended == 1 and subprocess.run(command[:3] + ["true"]).returncode != 0:
        print("skipped: no right to a network namespace, or no iproute2")
        return 77
    return ended


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    sys.exit(main(*sys.argv[1:]))
