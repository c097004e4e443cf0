"""A detector in Python: in pipeline.toml, `command = ["python3", "producer.py"]` in the source's table.

Here one sensor detects a car, and another sensor detects a pedestrian. Replace `detect` by your detectors. Positions are
in metres in the world frame. The frame's stamp is the time of its newest measurement on the sensors' clock. Each
detection contains its own time as an offset from the stamp. `stgdat_topics.py` and docs/interfaces.md describe the rest.
Environment variables describe the run: STGDAT_RUN_ID, STGDAT_PREFIX, STGDAT_ROOT, STGDAT_INTERVAL_NS, STGDAT_ORIGIN.

usage: producer.py [TICKS] [--offsets-ms CAR,PEDESTRIAN] [--csv FILE [--interval-ms MS]]
"""

import argparse
import csv

import ctypes
import itertools
import math
import os
import time
from decimal import Decimal

import iceoryx2 as iox2
from stgdat_topics import join, origin, topic
from stgdat_wire import (DETECTIONS_MAX, SCHEMA, TOPICS, AgentType, Counts, Detection, DetectionFlags, Flags, Header,
                         Hop, StageId, StampSource, protect)


def detect(stamp_ns, offsets_ns):
    """The detections of the two sensors, each at its own time: type, position, and other known values."""
    car_s, pedestrian_s = ((stamp_ns + offset_ns) / 1e9 for offset_ns in offsets_ns)
    yield Detection(agent_type=AgentType.VEHICLE, x_m=-20 + 6 * car_s, y_m=2, heading_rad=0, speed_mps=6, length_m=4.5,
                    width_m=1.8, score=0.9, offset_ns=offsets_ns[0],
                    flags=DetectionFlags.HAS_HEADING | DetectionFlags.HAS_SPEED | DetectionFlags.HAS_SIZE)
    yield Detection(agent_type=AgentType.PEDESTRIAN, x_m=5, y_m=-8 + 1.4 * pedestrian_s, score=0.8,
                    offset_ns=offsets_ns[1])


def world(row):
    """A row's position in the world frame. The run's origin (`stgdat run --origin X,Y`) is subtracted in 64 bits, before the
    position becomes a 32-bit float."""
    return float(row["x_m"]) - origin()[0], float(row["y_m"]) - origin()[1]


def detection(row):
    """The detection in a row of a CSV file (docs/recordings.md)."""
    has = lambda *names: all(row.get(name) for name in names)
    number = lambda name, default=0: float(row[name]) if has(name) else default
    flags = ((DetectionFlags.HAS_ID if has("id") else 0) | (DetectionFlags.HAS_HEADING if has("heading_rad") else 0)
             | (DetectionFlags.HAS_SPEED if has("speed_mps") else 0)
             | (DetectionFlags.HAS_SIZE if has("length_m", "width_m") else 0))
    x_m, y_m = world(row)
    return Detection(agent_type=AgentType[row["type"].upper()], id=int(row["id"]) if has("id") else 0, flags=flags,
                     x_m=x_m, y_m=y_m, heading_rad=number("heading_rad"),
                     speed_mps=number("speed_mps"), length_m=number("length_m"), width_m=number("width_m"),
                     score=number("score", 1), sigma_m=number("sigma_m"), sensor=int(number("sensor")))


def interpolated(poses, stamp_ns):
    """The ego pose at a time, interpolated between two poses, with the heading along the shortest arc."""
    after = next((pose for pose in poses if pose[0] >= stamp_ns), poses[-1])
    before = next((pose for pose in reversed(poses) if pose[0] <= stamp_ns), poses[0])
    share = (stamp_ns - before[0]) / (after[0] - before[0]) if after[0] > before[0] else 0
    turn = math.remainder(after[3] - before[3], math.tau)
    return (before[1] + share * (after[1] - before[1]), before[2] + share * (after[2] - before[2]),
            math.remainder(before[3] + share * turn, math.tau))


def merged(path):
    """The frames that a producer would send if it merged the sensors of a CSV file: for each interval, the newest
    detection of each identity. Yields the stamp, the detections with their offsets, flags and the ego pose."""
    with open(path, newline="") as file:
        rows = [(int(round(Decimal(row["stamp_s"]) * 10**9)), row)
                for row in csv.DictReader(line for line in file if not line.startswith("#"))]
    rows.sort(key=lambda row: row[0])
    is_pose = lambda row: row["type"] in ("ego", "above")
    poses = [(stamp_ns, *world(row), float(row.get("heading_rad") or 0))
             for stamp_ns, row in rows if is_pose(row)]
    measured = [row for row in rows if not is_pose(row[1])]
    flags = Flags.SEEN_FROM_EGO if any(row["type"] == "ego" for _, row in rows) else 0
    sweep = lambda row: (row[0] - measured[0][0]) // interval_ns
    for _, together in itertools.groupby(measured, key=sweep):
        newest = {row.get("id") or place: (stamp_ns, row) for place, (stamp_ns, row) in enumerate(together)}
        frame_ns = max(stamp_ns for stamp_ns, _ in newest.values())
        detections = []
        for stamp_ns, row in newest.values():
            detections.append(detection(row))
            detections[-1].offset_ns = stamp_ns - frame_ns
        yield frame_ns, detections, flags, interpolated(poses, frame_ns) if poses else (0, 0, 0)


def send(topic, seq, stamp_ns, elements=(), flags=0, ego=(0, 0, 0)):
    """Writes a frame into shared memory and wakes its readers; `ego` is the sensor's x, y (m) and heading (rad)."""
    publisher, notifier, element, name, counter = topic
    now_ns = time.monotonic_ns()
    header = Header(schema=SCHEMA, flags=flags, run_id=run_id, seq=seq, stamp_ns=stamp_ns, released_ns=now_ns,
                    interval_ns=interval_ns, stamp_source=StampSource.SENSOR_CLOCK, sender=StageId.SOURCE,
                    observed_types=sum(1 << agent_type for agent_type in AgentType), hops_len=1,
                    counts=Counts(agents_len=len(elements)), ego_m=ego[:2], ego_heading_rad=ego[2])
    header.hops[0] = Hop(stage=StageId.SOURCE, received_ns=now_ns, started_ns=now_ns, finished_ns=now_ns, sent_ns=now_ns)
    payload = (element * len(elements))(*elements)
    # The run's readers refuse detections without a check value, unless `protect` in pipeline.toml leaves them out.
    protect(header, payload, name, next(counter))
    sample = publisher.loan_slice_uninit(len(elements))
    ctypes.memmove(sample.user_header_ptr, ctypes.byref(header), ctypes.sizeof(header))
    ctypes.memmove(sample.payload_ptr, payload, ctypes.sizeof(payload))
    sample.assume_init().send()
    try:
        notifier.notify()
    except iox2.NotifierNotifyError:
        pass  # More than two intervals since the last frame: the notification is delivered all the same.


def output(name):
    """The writing end of a topic."""
    frames, events = topic(node, name)
    publisher = frames.publisher_builder().initial_max_slice_len(DETECTIONS_MAX).create()
    return publisher, events.notifier_builder().create(), TOPICS[name], name, itertools.count()


run_id, interval_ns = int(os.environ["STGDAT_RUN_ID"]), int(os.environ["STGDAT_INTERVAL_NS"])
arguments = argparse.ArgumentParser(description="A detector that sends what two sensors see, or a recording.")
arguments.add_argument("ticks", type=int, nargs="?")
arguments.add_argument("--offsets-ms", default="0,0", help="when each sensor measures, from the frame's stamp")
arguments.add_argument("--csv", help="a recording to send instead")
arguments.add_argument("--interval-ms", type=float, help="the interval in which rows of the recording are merged")
arguments = arguments.parse_args()
if arguments.interval_ms:
    interval_ns = round(arguments.interval_ms * 1e6)
offsets_ns = [round(float(ms) * 1e6) for ms in arguments.offsets_ms.split(",")]
if arguments.csv:
    frames = list(itertools.islice(merged(arguments.csv), arguments.ticks))
else:
    stamps_ns = [seq * interval_ns for seq in range(125 if arguments.ticks is None else arguments.ticks)]
    frames = [(stamp_ns, list(detect(stamp_ns, offsets_ns)), Flags.SEEN_FROM_EGO, (0, 0, 0)) for stamp_ns in stamps_ns]
has_identities = bool(frames) and all(d.flags & DetectionFlags.HAS_ID for frame in frames for d in frame[1])
identities = Flags.HAS_IDENTITIES if has_identities else 0
node = join("producer")
# A sensor has no truth. Its truth topic carries only the frames that link and end the run.
detections, truth = output("detections"), output("truth")

# A frame reaches a reader only after the reader has mapped the connection. So warm-up frames are sent until one arrives on
# `forecasts`.
returned = topic(node, "forecasts")[0].subscriber_builder().create()
while not returned.has_samples():
    send(truth, 0, 0, flags=Flags.WARM_UP)
    send(detections, 0, 0, flags=Flags.WARM_UP)
    time.sleep(0.05)

begin_ns = time.monotonic_ns()
first_ns = frames[0][0] if frames else 0
for seq, (stamp_ns, elements, flags, ego) in enumerate(frames):
    time.sleep(max(0, begin_ns + stamp_ns - first_ns - time.monotonic_ns()) / 1e9)
    send(detections, seq, stamp_ns, elements, identities | flags, ego)
send(detections, len(frames), (frames[-1][0] if frames else 0) + interval_ns, flags=Flags.END)
# The frames stay readable while this process lives.
time.sleep(1)
