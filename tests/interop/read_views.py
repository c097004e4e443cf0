#!/usr/bin/env python3
"""Reads a recording with messages for other tools, by PyPI's `mcap`, `mcap-ros2-support` and `rosbags`.

Counts the messages of each topic, and compares the predicted objects of every tick with its JSON line, number by number.
Exit code 0: equal, 1: different, 77: a module is missing.

    python3 tests/interop/read_views.py RUN.mcap FORECASTS.jsonl [rosbags]
"""

import json
import math
import sys
from collections import Counter
from pathlib import Path

try:
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory
    from rosbags.rosbag2 import Reader
except ImportError as error:
    print(f"skipped: {error}: pip install mcap mcap-ros2-support rosbags")
    sys.exit(77)

PREDICTED = "/perception/object_recognition/objects"
LABELS = {"vehicle": 1, "cyclist": 6, "pedestrian": 7}


def near(a, b, slack=1e-4):
    return abs(a - b) <= slack * max(1.0, abs(b) * 1e-3)


def uuid(agent):
    own = agent["source_id"] != 0
    return b"stgdat\x80" + bytes([own]) + (agent["source_id"] if own else agent["id"]).to_bytes(8, "big")


def compare(found, agent, step_s):
    """The fields that differ between an object and the agent of a line."""
    wrong = []
    pose = found.kinematics.initial_pose_with_covariance.pose
    position = pose.position
    if not (near(position.x, agent["x_m"]) and near(position.y, agent["y_m"])):
        wrong.append("position")
    heading = 2.0 * math.atan2(pose.orientation.z, pose.orientation.w)
    if not near(math.cos(heading - agent["heading_rad"]), 1.0):
        wrong.append("heading")
    twist = found.kinematics.initial_twist_with_covariance.twist.linear
    along = (math.cos(heading), math.sin(heading))
    velocity = (along[0] * twist.x - along[1] * twist.y, along[1] * twist.x + along[0] * twist.y)
    if not (near(velocity[0], agent["vx_mps"], 1e-3) and near(velocity[1], agent["vy_mps"], 1e-3)):
        wrong.append("velocity")
    if max(found.classification, key=lambda c: c.probability).label != LABELS[agent["type"]]:
        wrong.append("classification")
    for field, of in (("length_m", "x"), ("width_m", "y")):
        if agent[field] and not near(getattr(found.shape.dimensions, of), agent[field]):
            wrong.append(field)
    # The most probable modes, first the most probable one.
    paths = found.kinematics.predicted_paths
    probability = sorted(agent["probability"], reverse=True)[: len(paths)]
    if not paths or not all(near(path.confidence, p, 1e-5) for path, p in zip(paths, probability)):
        wrong.append("confidence")
    for path in paths:
        span = path.time_step.sec + path.time_step.nanosec / 1e9
        points = [(pose.position.x, pose.position.y) for pose in path.path[1:]]
        like = [m for m, p in zip(agent["modes_m"], agent["probability"]) if near(p, path.confidence, 1e-5)]
        same = any(
            len(mode) == len(points) and all(near(a, b) for p, q in zip(points, mode) for a, b in zip(p, q))
            for mode in like
        )
        if not same or not near(span, step_s):
            wrong.append("path")
    return wrong


def main(recording, lines, *options):
    with open(lines) as file:
        by_stamp = {line["stamp_ns"]: line for line in map(json.loads, file)}
    counts, compared, wrong = Counter(), 0, []
    with open(recording, "rb") as file:
        for _, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            counts[channel.topic] += 1
    with open(recording, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        topics = [topic for topic in counts if topic == PREDICTED or topic.startswith(("/tf", "/diag", "/perception"))]
        for _, channel, _, ros in reader.iter_decoded_messages(topics=topics):
            if channel.topic != PREDICTED:
                continue
            line = by_stamp[ros.header.stamp.sec * 1_000_000_000 + ros.header.stamp.nanosec]
            objects = {bytes(found.object_id.uuid): found for found in ros.objects}
            if len(objects) != len(line["agents"]):
                wrong.append((line["seq"], "objects"))
            for agent in line["agents"]:
                found = objects.get(uuid(agent))
                missing = ["object"] if found is None else compare(found, agent, line["step_s"])
                wrong += [(line["seq"], agent["id"], field) for field in missing]
                compared += 1
    for topic, count in sorted(counts.items()):
        print(f"{topic} {count}")
    if "rosbags" in options:
        with Reader(Path(recording)) as bag:
            told = Counter(connection.topic for connection, _, _ in bag.messages())
            print(f"rosbags {sum(told.values())}")
            if told != counts or any(len(c.ext.offered_qos_profiles) != 1 for c in bag.connections if c.ext.serialization_format == "cdr"):
                wrong.append(("rosbags", dict(told)))
    print(f"{compared} objects decoded and compared, different: {wrong[:5] or 'none'}")
    return 0 if compared and not wrong else 1


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    sys.exit(main(*sys.argv[1:]))
