"""Agents as the model reads them."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, Dict, Optional, Tuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from ..frames import Frame, dtype
from .layers import EDGE


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

    def to(self, *to: Any, **how: Any) -> Graph:
        """The same agents on another device."""
        return replace(self, **moved(self, *to, **how))


def moved(data: Any, *to: Any, **how: Any) -> Dict[str, Any]:
    """The fields of a dataclass, with tensors and graphs on another device; a data type is that of the quantities."""
    values = ((of.name, getattr(data, of.name)) for of in fields(data))
    is_type = any(isinstance(of, torch.dtype) for of in (*to, *how.values()))

    def moves(value: Any) -> bool:
        return isinstance(value, Graph) or isinstance(value, Tensor) and (value.is_floating_point() or not is_type)

    return {name: value.to(*to, **how) if moves(value) else value for name, value in values}


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
