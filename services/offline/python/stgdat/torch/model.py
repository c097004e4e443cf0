"""The model as a module of PyTorch, from a weights file and back."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field, fields
from typing import Any, Dict, Iterable, List, Mapping, Optional, Tuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from .. import _stgdat
from ..arguments import Path, weights_file
from ..frames import Frame, dtype
from ..recording import Recording
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


@dataclass
class Graph:
    """Agents at some steps. A node's row is agent · steps + step.

    Either the features of nodes and edges are known (`patches`, `relation`), or already their attributes (`node`,
    `edge`), as in the frames of the topic `features`.
    """

    types: Tensor
    """Number of the agent type, [agent]: vehicle 0, cyclist 1, pedestrian 2."""
    state: Tensor
    """State features [agent, step, 6] in the model's scale; zeros where absent."""
    present: Tensor
    """Whether the agent has a state, [agent, step]."""
    receiver: Tensor
    """Row of the node that receives, [edge]."""
    sender: Tensor
    """Row of the node that sends, [edge]."""
    length_m: Tensor
    """Length, or 0 if it is unknown, [agent]."""
    relation: Optional[Tensor] = None
    """Distinct relation features [relation, 6]."""
    relation_of_edge: Optional[Tensor] = None
    """Relation of each edge; `None` if `relation` has a row for each edge."""
    patches: Optional[Tensor] = None
    """Distinct patches [patch, 3, row, column]; the first one, of zeros, stands for no map."""
    patch_of_node: Optional[Tensor] = None
    """Patch of each node, [agent, step]."""
    node: Optional[Tensor] = None
    """Node attributes [agent · step, 64]."""
    edge: Optional[Tensor] = None
    """Edge attributes [edge, 16]."""

    def to(self, *to: Any, **how: Any) -> Any:
        """The same agents on another device."""
        values = {of.name: getattr(self, of.name) for of in fields(self)}
        moved = {name: value.to(*to, **how) if isinstance(value, Tensor) else value for name, value in values.items()}
        return type(self)(**moved)


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
    with their weights.
    """

    def __init__(self, config: Mapping[str, Any], hidden: int = HIDDEN, has_posterior: bool = True) -> None:
        super().__init__()
        self.config: Dict[str, Any] = dict(config)
        self.card: Optional[Dict[str, Any]] = None
        """The model card of the loaded file."""
        self.sha256: Optional[str] = None
        """Fingerprint of the loaded file."""
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

    @classmethod
    def load(cls, weights: Path = "onboard") -> Model:
        """The model of a weights file, or of shipped weights: `"onboard"`, `"onboard-free"`.

        >>> Model.load("onboard").config["modes"]
        20
        """
        path = None if weights == "onboard" and not os.path.exists("onboard") else weights_file(weights)
        config, card, sha256, tensors = _stgdat.read_weights(path)
        values = {
            name: torch.from_numpy(np.frombuffer(numbers, dtype=np.float32).reshape(shape).copy())
            for name, shape, numbers in tensors
        }
        model = cls(json.loads(config), has_posterior="encoder.0.weight" in values)
        known = model._tensors()
        missing = [name for name in known if name not in values]
        if missing:
            raise _stgdat.InputError(f"{os.fspath(weights)}: tensor {missing[0]} is missing")
        model.load_state_dict({name: values[name] for name in known}, strict=False)
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
        recordings: Iterable[Recording] = (),
        card: Optional[Mapping[str, Any]] = None,
        half: bool = False,
    ) -> str:
        """Writes a file that `--weights` reads, and returns its fingerprint.

        A decoder with a smaller state, and narrower hidden layers of perceptrons, are filled up with zeros, which
        changes no forecast: the program has one size of each layer. The card is the loaded one if no value has
        changed. Otherwise it has the `updates` made and the `recordings` seen, and no figures of the earlier weights;
        `card` overrides its entries. `half` stores half precision, as in shipped weights, which rounds new values.

        Raises `InputError` if the program cannot run the model.
        """
        tensors = {name: value.detach().cpu().float() for name, value in self._tensors().items()}
        hidden = next(iter(self.decoder.values())).gru.hidden_size
        if hidden > HIDDEN:
            raise _stgdat.InputError(f"hidden = {hidden}: the program's decoder has at most {HIDDEN}")
        tensors = {name: _filled(name, value, hidden) for name, value in tensors.items()}
        text = self._card(tensors, updates, list(recordings), card)
        parts = [(name, list(value.shape), value.contiguous().numpy().tobytes()) for name, value in tensors.items()]
        return _stgdat.write_weights(os.fspath(path), json.dumps(self.config), text, parts, half)

    def _card(
        self,
        tensors: Mapping[str, Tensor],
        updates: int,
        recordings: List[Recording],
        overrides: Optional[Mapping[str, Any]],
    ) -> Optional[str]:
        if self.card is None:
            return None if overrides is None else json.dumps(dict(overrides))
        card: Dict[str, Any] = json.loads(json.dumps(self.card))
        is_same = tensors.keys() == self._loaded.keys() and all(
            torch.equal(value, self._loaded[name]) for name, value in tensors.items()
        )
        if not is_same or recordings:
            seen = [{"set": "own train", "name": of.name, "sha256": of.sha256} for of in recordings]
            card["about"] += "; trained further in PyTorch"
            card["step"] = updates
            card["options"].update(recipe=None, begin_with=[self._name])
            card["parameters"] = sum(value.numel() for value in tensors.values())
            card["recordings"] = card["recordings"] + [of for of in seen if of not in card["recordings"]]
            if recordings:
                card["licences"] = {**card.get("licences", {}), "own": "as of the recordings"}
            card.update(calibration={}, validation=[], validation_without_map=[], gains=[])
        card["options"]["model"] = self.config
        card.update(overrides or {})
        return json.dumps(card)

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
            context = self.fe.context(graph.patches)[graph.patch_of_node.flatten()]
            node = torch.cat([node, context.unflatten(0, (agents, steps))], 2)
        node = torch.where(graph.present[:, :, None], node, torch.zeros_like(node))
        edge = self.fe.relation(graph.relation)
        return node.flatten(0, 1), edge if graph.relation_of_edge is None else edge[graph.relation_of_edge]

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


def features(frame: Frame) -> Tuple[Graph, npt.NDArray[Any]]:
    """The agents, nodes and edges of a frame of the topic `features`, and the tracks of the agents."""
    counts = frame.header["counts"]
    agents_len, edges_len, history_len = (int(counts[of]) for of in ("agents_len", "edges_len", "history_len"))
    data = np.ascontiguousarray(frame.records).view(np.uint8).reshape(-1)
    layouts = dtype("AgentFeatures"), dtype("Edge")
    agents_end = agents_len * layouts[0].itemsize
    agents = data[:agents_end].view(layouts[0])
    edges = data[agents_end : agents_end + edges_len * layouts[1].itemsize].view(layouts[1])
    attributes = data[len(data) - edges_len * EDGE * 4 :].view(np.float32).reshape(edges_len, EDGE)
    steps = np.arange(history_len)
    row = {end: torch.from_numpy(edges[end].astype(np.int64) * history_len + edges["step"]) for end in ("receiver", "sender")}
    graph = Graph(
        types=torch.from_numpy(agents["agent_type"].astype(np.int64)),
        state=torch.from_numpy(agents["state"][:, :history_len].copy()),
        present=torch.from_numpy((agents["present"][:, None] >> steps.astype(np.uint32) & 1).astype(bool)),
        receiver=row["receiver"],
        sender=row["sender"],
        length_m=torch.from_numpy(agents["length_m"].copy()),
        node=torch.from_numpy(agents["node"][:, :history_len].copy()).flatten(0, 1),
        edge=torch.from_numpy(attributes.copy()),
    )
    return graph, agents["id"]
