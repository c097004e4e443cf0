"""Golden vectors of filters::noise, in float64: contrasts of uneven measurements and their scale.

Writes noise.csv beside itself. Needs Python alone.
"""

import csv
import math
import pathlib

FREEDOM, NORMAL_SHARE, COUNT_MAX = 4.0, 0.6905668066708779, 25.0
GAP_MAX_NS = 1_100_000_000


def contrast(window):
    """c = Σ w_i z_i / √(Σ w_i² σ_i²) with w_i = 1 / Π_{j≠i} (t_i − t_j), or None of fewer than three."""
    if len(window) < 3:
        return None
    times = [(time_ns - window[-1][0]) / 1e9 for time_ns, _, _ in window]
    weights = [1.0 / math.prod(t - u for j, u in enumerate(times) if j != i) for i, t in enumerate(times)]
    norm = math.sqrt(sum((w * sigma) ** 2 for w, (_, _, sigma) in zip(weights, window)))
    return [sum(w * z[axis] for w, (_, z, _) in zip(weights, window)) / norm for axis in range(2)]


def learned(squared, count, c):
    """One EM step of the t distribution's squared scale."""
    weighed = (FREEDOM + 1.0) * c * c / (FREEDOM + c * c / squared)
    return squared + (weighed - squared) / (count + 1.0), min(count + 1.0, COUNT_MAX)


def main():
    state, window, rows = 12345, [], []
    squared, count, time_ns = NORMAL_SHARE, 0.1, 0

    def uniform():
        nonlocal state
        state = (1103515245 * state + 12345) % 2**31
        return state / 2**31

    for k in range(60):
        time_ns += 80_000_000 + int(60_000_000 * uniform()) + (2_000_000_000 if k == 30 else 0)
        s = time_ns / 1e9
        noise = [0.4 * (sum(uniform() for _ in range(4)) - 2.0) for _ in range(2)]
        outlier = 5.0 if k in (17, 44) else 0.0
        z = [9.0 * s + noise[0] + outlier, 2.0 + 0.8 * s * s + noise[1]]
        sigma = 0.25 if k % 3 else 0.2
        if window and time_ns - window[-1][0] > GAP_MAX_NS:
            window = []
        window = (window + [(time_ns, z, sigma)])[-4:]
        found = contrast(window)
        for c in found or []:
            squared, count = learned(squared, count, c)
        rows.append([time_ns, *map(repr, z), sigma, *(map(repr, found) if found else ["", ""]), repr(squared / NORMAL_SHARE)])
    with open(pathlib.Path(__file__).with_name("noise.csv"), "w", newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(["time_ns", "x", "y", "sigma", "contrast_x", "contrast_y", "variance"])
        out.writerows(rows)


main()
