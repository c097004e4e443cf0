"""The expert `following` in double precision: python following.py > following.csv

Each row is a case: the motion now, the leader (a negative gap means none), and the position after each of 12 steps of
0.4 s. The formulas are those of docs/evidence.md.
"""

import math
import random

DT, STEPS, PARTS = 0.4, 12, 4
TURN_S, ACCELERATION_S = 2.0, 1.5
STANDING, TIME_GAP, REACTION, COMFORTABLE, BRAKING = 2.0, 1.2, 1.5, 2.0, 5.0


def progress(speed, acceleration, leader):
    """The distance gone after each step."""
    part = DT / PARTS
    v, gone, leader_gone, out = speed, 0.0, 0.0, []
    for step in range(STEPS):
        for number in range(PARTS):
            t = ((step * PARTS + number) + 0.5) * part
            a = acceleration * math.exp(-t / ACCELERATION_S)
            if leader:
                gap_now, leader_speed, leader_acceleration = leader
                time_gap = min(max((gap_now - STANDING) / max(speed, 1.0), 0.0), TIME_GAP)
                gained = leader_acceleration * ACCELERATION_S * (1.0 - math.exp(-t / ACCELERATION_S))
                leader_v = max(leader_speed + gained, 0.0)
                gap = max(gap_now + leader_gone - gone, 0.5)
                leader_gone += leader_v * part
                closing = v * (v - leader_v) / (2.0 * math.sqrt(REACTION * COMFORTABLE))
                wanted = min(STANDING, max(gap_now, 0.5)) + max(v * time_gap + closing, 0.0)
                if wanted > gap:
                    a = min(a, -REACTION * ((wanted / gap) ** 2 - 1.0))
            after = max(v + max(a, -BRAKING) * part, 0.0)
            gone += 0.5 * (v + after) * part
            v = after
        out.append(gone)
    return out


def along_turn(position, velocity, turn_rate, gone):
    """The positions on the decaying turn after these distances."""
    speed, course = math.hypot(*velocity), math.atan2(velocity[1], velocity[0])
    (x, y), before, out = position, 0.0, []
    for distance in gone:
        part = (distance - before) / PARTS
        for number in range(PARTS):
            t = (before + (number + 0.5) * part) / speed
            angle = course + turn_rate * TURN_S * (1.0 - math.exp(-t / TURN_S))
            x, y = x + math.cos(angle) * part, y + math.sin(angle) * part
        before = distance
        out.append((x, y))
    return out


def main():
    draw = random.Random(1)
    names = "x,y,vx,vy,turn_rate,acceleration,gap,leader_speed,leader_acceleration".split(",")
    print(",".join(names + [f"{axis}{step}" for step in range(STEPS) for axis in "xy"]))
    for number in range(60):
        position = (round(draw.uniform(-50, 50), 2), round(draw.uniform(-50, 50), 2))
        speed, course = draw.uniform(0.5, 25.0), draw.uniform(-math.pi, math.pi)
        velocity = (round(speed * math.cos(course), 3), round(speed * math.sin(course), 3))
        turn_rate, acceleration = round(draw.uniform(-0.3, 0.3), 3), round(draw.uniform(-3.0, 2.0), 2)
        leader = None
        if number % 3:
            leader = (round(draw.uniform(1.0, 50.0), 1), round(draw.uniform(0.0, speed), 2), round(draw.uniform(-2, 1), 2))
        gone = progress(math.hypot(*velocity), acceleration, leader)
        path = along_turn(position, velocity, turn_rate, gone)
        row = [*position, *velocity, turn_rate, acceleration, *(leader or (-1.0, 0.0, 0.0))]
        print(",".join([repr(value) for value in row] + [f"{value:.6f}" for point in path for value in point]))


if __name__ == "__main__":
    main()
