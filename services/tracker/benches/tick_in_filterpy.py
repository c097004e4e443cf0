"""How long a tick takes, in time of the processor, with filterpy and scipy, on the detections that the bench `tick` writes with --csv FOLDER.

    pip install filterpy scipy numpy
    python3 tick_in_filterpy.py FOLDER [--plain]

A filterpy filter per track: for vehicles the extended Kalman filter of a bicycle [x, y, heading, speed, slip] that sees
position and heading, as stgdat has it; for pedestrians a Kalman filter [x, y, vx, vy] that sees the position. With --plain
vehicles are such points too. Squared Mahalanobis distances of all tracks and detections, and one assignment of that dense
matrix by scipy. Tracks begin with a detection that none took and end after 25 misses.
"""

import csv
import itertools
import math
import sys
import time
from pathlib import Path

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, KalmanFilter
from scipy.optimize import linear_sum_assignment

TICK_S = 0.08
DENSITY = 2.0
SIGMA_M = 0.15
SIGMA_RAD = 0.1
REAR_AXLE_M = 1.5
GATE = 9.21
MISSES_MAX = 25


class Point:
    def __init__(self, detection):
        self.kalman = KalmanFilter(dim_x=4, dim_z=2)
        self.kalman.x = np.array([*detection[:2], 0.0, 0.0])
        self.kalman.P = np.diag([SIGMA_M**2, SIGMA_M**2, 25.0, 25.0])
        self.kalman.F = np.eye(4) + TICK_S * np.eye(4, k=2)
        self.kalman.H = np.eye(2, 4)
        self.kalman.R = np.eye(2) * SIGMA_M**2
        cube, square = TICK_S**3 / 3, TICK_S**2 / 2
        self.kalman.Q = DENSITY * np.kron([[cube, square], [square, TICK_S]], np.eye(2))
        self.misses = 0

    def predict(self):
        self.kalman.predict()

    def update(self, detection):
        self.kalman.update(detection[:2])


class MovingBicycle(ExtendedKalmanFilter):
    def predict_x(self, u=0):
        x, y, heading, speed, slip = self.x
        course = heading + slip
        vx, vy, turn_rate = speed * math.cos(course), speed * math.sin(course), speed / REAR_AXLE_M * math.sin(slip)
        self.x = np.array([x + vx * TICK_S, y + vy * TICK_S, heading + turn_rate * TICK_S, speed, slip])
        self.F = np.eye(5)
        self.F[0, 2:] = -vy * TICK_S, math.cos(course) * TICK_S, -vy * TICK_S
        self.F[1, 2:] = vx * TICK_S, math.sin(course) * TICK_S, vx * TICK_S
        self.F[2, 3:] = TICK_S * math.sin(slip) / REAR_AXLE_M, TICK_S * speed / REAR_AXLE_M * math.cos(slip)


class Bicycle:
    def __init__(self, detection):
        self.kalman = MovingBicycle(dim_x=5, dim_z=3)
        self.kalman.x = np.array([*detection, 0.0, 0.0])
        self.kalman.P = np.diag([SIGMA_M**2, SIGMA_M**2, SIGMA_RAD**2, 100.0, 0.05**2])
        self.kalman.R = np.diag([SIGMA_M**2, SIGMA_M**2, SIGMA_RAD**2])
        self.kalman.Q = np.diag([1e-4, 1e-4, 1e-5, (2.8 * TICK_S) ** 2, (0.1 * TICK_S) ** 2])
        self.misses = 0

    def predict(self):
        self.kalman.predict()

    def update(self, detection):
        self.kalman.update(detection, lambda x: SEEN, lambda x: x[:3], residual=difference)


SEEN = np.eye(3, 5)


def difference(a, b):
    off = a - b
    off[2] = (off[2] + math.pi) % math.tau - math.pi
    return off


def step(tracks, detections, start):
    for track in tracks:
        track.predict()
    taken = set()
    if tracks and len(detections):
        costs = np.empty((len(tracks), len(detections)))
        for row, track in zip(costs, tracks):
            spread = np.linalg.inv(track.kalman.P[:2, :2] + track.kalman.R[:2, :2])
            off = detections[:, :2] - track.kalman.x[:2]
            row[:] = np.einsum("ni,ij,nj->n", off, spread, off)
        costs[costs > GATE] = 1e6
        rows, columns = linear_sum_assignment(costs)
        for track in tracks:
            track.misses += 1
        for row, column in zip(rows, columns):
            if costs[row, column] < 1e6:
                tracks[row].update(detections[column])
                tracks[row].misses = 0
                taken.add(column)
    tracks[:] = [track for track in tracks if track.misses <= MISSES_MAX]
    tracks.extend(start(d) for number, d in enumerate(detections) if number not in taken)


def frames(path):
    with open(path, newline="") as file:
        rows = [(int(r["tick"]), float(r["x_m"]), float(r["y_m"]), float(r["heading_rad"])) for r in csv.DictReader(file)]
    return [np.array([row[1:] for row in group]) for _, group in itertools.groupby(rows, lambda row: row[0])]


def main():
    print("| agents | tracks held | median ms | p99 ms |\n|---|---|---|---|")
    plain = "--plain" in sys.argv
    for path in sorted(Path(sys.argv[1]).glob("*.csv"), key=lambda path: path.stat().st_size):
        tracks, times = [], []
        start = Point if plain or "crowd" in path.stem else Bicycle
        for number, detections in enumerate(frames(path)):
            begin = time.thread_time()
            step(tracks, detections, start)
            if number >= 20:
                times.append((time.thread_time() - begin) * 1e3)
        median, p99 = np.percentile(times, [50, 99])
        print(f"| {path.stem} | {len(tracks)} | {median:.2f} | {p99:.2f} |", flush=True)


if __name__ == "__main__":
    main()
