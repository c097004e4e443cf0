"""A detector's stream through the stages of this process: `python stream.py`.

Two pedestrians walk towards each other. The loop prints the likely position of each in 2.4 s.
"""

import numpy as np

import stgdat

PEDESTRIANS = [stgdat.AgentType.PEDESTRIAN] * 2
predictor = stgdat.Predictor()
for k in range(50):
    t = k * 0.1
    x_m = np.array([1.4 * t - 4.0, 4.0 - 1.2 * t])
    tick = stgdat.detections(k * 100_000_000, PEDESTRIANS, x_m, np.array([0.0, 1.0]), interval_ns=100_000_000)
    forecasts = predictor.step(tick)
    for agent, track in enumerate(forecasts.ids):
        mode = forecasts.probabilities[agent].argmax()
        step = int(np.searchsorted(forecasts.times_s, 2.4))
        x, y = forecasts.modes_m[agent, mode, step]
        quality = stgdat.Quality(forecasts.quality[agent]).name.lower()
        print(f"{t:.1f} s: track {track} goes to ({x:.1f}, {y:.1f}), {quality}")
