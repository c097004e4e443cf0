"""Golden vectors of the probability of a conflict, in float64: docs/conflicts.md.

Writes odds.json beside itself: pairs of agents with their modes, and what the equations give for them. Needs Python
alone.
"""

import json
import math
import pathlib
import random

CONFLICT_M, NEAR_M, APART_MIN_M, APART_MAX_M, STANDS_MPS = 0.5, 2.0, 1.0, 60.0, 0.5
LEAST, ALIKE = 1e-4, 0.7
STEPS, MODES, DT_S, PAIRS = 12, 3, 0.4, 40
ODDS = [2.0, 0.3, 0.25, 0.2, 0.4, -0.6, 0.5, -0.8, 0.7, -0.4, -0.3, -0.5, 0.05]
#: A gap as near to a bound as this depends on rounding.
UNCLEAR_M = 1e-3


def circles(agent, at_m, direction):
    """Middles and radius of an outline."""
    if agent["type"] == "pedestrian":
        return [at_m], 0.3
    radius = 0.5 * max(agent["width_m"], 0.5)
    reach = max(0.5 * agent["length_m"] - radius, 0.0)
    return [[a + along * d for a, d in zip(at_m, direction)] for along in (0.0, reach, -reach)], radius


def outline(agent, path_m):
    """The circles of each step of a path."""
    from_m, direction = agent["position_m"], [math.cos(agent["heading_rad"]), math.sin(agent["heading_rad"])]
    found = []
    for at_m in path_m:
        step = [a - b for a, b in zip(at_m, from_m)]
        if math.hypot(*step) > 0.1:
            direction = [value / math.hypot(*step) for value in step]
        found.append(circles(agent, at_m, direction))
        from_m = at_m
    return found


def gap(one, other):
    (middles, radius), (others, other_radius) = one, other
    return min(math.dist(a, b) for a in middles for b in others) - radius - other_radius


def judged(a, b):
    """The signs of a pair; None if it has none."""
    now = [outline(agent, [agent["position_m"]])[0] for agent in (a, b)]
    stands = [math.hypot(*agent["velocity_mps"]) <= STANDS_MPS for agent in (a, b)]
    apart = math.dist(a["position_m"], b["position_m"])
    if apart > APART_MAX_M or all(stands) or gap(*now) < APART_MIN_M:
        return None
    quarters, near, times = [0.0] * 3, 0.0, {CONFLICT_M: [0.0, 0.0], NEAR_M: [0.0, 0.0]}
    for path_a, p_a in zip(a["modes_m"], a["probability"]):
        for path_b, p_b in zip(b["modes_m"], b["probability"]):
            gaps = [gap(*steps) for steps in zip(outline(a, path_a), outline(b, path_b))]
            for place, part in enumerate((4, 2, 1)):
                quarters[place] += p_a * p_b * (min(gaps[: math.ceil(STEPS / part)]) < CONFLICT_M)
            near += p_a * p_b * (min(gaps) < NEAR_M)
            for bound, sums in times.items():
                first = next((step + 1 for step, value in enumerate(gaps) if value < bound), None)
                if first is not None:
                    sums[0] += p_a * p_b
                    sums[1] += p_a * p_b * first
    if near < LEAST:
        return None
    timed = times[CONFLICT_M if times[CONFLICT_M][0] >= LEAST else NEAR_M]
    cosine = math.cos(a["heading_rad"] - b["heading_rad"])
    pedestrians = [a["type"], b["type"]].count("pedestrian")
    numbers = [math.log(max(q, LEAST)) for q in (*quarters, near)]
    numbers += [any(stands), pedestrians == 1, pedestrians == 2, cosine > ALIKE, cosine < -ALIKE]
    best = [gap(*steps) for steps in zip(outline(a, a["best_m"]), outline(b, b["best_m"]))]
    way, velocity = ([q - p for p, q in zip(a[key], b[key])] for key in ("position_m", "velocity_mps"))
    closing = -sum(p * v for p, v in zip(way, velocity)) / apart
    numbers += [min(max(min(best), -1.0), 4.0), math.log(max(apart, 1.0)), min(max(closing, -5.0), 15.0)]
    logit = ODDS[0] + sum(weight * float(sign) for weight, sign in zip(ODDS[1:], numbers))
    return {
        "conflict": quarters,
        "near": near,
        "in_s": timed[1] / timed[0] * DT_S,
        "probability": 1.0 / (1.0 + math.exp(-logit)),
    }


def is_clear(a, b):
    """Whether no gap is so near to a bound that rounding decides."""
    pairs = [
        gap(*steps)
        for path_a in a["modes_m"]
        for path_b in b["modes_m"]
        for steps in zip(outline(a, path_a), outline(b, path_b))
    ]
    return all(abs(value - bound) > UNCLEAR_M for value in pairs for bound in (CONFLICT_M, NEAR_M))


def drawn(draw):
    """An agent that comes near the origin after about two seconds."""
    kind = draw.choice(["vehicle", "cyclist", "pedestrian"])
    length, width = {"vehicle": (4.5, 1.9), "cyclist": (1.8, 0.6), "pedestrian": (0.0, 0.0)}[kind]
    speed = draw.choice([0.2, draw.uniform(0.8, 9.0)])
    heading = draw.uniform(-math.pi, math.pi)
    past, aside = speed * draw.uniform(1.0, 3.5) + 2.0, draw.uniform(-3.0, 3.0)
    cos, sin = math.cos(heading), math.sin(heading)
    start = [-past * cos - aside * sin, -past * sin + aside * cos]
    modes = []
    for _ in range(MODES + 1):
        faster, turn = draw.uniform(0.6, 1.3), draw.uniform(-0.15, 0.15)
        at, path = list(start), []
        for step in range(STEPS):
            course = heading + turn * (step + 0.5) * DT_S
            at = [at[0] + faster * speed * DT_S * math.cos(course), at[1] + faster * speed * DT_S * math.sin(course)]
            path.append([round(value, 3) for value in at])
        modes.append(path)
    weights = [draw.uniform(0.05, 1.0) for _ in range(MODES)]
    return {
        "type": kind,
        "length_m": length,
        "width_m": width,
        "position_m": [round(value, 3) for value in start],
        "heading_rad": round(heading, 4),
        "velocity_mps": [round(speed * cos, 4), round(speed * sin, 4)],
        "probability": [round(weight / sum(weights), 6) for weight in weights],
        "best_m": modes.pop(),
        "modes_m": modes,
    }


def main():
    draw, pairs = random.Random(7), []
    while len(pairs) < PAIRS:
        a, b = drawn(draw), drawn(draw)
        signs = judged(a, b)
        if is_clear(a, b) and (signs is not None or sum(pair["signs"] is None for pair in pairs) < PAIRS // 4):
            pairs.append({"a": a, "b": b, "signs": signs})
    text = json.dumps({"dt_s": DT_S, "odds": {"constant": ODDS[0], "weights": ODDS[1:]}, "pairs": pairs})
    pathlib.Path(__file__).with_suffix(".json").write_text(text + "\n")


if __name__ == "__main__":
    main()
