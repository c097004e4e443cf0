"""A planner's view of a live run: `stgdat run` in one terminal, `python planner.py [RUN]` in another.

Prints the smallest distance of any likely path to the ego vehicle's place, tick by tick.
"""

import sys

import numpy as np

import stgdat

run = stgdat.Run.attach(sys.argv[1] if len(sys.argv) > 1 else None)
for frame in run.frames("forecasts"):
    assert isinstance(frame, stgdat.Forecasts)
    if len(frame) == 0:
        continue
    likely = frame.probabilities.argmax(axis=1)
    paths_m = frame.modes_m[np.arange(len(frame)), likely]
    distances_m = np.linalg.norm(paths_m - frame.header["ego_m"], axis=-1)
    agent, step = np.unravel_index(distances_m.argmin(), distances_m.shape)
    nearest_m, after_s = distances_m[agent, step], frame.times_s[step]
    print(f"tick {frame.seq}: track {frame.ids[agent]} comes within {nearest_m:.1f} m in {after_s:.1f} s")
