#!/usr/bin/env python3
"""Holds our markers for rviz to PyPI's `rosbags`, which has the definitions of ROS 2 Jazzy.

Prints the type hash of `MarkerArray`. With a file it also writes a golden message: the bytes of a message with a different
value in each field. Exit code 77: a module is missing.

    python3 tests/interop/markers_by_rosbags.py [GOLDEN.cdr]
"""

import sys
from itertools import count
from pathlib import Path

try:
    import numpy
    from rosbags.typesys import Stores, get_typestore
except ImportError as error:
    print(f"skipped: {error}: pip install rosbags")
    sys.exit(77)

NAME = "visualization_msgs/msg/MarkerArray"
# Kinds of fields in the definitions of rosbags.
PRIMITIVE, MESSAGE, SEQUENCE = 1, 2, 4


def fill(store, kind, of, number):
    """A value with a different number in each field and two elements in each sequence."""
    if kind == MESSAGE:
        fields = {name: fill(store, *field, number) for name, field in store.fielddefs[of][1]}
        return store.types[of](**fields)
    if kind == SEQUENCE:
        element, _ = of
        values = [fill(store, *element, number) for _ in range(2)]
        return values if element[0] == MESSAGE else numpy.array(values, dtype=element[1][0])
    assert kind == PRIMITIVE, kind
    if of[0] == "string":
        return "text" * (next(number) % 3) + "é"
    if of[0] == "bool":
        return next(number) % 2 == 0
    return next(number) / 8.0 if of[0].startswith("float") else next(number) % 256


def main(golden=None):
    store = get_typestore(Stores.ROS2_JAZZY)
    print(store.hash_rihs01(NAME))
    if golden:
        Path(golden).write_bytes(bytes(store.serialize_cdr(fill(store, MESSAGE, NAME, count(1)), NAME)))
    return 0


if __name__ == "__main__":
    if len(sys.argv) > 2:
        sys.exit(__doc__)
    sys.exit(main(*sys.argv[1:]))
