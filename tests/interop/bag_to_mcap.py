#!/usr/bin/env python3
"""Converts a rosbag2 in sqlite3 into one MCAP file that `stgdat run --recording` plays. Needs only Python.

The messages in a write-ahead log beside a file (`.db3-wal`, after the recorder was killed) are converted too. The result
is all messages that `metadata.yaml` lists, or exit code 65 and no file. Exit code 77: a module is missing.

    python3 tests/interop/bag_to_mcap.py BAG_FOLDER OUT.mcap
"""

import os
import re
import shutil
import sqlite3
import struct
import sys
import tempfile
from pathlib import Path

MAGIC = b"\x89MCAP0\r\n"


class Writer:
    """Writes an MCAP file without chunks and without an index."""

    def __init__(self, file):
        self.file = file
        self.channels = {}
        file.write(MAGIC)
        self.record(1, self.text("ros2") + self.text("bag_to_mcap"))

    @staticmethod
    def text(value):
        raw = value.encode()
        return struct.pack("<I", len(raw)) + raw

    def record(self, code, body):
        self.file.write(struct.pack("<BQ", code, len(body)) + body)

    def message(self, topic, kind, definition, stamp_ns, data):
        if topic not in self.channels:
            number = self.channels[topic] = len(self.channels) + 1
            head = struct.pack("<H", number)
            self.record(3, head + self.text(kind) + self.text("ros2msg") + self.text(definition))
            self.record(4, head + head + self.text(topic) + self.text("cdr") + self.text(""))
        self.record(5, struct.pack("<HIQQ", self.channels[topic], 0, stamp_ns, stamp_ns) + data)

    def finish(self):
        self.record(15, struct.pack("<I", 0))
        self.record(2, struct.pack("<QQI", 0, 0, 0))
        self.file.write(MAGIC)


def parts(bag):
    """The files of the bag in order, and the number of messages that its list has; None without a list."""
    listing = bag / "metadata.yaml"
    if not listing.is_file():
        return sorted(bag.glob("*.db3")), None
    text = listing.read_text()
    files = re.search(r"^ *relative_file_paths:\n((?: *- .*\n)+)", text, re.M)
    count = re.search(r"^  message_count: (\d+)$", text, re.M)
    names = re.findall(r"- [\"']?(.*?)[\"']?$", files[1], re.M) if files else []
    return [bag / Path(name).name for name in names], int(count[1]) if count else None


def messages(file, folder):
    """Topic, type, definition, time and content of each message. The database is a copy, because SQLite changes it."""
    copy = Path(folder, file.name)
    for end in ("", "-wal"):
        if Path(f"{file}{end}").exists():
            shutil.copy(f"{file}{end}", f"{copy}{end}")
    with sqlite3.connect(copy) as database:
        tables = {name for (name,) in database.execute("SELECT name FROM sqlite_master")}
        if not {"topics", "messages"} <= tables:
            raise ValueError(f"{file}: has no tables topics and messages")
        has_definitions = "message_definitions" in tables
        found = database.execute("SELECT topic_type, encoded_message_definition FROM message_definitions") if has_definitions else []
        definitions = dict(found)
        topics = {
            number: (name, kind, definitions.get(kind, ""))
            for number, name, kind in database.execute("SELECT id, name, type FROM topics")
        }
        for number, stamp_ns, data in database.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY timestamp, id"):
            yield (*topics[number], stamp_ns, data)
    database.close()


def convert(bag, out):
    """Writes the file and returns the number of messages."""
    files, expected = parts(bag)
    if not files:
        raise ValueError(f"{bag}: no file in sqlite3")
    count = 0
    with open(out, "wb") as file, tempfile.TemporaryDirectory() as folder:
        writer = Writer(file)
        for part in files:
            for message in messages(part, folder):
                writer.message(*message)
                count += 1
        writer.finish()
    if expected not in (None, count):
        raise ValueError(f"{bag}: {count} messages, and metadata.yaml lists {expected}: is a file or its -wal file missing?")
    return count


def main(bag, out):
    """Converts, and removes what a failure leaves."""
    try:
        print(f"{convert(Path(bag), out)} messages")
    except (OSError, ValueError, sqlite3.Error) as error:
        if os.path.isfile(out):
            os.remove(out)
        print(f"error: {error}", file=sys.stderr)
        return 65
    return 0


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    sys.exit(main(*sys.argv[1:]))
