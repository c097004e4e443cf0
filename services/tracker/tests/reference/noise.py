"""Golden vectors of the learned noise, in float64: docs/tracking.md, "Noise of the detections".

Writes noise.csv beside itself: measurements of three vehicles whose errors are correlated in time, and what is learned
after each of them. Needs Python alone.
"""

import csv
import math
import pathlib
import struct

from draws import Draws

NU, SHARE = 4.0, 0.6905668066708779
NOMINAL_M, TAU_S, CHANGE_M, APART_MS, GAP_MS, SHORT_MS = 0.25, 0.3, 0.04, 400, 1100, 300


class Scale:
    """An online fit of Student's t distribution."""

    def __init__(self, sigma, count):
        self.squared, self.count = SHARE * sigma**2, count

    def add(self, c):
        u = (NU + 1) / (NU + c * c / self.squared)
        self.squared += (u * c * c - self.squared) / (self.count + 1)
        self.count = min(self.count + 1, 400.0)

    def variance(self):
        return self.squared / SHARE


class Window:
    """The newest measurements (ms, values) of one agent, at most `most`, and their contrast."""

    def __init__(self, most, sigma):
        self.most, self.sigma, self.held = most, sigma, []

    def add(self, ms, values, short_ms=0):
        if self.held and ms - self.held[-1][0] > GAP_MS:
            self.held = []
        self.held = (self.held + [(ms, values)])[-self.most :]
        is_short = len(self.held) >= 3 and ms - self.held[0][0] <= short_ms
        return self.contrast() if len(self.held) == self.most or is_short else None

    def contrast(self):
        seconds = [ms / 1e3 for ms, _ in self.held]
        weights = [1 / math.prod(t - s for s in seconds if s != t) for t in seconds]
        norm = self.sigma * math.sqrt(sum(w * w for w in weights))
        newest = self.held[-1][1]
        values = [[v - n for v, n in zip(values, newest)] for _, values in self.held]
        return [sum(w * v for w, v in zip(weights, axis)) / norm for axis in zip(*values)]


def g(rho):
    """The variance of a contrast of four even measurements with unit variance and this correlation."""
    weights = [-1, 3, -3, 1]
    return sum(a * b * rho ** abs(i - j) for i, a in enumerate(weights) for j, b in enumerate(weights)) / 20


class Positions:
    def __init__(self):
        self.next, self.apart, self.paired = Scale(1, 0.1), Scale(1, 0), Scale(1, 0)
        self.next_s = self.apart_s = 0.0

    def add(self, contrast, apart, next_s, apart_s):
        if contrast is None:
            return
        for c in contrast:
            self.next.add(c)
        if apart is None:
            return
        for far, near in zip(apart, contrast):
            self.apart.add(far)
            self.paired.add(near)
        gain = 1 / self.apart.count
        self.next_s += gain * (next_s - self.next_s)
        self.apart_s += gain * (apart_s - self.apart_s)

    def learned(self):
        """The variance of the noise, and of independent noise that averages as slowly."""
        s2, l2, paired = self.next.variance(), self.apart.variance(), self.paired.variance()
        rho, far = math.exp(-self.next_s / TAU_S), math.exp(-self.apart_s / TAU_S)
        if g(far) - g(rho) < 0.15:
            return [s2, s2]
        x, k = l2 - paired - (CHANGE_M / NOMINAL_M) ** 2, 7 * paired / math.sqrt(self.apart.count)
        a2 = (x - k * k / x if x > k else 0) / (g(far) - g(rho)) * min(1, s2 / paired)
        return [s2 + a2 * (1 - g(rho)), s2 + a2 * ((1 + rho) / (1 - rho) - g(rho))]


def single(value):
    """The nearest float32."""
    return struct.unpack("f", struct.pack("f", value))[0]


def main():
    draws = Draws(7)

    positions, heading = Positions(), Scale(0.12, 0.1)
    agents = [
        {"next": Window(4, NOMINAL_M), "apart": Window(4, NOMINAL_M), "heading": Window(3, 1.0), "off": [0.0, 0.0]}
        for _ in range(3)
    ]
    rows, ms = [], 0
    for frame in range(120):
        step_ms = 70 + int(60 * draws.uniform()) + (1500 if frame == 60 else 0)
        ms += step_ms
        rho = math.exp(-step_ms / 1e3 / TAU_S)
        for id, agent in enumerate(agents):
            spread = math.sqrt(1 - rho * rho)
            agent["off"] = [rho * off + spread * 0.2 * draws.normal() for off in agent["off"]]
            way = [(6 + 3 * id) * ms / 1e3, 0.2 * id * (ms / 1e3) ** 2]
            place = [single(w + off) for w, off in zip(way, agent["off"])]
            angle = 0.3 * id + 0.05 * draws.normal() + (math.pi if draws.uniform() < 0.3 else 0)
            angle = single(math.remainder(angle, 2 * math.pi))
            near, far = agent["next"].held, agent["apart"].held
            next_s = (ms - near[-1][0]) / 1e3 if near else 0.0
            apart_s = (ms - far[-1][0]) / 1e3 if far else 0.0
            is_apart = not far or ms - far[-1][0] >= APART_MS
            apart = agent["apart"].add(ms, place) if is_apart else None
            positions.add(agent["next"].add(ms, place, SHORT_MS), apart, next_s, apart_s)
            held = agent["heading"].held
            last = held[-1][1][0] if held else angle
            # Front and rear may be exchanged, so headings continue modulo half a turn.
            turn = agent["heading"].add(ms, [last + 0.5 * math.remainder(2 * (angle - last), 2 * math.pi)])
            for c in turn or []:
                heading.add(c)
            scales = [positions.next, positions.apart, positions.paired, heading]
            rows.append([id, ms, *place, angle, *(scale.variance() for scale in scales), *positions.learned()])
    with open(pathlib.Path(__file__).with_name("noise.csv"), "w", newline="") as file:
        names = "agent,time_ms,x,y,heading,s2,l2,s2_paired,heading_variance,own,as_independent"
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names.split(","))
        writer.writerows(rows)


main()
