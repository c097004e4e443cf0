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
from pathlib import Path

from cdr_by_cyclonedds import blank
from ros2_cyclone import (CYCLONEDDS, INTERVAL_S, LATCHED, NAMESPACE, PATHS, POSES, QOS, DataWriter, DomainParticipant, Reader,
                          ReaderProcess, Topic, Writer, detected_objects, end_run, figures, pipeline, place, process_of,
                          read_until_killed, root_of, send, start_run, ticks_of, types_of, until, wait_for_bridge)


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
    elif scenario in (plain := {"stopped-reader": stopped_reader, "transforms": transforms, "tracked": tracked,
                                "killed-bridge": killed_bridge, "attached": attached, "domains": domains}):
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
