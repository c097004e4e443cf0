"""The layers of the model [docs/model.md §3], under the tensor names of a weights file.

A *node* is an agent at a step, an *edge* joins two nodes of the same step. The rows of a graph's nodes are
agent · steps + step, also for steps at which the agent is absent.
"""

from __future__ import annotations

from typing import Any, Mapping, Optional, Tuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

TYPES = ("vehicle", "cyclist", "pedestrian")
STATE, NODE, EDGE, LATENT, CONTROL = 6, 64, 16, 32, 5
HIDDEN = 128
#: Bounds of the logarithms in a control's Cholesky factor.
LOG_SCALE = (-5.0, 2.0)

Config = Mapping[str, Any]


class Mlp(nn.ModuleList):
    """Linear layers with ReLU between them."""

    def __init__(self, *sizes: int) -> None:
        super().__init__(nn.Linear(inputs, outputs) for inputs, outputs in zip(sizes, sizes[1:]))

    def forward(self, x: Tensor) -> Tensor:
        for layer in list(self)[:-1]:
            x = F.relu(layer(x))
        return self[-1](x)


class Block(nn.Module):
    """Two 3×3 convolutions with a shortcut around them."""

    def __init__(self, inputs: int, outputs: int, stride: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(outputs)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, 1, 1, bias=False)
        self.bn2 = nn.BatchNorm2d(outputs)
        self.downsample: Optional[nn.Module] = None
        if stride != 1 or inputs != outputs:
            self.downsample = nn.Sequential(
                nn.Conv2d(inputs, outputs, 1, stride, bias=False), nn.BatchNorm2d(outputs)
            )

    def forward(self, x: Tensor) -> Tensor:
        y = self.bn2(self.conv2(F.relu(self.bn1(self.conv1(x)))))
        return F.relu(y + (x if self.downsample is None else self.downsample(x)))


class Context(nn.Module):
    """The context CNN: patches [patch, 3, row, column] to embeddings [patch, 32]."""

    def __init__(self, width: int, stem: str) -> None:
        super().__init__()
        self.pools = stem == "imagenet"
        side = 7 if self.pools else 3
        self.conv1 = nn.Conv2d(3, width, side, 2, side // 2, bias=False)
        self.bn1 = nn.BatchNorm2d(width)
        inputs = width
        for stage in range(4):
            outputs = width << stage
            blocks = Block(inputs, outputs, 2 if stage else 1), Block(outputs, outputs, 1)
            self.add_module(f"layer{stage + 1}", nn.Sequential(*blocks))
            inputs = outputs
        self.fc = nn.Linear(inputs, NODE // 2)
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, mode="fan_out")

    def forward(self, patches: Tensor) -> Tensor:
        x = F.relu(self.bn1(self.conv1(patches)))
        if self.pools:
            x = F.max_pool2d(x, 3, 2, 1)
        for stage in range(4):
            x = self.get_submodule(f"layer{stage + 1}")(x)
        return self.fc(x.mean((2, 3)))


class Topological(nn.Module):
    """A round of topological attention, with the edge update if it is not the last."""

    def __init__(self, config: Config, is_last: bool) -> None:
        super().__init__()
        self.heads = config["topological_heads"]
        self.slope = config["leaky_slope"]
        self.scales = (1 / NODE, 1 / EDGE) if config["distance_scale"] else (1.0, 1.0)
        self.w_n = nn.Linear(NODE, NODE, bias=False)
        self.u_e = nn.Linear(EDGE, NODE, bias=False) if config["edge_in_message"] else None
        self.is_dual = config["attention"] == "dual"
        if self.is_dual:
            # At this value the softplus is 1.
            self.lambda_raw = nn.Parameter(torch.full((self.heads,), 0.5413249))
            self.mu_raw = nn.Parameter(torch.full((self.heads,), 0.5413249))
        self.edge = None if is_last else Mlp(2 * NODE + EDGE, HIDDEN, EDGE)

    def forward(self, node: Tensor, edge: Tensor, receiver: Tensor, sender: Tensor) -> Tuple[Tensor, Tensor, Tensor]:
        """v̄ of all nodes, the new edge attributes, and α [edge, head]."""
        scores = edge.new_zeros(len(edge), self.heads)
        if self.is_dual:
            apart = (node[receiver] - node[sender]).square().sum(1, keepdim=True) * self.scales[0]
            of_edge = edge.square().sum(1, keepdim=True) * self.scales[1]
            scores = -(F.softplus(self.lambda_raw) * apart + F.softplus(self.mu_raw) * of_edge)
        alpha = softmax_by(scores, receiver, len(node))
        message = self.w_n(node)[sender]
        if self.u_e is not None:
            message = message + self.u_e(edge)
        message = F.leaky_relu(message, self.slope).unflatten(1, (self.heads, -1))
        out = torch.zeros_like(node).index_add(0, receiver, (alpha[:, :, None] * message).flatten(1))
        if self.edge is not None:
            edge = self.edge(torch.cat([out[receiver], out[sender], edge], 1))
        return out, edge, alpha


class Temporal(nn.Module):
    """Temporal attention: the weights of an agent's steps."""

    def __init__(self, config: Config) -> None:
        super().__init__()
        is_literal = config["temporal"] == "literal"
        self.heads = NODE if is_literal else config["temporal_heads"]
        self.slope = config["leaky_slope"]
        self.is_dual = config["attention"] == "dual"
        self.score = nn.Linear(NODE, self.heads, bias=False) if is_literal or self.is_dual else None
        self.value = None if is_literal else nn.Linear(NODE, NODE, bias=False)

    def forward(self, node: Tensor, present: Tensor) -> Tuple[Tensor, Tensor]:
        """ṽ [agent, 64] of v̄ [agent, step, 64], and β [agent, step, head]."""
        activated = None if self.score is None else F.leaky_relu(self.score(node), self.slope)
        value = activated if self.value is None else F.leaky_relu(self.value(node), self.slope)
        scores = activated if self.is_dual else node.new_zeros(*node.shape[:2], self.heads)
        assert scores is not None and value is not None
        absent = ~present[:, :, None]
        beta = scores.masked_fill(absent, torch.finfo(scores.dtype).min).softmax(1).masked_fill(absent, 0.0)
        return (beta[..., None] * value.unflatten(2, (self.heads, -1))).sum(1).flatten(1), beta


class Decoder(nn.Module):
    """The decoder of an agent type: a GRU from history and latent point to control Gaussians."""

    def __init__(self, config: Config, hidden: int = HIDDEN) -> None:
        super().__init__()
        modes, self.horizon_len = config["modes"], config["horizon_len"]
        self.gru = nn.GRUCell(STATE + NODE + LATENT, hidden)
        self.head = nn.Linear(hidden, CONTROL)
        if config["latents"] == "points":
            self.latents = nn.Parameter(torch.randn(modes, LATENT))
        if config["best_latent"]:
            self.latent_best = nn.Parameter(torch.randn(LATENT))
        if config["base_latent"]:
            self.latent_base = nn.Linear(2 * self.horizon_len, LATENT, bias=False)
        if config["mode_head"]:
            self.mode = Mlp(NODE + hidden, NODE, modes)

    def _step(self, inputs: Tensor, hidden: Tensor) -> Tensor:
        """A step of the GRU, given the term of its inputs."""
        of_hidden = F.linear(hidden, self.gru.weight_hh, self.gru.bias_hh)
        (r, z, n), (hr, hz, hn) = inputs.chunk(3, -1), of_hidden.chunk(3, -1)
        z = torch.sigmoid(z + hz)
        n = torch.tanh(n + torch.sigmoid(r + hr) * hn)
        return n + z * (hidden - n)

    def burn_in(self, state: Tensor, present: Tensor) -> Tensor:
        """The hidden state after the present steps of the history."""
        inputs = F.linear(state, self.gru.weight_ih[:, :STATE], self.gru.bias_ih)
        hidden = state.new_zeros(len(state), self.gru.hidden_size)
        for step in range(state.shape[1]):
            hidden = torch.where(present[:, step, None], self._step(inputs[:, step], hidden), hidden)
        return hidden

    def forward(self, hidden: Tensor, summary: Tensor, latent: Tensor) -> Tensor:
        """The head's outputs [agent, draw, step, 5] for latent variables [agent, draw, 32]."""
        of_state, of_summary, of_latent = self.gru.weight_ih.split([STATE, NODE, LATENT], 1)
        inputs = F.linear(summary, of_summary, self.gru.bias_ih)[:, None] + F.linear(latent, of_latent)
        state = hidden[:, None].expand(-1, latent.shape[1], -1)
        states = []
        for step in range(self.horizon_len):
            state = self._step(inputs if step == 0 else self.gru.bias_ih, state)
            states.append(state)
        return self.head(torch.stack(states, 2))

    def start_at_base(self, log_scale: Tuple[float, float]) -> None:
        """Makes the controls nearly those of the base, with these logarithms of their deviations."""
        with torch.no_grad():
            self.head.weight *= 0.02
            self.head.bias.copy_(torch.tensor([0.0, 0.0, *log_scale, 0.0]))

    def logits(self, hidden: Tensor, summary: Tensor) -> Tensor:
        """Scores of the modes [agent, mode]."""
        return self.mode(torch.cat([summary, hidden], 1))


class Base(nn.Module):
    """The base control of an agent type: a ridge regression, and an anchor for each mode."""

    STEPS, CLASSES, SPEED_BINS, FEATURES, BINS = 4, 3, 8, 26, 72
    ACCELERATION_CUTS_MPS2 = (-0.7, 0.5)
    YAW_RATE_CUTS_RADPS = (-0.06, 0.06)
    HALF_SUPPORT = 0.25

    def __init__(self, config: Config) -> None:
        super().__init__()
        self.modes, self.horizon_len = config["modes"], config["horizon_len"]
        self.position_scale, self.velocity_scale = config["position_scale"], config["velocity_scale"]
        self.dt_s = config["dt_s"]
        ridge = torch.zeros(self.CLASSES, self.SPEED_BINS, self.FEATURES, 2 * self.horizon_len)
        self.register_buffer("ridge", ridge)
        self.register_buffer("anchors", torch.zeros(self.BINS, self.modes, self.horizon_len, 2))
        self.register_buffer("speed_cuts", torch.zeros(self.SPEED_BINS - 1))
        self.has_support = config["base_support"]
        if self.has_support:
            everywhere = torch.tensor([-65504.0, 65504.0])  # the largest number of a file in half precision
            self.register_buffer("support", everywhere.repeat(self.CLASSES, self.FEATURES, 1))

    def _features(self, state: Tensor, present: Tensor) -> Tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """Features [agent, 26], class, speed, acceleration and yaw rate of histories."""
        missing = max(self.STEPS - state.shape[1], 0)
        state = F.pad(state, (0, 0, missing, 0))[:, -self.STEPS :]
        present = F.pad(present, (missing, 0))[:, -self.STEPS :]
        known = _consecutive(present)
        zero = state.new_zeros(())
        position = torch.where(known[..., None], state[..., :2] / self.position_scale, zero)
        velocity = torch.where(known[..., None], state[..., 2:4] / self.velocity_scale, zero)
        speed = torch.where(known, torch.hypot(velocity[..., 0], velocity[..., 1]), zero)
        heading = torch.where(known, torch.atan2(state[..., 5], state[..., 4]), zero)

        def change(newer: int) -> Tuple[Tensor, Tensor]:
            both = known[:, newer - 1]
            turn = wrapped(heading[:, newer] - heading[:, newer - 1]) / self.dt_s
            return torch.where(both, turn, zero), torch.where(both, (speed[:, newer] - speed[:, newer - 1]) / self.dt_s, zero)

        (yaw, accel), (yaw_before, accel_before) = change(3), change(2)
        newest = speed[:, 3]
        relative = torch.where(known[:, :3], wrapped(heading[:, :3] - heading[:, 3:]), zero)
        of_motion = [
            newest * yaw,
            newest * yaw_before,
            accel,
            accel_before,
            newest * newest * yaw,
            yaw.abs() * newest,
            newest * newest,
            accel.clamp(max=0.0) * newest,
            torch.ones_like(newest),
        ]
        features = torch.cat(
            [position[:, :3].flatten(1), velocity.flatten(1), relative, torch.stack(of_motion, 1)], 1
        )
        return features, known.sum(1).clamp(2, 4) - 2, newest, accel, yaw

    def forward(self, state: Tensor, present: Tensor) -> Tuple[Tensor, Tensor]:
        """Base controls [agent, mode, step, 2], the best forecast's after the modes', and the distance e [agent]."""
        features, of_class, speed, accel, yaw = self._features(state, present)
        speed_bin = (speed[:, None] >= self.speed_cuts).sum(1)
        outside = torch.zeros_like(speed)
        if self.has_support:
            lower, upper = self.support[of_class].unbind(2)
            clamped = torch.minimum(torch.maximum(features, lower), upper)
            width = (upper - lower).clamp(min=torch.finfo(torch.float32).tiny)
            outside = ((features - clamped).abs() / width).amax(1)
            features = clamped
        ridge = torch.einsum("af,afc->ac", features, self.ridge[of_class, speed_bin])
        ridge = (ridge * self.kept_share(outside)[:, None]).unflatten(1, (self.horizon_len, 2))
        anchor_bin = speed_bin
        for value, cuts in ((accel, self.ACCELERATION_CUTS_MPS2), (yaw, self.YAW_RATE_CUTS_RADPS)):
            anchor_bin = anchor_bin * 3 + sum((value >= cut).long() for cut in cuts)
        anchors = self.anchors[anchor_bin]
        return ridge[:, None] + torch.cat([anchors, torch.zeros_like(anchors[:, :1])], 1), outside

    @classmethod
    def kept_share(cls, outside: Tensor) -> Tensor:
        """The share of the controls that is kept at a distance from the support."""
        return 1 / (1 + (outside / cls.HALF_SUPPORT).square())


def _consecutive(present: Tensor) -> Tensor:
    """Whether a step and all newer ones are present."""
    return present.flip(1).long().cumprod(1).flip(1).bool()


def wrapped(angle_rad: Tensor) -> Tensor:
    """The equivalent angle within half a turn of 0."""
    return angle_rad - torch.floor((angle_rad + torch.pi) / (2 * torch.pi)) * (2 * torch.pi)


def softmax_by(scores: Tensor, group: Tensor, groups: int) -> Tensor:
    """Softmax of scores [row, column] over the rows of each group."""
    index = group[:, None].expand_as(scores)
    most = scores.new_full((groups, scores.shape[1]), -torch.inf)
    most = most.scatter_reduce(0, index, scores.detach(), "amax")
    exps = (scores - most[group]).exp()
    return exps / exps.new_zeros(groups, scores.shape[1]).index_add(0, group, exps)[group]
