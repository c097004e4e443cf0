"""Golden vectors of the smoothed history, in float64: docs/tracking.md, "Smoothed histories".

Writes smoothing.csv beside itself: filtered states of an agent that drives, turns and drives on, and the same
states smoothed from the last one back. Needs Python alone.
"""

import csv
import math
import pathlib

from draws import Draws

SIGMA_M, NOISE = 0.2, 0.5


def product(a, b):
    return [[sum(x * y for x, y in zip(row, column)) for column in zip(*b)] for row in a]


def transposed(a):
    return [list(column) for column in zip(*a)]


def inverse(a):
    (p, q), (r, s) = a
    det = p * s - q * r
    return [[s / det, -q / det], [-r / det, p / det]]


def turned(vector, angle):
    sin, cos = math.sin(angle), math.cos(angle)
    return [cos * vector[0] - sin * vector[1], sin * vector[0] + cos * vector[1]]


def predicted_covariance(covariance, dt, density):
    """F P Fᵀ + Q of position and velocity along one axis."""
    f = [[1, dt], [0, 1]]
    q = [[density * dt**3 / 3, density * dt**2 / 2], [density * dt**2 / 2, density * dt]]
    spread = product(product(f, covariance), transposed(f))
    return [[a + b for a, b in zip(*rows)] for rows in zip(spread, q)]


def moved(state, rate, dt):
    """A turn at a constant rate: position, velocity."""
    place, velocity = state
    middle = turned(velocity, 0.5 * rate * dt)
    return [p + dt * v for p, v in zip(place, middle)], turned(velocity, rate * dt)


def filtered():
    """Filtered states: time, rate, density of the step before, covariance per axis, position, velocity."""
    draws = Draws(99)

    place, velocity, time_ms, steps = [40.0, -7.0], [6.0, 2.0], 0, []
    state, covariance = (place[:], [5.0, 3.0]), [[SIGMA_M**2, 0.0], [0.0, 4.0]]
    for k in range(40):
        rate = 0.4 if 12 <= k < 28 else 0.0
        density = NOISE * (0.02 + draws.uniform())
        if k > 0:
            dt_ms = 60 + 10 * int(8 * draws.uniform())
            time_ms += dt_ms
            dt = dt_ms / 1e3
            place, velocity = moved((place, velocity), steps[-1][1], dt)
            state, covariance = moved(state, steps[-1][1], dt), predicted_covariance(covariance, dt, density)
        gain = [row[0] / (covariance[0][0] + SIGMA_M**2) for row in covariance]
        off = [p + SIGMA_M * draws.normal() - s for p, s in zip(place, state[0])]
        state = tuple([s + g * o for s, o in zip(part, off)] for part, g in zip(state, gain))
        covariance = [[c - g * covariance[0][j] for j, c in enumerate(row)] for row, g in zip(covariance, gain)]
        steps.append((time_ms, rate, density, [row[:] for row in covariance], *state))
    return steps


def smoothed(steps):
    """x̂_k = x_k + P_k Fᵀ (F P_k Fᵀ + Q)⁻¹ (x̂_k+1 − f(x_k)), in the frame of x_k."""
    later = (steps[-1][4], steps[-1][5])
    states = [later]
    for this, successor in zip(steps[-2::-1], steps[:0:-1]):
        dt = (successor[0] - this[0]) / 1e3
        rate, covariance, place, velocity = this[1], this[3], this[4], this[5]
        p_ft = product(covariance, [[1, 0], [dt, 1]])
        gain = product(p_ft, inverse(predicted_covariance(covariance, dt, successor[2])))
        expected = moved((place, velocity), rate, dt)[0]
        off = [a - b for a, b in zip(later[0], expected)]
        off_velocity = [a - b for a, b in zip(turned(later[1], -rate * dt), velocity)]
        later = tuple(
            [x + row[0] * a + row[1] * b for x, a, b in zip(part, off, off_velocity)]
            for part, row in zip((place, velocity), gain)
        )
        states.append(later)
    return states[::-1]


steps = filtered()
with open(pathlib.Path(__file__).with_name("smoothing.csv"), "w", newline="") as file:
    out = csv.writer(file, lineterminator="\n")
    out.writerow("time_ms rate density pp pv vv x y vx vy smoothed_x smoothed_y smoothed_vx smoothed_vy".split())
    for (time_ms, rate, density, (pp, vv), place, velocity), (to, by) in zip(steps, smoothed(steps)):
        out.writerow([time_ms, rate, *map(repr, [density, *pp, vv[1], *place, *velocity, *to, *by])])
