#!/usr/bin/env python3
"""Writes a bag with Autoware's objects by PyPI's `rosbags`: two cars, a pedestrian and an animal, seen from a moving ego.

KIND is detected, tracked or predicted; STORAGE is mcap or sqlite3. Objects are in the frame base_link. Predicted objects
have a straight path and a less confident one of standing, in steps of 0.5 s. Exit code 77: a module is missing.

    python3 tests/interop/write_bag.py BAG_FOLDER SCHEMAS.mcap KIND STORAGE
"""

import math
import sys
from pathlib import Path

try:
    from mcap.reader import make_reader
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore
except ImportError as error:
    print(f"skipped: {error}: pip install rosbags mcap")
    sys.exit(77)

PACKAGE = "autoware_perception_msgs/msg/"
DETECTED = {
    "DetectedObjectKinematics": """geometry_msgs/PoseWithCovariance pose_with_covariance
bool has_position_covariance
uint8 orientation_availability
geometry_msgs/TwistWithCovariance twist_with_covariance
bool has_twist
bool has_twist_covariance""",
    "DetectedObject": """float32 existence_probability
autoware_perception_msgs/ObjectClassification[] classification
autoware_perception_msgs/DetectedObjectKinematics kinematics
autoware_perception_msgs/Shape shape""",
    "DetectedObjects": """std_msgs/Header header
autoware_perception_msgs/DetectedObject[] objects""",
}
# Label, position and speed along +x in the world.
KINDS = {
    "detected": ("DetectedObjects", "/perception/object_recognition/detection/objects"),
    "tracked": ("TrackedObjects", "/perception/object_recognition/tracking/objects"),
    "predicted": ("PredictedObjects", "/perception/object_recognition/objects"),
}
STEP_NS, STEPS = 500_000_000, 10
AGENTS = [(1, 10.0, 5.0, 8.0), (1, -20.0, -5.0, 4.0), (7, 3.0, 9.0, 1.25), (8, 0.0, 0.0, 0.0)]
TICKS, INTERVAL_NS = 60, 100_000_000
EGO = (1.0, 2.0, 0.5)


def store(schemas):
    types = get_typestore(Stores.ROS2_HUMBLE)
    with open(schemas, "rb") as file:
        for schema in make_reader(file).get_summary().schemas.values():
            if schema.encoding == "ros2msg" and schema.name.startswith(PACKAGE):
                own = get_types_from_msg(schema.data.decode(), schema.name)
                types.register({name: of for name, of in own.items() if name.startswith(PACKAGE)})
    for name, text in DETECTED.items():
        types.register(get_types_from_msg(text, PACKAGE + name))
    return types


def main(folder, schemas, kind, storage):
    types = store(schemas)
    of = types.types
    ros = lambda name, *values: of[name](*values)
    geometry = lambda name, *values: of["geometry_msgs/msg/" + name](*values)
    turn = lambda angle: geometry("Quaternion", 0.0, 0.0, math.sin(angle / 2), math.cos(angle / 2))
    import numpy

    none = numpy.zeros(36)
    zero = geometry("Vector3", 0.0, 0.0, 0.0)
    name, topic = PACKAGE + KINDS[kind][0], KINDS[kind][1]
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    with Writer(Path(folder), version=9, storage_plugin=plugin) as bag:
        objects = bag.add_connection(topic, name, typestore=types)
        tf = bag.add_connection("/tf", "tf2_msgs/msg/TFMessage", typestore=types)
        for tick in range(TICKS):
            stamp_ns = 1_700_000_000_000_000_000 + tick * INTERVAL_NS
            stamp = ros("builtin_interfaces/msg/Time", stamp_ns // 10**9, stamp_ns % 10**9)
            t = tick * INTERVAL_NS / 1e9
            ego = (EGO[0] + 2.0 * t, EGO[1], EGO[2])
            place = geometry("Transform", geometry("Vector3", ego[0], ego[1], 0.0), turn(ego[2]))
            header = ros("std_msgs/msg/Header", stamp, "map")
            message = ros("tf2_msgs/msg/TFMessage", [geometry("TransformStamped", header, "base_link", place)])
            bag.write(tf, stamp_ns, types.serialize_cdr(message, "tf2_msgs/msg/TFMessage"))
            found = []
            for number, (label, x, y, speed) in enumerate(AGENTS):
                dx, dy = x + speed * t - ego[0], y - ego[1]
                cos, sin = math.cos(ego[2]), math.sin(ego[2])
                # The agent in base_link, after it has gone further.
                at = lambda ahead: geometry(
                    "Pose",
                    geometry("Point", cos * (dx + ahead) + sin * dy, cos * dy - sin * (dx + ahead), 0.0),
                    turn(-ego[2]),
                )
                pose = geometry("PoseWithCovariance", at(0.0), none)
                linear = geometry("Vector3", speed, 0.0, 0.0)
                twist = geometry("TwistWithCovariance", geometry("Twist", linear, zero), none)
                classes = [of[PACKAGE + "ObjectClassification"](label, 0.9)]
                shape = of[PACKAGE + "Shape"](0, geometry("Polygon", []), geometry("Vector3", 4.5, 1.8, 1.5))
                if kind == "detected":
                    kinematics = of[PACKAGE + "DetectedObjectKinematics"](pose, False, 2, twist, True, False)
                    found.append(of[PACKAGE + "DetectedObject"](0.8, classes, kinematics, shape))
                    continue
                accel = geometry("AccelWithCovariance", geometry("Accel", zero, zero), none)
                uuid = ros("unique_identifier_msgs/msg/UUID", numpy.full(16, number + 1, dtype=numpy.uint8))
                if kind == "predicted":
                    step = ros("builtin_interfaces/msg/Duration", STEP_NS // 10**9, STEP_NS % 10**9)
                    path = lambda mps: [at(mps * k * STEP_NS / 1e9) for k in range(STEPS + 1)]
                    paths = [of[PACKAGE + "PredictedPath"](path(mps), step, p) for mps, p in ((0.0, 0.25), (speed, 0.75))]
                    kinematics = of[PACKAGE + "PredictedObjectKinematics"](pose, twist, accel, paths)
                    found.append(of[PACKAGE + "PredictedObject"](uuid, 0.8, classes, kinematics, shape))
                else:
                    kinematics = of[PACKAGE + "TrackedObjectKinematics"](pose, twist, accel, 2, False)
                    found.append(of[PACKAGE + "TrackedObject"](uuid, 0.8, classes, kinematics, shape))
            header = ros("std_msgs/msg/Header", stamp, "base_link")
            bag.write(objects, stamp_ns, types.serialize_cdr(of[name](header, found), name))
    print(f"{TICKS} messages of {len(AGENTS)} objects")


if __name__ == "__main__":
    if len(sys.argv) != 5:
        sys.exit(__doc__)
    main(*sys.argv[1:])
