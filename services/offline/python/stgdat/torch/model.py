"""The model as a module of PyTorch, from a weights file and back."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, Dict, Iterable, List, Mapping, Optional, Tuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from .. import _stgdat
from ..arguments import Path, weights_file
from ..recording import Recording
from .graph import Graph
from .layers import (
    EDGE,
    HIDDEN,
    LATENT,
    LOG_SCALE,
    NODE,
    STATE,
    TYPES,
    Base,
    Context,
    Decoder,
    Mlp,
    Temporal,
    Topological,
)
from .motion import Start, covariances, displaced, driven

if TYPE_CHECKING:
    from .batches import Windows

#: Fewest patches by which the batch norms of the context network normalise in training.
_NORMALISED_PATCHES_MIN = 16


@dataclass
class Forecast:
    """Forecasts of agents. Draws are the modes, and after them the single best forecast."""

    probabilities: Tensor
    """[agent, mode]."""
    mean: Tensor
    """Means of the controls before saturation, [agent, draw, step, 2]."""
    cholesky: Tensor
    """Their Cholesky factors (l11, l21, l22), [agent, draw, step, 3]."""
    positions_m: Tensor
    """Positions in the agent frame under the means, [agent, draw, step, 2]."""
    outside: Tensor
    """Distance of the history from the base's support, [agent]."""

    @property
    def modes_m(self) -> Tensor:
        """Positions of the modes, [agent, mode, step, 2]."""
        return self.positions_m[:, :-1]

    @property
    def best_m(self) -> Tensor:
        """Positions of the single best forecast, [agent, step, 2]."""
        return self.positions_m[:, -1]


def _of_types(types: Iterable[str], make: Any) -> nn.ModuleDict:
    return nn.ModuleDict({name: make() for name in types})


class Model(nn.Module):
    """STG-DAT with the tensor names of a weights file.

    `config` holds the options of docs/model.md; `hidden` is the size of the decoder's state. `Model.load` reads them
    with their weights. A model of a configuration has the trainer's initial values, and a base control of zeros.
    """

    def __init__(self, config: Mapping[str, Any], hidden: int = HIDDEN, has_posterior: bool = True) -> None:
        super().__init__()
        self.config: Dict[str, Any] = dict(config)
        self.card: Optional[Dict[str, Any]] = None
        """The model card of the loaded file."""
        self.sha256: Optional[str] = None
        """Fingerprint of the loaded file."""
        self.fresh: List[str] = []
        """Tensors that have initial values, because those of the loaded file have another shape."""
        self._loaded: Dict[str, Tensor] = {}
        self._name = "initial weights"
        networks = TYPES if config["node_types"] == "own" else TYPES[2:]
        embedding = NODE // 2 if config["context"] else NODE
        self.fe = nn.Module()
        self.fe.state = _of_types(networks, lambda: Mlp(STATE, HIDDEN, HIDDEN, HIDDEN, embedding))
        self.fe.relation = Mlp(STATE, HIDDEN, HIDDEN, HIDDEN, EDGE)
        if config["context"]:
            self.fe.context = Context(config["width"], config["stem"])
        self.gdat = nn.Module()
        rounds = config["rounds"]
        self.gdat.topological = nn.ModuleList(Topological(config, r + 1 == rounds) for r in range(rounds))
        self.gdat.temporal = Temporal(config)
        if has_posterior:
            self.encoder = Mlp(2 * NODE, HIDDEN, HIDDEN, LATENT)
        self.decoder = _of_types(networks, lambda: Decoder(config, hidden))
        if config["base"]:
            self.base = _of_types(TYPES, lambda: Base(config))
            for name, decoder in self.decoder.items():
                drives = name == TYPES[0] and config["vehicle_motion"] == "bicycle"
                decoder.start_at_base((-0.7, -2.5) if drives else (-2.5, -2.5))
            if config["context"]:
                with torch.no_grad():
                    self.fe.context.fc.weight *= 0.1
                    self.fe.context.fc.bias *= 0.1

    @classmethod
    def load(
        cls, weights: Path = "onboard", *, hidden: int = HIDDEN, changes: Optional[Mapping[str, Any]] = None
    ) -> Model:
        """The model of a weights file, or of shipped weights: `"onboard"`, `"onboard-free"`.

        `hidden` and `changes` of the configuration make another model that starts from these weights. Tensors of other
        shapes have initial values; `fresh` lists them.

        >>> Model.load("onboard").config["modes"]
        20
        >>> Model.load("onboard", hidden=96).fresh[:2]
        ['decoder.vehicle.gru.weight_ih', 'decoder.vehicle.gru.weight_hh']

        Raises `InputError` if the file lacks a tensor, or if the configuration has no such option.
        """
        config, card, sha256, tensors = _stgdat.read_weights(weights_file(weights))
        values = {
            name: torch.from_numpy(np.frombuffer(numbers, dtype=np.float32).reshape(shape).copy())
            for name, shape, numbers in tensors
        }
        options, changes = json.loads(config), changes or {}
        for name in changes:
            if name not in options:
                raise _stgdat.InputError(f"changes[{name!r}]: expected one of {', '.join(options)}")
        model = cls({**options, **changes}, hidden, has_posterior="encoder.0.weight" in values)
        known = model._tensors()
        taken = {name: values[name] for name, own in known.items() if name in values and values[name].shape == own.shape}
        model.fresh = [name for name in known if name not in taken]
        if model.fresh and hidden == HIDDEN and not changes:
            raise _stgdat.InputError(f"{os.fspath(weights)}: tensor {model.fresh[0]} is missing")
        model.load_state_dict(taken, strict=False)
        model.card, model.sha256 = None if card is None else json.loads(card), sha256
        model._loaded, model._name = values, os.fspath(weights)
        return model.eval()

    def _tensors(self) -> Dict[str, Tensor]:
        """The tensors of a weights file."""
        state = self.state_dict()
        return {name: value for name, value in state.items() if not name.endswith(".num_batches_tracked")}

    def save(
        self,
        path: Path,
        *,
        updates: int = 0,
        windows: Optional[Windows] = None,
        recordings: Iterable[Recording] = (),
        card: Optional[Mapping[str, Any]] = None,
        half: bool = False,
    ) -> str:
        """Writes a file that `--weights` reads, and returns its fingerprint.

        A decoder with a smaller state, and narrower hidden layers of perceptrons, are filled up with zeros, which
        changes no forecast: the program has one size of each layer. The card is the loaded one if no value has
        changed. Otherwise it has the `updates` made, the `windows` or `recordings` seen, and no figures of the earlier
        weights; `card` overrides its entries. `half` stores half precision, as in shipped weights, which rounds new
        values.

        Raises `InputError` if the program cannot run the model.
        """
        tensors = {name: value.detach().cpu().float() for name, value in self._tensors().items()}
        hidden = next(iter(self.decoder.values())).gru.hidden_size
        if hidden > HIDDEN:
            raise _stgdat.InputError(f"hidden = {hidden}: the program's decoder has at most {HIDDEN}")
        tensors = {name: _filled(name, value, hidden) for name, value in tensors.items()}
        seen = [*recordings, *(windows.recordings if windows is not None else ())]
        counts = {"windows": 0, "agents": 0}
        if windows is not None:
            counts = {"windows": windows.window_count, "agents": windows.agent_count}
        text = self._card(tensors, updates, seen, counts, card)
        parts = [(name, list(value.shape), value.contiguous().numpy().tobytes()) for name, value in tensors.items()]
        return _stgdat.write_weights(os.fspath(path), json.dumps(self.config), text, parts, half)

    def _card(
        self,
        tensors: Mapping[str, Tensor],
        updates: int,
        recordings: List[Recording],
        counts: Mapping[str, int],
        overrides: Optional[Mapping[str, Any]],
    ) -> Optional[str]:
        is_same = tensors.keys() == self._loaded.keys() and all(
            torch.equal(value, self._loaded[name]) for name, value in tensors.items()
        )
        if is_same and self.card is None and not recordings and overrides is None:
            return None
        history_s = self.config["history_len"] * self.config["dt_s"]
        card: Dict[str, Any] = {
            "about": f"STG-DAT: forecasts of vehicles, cyclists and pedestrians from their last {history_s:.1f} s",
            "options": {"sets": ["own"], "validation_sets": ["own"]},
            "wall_s": 0.0,
            "training": {"windows": 0, "agents": 0},
            "recordings": [],
            "licences": {},
        }
        card.update(json.loads(json.dumps(self.card or {})))
        if not is_same or recordings:
            seen = [{"set": "own train", "name": of.name, "sha256": of.sha256} for of in recordings]
            card["about"] += "; trained further in PyTorch" if self._loaded else "; trained in PyTorch"
            card["step"] = updates
            card["options"].update(recipe=None, begin_with=[self._name] if self._loaded else [])
            card["parameters"] = sum(value.numel() for value in tensors.values())
            card["training"] = {name: card["training"][name] + count for name, count in counts.items()}
            card["recordings"] = card["recordings"] + [of for of in seen if of not in card["recordings"]]
            if recordings:
                card["licences"] = {**card.get("licences", {}), "own": "as of the recordings"}
            card.update(calibration={}, validation=[], validation_without_map=[], gains=[])
        card["options"]["model"] = self.config
        card.update(overrides or {})
        return json.dumps(card)

    def parameter_groups(self, learning_rate: float) -> List[Dict[str, Any]]:
        """Groups for an optimiser such as `torch.optim.Adam`, in which the decoder's heads learn slowly.

        Adam moves all parameters by steps of the learning rate. In a head such a step shifts every forecast: a slip
        rate of 0.001 rad/s moves a vehicle at 10 m/s by a metre within 4.8 s. The trainer learns heads in units of
        0.2 m/s², 0.01 rad/s and 0.1 m; here the rate of a whole head is that of its smallest unit.
        """
        heads = {id(p): name for name, decoder in self.decoder.items() for p in decoder.head.parameters()}
        groups: Dict[float, List[nn.Parameter]] = {}
        for parameter in self.parameters():
            name = heads.get(id(parameter))
            unit = 1.0 if name is None else 0.01 if self._is_driven(name) else 0.1
            groups.setdefault(unit, []).append(parameter)
        return [{"params": parameters, "lr": unit * learning_rate} for unit, parameters in groups.items()]

    def _is_driven(self, network: str) -> bool:
        """Whether the network of this name steers bicycles."""
        is_shared = self.config["node_types"] == "same"
        return self.config["vehicle_motion"] == "bicycle" and (is_shared or network == TYPES[0])

    def embed(self, graph: Graph) -> Tuple[Tensor, Tensor]:
        """Node attributes [agent · step, 64] and edge attributes [edge, 16]."""
        if graph.node is not None and graph.edge is not None:
            return graph.node, graph.edge
        assert graph.relation is not None
        agents, steps = graph.present.shape
        node = graph.state.new_zeros(agents, steps, NODE // 2 if self.config["context"] else NODE)
        for name, index in self._by_network(graph.types):
            node = node.index_put((index,), self.fe.state[name](graph.state[index]))
        if self.config["context"]:
            assert graph.patches is not None and graph.patch_of_node is not None
            context = self._embed_patches(graph.patches)[graph.patch_of_node.flatten()]
            node = torch.cat([node, context.unflatten(0, (agents, steps))], 2)
        node = torch.where(graph.present[:, :, None], node, torch.zeros_like(node))
        edge = self.fe.relation(graph.relation)
        return node.flatten(0, 1), edge if graph.relation_of_edge is None else edge[graph.relation_of_edge]

    def _embed_patches(self, patches: Tensor) -> Tensor:
        """Embeddings of patches. Few patches are normalised by the running values, in training too."""
        context = self.fe.context
        if not context.training or len(patches) >= _NORMALISED_PATCHES_MIN:
            return context(patches)
        context.eval()
        embedded = context(patches)
        context.train()
        # The backward pass reads the running values, which a later forward pass would change in place.
        for norm in context.modules():
            if isinstance(norm, nn.BatchNorm2d):
                norm.running_mean, norm.running_var = norm.running_mean.clone(), norm.running_var.clone()
        return embedded

    def attend(self, graph: Graph, node: Tensor, edge: Tensor) -> Tensor:
        """The temporal summary ṽ [agent, 64] of a graph with these attributes."""
        for layer in self.gdat.topological:
            node, edge, _ = layer(node, edge, graph.receiver, graph.sender)
        return self.gdat.temporal(node.unflatten(0, graph.present.shape), graph.present)[0]

    def encode(self, graph: Graph) -> Tensor:
        """The temporal summary ṽ [agent, 64]."""
        return self.attend(graph, *self.embed(graph))

    def forward(self, graph: Graph, latents: Optional[Tensor] = None) -> Forecast:
        """Forecasts of the graph's agents. A model without learned points needs `latents` [agent, mode, 32]."""
        summary = self.encode(graph)
        agents, draws, steps = len(summary), self.config["modes"] + 1, self.config["horizon_len"]
        like = summary.new_empty
        whole = Forecast(
            like(agents, draws - 1), like(agents, draws, steps, 2), like(agents, draws, steps, 3),
            like(agents, draws, steps, 2), like(agents),
        )  # fmt: skip
        for number, name in enumerate(TYPES):
            index = (graph.types == number).nonzero()[:, 0]
            if len(index):
                of_type = History(self, name, graph, index, summary[index])
                part = of_type.forecast(None if latents is None else latents[index])
                for of in fields(Forecast):
                    values = getattr(part, of.name).to(summary.dtype)
                    setattr(whole, of.name, getattr(whole, of.name).index_put((index,), values))
        return whole

    def covariances(self, graph: Graph, forecast: Forecast) -> Tensor:
        """Covariances of the positions [agent, draw, step, (xx, xy, yy)], as linearised Gaussians."""
        start = Start.of(graph.state, graph.present, graph.length_m, self.config)
        drives = self._drives(graph.types)
        arguments = self.config, start, forecast.mean, forecast.cholesky
        by_type = [covariances(*arguments, is_bicycle) for is_bicycle in (False, True)]
        return torch.where(drives[:, None, None, None], by_type[1], by_type[0])

    def _drives(self, types: Tensor) -> Tensor:
        return (types == 0) & (self.config["vehicle_motion"] == "bicycle")

    def network_of(self, name: str) -> str:
        """The type whose networks are used for agents of this type."""
        return name if self.config["node_types"] == "own" else TYPES[2]

    def _by_network(self, types: Tensor) -> Iterable[Tuple[str, Tensor]]:
        if self.config["node_types"] == "same":
            return [(TYPES[2], torch.arange(len(types), device=types.device))]
        return [(name, (types == number).nonzero()[:, 0]) for number, name in enumerate(TYPES)]


@dataclass
class History:
    """Encoded agents of one type, ready to be forecast."""

    model: Model
    type_name: str
    graph: Graph
    index: Tensor
    summary: Tensor
    decoder: Decoder = field(init=False)
    hidden: Tensor = field(init=False)
    start: Start = field(init=False)
    base: Optional[Tensor] = field(init=False, default=None)
    """Base controls [agent, draw, step, 2]."""
    outside: Tensor = field(init=False)

    def __post_init__(self) -> None:
        config, index = self.model.config, self.index
        state, present = self.graph.state[index], self.graph.present[index]
        self.decoder = self.model.decoder[self.model.network_of(self.type_name)]
        self.hidden = self.decoder.burn_in(state, present)
        self.start = Start.of(state, present, self.graph.length_m[index], config)
        self.outside = self.summary.new_zeros(len(index))
        if config["base"]:
            self.base, self.outside = self.model.base[self.type_name](state, present)

    @property
    def drives(self) -> bool:
        """Whether the agents move by bicycle controls."""
        return self.type_name == TYPES[0] and self.model.config["vehicle_motion"] == "bicycle"

    def base_of(self, modes: Tensor) -> Optional[Tensor]:
        """The base controls of these modes [agent, draw]."""
        if self.base is None:
            return None
        return self.base.gather(1, modes[:, :, None, None].expand(-1, -1, *self.base.shape[2:]))

    def points(self, modes: Tensor) -> Tensor:
        """The latent points of these modes [agent, draw]; the number after the last mode is the best forecast's."""
        decoder, config = self.decoder, self.model.config
        points = decoder.latents
        if config["best_latent"]:
            points = torch.cat([points, decoder.latent_best[None]])
        latent = points[modes]
        base = self.base_of(modes)
        if config["base_latent"] and base is not None:
            scale = latent.new_tensor([0.5, 5.0] if self.drives else [3.0, 3.0])
            latent = latent + decoder.latent_base((base * scale).flatten(2))
        return latent

    def controls(self, latent: Tensor, base: Optional[Tensor]) -> Tuple[Tensor, Tensor]:
        """Means and Cholesky factors of the controls under latent variables [agent, draw, 32]."""
        raw = self.decoder(self.hidden, self.summary, latent)
        share = Base.kept_share(self.outside)[:, None, None, None]
        mean = raw[..., :2] * share
        scale = raw[..., 2:4].clamp(*LOG_SCALE).exp()
        cholesky = torch.stack([scale[..., 0], raw[..., 4], scale[..., 1]], -1)
        return mean if base is None else mean + base, cholesky

    def positions(self, controls: Tensor) -> Tensor:
        """Positions [agent, draw, step, 2] under controls before saturation."""
        move = driven if self.drives else displaced
        return move(self.model.config, self.start, controls)

    def logits(self) -> Tensor:
        """Scores of the modes [agent, mode]."""
        if not self.model.config["mode_head"]:
            return self.summary.new_zeros(len(self.summary), self.model.config["modes"])
        return self.decoder.logits(self.hidden, self.summary)

    def forecast(self, latents: Optional[Tensor] = None) -> Forecast:
        """The modes and the single best forecast."""
        config, agents = self.model.config, len(self.summary)
        modes, probabilities = config["modes"], self.logits().softmax(1)
        if config["latents"] == "points" and latents is None:
            count = modes + 1 if config["best_latent"] else modes
            numbers = torch.arange(count, device=self.summary.device).expand(agents, -1)
            base = self.base_of(numbers)
            mean, cholesky = self.controls(self.points(numbers), base)
        else:
            if latents is None:
                raise ValueError("this model has no learned latent points: give latents, such as torch.randn")
            best = self.decoder.latent_best if config["best_latent"] else latents.new_zeros(LATENT)
            mean, cholesky = self.controls(torch.cat([latents, best.expand(agents, 1, -1)], 1), self.base)
        if mean.shape[1] == modes:
            best_row = probabilities.argmax(1)[:, None, None, None].expand(-1, -1, mean.shape[2], -1)
            mean = torch.cat([mean, mean.gather(1, best_row.expand(-1, -1, -1, 2))], 1)
            cholesky = torch.cat([cholesky, cholesky.gather(1, best_row.expand(-1, -1, -1, 3))], 1)
        return Forecast(probabilities, mean, cholesky, self.positions(mean), self.outside)


def _filled(name: str, value: Tensor, hidden: int) -> Tensor:
    """A tensor of narrower layers, filled up with zeros to the program's size."""
    rest = HIDDEN - hidden
    if name.startswith("decoder.") and rest:
        if ".gru." in name:
            gates = value.unflatten(0, (3, hidden))
            columns = (0, rest) if name.endswith("weight_hh") else (0, 0)
            pads = (0, rest) if value.dim() == 1 else (*columns, 0, rest)
            return F.pad(gates, pads).flatten(0, 1)
        if name.endswith((".head.weight", ".mode.0.weight")):
            return F.pad(value, (0, rest))
    return value
