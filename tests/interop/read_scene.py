#!/usr/bin/env python3
"""Reads the scene of a recording for Foxglove, by Foxglove's own descriptors in the file (PyPI's `mcap-protobuf-support`).

Compares the boxes and lines of every tick with its JSON line. Exit code 0: equal, 1: different, 77: a module is missing.

    python3 tests/interop/read_scene.py RUN.mcap FORECASTS.jsonl
"""

import json
import sys
from collections import Counter

try:
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory
except ImportError as error:
    print(f"skipped: {error}: pip install mcap mcap-protobuf-support")
    sys.exit(77)


def near(a, b, slack=1e-4):
    return abs(a - b) <= slack * max(1.0, abs(b) * 1e-3)


def same(points, others):
    return len(points) == len(others) and all(near(a, b) for p, q in zip(points, others) for a, b in zip(p, q))


def compare(entity, agent):
    """The parts of an entity that differ from the agent of a line."""
    wrong = []
    (shape,) = [*entity.cubes, *entity.cylinders]
    if not same([(shape.pose.position.x, shape.pose.position.y)], [(agent["x_m"], agent["y_m"])]):
        wrong.append("position")
    metadata = {pair.key: pair.value for pair in entity.metadata}
    if (metadata["quality"], metadata["cause"]) != (agent["quality"], agent["cause"]):
        wrong.append("quality")
    # The last line is the history. The others are the most probable modes, the most opaque one first.
    *paths, _ = [[(point.x, point.y) for point in line.points] for line in entity.lines]
    order = sorted(range(len(agent["probability"])), key=lambda mode: -agent["probability"][mode])
    modes = [agent["modes_m"][mode] for mode in order[: len(paths)]]
    is_tied = len(set(agent["probability"])) < len(agent["probability"])
    found = all(any(same(path[1:], mode) for mode in agent["modes_m"]) for path in paths)
    ordered = all(same(path[1:], mode) for path, mode in zip(paths, modes))
    if not paths or not (found and (ordered or is_tied)):
        wrong.append("paths")
    if agent["quality"] != "learned" and agent["cause"] not in entity.texts[0].text:
        wrong.append("label")
    return wrong


def main(recording, lines):
    with open(lines) as file:
        by_stamp = {line["stamp_ns"]: line for line in map(json.loads, file)}
    counts, compared, wrong = Counter(), 0, []
    with open(recording, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        topics = ["/stgdat/scene", "/stgdat/tf", "/stgdat/log"]
        for schema, channel, _, message in reader.iter_decoded_messages(topics=topics):
            counts[schema.name] += 1
            if channel.topic == "/stgdat/tf":
                (transform,) = message.transforms
                assert (transform.parent_frame_id, transform.child_frame_id) == ("map", "base_link")
            if channel.topic != "/stgdat/scene":
                continue
            assert len(message.deletions) == 1 and message.deletions[0].type == 1, message.deletions
            entities = {entity.id: entity for entity in message.entities}
            line = by_stamp[message.deletions[0].timestamp.ToNanoseconds()]
            for agent in line["agents"]:
                differs = compare(entities[str(agent["source_id"] or agent["id"])], agent)
                wrong += [(line["seq"], agent["id"], part) for part in differs]
                compared += 1
    for name, count in sorted(counts.items()):
        print(f"{name} {count}")
    print(f"{compared} entities decoded and compared, different: {wrong[:5] or 'none'}")
    return 0 if compared and not wrong else 1


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    sys.exit(main(*sys.argv[1:]))
