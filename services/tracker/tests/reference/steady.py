"""Golden vectors of the tracker's three motions, in float64: docs/tracking.md, "Steady motion and standing".

Writes steady.csv (constant velocity, positions alone) and steady_bicycle.csv (bicycle, with headings, speeds and
errors that are longer in one direction) beside itself. Needs Python alone.
"""

import csv
import math
import pathlib

from draws import Draws

FREE_DENSITY, STEADY_DENSITY = 0.5, 0.01
BEGINS, ENDS, STOPS, STARTS = 0.003, 0.03, 0.03, 0.003
STOPPING_MPS, CREEP_M2, STANDING_VARIANCE, LEAST = 0.3, 1e-3, 1e-4, 1e-6
STEP_S = 0.08
# The bicycle: rear axle in m; deviations of acceleration and slip rate of the free and of the steady motion;
# variances added in 80 ms; decay of the slip per s; largest slip.
AXLE_M, FREE, STEADY = 1.6, (2.8, 0.1), (0.35, 0.01)
FLOOR, DECAY, SLIP_MAX = (1e-4, 1e-4, 1e-5, 0.0, 0.0), 0.15, 0.5


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


def chained(mu, slow, dt):
    """Probabilities of the motions after a time, and the matrix that leads there."""
    begins, ends, stops, starts = (1 - (1 - p) ** (dt / STEP_S) for p in (BEGINS, ENDS, STOPS, STARTS))
    stops *= slow
    # Rows: from free, steady, standing. Columns: to the same.
    chain = [
        [(1 - ends) * (1 - stops), ends, (1 - ends) * stops],
        [begins, (1 - begins) * (1 - stops), (1 - begins) * stops],
        [starts, 0.0, 1 - starts],
    ]
    return [sum(m * row[j] for m, row in zip(mu, chain)) for j in range(3)], chain


class Motions:
    """The motions under constant velocity: positions are measured."""

    mixture = staticmethod(moments)

    def __init__(self, first):
        self.free = self.steady = first
        self.place, self.variance = first[0][:2], 0.5 * (first[1][0][0] + first[1][1][1])
        self.mu = [0.475, 0.475, 0.05]

    def speed(self):
        """The squared speed of the steady motion, and its variance."""
        mean, cov = self.steady
        return mean[2] ** 2 + mean[3] ** 2, 0.5 * (cov[2][2] + cov[3][3])

    def move(self, dt):
        self.free = predicted(self.free, dt, FREE_DENSITY)
        self.steady = predicted(self.steady, dt, STEADY_DENSITY)

    def predict(self, dt):
        speed2, variance = self.speed()
        slow = math.exp(-0.5 * speed2 / (STOPPING_MPS**2 + variance))
        c, chain = chained(self.mu, slow, dt)
        share = self.mu[0] * chain[0][1] / c[1]
        self.steady = self.mixture([(1 - share, self.steady), (share, self.free)])
        # Who stops has the moments of the two motions that move.
        moving = self.mu[0] + self.mu[1]
        mean, cov = self.mixture([(self.mu[0] / moving, self.free), (self.mu[1] / moving, self.steady)])
        share = 1 - self.mu[2] * chain[2][2] / c[2]
        spread = sum(0.5 * share * (1 - share) * (m - p) ** 2 for m, p in zip(mean, self.place))
        self.place = [p + share * (m - p) for m, p in zip(mean, self.place)]
        self.variance += share * (0.5 * (cov[0][0] + cov[1][1]) - self.variance) + spread + CREEP_M2 * dt
        self.mu = normalised(c)
        self.move(dt)

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


def wrapped(angle):
    return math.remainder(angle, 2 * math.pi)


def driven(state, dt, noise):
    """The bicycle in equal Euler steps of at most 80 ms; its slip decays."""
    (mean, cov), count = state, math.ceil(dt / STEP_S - 1e-9)
    h = dt / count
    share = (1 - math.exp(-DECAY * h)) / (DECAY * h)
    acting = h * share * (1 - share * DECAY * h / 2)
    for _ in range(count):
        x, y, psi, v, beta = mean
        sin, cos, turn = math.sin(psi + beta), math.cos(psi + beta), math.sin(beta) / AXLE_M
        f = [
            [1, 0, -v * sin * h, cos * h, -v * sin * h],
            [0, 1, v * cos * h, sin * h, v * cos * h],
            [0, 0, 1, turn * h, v * math.cos(beta) / AXLE_M * h],
            [0, 0, 0, 1, 0],
            [0, 0, 0, 0, 1 - DECAY * share * h],
        ]
        factor = 1.0 if noise == FREE else 0.01
        added_variances = [factor * floor * h / STEP_S for floor in FLOOR]
        added_variances[3] += noise[0] ** 2 * h * STEP_S
        if cov[4][4] < SLIP_MAX**2:
            added_variances[4] += noise[1] ** 2 * acting * STEP_S
        mean = [x + v * cos * h, y + v * sin * h, wrapped(psi + v * turn * h), v, beta * (1 - DECAY * share * h)]
        cov = product(product(f, cov), transposed(f))
        cov = [[c + (added_variances[i] if i == j else 0.0) for j, c in enumerate(row)] for i, row in enumerate(cov)]
    return mean, cov


def solved(a, columns):
    """a⁻¹ columns, by Gauss-Jordan elimination."""
    rows = [list(row) + list(right) for row, right in zip(a, columns)]
    for k in range(len(rows)):
        pivot = max(range(k, len(rows)), key=lambda i: abs(rows[i][k]))
        rows[k], rows[pivot] = rows[pivot], rows[k]
        rows[k] = [value / rows[k][k] for value in rows[k]]
        for i in range(len(rows)):
            if i != k:
                rows[i] = [a - rows[i][k] * b for a, b in zip(rows[i], rows[k])]
    return [row[len(rows) :] for row in rows]


def measured(state, z, r):
    """A Kalman update by position, heading and speed, with the covariance r, in Joseph's form."""
    mean, cov = state
    s = [[cov[i][j] + r[i][j] for j in range(4)] for i in range(4)]
    gain = transposed(solved(s, [row[:] for row in cov[:4]]))
    off = [z[0] - mean[0], z[1] - mean[1], wrapped(z[2] - mean[2]), z[3] - mean[3]]
    mean = [m + sum(g * o for g, o in zip(row, off)) for m, row in zip(mean, gain)]
    left = [[(i == j) - (gain[i][j] if j < 4 else 0.0) for j in range(5)] for i in range(5)]
    noise = product(product(gain, r), transposed(gain))
    mean[2], mean[4] = wrapped(mean[2]), max(-SLIP_MAX, min(SLIP_MAX, wrapped(mean[4])))
    return mean, added(product(product(left, cov), transposed(left)), noise)


def moments_about(parts):
    """As moments, with headings relative to the first part's."""
    first = parts[0][1][0]
    away = [[wrapped(a - b) if i == 2 else a - b for i, (a, b) in enumerate(zip(s[0], first))] for _, s in parts]
    shift = [sum(w * off[i] for (w, _), off in zip(parts, away)) for i in range(5)]
    mean = [a + b for a, b in zip(first, shift)]
    mean[2] = wrapped(mean[2])
    cov = [[0.0] * 5 for _ in range(5)]
    for (w, (_, own_cov)), off in zip(parts, away):
        off = [a - b for a, b in zip(off, shift)]
        cov = [[c + w * (o + off[i] * off[j]) for j, (c, o) in enumerate(zip(row, own_cov[i]))] for i, row in enumerate(cov)]
    return mean, cov


def normal(off, variance):
    return -0.5 * (off * off / variance + math.log(variance))


class Driving(Motions):
    """The motions of a bicycle: positions, headings and speeds are measured."""

    mixture = staticmethod(moments_about)

    def speed(self):
        mean, cov = self.steady
        return mean[3] ** 2, cov[3][3]

    def move(self, dt):
        self.free, self.steady = driven(self.free, dt, FREE), driven(self.steady, dt, STEADY)

    def update(self, z, r):
        def density(mean, position_cov, heading_variance, speed_variance):
            xx, xy, yy = position_cov
            off = [z[k] - mean[k] for k in range(2)]
            of_place = log_density(off, xx + r[0][0] - r[1][1], xy + r[0][1], yy, r[1][1])
            of_heading = normal(wrapped(z[2] - mean[2]), heading_variance + r[2][2])
            return of_place + of_heading + normal(z[3] - mean[3], speed_variance + r[3][3])

        of = [density(m, (c[0][0], c[0][1], c[1][1]), c[2][2], c[3][3]) for m, c in (self.free, self.steady)]
        # A standing agent has the steady heading.
        mean, cov = self.steady
        stands = [*self.place, mean[2], 0.0]
        of.append(density(stands, (self.variance, 0.0, self.variance), cov[2][2], STANDING_VARIANCE))
        self.mu = normalised([m * math.exp(log - max(of)) for m, log in zip(self.mu, of)])
        gain = self.variance / (self.variance + 0.5 * (r[0][0] + r[1][1]))
        self.place = [p + gain * (m - p) for m, p in zip(z, self.place)]
        self.variance *= 1 - gain
        self.free, self.steady = measured(self.free, z, r), measured(self.steady, z, r)

    def published(self):
        mean, cov = self.steady
        known = {0: self.variance, 1: self.variance, 3: STANDING_VARIANCE}
        stands = [
            [known.get(i, cov[i][j]) if i == j else (0.0 if i in known or j in known else cov[i][j]) for j in range(5)]
            for i in range(5)
        ]
        standing = [*self.place, mean[2], 0.0, 0.0], stands
        total = sum(self.mu)
        parts = [(m / total, s) for m, s in zip(self.mu, (self.free, self.steady, standing))]
        return moments_about([parts[1], parts[0], parts[2]])


def write(name, columns, rows):
    with open(pathlib.Path(__file__).with_name(name), "w", newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(columns.split())
        out.writerows(rows)


def drives():
    random, rows, time_ms = Draws(4711), [], 0
    motions, x, y, course = None, -800.0, 20_000.0, 2.6
    for k in range(240):
        dt_ms = 60 + 10 * int(8 * random.uniform()) + (700 if k == 150 else 0)
        time_ms += dt_ms
        # Drives, turns across the direction of π, stands, and drives again.
        s = time_ms / 1e3
        speed = 6.0 if s < 9 or s > 16 else 0.0
        course += (0.5 if 4 < s < 7 else 0.0) * dt_ms / 1e3
        x, y = x + speed * math.cos(course) * dt_ms / 1e3, y + speed * math.sin(course) * dt_ms / 1e3
        z = [x + 0.3 * random.normal(), y + 0.15 * random.normal()]
        z += [wrapped(course + 0.05 * random.normal()), speed + 0.4 * random.normal()]
        r = [[0.09, 0.02, 0, 0], [0.02, 0.0225, 0, 0], [0, 0, 0.0025, 0], [0, 0, 0, 0.16]]
        if motions is None:
            mean_variance = 0.5 * (r[0][0] + r[1][1])
            diagonal = [mean_variance, mean_variance, r[2][2], r[3][3], 0.04]
            motions = Driving(([*z, 0.0], [[diagonal[i] * (i == j) for j in range(5)] for i in range(5)]))
        else:
            motions.predict(dt_ms / 1e3)
            motions.update(z, r)
        mean, cov = motions.published()
        rows.append([time_ms, *map(repr, [*z, *mean, cov[0][0], cov[0][1], cov[2][2], cov[3][3], *motions.mu])])
    write("steady_bicycle.csv", "time_ms x y heading speed mean_x mean_y mean_heading mean_speed mean_slip xx xy hh vv free steady standing", rows)


def walks():
    random, rows, time_ms = Draws(4711), [], 0
    motions, x, y = None, 30_000.0, -2.0
    for k in range(240):
        dt_ms = 60 + 10 * int(8 * random.uniform()) + (1300 if k == 150 else 0)
        time_ms += dt_ms
        # Walks, turns, stands, and walks again.
        s = time_ms / 1e3
        speed = 1.4 if s < 9 or s > 16 else 0.0
        course = 0.3 if s < 5 else 1.6
        x, y = x + speed * math.cos(course) * dt_ms / 1e3, y + speed * math.sin(course) * dt_ms / 1e3
        sigma = 0.15 if k % 5 else 0.1
        z = [p + sigma * random.normal() for p in (x, y)]
        r = sigma * sigma
        if motions is None:
            first = [*z, 0.0, 0.0], [[(r if i < 2 else 4.0) * (i == j) for j in range(4)] for i in range(4)]
            motions = Motions(first)
        else:
            motions.predict(dt_ms / 1e3)
            motions.update(z, r)
        mean, cov = motions.published()
        rows.append([time_ms, *map(repr, z), sigma, *(repr(v) for v in [*mean, cov[0][0], cov[0][1], cov[2][2], *motions.mu])])
    write("steady.csv", "time_ms x y sigma mean_x mean_y mean_vx mean_vy xx xy vxvx free steady standing", rows)


walks()
drives()
