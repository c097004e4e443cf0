"""A sampler in Python: in pipeline.toml, `command = ["python3", "sampler.py"]` in the sampler's table.

Needs numpy and iceoryx2. It reads `tracks` and `controls` and writes `forecasts`. Particles draw controls from the
Gaussians of each mode and move by the equations of docs/model.md. If a tick has no controls, its forecasts are constant
velocity. The program shows the tasks of a stage in another language: it passes on frames that are not ticks, adds a hop,
protects the frame, and waits for the handover if it replaces another process.
"""

import ctypes
import itertools
import json
import os
import sys
import time

import iceoryx2 as iox2
import numpy as np
from stgdat_topics import await_turn, join, topic
from stgdat_wire import (AGENTS_MAX, DTYPES, SCHEMA, AgentControls, AgentType, Cause, Flags,
                         Forecast, Header, Hop, Protection, Quality, StageId, Steering, Track, protect)

PARTICLES = int(sys.argv[1]) if len(sys.argv) > 1 else 64
DEADLINE_NS = 72_000_000
MOVING_MPS = 0.1

with open(os.path.join(os.environ["STGDAT_ROOT"], "model.json")) as file:
    model = json.load(file)
assert model["integrator"] == "midpoint" and model["displacement"] == "residual", "what is implemented here"
horizon, history = model["horizon_len"], model["history_len"]


def turn(before, after):
    return (after - before + np.pi) % (2 * np.pi) - np.pi


def vehicle_start(track, steps, dt_s):
    """Mean and covariance of [x, y, heading, speed, slip] at the stamp, and the distance of the rear axle."""
    heading = float(track["heading_rad"])
    speed = np.cos(heading) * track["vx_mps"] + np.sin(heading) * track["vy_mps"]
    rear_m = model["rear_axle_ratio"] * (track["length_m"] if track["length_m"] > 0 else model["default_length_m"])
    rates = [turn(steps["heading_rad"][-2 - i], steps["heading_rad"][-1 - i]) / dt_s
             if steps["present"][-2 - i] and steps["present"][-1 - i] else 0.0 for i in range(2)]
    rate = 1.5 * rates[0] - 0.5 * rates[1]
    slip = np.arcsin(np.clip(rear_m * rate / speed, -0.45, 0.45)) if model["initial_slip"] and speed else 0.0
    size = int(track["state_len"])
    covariance = track["covariance"][:size * size].reshape(size, size).astype(float)
    if size == 5:
        covariance[4, :] = covariance[:, 4] = 0  # The slip comes from the headings.
    else:
        steady = max(abs(track["speed_mps"]), 1.0)
        by_velocity = np.zeros((5, 4))
        by_velocity[:2, :2] = np.eye(2)
        by_velocity[2, 2:] = -np.sin(heading) / steady, np.cos(heading) / steady
        by_velocity[3, 2:] = np.cos(heading), np.sin(heading)
        covariance = by_velocity @ covariance @ by_velocity.T
    return np.array([track["x_m"], track["y_m"], heading, speed, slip], float), covariance, rear_m


def walker_start(track, steps):
    """Mean and covariance of [x, y, vx, vy] at the stamp, and the heading of the agent frame."""
    seen = steps[steps["present"] != 0]
    frame = float(track["heading_rad"])
    if len(seen):
        last, velocity = seen[-1], np.stack([seen["vx_mps"], seen["vy_mps"]], 1)
        frame = float(last["heading_rad"])
        total = velocity.sum(0)
        if np.hypot(last["vx_mps"], last["vy_mps"]) < MOVING_MPS and np.hypot(*total) > MOVING_MPS * len(seen):
            frame = float(np.arctan2(total[1], total[0]))
    size = int(track["state_len"])
    covariance = track["covariance"][:size * size].reshape(size, size).astype(float)
    if size == 5:
        course, speed = track["heading_rad"] + track["slip_rad"], track["speed_mps"]
        by_bicycle = np.zeros((4, 5))
        by_bicycle[:2, :2] = np.eye(2)
        across = -speed * np.sin(course), speed * np.cos(course)
        by_bicycle[2, 2:] = across[0], np.cos(course), across[0]
        by_bicycle[3, 2:] = across[1], np.sin(course), across[1]
        covariance = by_bicycle @ covariance @ by_bicycle.T
    mean = np.array([track[name] for name in ("x_m", "y_m", "vx_mps", "vy_mps")], float)
    return mean, covariance, frame


def drive(state, control, rear_m, dt_s):
    """A midpoint step of the bicycle along the last axis of `state`, with saturated controls."""
    limits = np.array([model["accel_limit_mps2"], model["slip_rate_limit_radps"]])
    control = limits * np.tanh(control / limits)
    x, y, heading, speed, slip = np.moveaxis(state, -1, 0)
    next_speed, next_slip = speed + control[..., 0] * dt_s, slip + control[..., 1] * dt_s
    if model["slip_limit_rad"] is not None:
        next_slip = np.clip(next_slip, -model["slip_limit_rad"], model["slip_limit_rad"])
    mid_speed, mid_slip = (speed + next_speed) / 2, (slip + next_slip) / 2
    rate = mid_speed * np.sin(mid_slip) / rear_m
    course = heading + rate * dt_s / 2 + mid_slip
    return np.stack([x + mid_speed * np.cos(course) * dt_s, y + mid_speed * np.sin(course) * dt_s,
                     heading + rate * dt_s, next_speed, next_slip], -1)


def walk(state, control, frame, dt_s):
    """A step of a cyclist or pedestrian: its velocity, and a displacement in the axes of its frame."""
    cos, sin, moved = np.cos(frame), np.sin(frame), state.copy()
    moved[..., 0] += state[..., 2] * dt_s + cos * control[..., 0] - sin * control[..., 1]
    moved[..., 1] += state[..., 3] * dt_s + sin * control[..., 0] + cos * control[..., 1]
    return moved


def entries(covariance):
    return covariance[..., [0, 0, 1], [0, 1, 1]]


def learned(track, controls, dt_s, random, out):
    """Writes the forecast of a track from its controls."""
    steps, modes = track["history"][:history], int(controls["modes_len"])
    if track["agent_type"] == AgentType.VEHICLE and model["vehicle_motion"] == "bicycle":
        mean, covariance, along = vehicle_start(track, steps, dt_s)
        step = drive
    else:
        mean, covariance, along = walker_start(track, steps)
        step = walk
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0))
    cloud = mean + random.standard_normal((modes, PARTICLES, len(mean))) @ root.T
    best = mean
    probability = controls["probability"][:modes].astype(float)
    for k in range(horizon):
        gaussian = controls["modes"][:modes, k]
        noise, factor = random.standard_normal((modes, PARTICLES, 2)), gaussian["cholesky"][:, None]
        drawn = np.stack([factor[..., 0] * noise[..., 0],
                          factor[..., 1] * noise[..., 0] + factor[..., 2] * noise[..., 1]], -1)
        cloud = step(cloud, gaussian["mean"][:, None] + drawn, along, dt_s)
        best = step(best, controls["best"]["mean"][k], along, dt_s)
        centre = cloud[..., :2].mean(1)
        apart = cloud[..., :2] - centre[:, None]
        within = np.einsum("mpi,mpj->mij", apart, apart) / PARTICLES
        middle = probability @ centre
        between = np.einsum("mi,mj->mij", centre - middle, centre - middle)
        out["modes"][:modes, k], out["mode_covariance"][:modes, k] = centre, entries(within)
        out["mean"][k], out["best"][k] = middle, best[:2]
        out["covariance"][k] = entries(np.einsum("m,mij->ij", probability, within + between))
    out["modes_len"], out["probability"][:modes] = modes, controls["probability"][:modes]
    out["steering"], out["quality"] = Steering.NONE, Quality.LEARNED
    out["out_of_distribution"] = controls["out_of_distribution"]


def steady(track, cause, dt_s, out):
    """Writes a forecast of constant velocity with a growing spread."""
    cause = Cause.YOUNG if not track["forecastable"] else cause
    times = dt_s * np.arange(1, horizon + 1)[:, None]
    path = np.array([track["x_m"], track["y_m"]]) + times * np.array([track["vx_mps"], track["vy_mps"]])
    out["modes"][0, :horizon] = out["mean"][:horizon] = out["best"][:horizon] = path
    out["covariance"][:horizon] = out["mode_covariance"][0, :horizon] = (0.1 + times ** 2) * np.array([1, 0, 1])
    out["modes_len"], out["probability"][0], out["quality"] = 1, 1, Quality.KINEMATIC
    out["cause"], out["causes"] = cause, 1 << cause


def forecasts(header, tracks, controls, cause):
    """A forecast per track, in the tracks' order."""
    out, dt_s = np.zeros(len(tracks), DTYPES[Forecast]), header.step_ns * 1e-9
    random = np.random.default_rng(header.seq)
    of_track = {} if controls is None else {int(of["id"]): of for of in controls}
    for track, forecast in zip(tracks, out):
        for name in ("id", "source_id", "agent_type", "x_m", "y_m", "vx_mps", "vy_mps", "heading_rad", "length_m",
                     "width_m", "prior", "prior_age_ns"):
            forecast[name] = track[name]
        found = of_track.get(int(track["id"]))
        if found is not None:
            learned(track, found, dt_s, random, forecast)
        else:
            steady(track, cause if controls is None else Cause.MISSING, dt_s, forecast)
    return out


class Input:
    """The reading end of a topic."""

    def __init__(self, node, name, element):
        frames, events = topic(node, name)
        self.dtype, self.early = DTYPES[element], None
        self.subscriber = frames.subscriber_builder().buffer_size(2).create()
        self.listener = events.listener_builder().create()

    def take(self):
        """The oldest frame, with copies of its header and elements; None if there is no frame."""
        if self.early is not None:
            frame, self.early = self.early, None
            return frame
        sample = self.subscriber.receive()
        if sample is None:
            return None
        header, length = Header.from_buffer_copy(sample.user_header().contents), sample.header.number_of_elements
        elements = np.zeros(0, self.dtype)
        if length:
            size = length * self.dtype.itemsize
            bytes_ = (ctypes.c_char * size).from_address(sample.payload().as_ptr())
            elements = np.frombuffer(bytes_, self.dtype).copy()
        sample.delete()
        return header, elements, time.monotonic_ns()

    def of_tick(self, seq, until_ns):
        """The frame of a tick; None if it has not arrived by `until_ns`."""
        while True:
            while (frame := self.take()) is not None:
                is_tick = not frame[0].flags & (Flags.WARM_UP | Flags.END)
                if is_tick and frame[0].seq == seq:
                    return frame
                if is_tick and frame[0].seq > seq:
                    self.early = frame
                    return None
            if until_ns is not None and time.monotonic_ns() >= until_ns:
                return None
            self.listener.timed_wait(iox2.Duration.from_millis(5))


def send(header, elements, hop):
    """Sends a frame with the hop of this stage."""
    hop.finished_ns = hop.finished_ns or time.monotonic_ns()
    hop.sent_ns = time.monotonic_ns()
    header.sender, header.incarnation, header.schema = StageId.SAMPLER, incarnation, SCHEMA
    if header.hops_len < len(header.hops):
        header.hops[header.hops_len] = hop
        header.hops_len += 1
    else:
        header.hops_missing_len += 1
    payload, header.protection = elements.tobytes(), Protection()
    protect(header, payload, "forecasts", next(counter))
    sample = publisher.loan_slice_uninit(len(elements))
    ctypes.memmove(sample.user_header_ptr, ctypes.byref(header), ctypes.sizeof(header))
    ctypes.memmove(sample.payload_ptr, payload, len(payload))
    sample.assume_init().send()
    try:
        notifier.notify()
    except iox2.NotifierNotifyError:
        pass  # More than two intervals since the last frame: the notification is delivered all the same.


node, incarnation, counter = join("sampler"), int(os.environ.get("STGDAT_INCARNATION", 0)), itertools.count()
tracks, controls = Input(node, "tracks", Track), Input(node, "controls", AgentControls)
frames, events = topic(node, "forecasts")
await_turn()
publisher = frames.publisher_builder().initial_max_slice_len(AGENTS_MAX).create()
notifier = events.notifier_builder().create()
nothing = np.zeros(0, DTYPES[Forecast])

while True:
    frame = tracks.take()
    if frame is None:
        tracks.listener.timed_wait(iox2.Duration.from_millis(50))
        continue
    header, agents, received_ns = frame
    hop = Hop(stage=StageId.SAMPLER, incarnation=incarnation, received_ns=received_ns, started_ns=time.monotonic_ns())
    if header.flags & (Flags.WARM_UP | Flags.END | Flags.VOID):
        send(header, nothing, hop)
        continue
    until_ns = None if header.flags & Flags.LOCKSTEP else header.released_ns + DEADLINE_NS
    answer = controls.of_tick(header.seq, until_ns)
    cause, found = Cause.LATE, None
    if answer is not None:
        of_controls, found, hop.received_ns = answer
        header.hops, header.hops_len = of_controls.hops, of_controls.hops_len
        if of_controls.flags & Flags.VOID:
            cause, found = Cause.REJECTED, None
    hop.started_ns = time.monotonic_ns()
    out = forecasts(header, agents, found, cause)
    header.counts.horizon_len, header.counts.modes_len = horizon, model["modes"]
    hop.finished_ns = time.monotonic_ns()
    send(header, out, hop)
