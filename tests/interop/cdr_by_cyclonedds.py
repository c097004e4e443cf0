#!/usr/bin/env python3
"""Holds our CDR to Eclipse Cyclone DDS (PyPI's `cyclonedds`).

Builds Cyclone's types from the schemas of a recording with Autoware's messages. Each message of the recording must be
equal to Cyclone's bytes of the same values. With a folder as second argument it also writes golden messages: Cyclone's
bytes of a message of each type with a different value in every field. Exit code 77: a module is missing.

    python3 tests/interop/cdr_by_cyclonedds.py RUN.mcap [GOLDEN_FOLDER]
"""

import sys
from collections import Counter
from itertools import count
from pathlib import Path

try:
    from cyclonedds.idl import make_idl_struct, types
    from mcap.reader import make_reader
except ImportError as error:
    print(f"skipped: {error}: pip install cyclonedds mcap")
    sys.exit(77)

PRIMITIVES = {
    "uint8": types.uint8,
    "byte": types.uint8,
    "int32": types.int32,
    "uint32": types.uint32,
    "float32": types.float32,
    "float64": types.float64,
    "bool": bool,
    "string": str,
}
# Only the reader of detections has this type; its parts are in the schemas of tracked objects.
DETECTED = {
    "autoware_perception_msgs/DetectedObjectKinematics": """geometry_msgs/PoseWithCovariance pose_with_covariance
bool has_position_covariance
uint8 orientation_availability
geometry_msgs/TwistWithCovariance twist_with_covariance
bool has_twist
bool has_twist_covariance""",
    "autoware_perception_msgs/DetectedObject": """float32 existence_probability
autoware_perception_msgs/ObjectClassification[] classification
autoware_perception_msgs/DetectedObjectKinematics kinematics
autoware_perception_msgs/Shape shape""",
    "autoware_perception_msgs/DetectedObjects": """std_msgs/Header header
autoware_perception_msgs/DetectedObject[] objects""",
}


def definitions(schema):
    """The lines of each message of a flattened schema."""
    first, *others = schema.data.decode().split("=" * 80 + "\n")
    found = {schema.name.replace("/msg/", "/"): first}
    for other in others:
        name, lines = other.split("\n", 1)
        found[name.removeprefix("MSG: ")] = lines
    return found


class Types:
    def __init__(self, texts):
        self.texts, self.made = texts, {}

    def of(self, text):
        if text.endswith("[]"):
            return types.sequence[self.of(text[:-2])]
        if text.endswith("]"):
            element, len = text[:-1].split("[")
            return types.array[self.of(element), int(len)]
        if text in PRIMITIVES:
            return PRIMITIVES[text]
        if text not in self.made:
            lines = [line.split() for line in self.texts[text].splitlines() if line and "=" not in line]
            members = {name: self.of(of) for of, name in lines}
            name = text.replace("/", ".msg.dds_.") + "_"
            self.made[text] = make_idl_struct(name.split(".")[-1], name, members)
        return self.made[text]


def fill(text, made, number):
    """A value with a different number in each field and two elements in each sequence."""
    if text.endswith("]"):
        element, len = text[:-1].split("[")
        return [fill(element, made, number) for _ in range(int(len or 2))]
    if text == "string":
        return "text" * (next(number) % 3) + "é"
    if text == "bool":
        return next(number) % 2 == 0
    if text.startswith("float"):
        return next(number) / 8.0
    if text in PRIMITIVES:
        return next(number) % 256
    lines = [line.split() for line in made.texts[text].splitlines() if line and "=" not in line]
    return made.of(text)(**{name: fill(of, made, number) for of, name in lines})


def blank(text, made, count):
    """A value of zeros, with this many elements in its own sequence and one in all others."""
    if text.endswith("]"):
        element, len = text[:-1].split("[")
        return [blank(element, made, 1) for _ in range(int(len or count))]
    if text in PRIMITIVES:
        return {"string": "", "bool": False}.get(text, 0.0 if text.startswith("float") else 0)
    lines = [line.split() for line in made.texts[text].splitlines() if line and "=" not in line]
    return made.of(text)(**{name: blank(of, made, count) for of, name in lines})


def main(recording, golden=None):
    counts, wrong, texts = Counter(), [], dict(DETECTED)
    with open(recording, "rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            if channel.message_encoding != "cdr":
                continue
            if counts[channel.topic] == 0:
                texts |= definitions(schema)
            made = made if counts[channel.topic] else Types(texts)
            of = made.of(schema.name.replace("/msg/", "/"))
            if of.deserialize(message.data).serialize(use_version_2=False) != message.data:
                wrong.append((channel.topic, message.sequence))
            counts[channel.topic] += 1
    if golden:
        made = Types(texts)
        for name in ("PredictedObjects", "TrackedObjects", "DetectedObjects"):
            value = fill(f"autoware_perception_msgs/{name}", made, count(1))
            Path(golden, f"{name}.cdr").write_bytes(value.serialize(use_version_2=False))
        for name in ("tf2_msgs/TFMessage", "diagnostic_msgs/DiagnosticArray"):
            value = fill(name, made, count(1))
            Path(golden, f"{name.split('/')[1]}.cdr").write_bytes(value.serialize(use_version_2=False))
    for topic, found in sorted(counts.items()):
        print(f"{topic} {found}")
    print(f"{sum(counts.values())} messages, different: {wrong[:5] or 'none'}")
    return 0 if counts and not wrong else 1


if __name__ == "__main__":
    if len(sys.argv) not in (2, 3):
        sys.exit(__doc__)
    sys.exit(main(*sys.argv[1:]))
