"""How long a tick takes, in time of the processor, with filterpy and scipy, on the detections that the bench `tick` writes with --csv FOLDER.

    pip install filterpy scipy numpy
    python3 tick_in_filterpy.py FOLDER

One filterpy KalmanFilter [x, y, vx, vy] per track; squared Mahalanobis distances of all tracks and detections, and one
assignment of that dense matrix by scipy. Tracks begin with a detection that none took and end after 25 misses.
"""

import csv
import itertools
import sys
import time
from pathlib import Path

import numpy as np
from filterpy.kalman import KalmanFilter
from scipy.optimize import linear_sum_assignment

TICK_S = 0.08
DENSITY = 2.0
SIGMA_M = 0.15
GATE = 9.21
MISSES_MAX = 25


class Track:
    def __init__(self, position):
        self.kalman = KalmanFilter(dim_x=4, dim_z=2)
        self.kalman.x = np.array([*position, 0.0, 0.0])
        self.kalman.P = np.diag([SIGMA_M**2, SIGMA_M**2, 25.0, 25.0])
        self.kalman.F = np.eye(4) + TICK_S * np.eye(4, k=2)
        self.kalman.H = np.eye(2, 4)
        self.kalman.R = np.eye(2) * SIGMA_M**2
        cube, square = TICK_S**3 / 3, TICK_S**2 / 2
        self.kalman.Q = DENSITY * np.kron([[cube, square], [square, TICK_S]], np.eye(2))
        self.misses = 0


def step(tracks, detections):
    for track in tracks:
        track.kalman.predict()
    taken = set()
    if tracks and len(detections):
        costs = np.empty((len(tracks), len(detections)))
        for row, track in zip(costs, tracks):
            spread = np.linalg.inv(track.kalman.P[:2, :2] + track.kalman.R)
            off = detections - track.kalman.x[:2]
            row[:] = np.einsum("ni,ij,nj->n", off, spread, off)
        costs[costs > GATE] = 1e6
        rows, columns = linear_sum_assignment(costs)
        for track in tracks:
            track.misses += 1
        for row, column in zip(rows, columns):
            if costs[row, column] < 1e6:
                tracks[row].kalman.update(detections[column])
                tracks[row].misses = 0
                taken.add(column)
    tracks[:] = [track for track in tracks if track.misses <= MISSES_MAX]
    tracks.extend(Track(d) for number, d in enumerate(detections) if number not in taken)


def frames(path):
    with open(path, newline="") as file:
        rows = [(int(r["tick"]), float(r["x_m"]), float(r["y_m"])) for r in csv.DictReader(file)]
    return [np.array([row[1:] for row in group]) for _, group in itertools.groupby(rows, lambda row: row[0])]


def main():
    print("| agents | tracks held | median ms | p99 ms |\n|---|---|---|---|")
    for path in sorted(Path(sys.argv[1]).glob("*.csv"), key=lambda path: path.stat().st_size):
        tracks, times = [], []
        for number, detections in enumerate(frames(path)):
            begin = time.thread_time()
            step(tracks, detections)
            if number >= 20:
                times.append((time.thread_time() - begin) * 1e3)
        median, p99 = np.percentile(times, [50, 99])
        print(f"| {path.stem} | {len(tracks)} | {median:.2f} | {p99:.2f} |", flush=True)


if __name__ == "__main__":
    main()
