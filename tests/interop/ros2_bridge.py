#!/usr/bin/env python3
"""Holds the bridge to ROS 2 to Eclipse Cyclone DDS (PyPI's `cyclonedds`), in a network namespace of its own.

Cyclone sends DetectedObjects at 12.5 Hz and receives the PredictedObjects of the run. Nothing leaves the loopback
interface of the namespace. Exit code 77: a module, `unshare` or the right to a namespace is missing.

    python3 tests/interop/ros2_bridge.py PROGRAMS round-trip 8 [SECONDS]    one number of objects
    python3 tests/interop/ros2_bridge.py PROGRAMS stopped-reader            a reader is stopped, killed, started again
    python3 tests/interop/ros2_bridge.py PROGRAMS transforms                objects in the frame of a moving sensor
    python3 tests/interop/ros2_bridge.py PROGRAMS tracked                   TrackedObjects keep their identities
    python3 tests/interop/ros2_bridge.py PROGRAMS killed-bridge             the bridge is killed and comes back
    python3 tests/interop/ros2_bridge.py PROGRAMS domains                   a reader in another domain receives nothing
    python3 tests/interop/ros2_bridge.py PROGRAMS silence                   detections pause for 8 s: what others receive
    python3 tests/interop/ros2_bridge.py PROGRAMS clock 0.5                 /clock at this rate, then the bag begins again
    python3 tests/interop/ros2_bridge.py PROGRAMS near-misses               other QoS, types, names and domains
    python3 tests/interop/ros2_bridge.py PROGRAMS markers                   markers for rviz
    python3 tests/interop/ros2_bridge.py PROGRAMS attached                  `stgdat ros2` publishes a running pipeline
    python3 tests/interop/ros2_bridge.py PROGRAMS table                     all of them, as the tables of docs/results

PROGRAMS is the folder of `stgdat` and `stgdat-ros2`, such as target/release.
"""

import json
import math
import os
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

from cdr_by_cyclonedds import Types, blank, definitions
from ros2_cyclone import (CYCLONEDDS, DETECTIONS, INTERVAL_S, IdlStruct, LATCHED, NAMESPACE, PATHS, POSES, QOS, REST, DataReader,
                          DataWriter, DomainParticipant, Policy, Qos, Reader, ReaderProcess, Topic, Writer,
                          detected_objects, duration, end_run, figures, idl_types, pipeline, place, process_of, read_until_killed,
                          root_of, send, start_run, ticks_of, types_of, until, wait_for_bridge)


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


def tracked(programs, types):
    """TrackedObjects on a topic of another name: identities stay the same."""
    with tempfile.TemporaryDirectory() as folder:
        objects = types.of("autoware_perception_msgs/TrackedObjects")
        participant, whole = DomainParticipant(0), Reader(types)
        writer = DataWriter(participant, Topic(participant, "rt/my/tracks", objects), qos=QOS)
        run = start_run(programs, pipeline(programs, folder, 'tracks = ["/tracks"], remap = ["/tracks:=/my/tracks"]'))
        until(lambda: run.poll() is not None or len(writer.get_matched_subscriptions()) > 0, 120, "no bridge")
        time.sleep(3)
        message, identities = blank("autoware_perception_msgs/TrackedObjects", types, 3), set()
        for tick in range(60):
            time.sleep(INTERVAL_S)
            stamp_ns = time.time_ns()
            message.header.stamp.sec, message.header.stamp.nanosec = stamp_ns // 10**9, stamp_ns % 10**9
            message.header.frame_id = "map"
            for number, of in enumerate(message.objects):
                of.object_id.uuid = [number + 1] * 15 + [0xff]
                of.classification[0].label, of.classification[0].probability, of.existence_probability = 1, 1.0, 0.9
                of.kinematics.orientation_availability = 2
                pose = of.kinematics.pose_with_covariance.pose
                pose.position.x, pose.position.y, pose.orientation.w = 8.0 * tick * INTERVAL_S, 10.0 * number, 1.0
                of.kinematics.twist_with_covariance.twist.linear.x = 8.0
            writer.write(message)
            for *_, data in whole.take(0.01):
                identities |= {bytes(of.object_id.uuid).hex() for of in whole.type.deserialize(data).objects}
        end_run(run)
        return {"identities": sorted(identities)}


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


class Diagnostics:
    """Takes /diagnostics: [(received_s, {name: (level, message, {key: value})})]"""

    def __init__(self, types):
        participant = DomainParticipant(0)
        topic = Topic(participant, "rt/diagnostics", types.of("diagnostic_msgs/DiagnosticArray"))
        self.reader = DataReader(participant, topic, qos=Qos(Policy.Reliability.Reliable(duration(milliseconds=100)),
                                                             Policy.History.KeepLast(64)))

    def raw(self):
        return [array for array in self.reader.take(64) if hasattr(array, "status")]

    def take(self):
        valid = self.raw()
        return [(time.time(), {of.name: (of.level, of.message, {pair.key: pair.value for pair in of.values})
                               for of in array.status}) for array in valid]


def silence(programs, types):
    """Detections pause for 8 s. Planners and monitors receive messages all the time."""
    with tempfile.TemporaryDirectory() as folder:
        run = start_run(programs, pipeline(programs, folder))
        writer, whole, diagnostics, waiting = Writer(types), Reader(types), Diagnostics(types), []
        wait_for_bridge(writer, run)
        until(lambda: waiting.extend(diagnostics.take()) or waiting, 20, "no diagnostics before the first detection")
        send(writer, 8, 4)
        whole.take(0), diagnostics.take()
        begun, frames, states = time.time(), [], []
        while time.time() - begun < 8:
            frames += whole.take(0.05)
            states += diagnostics.take()
        stamps = send(writer, 8, 3)
        again = whole.take(0.5)
        log = end_run(run)
    of_tick = [of["stgdat: tick"] for _, of in states if "stgdat: tick" in of]
    of_input = [of["stgdat: ros2 input"] for _, of in states if "stgdat: ros2 input" in of]
    times = [begun] + [received_ns / 1e9 for received_ns, *_ in frames] + [begun + 8]
    return {"waiting": sorted({message for _, of in waiting for _, message, _ in of.values()}),
            "frames": len(frames), "longest_gap_s": max(b - a for a, b in zip(times, times[1:])),
            "objects": [objects for *_, objects, _ in frames][::12],
            "tick": [of_tick[0][1], of_tick[-1][1]], "input": [of_input[0][1], of_input[-1][1]], "values": of_input[-1][2],
            "input_messages": len(of_input), "again": len(again), "sent": len(stamps), "log": log}


def clock(programs, types, rate):
    """A bag of 4 s is played three times at a rate, with /clock. Its stamps begin at 1000 s."""
    # Two numbers in a message; Cyclone compares names of types only.
    @dataclass
    class Clock(IdlStruct, typename="rosgraph_msgs::msg::dds_::Clock_"):
        sec: idl_types.int32
        nanosec: idl_types.uint32

    with tempfile.TemporaryDirectory() as folder:
        run = start_run(programs, pipeline(programs, folder, "use_sim_time = true"))
        writer, whole, diagnostics, participant = Writer(types), Reader(types), Diagnostics(types), DomainParticipant(0)
        ticking = DataWriter(participant, Topic(participant, "rt/clock", Clock),
                             qos=Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(1)))
        wait_for_bridge(writer, run)
        answered, speeds, stamps_s = [], [], []
        for _ in range(3):
            begun, frames = time.time(), []
            for tick in range(50):
                time.sleep(max(0.0, begun + tick * INTERVAL_S / rate - time.time()))
                stamp_ns = 1000 * 10**9 + round(tick * INTERVAL_S * 1e9)
                ticking.write(Clock(stamp_ns // 10**9, stamp_ns % 10**9))
                writer.write(detected_objects(stamp_ns, 4, tick * INTERVAL_S))
                frames += whole.take(0)
                for array in diagnostics.raw():
                    stamps_s.append(array.header.stamp.sec)
            frames += whole.take(0.3)
            answered.append(len({stamp for _, stamp, objects, _ in frames if objects}))
            *_, data = frames[-1]
            speeds += [round(of.kinematics.initial_twist_with_covariance.twist.linear.x, 1)
                       for of in whole.type.deserialize(data).objects]
        log = end_run(run)
    return {"answered": answered, "speeds": speeds, "diagnostics_s": [min(stamps_s), max(stamps_s)], "log": log}


def near_misses(programs, types):
    """Publishers that do not fit, one after the other."""
    detected, tracked = (types.of(f"autoware_perception_msgs/{name}Objects") for name in ("Detected", "Tracked"))
    best_effort = Qos(Policy.Durability.Volatile, Policy.Reliability.BestEffort, *REST[1:])
    rows = {"qos": (0, DETECTIONS, detected, best_effort), "type": (0, DETECTIONS, tracked, QOS),
            "namespace": (0, "rt/car/objects", detected, QOS), "domain": (7, DETECTIONS, detected, QOS)}
    found = {}
    for name, (domain, topic, of, qos) in rows.items():
        with tempfile.TemporaryDirectory() as folder:
            run = start_run(programs, pipeline(programs, folder))
            participant = DomainParticipant(domain)
            writer = DataWriter(participant, Topic(participant, topic, of), qos=qos)
            time.sleep(11)
            found[name] = [line for line in end_run(run).splitlines() if "publishes" in line or "connections" in line]
            del writer, participant
    return found


def markers(programs, types, count=10):
    """Markers for rviz, read with the definition of PyPI's `rosbags`."""
    try:
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        print(f"skipped: {error}: pip install rosbags")
        sys.exit(77)
    name = "visualization_msgs/msg/MarkerArray"
    text = get_typestore(Stores.ROS2_JAZZY).generate_msgdef(name, ros_version=2)[0]
    array = Types(definitions(SimpleNamespace(name=name, data=text.encode()))).of("visualization_msgs/MarkerArray")
    with tempfile.TemporaryDirectory() as folder:
        run = start_run(programs, pipeline(programs, folder, "markers = true"))
        writer, participant = Writer(types), DomainParticipant(0)
        reader = DataReader(participant, Topic(participant, "rt/stgdat/markers", array), qos=QOS)
        wait_for_bridge(writer, run)
        send(writer, count, 4)
        newest = reader.take(100)[-1]
        end_run(run)
    of = {ns: [marker for marker in newest.markers if marker.ns == ns] for ns in ("agents", "paths", "labels")}
    return {"frames": sorted({marker.header.frame_id for marker in newest.markers}), "first": newest.markers[0].action,
            "counts": [len(found) for found in of.values()], "texts": sorted({marker.text.split()[0] for marker in of["labels"]}),
            "types": sorted({marker.type for marker in of["agents"]}),
            "pairs": all(len(marker.points) % 2 == 0 and marker.points for marker in of["paths"]),
            "colors": sorted({"".join(f"{round(value * 255):02x}" for value in (c.r, c.g, c.b)) for m in newest.markers[1:] for c in [m.color]})}


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
    elif scenario == "clock":
        print(json.dumps(clock(programs, types, float(arguments[0]))))
    elif scenario in (plain := {"stopped-reader": stopped_reader, "transforms": transforms, "tracked": tracked,
                                "killed-bridge": killed_bridge, "silence": silence,
                                "near-misses": near_misses, "markers": markers, "attached": attached, "domains": domains}):
        print(json.dumps(plain[scenario](programs, types)))
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
