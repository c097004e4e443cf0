"""A detector in Python: in pipeline.toml, `command = ["python3", "producer.py"]` in the source's table.

Here it detects a car and a pedestrian; put your detector in the place of `detect`. Positions are metres in the world
frame, the stamp is the sensor's time of validity, and the ego pose belongs to each frame: see `stgdat_topics.py`, and
docs/interfaces.md for all of it. The run comes by environment: STGDAT_RUN_ID, STGDAT_PREFIX, STGDAT_ROOT, STGDAT_INTERVAL_NS.
"""

import ctypes
import itertools
import os
import sys
import time

import iceoryx2 as iox2
from stgdat_topics import join, topic
from stgdat_wire import (DETECTIONS_MAX, SCHEMA, TOPICS, AgentType, Counts, Detection, DetectionFlags, Flags, Header,
                         Hop, StageId, StampSource, protect)


def detect(t_s):
    """What the sensor sees at `t_s`: type, position, and what else it knows."""
    yield Detection(agent_type=AgentType.VEHICLE, x_m=-20 + 6 * t_s, y_m=2, heading_rad=0, speed_mps=6, length_m=4.5,
                    width_m=1.8, score=0.9,
                    flags=DetectionFlags.HAS_HEADING | DetectionFlags.HAS_SPEED | DetectionFlags.HAS_SIZE)
    yield Detection(agent_type=AgentType.PEDESTRIAN, x_m=5, y_m=-8 + 1.4 * t_s, score=0.8)


def send(topic, seq, stamp_ns, elements=(), flags=0, ego=(0, 0, 0)):
    """Writes a frame into shared memory and wakes its readers; `ego` is the sensor's x, y (m) and heading (rad)."""
    publisher, notifier, element, name, counter = topic
    now_ns = time.monotonic_ns()
    header = Header(schema=SCHEMA, flags=flags, run_id=run_id, seq=seq, stamp_ns=stamp_ns, released_ns=now_ns,
                    interval_ns=interval_ns, stamp_source=StampSource.SENSOR_CLOCK, sender=StageId.SOURCE,
                    observed_types=1 << AgentType.VEHICLE | 1 << AgentType.PEDESTRIAN, hops_len=1,
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
        pass  # A frame after more than two intervals: the missed deadline is reported, the notification delivered.


def output(name):
    """The writing end of a topic."""
    frames, events = topic(node, name)
    publisher = frames.publisher_builder().initial_max_slice_len(DETECTIONS_MAX).create()
    return publisher, events.notifier_builder().create(), TOPICS[name], name, itertools.count()


run_id, interval_ns = int(os.environ["STGDAT_RUN_ID"]), int(os.environ["STGDAT_INTERVAL_NS"])
ticks = int(sys.argv[1]) if len(sys.argv) > 1 else 125
node = join("producer")
# A sensor knows no truth: that topic carries the frames that link and end the run, and no others.
detections, truth = output("detections"), output("truth")

# Frames reach a reader once it has mapped the connection: warm-up frames pass until one has come out at the end.
returned = topic(node, "forecasts")[0].subscriber_builder().create()
while not returned.has_samples():
    send(truth, 0, 0, flags=Flags.WARM_UP)
    send(detections, 0, 0, flags=Flags.WARM_UP)
    time.sleep(0.05)

begin_ns = time.monotonic_ns()
for seq in range(ticks):
    time.sleep(max(0, begin_ns + seq * interval_ns - time.monotonic_ns()) / 1e9)
    send(detections, seq, seq * interval_ns, list(detect(seq * interval_ns / 1e9)), Flags.SEEN_FROM_EGO,
         ego=(0, 0, 0))
send(detections, ticks, ticks * interval_ns, flags=Flags.END)
# The frames stay readable as long as this process lives.
time.sleep(1)
