"""Prints the forecasts of a run, tick by tick: `python3 consumer.py` beside `stgdat run`, or as a stage of it.

Positions are in metres. They are printed in the frame of map and detections: the run's origin is added. Step k of a
forecast is at `stamp_ns` + (k + 1) `step_ns`. `stgdat_topics.py` has the whole contract. A planner does the same: it
waits, takes the newest frame, and uses the frame while it holds the sample.
"""

import iceoryx2 as iox2
from stgdat_topics import join, origin, reader
from stgdat_wire import AgentType, Flags, Quality

node, (x0_m, y0_m) = join("consumer"), origin()
subscriber, listener = reader(node, "forecasts")

ended = False
while not ended:
    # Sleeps until a frame arrives. The events have no content; the frames are in the queue.
    listener.timed_wait(iox2.Duration.from_secs(2))
    while (sample := subscriber.receive()) is not None:
        header = sample.user_header().contents
        ended = ended or bool(header.flags & Flags.END)
        if header.flags & (Flags.WARM_UP | Flags.END):
            continue
        # `payload()` is a view of shared memory, valid until the sample is deleted. Its length is in bytes.
        payload, last = sample.payload(), header.counts.horizon_len - 1
        print(f"tick {header.seq} at {header.stamp_ns / 1e9:.2f} s: {sample.header.number_of_elements} agents")
        for i in range(sample.header.number_of_elements):
            agent = payload[i]
            x_m, y_m = agent.best[last]
            print(f"  {AgentType(agent.agent_type).name.lower()} {agent.id} at ({x0_m + agent.x_m:.1f}, {y0_m + agent.y_m:.1f}) goes to "
                  f"({x0_m + x_m:.1f}, {y0_m + y_m:.1f}), {agent.modes_len} modes, {Quality(agent.quality).name.lower()}")
        sample.delete()
