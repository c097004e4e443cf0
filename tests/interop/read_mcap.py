#!/usr/bin/env python3
"""Reads a recording of `stgdat run --record` with PyPI's `mcap` alone.

Counts the messages of each topic, decodes one forecast by the schema in the file, and compares it with the JSON line of
its tick. Exit code 0: equal, 1: different, 77: a module is missing.

    python3 tests/interop/read_mcap.py RUN.mcap FORECASTS.jsonl
"""

import json
import struct
import sys
from collections import Counter

try:
    from mcap.reader import make_reader
except ImportError as error:
    print(f"skipped: {error}: pip install mcap")
    sys.exit(77)

FORMATS = {"u8": "B", "u16": "H", "u32": "I", "u64": "Q", "i64": "q", "f32": "f"}


class Layout:
    """Decodes records by the document of `stgdat wire --json`."""

    def __init__(self, document):
        self.records = {record["name"]: record for record in document["records"]}

    def size(self, of):
        if isinstance(of, str):
            return struct.calcsize("<" + FORMATS[of])
        if "array" in of:
            return self.size(of["array"]) * of["len"]
        return self.records[of["record"]]["size"]

    def value(self, of, data, at):
        if isinstance(of, str):
            return struct.unpack_from("<" + FORMATS[of], data, at)[0]
        if "array" in of:
            size = self.size(of["array"])
            return [self.value(of["array"], data, at + i * size) for i in range(of["len"])]
        return self.record(of["record"], data, at)

    def record(self, name, data, at=0, size=None):
        """The fields of a record, of which the file may have the first `size` bytes alone."""
        fields = self.records[name]["fields"]
        ends = {field["name"]: field["offset"] + self.size(field["type"]) for field in fields}
        known = [field for field in fields if size is None or ends[field["name"]] <= size]
        return {field["name"]: self.value(field["type"], data, at + field["offset"]) for field in known}


def near(a, b, slack):
    return abs(a - b) <= slack


def compare(forecast, agent, horizon):
    """The fields that differ between a decoded forecast and the agent of a line."""
    wrong = [key for key in ("id", "source_id") if forecast[key] != agent[key]]
    wrong += [key for key in ("x_m", "y_m", "vx_mps", "vy_mps") if not near(forecast[key], agent[key], 1e-4)]
    modes = range(forecast["modes_len"])
    if not all(near(forecast["probability"][mode], agent["probability"][mode], 1e-6) for mode in modes):
        wrong.append("probability")
    points = [
        (forecast["modes"][mode][step][axis], agent["modes_m"][mode][step][axis])
        for mode in modes
        for step in range(horizon)
        for axis in range(2)
    ]
    if not all(near(a, b, 1e-4) for a, b in points):
        wrong.append("modes_m")
    return wrong


def main(recording, lines):
    with open(lines) as file:
        by_tick = {line["seq"]: line for line in map(json.loads, file)}
    counts, compared, wrong = Counter(), 0, []
    with open(recording, "rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        for schema, channel, message in reader.iter_messages():
            counts[channel.topic] += 1
            if channel.topic != "forecasts":
                continue
            layout = Layout(json.loads(schema.data))
            header_bytes = int(channel.metadata["header_bytes"])
            header = layout.record(channel.metadata["header"], message.data)
            element, size = channel.metadata["element"], int(channel.metadata["element_bytes"])
            forecasts_len = (len(message.data) - header_bytes) // size
            is_tick = header["flags"] & 3 == 0
            # Every line of the run has its frame; one forecast in each is decoded.
            if not is_tick or forecasts_len == 0 or header["seq"] not in by_tick or header["seq"] % 10:
                continue
            forecast = layout.record(element, message.data, header_bytes, size)
            line = by_tick[header["seq"]]
            assert header["stamp_ns"] == line["stamp_ns"], (header["seq"], header["stamp_ns"])
            wrong += compare(forecast, line["agents"][0], header["counts"]["horizon_len"])
            compared += 1
        told = {summary.channels[id].topic: count for id, count in summary.statistics.channel_message_counts.items()}
    for topic, count in sorted(counts.items()):
        print(f"{topic} {count}")
    if told != dict(counts):
        wrong.append(f"the index counts {told}")
    print(f"{compared} forecasts decoded and compared, different: {wrong or 'none'}")
    return 0 if compared and not wrong else 1


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    sys.exit(main(*sys.argv[1:]))
