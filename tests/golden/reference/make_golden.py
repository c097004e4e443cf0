"""Creates the golden vectors of the model, or compares existing ones with this reference.

    python make_golden.py OUT              # writes OUT/vehicle, OUT/pedestrian, OUT/plus and OUT/literal
    python make_golden.py --check FOLDER   # creates them again and compares every byte with FOLDER/vehicle, …

Weights and scene are drawn from a seed; weights are rounded to float32 first, so that both sides start from the same
numbers, everything else is computed in float64 and rounded to float32 when it is written.
"""

import argparse
import filecmp
import json
import pathlib
import sys
import tempfile
from dataclasses import dataclass

import torch
from safetensors.torch import save_file

import stgdat_ref as ref

REAL = torch.float64
# Limits of the controls, m/s² and rad/s; distance of the rear axle from the centre, m.
ACCEL_LIMIT, SLIP_RATE_LIMIT, REAR_AXLE = 5.0, 0.5, 1.6
# Lower left corner of the context map, m, and its rows and columns of 1 m.
MAP_ORIGIN, MAP_SHAPE, MAP_POINTS = (-40.0, -36.0), (72, 80), 4000
LATENT_DRAWS, LOSS_DRAWS = 5, 24
FILES = ["scene.json", "weights.safetensors", "tensors.safetensors"]


@dataclass(frozen=True)
class Profile:
    """The parameters of one folder."""

    name: str
    seed: int
    agents: int
    history_len: int
    horizon_len: int
    dt_s: float
    edge_radius_m: float
    patch_cell_m: float
    patch_size: int
    stem: str
    # Edge in the message, distance scale, scaled inputs.
    plus: bool = False
    # 64 scalar temporal heads: the paper's formula as printed.
    literal: bool = False
    width: int = 16

    def config(self):
        """The model's configuration as stored in its weights."""
        return {
            "width": self.width,
            "stem": self.stem,
            "patch_size": self.patch_size,
            "patch_cell_m": self.patch_cell_m,
            "edge_radius_m": self.edge_radius_m,
            "history_len": self.history_len,
            "horizon_len": self.horizon_len,
            "dt_s": self.dt_s,
            "rounds": 2,
            "topological_heads": 4,
            "temporal_heads": 4,
            "temporal": "literal" if self.literal else "value_matrix",
            "edge_in_message": self.plus,
            "distance_scale": self.plus,
            "position_scale": 0.1 if self.plus else 1.0,
            "velocity_scale": 0.2 if self.plus else 1.0,
            "leaky_slope": ref.LRELU,
        }


PROFILES = [
    Profile("vehicle", 7, 6, 4, 10, 0.5, 30.0, 1.0, 32, "imagenet"),
    Profile("pedestrian", 11, 5, 8, 12, 0.4, 10.0, 0.75, 16, "compact"),
    Profile("plus", 19, 7, 8, 12, 0.4, 30.0, 2.0, 16, "compact", plus=True),
    Profile("literal", 23, 4, 4, 10, 0.5, 30.0, 2.0, 16, "compact", literal=True),
]


def f32(tensor):
    """The numbers rounded to float32, as float64."""
    return tensor.float().double()


def make_network(profile):
    """A network with large activations, so that a wrong layer is visible, and its weights in float32."""
    net = ref.STGDAT(
        width=profile.width,
        stem=profile.stem,
        edge_in_message=profile.plus,
        distance_scale=profile.plus,
        literal=profile.literal,
    )
    init = torch.nn.init
    for module in net.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            module.running_mean.normal_(0, 0.1)
            module.running_var.uniform_(0.5, 1.5)
            init.uniform_(module.weight, 0.5, 1.5)
            init.normal_(module.bias, 0, 0.1)
    for module in net.modules():
        if isinstance(module, torch.nn.Linear):
            init.kaiming_normal_(module.weight)
            if module.bias is not None:
                init.normal_(module.bias, 0, 0.1)
    for of_type in ref.TYPES:
        decoder = net.decoder[of_type]
        init.normal_(decoder["head"].bias, 0, 0.3)
        with torch.no_grad():
            decoder["head"].bias[2:4] -= 1.5
            decoder["gru"].weight_ih[:, -ref.LAT :] *= 4
            decoder["gru"].weight_ih[:, 6:70] *= 0.3
    for attention_round in net.gdat.topological:
        init.normal_(attention_round.lambda_raw, -3.4 if profile.plus else -7.5, 0.7)
        init.normal_(attention_round.mu_raw, -5 if profile.plus else -8, 0.7)
        init.xavier_normal_(attention_round.w_n.weight, 1.6)
    # In the literal reading scores are values: one tensor under two names.
    left_out = ["num_batches"] + (["temporal.value"] if profile.literal else [])
    state = net.state_dict().items()
    weights = {
        k: v.detach().float().contiguous() for k, v in state if not any(part in k for part in left_out)
    }
    net = net.double().eval()
    net.load_state_dict({k: v.double() for k, v in weights.items()}, strict=False)
    return net, weights


@dataclass
class Scene:
    """Agents on circular arcs, [step, agent, …] over history and horizon, some of them absent at first."""

    types: list
    position: torch.Tensor
    velocity: torch.Tensor
    heading: torch.Tensor
    present: torch.Tensor


def make_scene(profile):
    agents, steps = profile.agents, profile.history_len + profile.horizon_len
    types = [[0, 2, 1][i % 3] for i in range(agents)]
    spread = profile.edge_radius_m * 1.2
    start = torch.rand(agents, 2, dtype=REAL) * spread - spread / 2
    first_heading = (torch.rand(agents, dtype=REAL) * 2 - 1) * 3.14159
    speed = torch.tensor([8.0, 4.0, 1.4], dtype=REAL)[types] * (0.5 + torch.rand(agents, dtype=REAL))
    yaw_rate = torch.randn(agents, dtype=REAL) * 0.15
    heading = torch.stack([first_heading + yaw_rate * profile.dt_s * k for k in range(steps)])
    velocity = speed[None, :, None] * torch.stack([heading.cos(), heading.sin()], -1)
    position = start + torch.cumsum(velocity * profile.dt_s, 0)
    present = torch.ones(steps, agents, dtype=torch.bool)
    present[0, 1] = False
    present[:2, min(4, agents - 1)] = False
    if agents > 5:
        present[1, 5] = False
    return Scene(types, f32(position), f32(velocity), f32(heading), present)


def graph_attention(net, profile, scene, context, steps, tag, out):
    """Features, graph and both attentions over some steps; every tensor goes to `out` as `tag.…`."""
    first, last = steps
    length = last - first
    position, velocity = scene.position[first:last], scene.velocity[first:last]
    heading, present = scene.heading[first:last], scene.present[first:last]
    # The future is in the same agent frame as the history, at the last observed step.
    now = profile.history_len - 1

    def with_now(whole, part):
        return torch.cat([part, whole[now : now + 1]])

    scale = torch.tensor([0.1, 0.1, 0.2, 0.2, 1, 1] if profile.plus else [1.0] * 6, dtype=REAL)
    state = ref.agent_frame(
        with_now(scene.position, position),
        with_now(scene.velocity, velocity),
        with_now(scene.heading, heading),
        with_now(scene.present, present),
    )
    state = state[:length] * scale
    relation = ref.relation(position, velocity, heading, present) * scale
    adjacency = ref.adjacency(position, present, profile.edge_radius_m)
    density, mean_velocity = context

    def patch(k, i):
        point, angle = position[k, i].tolist(), float(heading[k, i])
        return ref.patch(
            density, mean_velocity, MAP_ORIGIN, point, angle, profile.patch_cell_m, profile.patch_size
        )

    patches = torch.stack([torch.stack([patch(k, i) for i in range(profile.agents)]) for k in range(length)])
    patches = torch.where(present[:, :, None, None, None], patches, torch.zeros_like(patches))
    node, edge = net.embed(scene.types, state, relation, patches)
    node = torch.where(present[..., None], node, torch.zeros_like(node))
    pair = (present[:, :, None] & present[:, None, :])[..., None]
    edge = torch.where(pair, edge, torch.zeros_like(edge))

    round_node, round_edge = node, edge
    for number, attention_round in enumerate(net.gdat.topological):
        round_node, round_edge, alpha = attention_round(round_node, round_edge, adjacency)
        out[f"{tag}.topo{number}.node"] = round_node
        out[f"{tag}.topo{number}.alpha"] = alpha
        if attention_round.edge is not None:
            kept = torch.where(adjacency[..., None], round_edge, torch.zeros_like(round_edge))
            out[f"{tag}.topo{number}.edge"] = kept
    temporal, beta = net.gdat.temporal(round_node, present)
    out.update(
        {
            f"{tag}.state": state,
            f"{tag}.relation": relation,
            f"{tag}.adjacency": adjacency.double(),
            f"{tag}.node": node,
            f"{tag}.edge": edge,
            f"{tag}.temporal": temporal,
            f"{tag}.beta": beta,
        }
    )
    if tag == "history":
        out["history.patches"] = patches
    return state, temporal


def drive(start, mean, cholesky, dt_s, integrator):
    """States and covariances of vehicles under Gaussian controls, linearised: [draw, vehicle, step, …]."""
    limits = torch.tensor([ACCEL_LIMIT, SLIP_RATE_LIMIT], dtype=REAL)
    draws, vehicles, horizon_len = mean.shape[:3]
    state = start.expand(draws, -1, -1).clone()
    covariance = torch.zeros(draws, vehicles, 5, 5, dtype=REAL)
    states, covariances = [], []
    for k in range(horizon_len):
        asked = mean[:, :, k]
        acting = ref.saturate(asked, limits)
        slope = torch.diag_embed(1 - torch.tanh(asked / limits).pow(2))
        factor = cholesky[:, :, k]
        of_control = slope @ factor @ factor.transpose(-1, -2) @ slope.transpose(-1, -2)
        if integrator == "euler":
            by_state, by_control = ref.bicycle_jacobians(state, REAR_AXLE, dt_s)
        else:
            by_state, by_control = ref.midpoint_jacobians(state, acting, REAR_AXLE, dt_s)
        covariance = by_state @ covariance @ by_state.transpose(-1, -2)
        covariance = covariance + by_control @ of_control @ by_control.transpose(-1, -2)
        step = ref.bicycle_step if integrator == "euler" else ref.bicycle_midpoint_step
        state = step(state, acting, REAR_AXLE, dt_s)
        states.append(state)
        covariances.append(covariance)
    return torch.stack(states, 2), torch.stack(covariances, 2)


def make_tensors(net, profile, scene):
    """Every intermediate tensor by its name."""
    points = f32(torch.rand(MAP_POINTS, 2, dtype=REAL) * 80 - 40)
    velocities = f32(torch.randn(MAP_POINTS, 2, dtype=REAL) * 3)
    density, velocity = ref.build_map(points, velocities, MAP_ORIGIN, MAP_SHAPE)
    out = {
        "map.points": points,
        "map.velocities": velocities,
        "map.density": density,
        "map.velocity": velocity,
    }
    now, end = profile.history_len, profile.history_len + profile.horizon_len
    context = (density, velocity)
    state, of_history = graph_attention(net, profile, scene, context, (0, now), "history", out)
    _, of_future = graph_attention(net, profile, scene, context, (now, end), "future", out)

    out["latent.mean"] = net.latent_mean(of_history, of_future)
    latent = f32(torch.randn(LATENT_DRAWS, profile.agents, ref.LAT, dtype=REAL))
    out["latent.z"] = latent
    present = scene.present[:now]
    raw = net.decode(scene.types, state, present, of_history, latent, profile.horizon_len)
    out["decoder.raw"] = raw
    mean, cholesky = ref.control(raw)
    out["control.mean"], out["control.cholesky"] = mean, cholesky

    vehicles = vehicles_of(scene)
    start = torch.cat(
        [
            scene.position[now - 1, vehicles],
            scene.heading[now - 1, vehicles, None],
            scene.velocity[now - 1, vehicles].norm(dim=-1, keepdim=True),
            torch.zeros(len(vehicles), 1, dtype=REAL),
        ],
        -1,
    )
    of_vehicles = (start, mean[:, vehicles], cholesky[:, vehicles], profile.dt_s)
    midpoint_mean, midpoint_covariance = drive(*of_vehicles, "midpoint")
    out["bicycle.midpoint_mean"], out["bicycle.midpoint_covariance"] = midpoint_mean, midpoint_covariance
    out["bicycle.initial"] = start
    out["bicycle.mean"], out["bicycle.covariance"] = drive(*of_vehicles, "euler")

    posterior = torch.randn(LOSS_DRAWS, ref.LAT, dtype=REAL) * 1.2
    prior = torch.randn(LOSS_DRAWS, ref.LAT, dtype=REAL)
    posterior, prior = f32(posterior), f32(prior)
    out["loss.posterior"], out["loss.prior"] = posterior, prior
    out["loss.mmd"] = ref.imq_mmd(posterior, prior)[None]
    out["loss.kl_sigma_1"] = ref.kl(posterior, 1.0)
    out["loss.kl_sigma_0.5"] = ref.kl(posterior, 0.5)
    return out


def vehicles_of(scene):
    return [i for i, of_type in enumerate(scene.types) if of_type == 0]


def describe(profile, scene):
    """The content of scene.json."""
    return {
        "seed": profile.seed,
        "width": profile.width,
        "agents": profile.agents,
        "history_len": profile.history_len,
        "horizon_len": profile.horizon_len,
        "dt_s": profile.dt_s,
        "edge_radius_m": profile.edge_radius_m,
        "patch_cell_m": profile.patch_cell_m,
        "patch_size": profile.patch_size,
        "stem": profile.stem,
        "config": profile.config(),
        "types": [ref.TYPES[t] for t in scene.types],
        "vehicles": vehicles_of(scene),
        "rear_axle_m": REAR_AXLE,
        "map_origin_m": MAP_ORIGIN,
        "map_shape": MAP_SHAPE,
        "latent_draws": LATENT_DRAWS,
        "accel_limit_mps2": ACCEL_LIMIT,
        "slip_rate_limit_radps": SLIP_RATE_LIMIT,
        "position_m": scene.position.tolist(),
        "velocity_mps": scene.velocity.tolist(),
        "heading_rad": scene.heading.tolist(),
        "present": scene.present.tolist(),
    }


def make(profile, folder):
    """Writes one folder of golden vectors."""
    folder.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(profile.seed)
    torch.set_num_threads(1)
    net, weights = make_network(profile)
    save_file(weights, str(folder / "weights.safetensors"), metadata={"config": json.dumps(profile.config())})
    scene = make_scene(profile)
    tensors = make_tensors(net, profile, scene)
    tensors = {name: tensor.detach().float().contiguous() for name, tensor in tensors.items()}
    save_file(tensors, str(folder / "tensors.safetensors"))
    with open(folder / "scene.json", "w") as file:
        json.dump(describe(profile, scene), file)


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=pathlib.Path, help="where the folders of the profiles lie")
    parser.add_argument("--check", action="store_true", help="compare instead of writing")
    arguments = parser.parse_args()
    off = []
    with tempfile.TemporaryDirectory() as temporary:
        root = pathlib.Path(temporary) if arguments.check else arguments.folder
        for profile in PROFILES:
            make(profile, root / profile.name)
            names = [f"{profile.name}/{file}" for file in FILES]
            if arguments.check:
                differ = [n for n in names if not filecmp.cmp(root / n, arguments.folder / n, shallow=False)]
                off += differ
                print(f"{profile.name}: {f'DIFFERENT: {differ}' if differ else 'the same bytes'}")
            else:
                print(f"{profile.name}: {arguments.folder / profile.name}")
    sys.exit(1 if off else 0)


if __name__ == "__main__":
    main()
