"""Times a training step of the network in PyTorch, on one thread, for comparison with `cargo bench --bench step`.

    python -m venv venv && venv/bin/pip install torch
    venv/bin/python services/offline/trainer/benches/step_in_pytorch.py [without_map] [with_map] [pedestrians]

Layer sizes and batches are those of the bench: clips of four windows that share most of their patches and relations,
eight candidates without gradient, then four draws with gradient, displacement, energy score and mode probabilities, and
Adam with clipping. Values are random: no operation takes longer for them. What the trainer does before a step, cutting
scenes to batches, is not in these times but in those of the bench.
"""

import sys
import time

import torch
from torch import nn
from torch.nn import functional as F

HISTORY, HORIZON, NEIGHBOURS, MODES, CANDIDATES, DRAWS, DT_S = 8, 12, 8, 20, 8, 4, 0.4
CONFIGURATIONS = {
    # Clips, agents of a scene, agent types, whether there is a map.
    "without_map": (2, 12, 3, False),
    "with_map": (2, 12, 3, True),
    "pedestrians": (4, 16, 1, False),
}
CLIP_WINDOWS = 4
STEPS, WARM_UP = 20, 3


def perceptron(*sizes):
    layers = []
    for inputs, outputs in zip(sizes, sizes[1:]):
        layers += [nn.Linear(inputs, outputs), nn.ReLU()]
    return nn.Sequential(*layers[:-1])


class Block(nn.Module):
    def __init__(self, inputs, outputs, stride):
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, 1, 1, bias=False)
        self.bn1, self.bn2 = nn.BatchNorm2d(outputs), nn.BatchNorm2d(outputs)
        self.shortcut = None
        if stride > 1:
            self.shortcut = nn.Sequential(
                nn.Conv2d(inputs, outputs, 1, stride, bias=False), nn.BatchNorm2d(outputs)
            )

    def forward(self, x):
        y = self.bn2(self.conv2(F.relu(self.bn1(self.conv1(x)))))
        return F.relu(y + (x if self.shortcut is None else self.shortcut(x)))


def context(width=16):
    layers = [nn.Conv2d(3, width, 3, 2, 1, bias=False), nn.BatchNorm2d(width), nn.ReLU()]
    inputs = width
    for stage in range(4):
        for block in range(2):
            layers.append(Block(inputs, width << stage, 2 if stage > 0 and block == 0 else 1))
            inputs = width << stage
    return nn.Sequential(*layers, nn.AdaptiveAvgPool2d(1), nn.Flatten(), nn.Linear(inputs, 32))


def bicycle(control, start, axle_m):
    """Midpoint steps; `control` [rows, horizon, 2], `start` [rows, 4] = heading, speed, slip and nothing."""
    x, y = torch.zeros_like(start[:, 0]), torch.zeros_like(start[:, 0])
    heading, speed, slip = start[:, 0], start[:, 1], start[:, 2]
    acceleration, slip_rate = 6 * torch.tanh(control[..., 0] / 6), torch.tanh(control[..., 1])
    places = []
    for step in range(HORIZON):
        new_speed = speed + acceleration[:, step] * DT_S
        new_slip = (slip + slip_rate[:, step] * DT_S).clamp(-0.5, 0.5)
        mean_speed, mean_slip = (speed + new_speed) / 2, (slip + new_slip) / 2
        turn = mean_speed * torch.sin(mean_slip) / axle_m * DT_S
        course = heading + turn / 2 + mean_slip
        x, y = x + mean_speed * torch.cos(course) * DT_S, y + mean_speed * torch.sin(course) * DT_S
        heading, speed, slip = heading + turn, new_speed, new_slip
        places.append(torch.stack([x, y], 1))
    return torch.stack(places, 1)


class Decoder(nn.Module):
    def __init__(self, drives):
        super().__init__()
        self.drives = drives
        self.cell = nn.GRUCell(6 + 64 + 32, 128)
        self.head = nn.Linear(128, 5)
        self.latents = nn.Parameter(torch.randn(MODES + 1, 32))
        self.latent_base = nn.Linear(2 * HORIZON, 32, bias=False)
        self.mode = perceptron(64 + 128, 64, MODES)

    def gates(self, inputs, state):
        """A step of the cell, given what its inputs contribute."""
        of_state = F.linear(state, self.cell.weight_hh, self.cell.bias_hh)
        (r, z, n), (hr, hz, hn) = inputs.chunk(3, 1), of_state.chunk(3, 1)
        z = torch.sigmoid(z + hz)
        n = torch.tanh(n + torch.sigmoid(r + hr) * hn)
        return n + z * (state - n)

    def burn_in(self, states):
        inputs = F.linear(states, self.cell.weight_ih[:, :6], self.cell.bias_ih)
        hidden = states.new_zeros(states.shape[0], 128)
        for step in range(HISTORY):
            hidden = self.gates(inputs[:, step], hidden)
        return hidden

    def forecast(self, hidden, encoding, base, modes):
        """Raw controls [agents × draws, horizon, 5] of `modes` [agents, draws]; `base` [agents, modes + 1, 24]."""
        draws = modes.shape[1]
        of_mode = base.gather(1, modes[..., None].expand(-1, -1, base.shape[2]))
        latent = (self.latents[modes] + self.latent_base(of_mode)).flatten(0, 1)
        of_encoding = F.linear(encoding, self.cell.weight_ih[:, 6:70], self.cell.bias_ih)
        of_latent = F.linear(latent, self.cell.weight_ih[:, 70:])
        inputs = of_encoding.repeat_interleave(draws, 0) + of_latent
        state, later = hidden.repeat_interleave(draws, 0), self.cell.bias_ih[None]
        states = []
        for step in range(HORIZON):
            state = self.gates(inputs if step == 0 else later, state)
            states.append(state)
        raw = self.head(torch.stack(states, 1))
        return raw, raw[..., :2] + of_mode.flatten(0, 1).unflatten(1, (HORIZON, 2))

    def positions(self, controls, start):
        start = start.repeat_interleave(controls.shape[0] // start.shape[0], 0)
        if self.drives:
            return bicycle(controls, start, 1.2)
        return (controls + start[:, None, 1:3] * DT_S).cumsum(1)


class Network(nn.Module):
    def __init__(self, types, with_map):
        super().__init__()
        self.state = nn.ModuleList(perceptron(6, 128, 128, 128, 32 if with_map else 64) for _ in range(types))
        self.relation = perceptron(6, 128, 128, 128, 16)
        self.context = context() if with_map else None
        rounds = range(2)
        self.w = nn.ModuleList(nn.Linear(64, 64, bias=False) for _ in rounds)
        self.u = nn.ModuleList(nn.Linear(16, 64, bias=False) for _ in rounds)
        self.coefficients = nn.ParameterList(nn.Parameter(torch.full((2, 4), 0.54)) for _ in rounds)
        self.edge_in, self.edge_out = nn.Linear(144, 128), nn.Linear(128, 16)
        self.score, self.value = nn.Linear(64, 4, bias=False), nn.Linear(64, 64, bias=False)
        self.decoders = nn.ModuleList(Decoder(drives=types > 1 and number == 0) for number in range(types))

    def round(self, number, node, edge, receiver, sender):
        """Every row receives from NEIGHBOURS rows in a row of edges."""
        nearness, likeness = F.softplus(self.coefficients[number])
        apart = (node[receiver] - node[sender]).square().mean(1, keepdim=True)
        alpha = -(nearness * apart + likeness * edge.square().mean(1, keepdim=True))
        alpha = alpha.unflatten(0, (-1, NEIGHBOURS)).softmax(1)
        message = F.leaky_relu(self.w[number](node)[sender] + self.u[number](edge), 0.01)
        message = message.view(-1, NEIGHBOURS, 4, 16)
        return (alpha[..., None] * message).sum(1).flatten(1)

    def update(self, node, edge, receiver, sender):
        """As the trainer does, the parts of both ends are computed by row, not by edge."""
        own, other, of_edge = self.edge_in.weight.split([64, 64, 16], 1)
        by_row = F.linear(node, own, self.edge_in.bias)[receiver] + F.linear(node, other)[sender]
        return self.edge_out(F.relu(by_row + F.linear(edge, of_edge)))

    def encode(self, batch):
        rows = batch["states"].flatten(0, 1).chunk(len(self.state))
        node = torch.cat([state(rows) for state, rows in zip(self.state, rows)])
        if self.context is not None:
            node = torch.cat([node, self.context(batch["patches"])[batch["patch_of_row"]]], 1)
        edge = self.relation(batch["relations"])[batch["relation_of_edge"]]
        ends = batch["receiver"], batch["sender"]
        attended = self.round(0, node, edge, *ends)
        node = self.round(1, attended, self.update(attended, edge, *ends), *ends)
        beta = F.leaky_relu(self.score(node), 0.01).unflatten(0, (-1, HISTORY)).softmax(1)
        value = F.leaky_relu(self.value(node), 0.01).view(-1, HISTORY, 4, 16)
        return (beta[..., None] * value).sum(1).flatten(1)

    def loss(self, batch):
        encodings = self.encode(batch).chunk(len(self.decoders))
        parts = [batch[name].chunk(len(self.decoders)) for name in ("states", "bases", "starts", "truth")]
        losses = [of_type(*inputs) for of_type, *inputs in zip(map(type_loss, self.decoders), encodings, *parts)]
        return sum(losses) / batch["states"].shape[0]


def distances(positions, truth):
    """[agents, draws, horizon]."""
    apart = positions.unflatten(0, (truth.shape[0], -1)) - truth[:, None]
    return (apart.square().sum(3) + 1e-6).sqrt()


def type_loss(decoder):
    def loss(encoding, states, base, start, truth):
        hidden = decoder.burn_in(states)
        agents = states.shape[0]
        with torch.no_grad():
            by_base = decoder.positions(base[:, :MODES].flatten(0, 1).unflatten(1, (HORIZON, 2)), start)
            near = distances(by_base, truth).mean(2).topk(CANDIDATES, largest=False).indices
            _, controls = decoder.forecast(hidden, encoding, base, near)
            errors = distances(decoder.positions(controls, start), truth)
            winners = [errors.mean(2).argmin(1), errors[..., -1].argmin(1)]
            winners = [near.gather(1, winner[:, None]) for winner in winners]
            anyone, single = torch.randint(MODES, (agents, 1)), torch.full((agents, 1), MODES)
            modes = torch.cat([*winners, anyone, single], 1)
        raw, controls = decoder.forecast(hidden, encoding, base, modes)
        errors = distances(decoder.positions(controls, start), truth)
        total = errors[:, 0].mean(1).sum() + 0.5 * errors[:, 1, -1].sum() + 0.3 * errors[:, 2:].mean(2).sum()
        spread, skew = raw[..., 2:4].clamp(-5, 2).exp(), raw[..., 4]
        drawn = []
        for _ in range(2):
            noise = torch.randn_like(spread)
            skewed = torch.stack([torch.zeros_like(skew), skew * noise[..., 0]], 2)
            drawn.append(decoder.positions(controls.detach() + spread * noise + skewed, start))
        score = distances(drawn[0], truth) + distances(drawn[1], truth)
        total = total + 0.02 * (score.sum() - ((drawn[0] - drawn[1]).square().sum(2) + 1e-6).sqrt().sum())
        logits = decoder.mode(torch.cat([encoding, hidden], 1).detach())
        return total + 0.05 * F.cross_entropy(logits, winners[0][:, 0], reduction="sum")

    return loss


def random_batch(clips, scene_agents, with_map):
    """Windows of a clip share patches and relations, a window's step is that of its clip after as many steps."""
    agents, times = clips * CLIP_WINDOWS * scene_agents, HISTORY + CLIP_WINDOWS - 1
    clip, window, agent, step = torch.meshgrid(
        *map(torch.arange, (clips, CLIP_WINDOWS, scene_agents, HISTORY)), indexing="ij"
    )
    patch_of_row = ((clip * scene_agents + agent) * times + window + step).flatten()
    scene = (clip * CLIP_WINDOWS + window) * scene_agents
    offsets = torch.arange(NEIGHBOURS)
    sender = (scene[..., None] + (agent[..., None] + offsets) % scene_agents) * HISTORY + step[..., None]
    distinct = clips * scene_agents * times
    return {
        "states": torch.randn(agents, HISTORY, 6),
        "patches": torch.rand(distinct + 1, 3, 16, 16) if with_map else None,
        "patch_of_row": patch_of_row,
        "relations": torch.randn(distinct * NEIGHBOURS, 6),
        "relation_of_edge": (patch_of_row[:, None] * NEIGHBOURS + offsets).flatten(),
        "receiver": torch.arange(agents * HISTORY).repeat_interleave(NEIGHBOURS),
        "sender": sender.flatten(),
        "bases": 0.1 * torch.randn(agents, MODES + 1, 2 * HORIZON),
        "starts": torch.rand(agents, 4),
        "truth": torch.randn(agents, HORIZON, 2),
    }


def step_s(clips, scene_agents, types, with_map):
    network, batch = Network(types, with_map), random_batch(clips, scene_agents, with_map)
    adam = torch.optim.Adam(network.parameters(), lr=1e-3)
    times = []
    for _ in range(WARM_UP + STEPS):
        begun = time.perf_counter()
        adam.zero_grad()
        network.loss(batch).backward()
        nn.utils.clip_grad_norm_(network.parameters(), 10.0)
        adam.step()
        times.append(time.perf_counter() - begun)
    return min(times[WARM_UP:]), sum(times[WARM_UP:]) / STEPS


def main():
    torch.set_num_threads(1)
    torch.manual_seed(1)
    for name in sys.argv[1:] or CONFIGURATIONS:
        shortest, mean = step_s(*CONFIGURATIONS[name])
        print(f"{name}: {shortest * 1e3:.1f} ms at best, {mean * 1e3:.1f} ms on average")


if __name__ == "__main__":
    main()
