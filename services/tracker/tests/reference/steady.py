"""Golden vectors of the tracker's three motions, in float64: docs/tracking.md, "Steady motion and standing".

Writes steady.csv beside itself. Needs Python alone.
"""

import csv
import math
import pathlib

FREE_DENSITY, STEADY_DENSITY = 0.5, 0.01
BEGINS, ENDS, STOPS, STARTS = 0.03, 0.03, 0.03, 0.01
STOPPING_MPS, CREEP_M2, STANDING_VARIANCE, LEAST = 0.3, 1e-3, 1e-4, 1e-6
STEP_S = 0.08


def product(a, b):
    return [[sum(x * y for x, y in zip(row, column)) for column in zip(*b)] for row in a]


def transposed(a):
    return [list(column) for column in zip(*a)]


def added(a, b):
    return [[x + y for x, y in zip(p, q)] for p, q in zip(a, b)]


def predicted(state, dt, density):
    """Constant velocity under white acceleration, in equal steps of at most 80 ms."""
    (mean, cov), count = state, math.ceil(dt / STEP_S - 1e-9)
    h = dt / count
    f = [[1, 0, h, 0], [0, 1, 0, h], [0, 0, 1, 0], [0, 0, 0, 1]]
    p, c, v = density * h**3 / 3, density * h**2 / 2, density * h
    q = [[p, 0, c, 0], [0, p, 0, c], [c, 0, v, 0], [0, c, 0, v]]
    for _ in range(count):
        mean = [sum(a * m for a, m in zip(row, mean)) for row in f]
        cov = added(product(product(f, cov), transposed(f)), q)
    return mean, cov


def updated(state, z, r):
    """A Kalman update by a position, in Joseph's form."""
    mean, cov = state
    xx, xy, yy = cov[0][0] + r, cov[0][1], cov[1][1] + r
    det = xx * yy - xy * xy
    inverse = [[yy / det, -xy / det], [-xy / det, xx / det]]
    gain = product([row[:2] for row in cov], inverse)
    off = [z[k] - mean[k] for k in range(2)]
    mean = [m + g[0] * off[0] + g[1] * off[1] for m, g in zip(mean, gain)]
    left = [[(i == j) - (gain[i][j] if j < 2 else 0.0) for j in range(4)] for i in range(4)]
    noise = [[r * (a[0] * b[0] + a[1] * b[1]) for b in gain] for a in gain]
    return mean, added(product(product(left, cov), transposed(left)), noise)


def moments(parts):
    """The mean and covariance of a mixture."""
    mean = [sum(w * s[0][i] for w, s in parts) for i in range(4)]
    cov = [
        [sum(w * (s[1][i][j] + (s[0][i] - mean[i]) * (s[0][j] - mean[j])) for w, s in parts) for j in range(4)]
        for i in range(4)
    ]
    return mean, cov


def log_density(off, xx, xy, yy, r):
    xx, yy = xx + r, yy + r
    det = xx * yy - xy * xy
    return -0.5 * ((yy * off[0] ** 2 - 2 * xy * off[0] * off[1] + xx * off[1] ** 2) / det + math.log(det))


def normalised(shares):
    return [max(share / sum(shares), LEAST) for share in shares]


class Motions:
    def __init__(self, first):
        self.free = self.steady = first
        self.place, self.variance = first[0][:2], 0.5 * (first[1][0][0] + first[1][1][1])
        self.mu = [0.475, 0.475, 0.05]

    def predict(self, dt):
        mean, cov = self.steady
        speed2, variance = mean[2] ** 2 + mean[3] ** 2, 0.5 * (cov[2][2] + cov[3][3])
        slow = math.exp(-0.5 * speed2 / (STOPPING_MPS**2 + variance))
        begins, ends, stops, starts = (1 - (1 - p) ** (dt / STEP_S) for p in (BEGINS, ENDS, STOPS * slow, STARTS))
        # Rows: from free, steady, standing. Columns: to the same.
        chain = [
            [(1 - ends) * (1 - stops), ends, (1 - ends) * stops],
            [begins, (1 - begins) * (1 - stops), (1 - begins) * stops],
            [starts, 0.0, 1 - starts],
        ]
        c = [sum(m * row[j] for m, row in zip(self.mu, chain)) for j in range(3)]
        share = self.mu[0] * chain[0][1] / c[1]
        self.steady = moments([(1 - share, self.steady), (share, self.free)])
        # Who stops has the moments of the two motions that move.
        moving = self.mu[0] + self.mu[1]
        mean, cov = moments([(self.mu[0] / moving, self.free), (self.mu[1] / moving, self.steady)])
        share = 1 - self.mu[2] * chain[2][2] / c[2]
        spread = sum(0.5 * share * (1 - share) * (m - p) ** 2 for m, p in zip(mean, self.place))
        self.place = [p + share * (m - p) for m, p in zip(mean, self.place)]
        self.variance += share * (0.5 * (cov[0][0] + cov[1][1]) - self.variance) + spread + CREEP_M2 * dt
        self.mu = normalised(c)
        self.free = predicted(self.free, dt, FREE_DENSITY)
        self.steady = predicted(self.steady, dt, STEADY_DENSITY)

    def update(self, z, r):
        logs = []
        for mean, cov in (self.free, self.steady):
            logs.append(log_density([z[k] - mean[k] for k in range(2)], cov[0][0], cov[0][1], cov[1][1], r))
        logs.append(log_density([z[k] - self.place[k] for k in range(2)], self.variance, 0.0, self.variance, r))
        self.mu = normalised([m * math.exp(log - max(logs)) for m, log in zip(self.mu, logs)])
        gain = self.variance / (self.variance + r)
        self.place = [p + gain * (m - p) for m, p in zip(z, self.place)]
        self.variance *= 1 - gain
        self.free, self.steady = updated(self.free, z, r), updated(self.steady, z, r)

    def published(self):
        diagonal = [self.variance, self.variance, STANDING_VARIANCE, STANDING_VARIANCE]
        stands = self.place + [0.0, 0.0], [[diagonal[i] * (i == j) for j in range(4)] for i in range(4)]
        total = sum(self.mu)
        return moments([(m / total, state) for m, state in zip(self.mu, (self.free, self.steady, stands))])


def main():
    state, rows, time_ms = 4711, [], 0

    def uniform():
        nonlocal state
        state = (1103515245 * state + 12345) % 2**31
        return state / 2**31

    motions, x, y = None, 30_000.0, -2.0
    for k in range(240):
        dt_ms = 60 + 10 * int(8 * uniform()) + (1300 if k == 150 else 0)
        time_ms += dt_ms
        # Walks, turns, stands, and walks again.
        s = time_ms / 1e3
        speed = 1.4 if s < 9 or s > 16 else 0.0
        course = 0.3 if s < 5 else 1.6
        x, y = x + speed * math.cos(course) * dt_ms / 1e3, y + speed * math.sin(course) * dt_ms / 1e3
        sigma = 0.15 if k % 5 else 0.1
        z = [p + sigma * 1.7 * (sum(uniform() for _ in range(4)) - 2.0) for p in (x, y)]
        r = sigma * sigma
        if motions is None:
            first = [*z, 0.0, 0.0], [[(r if i < 2 else 4.0) * (i == j) for j in range(4)] for i in range(4)]
            motions = Motions(first)
        else:
            motions.predict(dt_ms / 1e3)
            motions.update(z, r)
        mean, cov = motions.published()
        rows.append([time_ms, *map(repr, z), sigma, *(repr(v) for v in [*mean, cov[0][0], cov[0][1], cov[2][2], *motions.mu])])
    with open(pathlib.Path(__file__).with_name("steady.csv"), "w", newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow("time_ms x y sigma mean_x mean_y mean_vx mean_vy xx xy vxvx free steady standing".split())
        out.writerows(rows)


main()
