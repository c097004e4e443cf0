"""Prints the forecasts of a run, tick by tick: `python3 consumer.py` beside `stgdat run`, or as a stage of it.

Positions are metres, printed in the frame of map and detections: the run's origin is added to them. Step k of a forecast lies at `stamp_ns` + (k + 1) `step_ns`. See
`stgdat_topics.py` for the whole contract. A planner does the same: wait, take the newest frame, use it while it is held.
"""

import iceoryx2 as iox2
from stgdat_topics import join, origin, reader
from stgdat_wire import AgentType, Flags, Quality

node, (x0_m, y0_m) = join("consumer"), origin()
subscriber, listener = reader(node, "forecasts")

ended = False
while not ended:
    # Asleep until a frame comes; what events came does not matter, the queue tells what there is.
    listener.timed_wait(iox2.Duration.from_secs(2))
    while (sample := subscriber.receive()) is not None:
        header = sample.user_header().contents
        ended = ended or bool(header.flags & Flags.END)
        if header.flags & (Flags.WARM_UP | Flags.END):
            continue
        # `payload()` is a view of shared memory, valid until the sample is deleted; it tells its length in bytes.
        payload, last = sample.payload(), header.counts.horizon_len - 1
        print(f"tick {header.seq} at {header.stamp_ns / 1e9:.2f} s: {sample.header.number_of_elements} agents")
        for i in range(sample.header.number_of_elements):
            agent = payload[i]
            x_m, y_m = agent.best[last]
            print(f"  {AgentType(agent.agent_type).name.lower()} {agent.id} at ({x0_m + agent.x_m:.1f}, {y0_m + agent.y_m:.1f}) goes to "
                  f"({x0_m + x_m:.1f}, {y0_m + y_m:.1f}), {agent.modes_len} modes, {Quality(agent.quality).name.lower()}")
        sample.delete()
