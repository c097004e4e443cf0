"""Controls to motion [docs/model.md §4], in agent frames: the equations of the crate `kinematics`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Tuple

import torch
from torch import Tensor

from .layers import Config, wrapped


@dataclass
class Start:
    """Agents at the end of their history, each at the origin of its frame: velocity [agent, 2] and the rest [agent]."""

    velocity_mps: Tensor
    heading_rad: Tensor
    speed_mps: Tensor
    slip_rad: Tensor
    rear_axle_m: Tensor

    @classmethod
    def of(cls, state: Tensor, present: Tensor, length_m: Tensor, config: Config) -> Start:
        """The starts of histories of state features; a length of 0 is unknown."""
        velocity = state[:, -1, 2:4] / config["velocity_scale"]
        heading = torch.atan2(state[..., 5], state[..., 4])
        speed = torch.cos(heading[:, -1]) * velocity[:, 0] + torch.sin(heading[:, -1]) * velocity[:, 1]
        length = torch.where(length_m > 0, length_m, torch.full_like(length_m, config["default_length_m"]))
        axle = config["rear_axle_ratio"] * length
        slip = torch.zeros_like(speed)
        if config["initial_slip"] and state.shape[1] > 1:
            turns = wrapped(heading[:, 1:] - heading[:, :-1]) / config["dt_s"]
            turns = torch.where(present[:, 1:] & present[:, :-1], turns, torch.zeros_like(turns))
            rate = 1.5 * turns[:, -1] - (0.5 * turns[:, -2] if turns.shape[1] > 1 else 0.0)
            slip = torch.asin((axle * rate / torch.where(speed == 0, 1.0, speed)).clamp(-0.45, 0.45))
            slip = torch.where(speed == 0, torch.zeros_like(slip), slip)
        return cls(velocity, heading[:, -1], speed, slip, axle)

    def rows(self, index: Tensor) -> Start:
        """The starts of these agents."""
        parts = self.velocity_mps, self.heading_rad, self.speed_mps, self.slip_rad, self.rear_axle_m
        return Start(*(part[index] for part in parts))


def displaced(config: Config, start: Start, controls: Tensor) -> Tensor:
    """Positions [agent, draw, step, 2] under displacements of the same shape."""
    carried_s = config["dt_s"] if config["displacement"] == "residual" else 0.0
    return (controls + start.velocity_mps[:, None, None] * carried_s).cumsum(2)


def driven(config: Config, start: Start, controls: Tensor) -> Tensor:
    """Positions [agent, draw, step, 2] of bicycles under controls before saturation."""
    return _drive(config, start, controls)[0]


def _drive(config: Config, start: Start, controls: Tensor) -> Tuple[Tensor, Tensor]:
    dt_s, limit = config["dt_s"], config["slip_limit_rad"]
    middle = 0.5 if config["integrator"] == "midpoint" else 0.0
    limits = controls.new_tensor([config["accel_limit_mps2"], config["slip_rate_limit_radps"]])
    acting = limits * torch.tanh(controls / limits)
    draws = controls.shape[1]
    heading, speed, slip, axle = (
        part[:, None].expand(-1, draws)
        for part in (start.heading_rad, start.speed_mps, start.slip_rad, start.rear_axle_m)
    )
    place = controls.new_zeros(len(controls), draws, 2)
    places, states = [], []
    for step in range(controls.shape[2]):
        next_speed = speed + acting[:, :, step, 0] * dt_s
        next_slip = slip + acting[:, :, step, 1] * dt_s
        if limit is not None:
            next_slip = next_slip.clamp(-limit, limit)
        speed, slip = speed + (next_speed - speed) * middle, slip + (next_slip - slip) * middle
        turn = speed * torch.sin(slip) / axle * dt_s
        course = heading + turn * middle + slip
        place = place + (speed * dt_s)[..., None] * torch.stack([torch.cos(course), torch.sin(course)], -1)
        heading, speed, slip = heading + turn, next_speed, next_slip
        places.append(place)
        states.append(torch.stack([heading, speed, slip], -1))
    return torch.stack(places, 2), torch.stack(states, 2)


def covariances(config: Config, start: Start, controls: Tensor, cholesky: Tensor, is_bicycle: bool) -> Tensor:
    """Covariances [agent, draw, step, (xx, xy, yy)] of the positions as linearised Gaussians.

    `cholesky` holds (l11, l21, l22) of the controls before saturation.
    """
    factor = torch.zeros(*cholesky.shape[:-1], 2, 2, dtype=cholesky.dtype, device=cholesky.device)
    factor[..., 0, 0], factor[..., 1, 0], factor[..., 1, 1] = cholesky.unbind(-1)
    if not is_bicycle:
        steps = (factor @ factor.mT).cumsum(2)
        return torch.stack([steps[..., 0, 0], steps[..., 0, 1], steps[..., 1, 1]], -1)
    limits = controls.new_tensor([config["accel_limit_mps2"], config["slip_rate_limit_radps"]])
    factor = (1 - torch.tanh(controls / limits).square())[..., None] * factor
    whole = bicycle_covariances(config, start, controls, factor)
    return torch.stack([whole[..., 0, 0], whole[..., 0, 1], whole[..., 1, 1]], -1)


def bicycle_covariances(config: Config, start: Start, controls: Tensor, factor: Tensor) -> Tensor:
    """Covariances [agent, draw, step, 5, 5] of (x, y, ψ, v, β). `factor` is that of the acting controls."""
    dt_s, limit = config["dt_s"], config["slip_limit_rad"]
    is_middle = config["integrator"] == "midpoint"
    half = 0.5 if is_middle else 0.0
    limits = controls.new_tensor([config["accel_limit_mps2"], config["slip_rate_limit_radps"]])
    acting = limits * torch.tanh(controls / limits)
    agents, draws = controls.shape[:2]
    heading, speed, slip, axle = (
        part[:, None].expand(agents, draws)
        for part in (start.heading_rad, start.speed_mps, start.slip_rad, start.rear_axle_m)
    )
    covariance = controls.new_zeros(agents, draws, 5, 5)
    found = []
    for step in range(controls.shape[2]):
        next_speed, asked = speed + acting[:, :, step, 0] * dt_s, slip + acting[:, :, step, 1] * dt_s
        next_slip = asked if limit is None else asked.clamp(-limit, limit)
        free = (next_slip == asked).to(controls.dtype)
        at_speed, at_slip = speed + (next_speed - speed) * half, slip + (next_slip - slip) * half
        sin_slip, cos_slip = torch.sin(at_slip), torch.cos(at_slip)
        turn = at_speed * sin_slip / axle * dt_s
        course = heading + turn * half + at_slip
        # Derivatives of the evaluation point by the state before the step and by the control.
        slip_by_slip = (1 + free) / 2 if is_middle else torch.ones_like(free)
        slip_by_rate, speed_by_accel, course_by_turn = free * dt_s * half, dt_s * half, dt_s * half
        turn_by_speed, turn_by_slip = sin_slip / axle, at_speed * cos_slip / axle
        sin, cos = torch.sin(course), torch.cos(course)
        by_state = torch.eye(5, dtype=controls.dtype, device=controls.device).repeat(agents, draws, 1, 1)
        by_control = controls.new_zeros(agents, draws, 5, 2)
        for axis, (along, across) in enumerate(
            ((cos * dt_s, -at_speed * sin * dt_s), (sin * dt_s, at_speed * cos * dt_s))
        ):
            by_speed = along + across * course_by_turn * turn_by_speed
            by_slip = across * (1 + course_by_turn * turn_by_slip)
            by_state[..., axis, 2], by_state[..., axis, 3] = across, by_speed
            by_state[..., axis, 4] = by_slip * slip_by_slip
            by_control[..., axis, 0] = by_speed * speed_by_accel
            by_control[..., axis, 1] = by_slip * slip_by_rate
        by_state[..., 2, 3], by_state[..., 2, 4] = turn_by_speed * dt_s, turn_by_slip * slip_by_slip * dt_s
        by_state[..., 4, 4] = free
        by_control[..., 2, 0] = turn_by_speed * speed_by_accel * dt_s
        by_control[..., 2, 1] = turn_by_slip * slip_by_rate * dt_s
        by_control[..., 3, 0], by_control[..., 4, 1] = dt_s, free * dt_s
        noise = by_control @ factor[:, :, step]
        covariance = by_state @ covariance @ by_state.mT + noise @ noise.mT
        found.append(covariance)
        heading, speed, slip = heading + turn, next_speed, next_slip
    return torch.stack(found, 2)
