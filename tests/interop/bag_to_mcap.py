#!/usr/bin/env python3
"""Converts a rosbag2 in sqlite3 into one MCAP file that `stgdat run --recording` plays, with PyPI's `rosbags`.

Exit code 77: a module is missing.

    python3 tests/interop/bag_to_mcap.py BAG_FOLDER OUT.mcap
"""

import sys
from pathlib import Path

try:
    from mcap.writer import Writer
    from rosbags.rosbag2 import Reader
except ImportError as error:
    print(f"skipped: {error}: pip install rosbags mcap")
    sys.exit(77)


def main(bag, out):
    count = 0
    with Reader(Path(bag)) as reader, open(out, "wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="bag_to_mcap")
        channels = {}
        for connection, stamp_ns, data in reader.messages():
            if connection.id not in channels:
                schema = writer.register_schema(connection.msgtype, "ros2msg", (connection.msgdef.data or "").encode())
                channels[connection.id] = writer.register_channel(connection.topic, "cdr", schema)
            writer.add_message(channels[connection.id], stamp_ns, bytes(data), stamp_ns)
            count += 1
        writer.finish()
    print(f"{count} messages")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(*sys.argv[1:])
