"""Batches of training windows, made by the trainer of the program."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass, replace
from typing import Any, Dict, Iterable, Iterator, List, Mapping, Optional, Sequence, Tuple, Union

import torch
from torch import Tensor
from torch.utils.data import Dataset

from .. import _stgdat
from ..arguments import Path
from ..recording import Recording, open
from .graph import Graph, moved
from .losses import Loss, Paper, Plus
from .model import Model

_Arrays = Iterable[Tuple[str, List[int], bool, bytearray]]


@dataclass
class Batch:
    """Agents of some windows, sorted by type; within a type, those to forecast come first."""

    number: int
    """Number of the batch. The trainer draws it for its update of this number."""
    history: Graph
    """The observed steps."""
    future: Optional[Graph]
    """The steps to forecast, for `Paper`."""
    forecast: Tensor
    """Whether the loss counts the agent, [agent]."""
    truth_m: Tensor
    """True positions in the agent frame, [agent, step, 2]; zeros where unknown."""
    known: Tensor
    """Whether the true position is known, [agent, step]."""
    noise: Tensor
    """Standard normal numbers of the loss: [2, counted agent, 4, step, 2] for `Plus`, [2, counted agent, 32] for `Paper`."""
    random_mode: Optional[Tensor] = None
    """A random mode of each counted agent, for `Plus`."""

    def to(self, *to: Any, **how: Any) -> Batch:
        """The same batch on another device."""
        return replace(self, **moved(self, *to, **how))


class Windows(Dataset):
    """The batches of an epoch, for `torch.utils.data.DataLoader(windows, batch_size=None)`.

    `windows` makes it.
    """

    recordings: Sequence[Recording]
    """The recordings that the windows are of."""
    window_count: int
    """Number of windows."""
    agent_count: int
    """Number of agents with a target in all windows."""

    def __init__(self, recordings: Sequence[Recording], options: Mapping[str, Any], batches: Optional[int]) -> None:
        self.recordings, self.options, self.epoch = recordings, dict(options), 0
        self._inner = _stgdat.Windows([of._recording for of in recordings], json.dumps(self.options))
        self.window_count, self.agent_count = self._inner.counts()
        self._batches = max(1, self.agent_count // self.options["batch_agents"]) if batches is None else batches

    def __reduce__(self) -> Tuple[Any, ...]:
        return _again, (self.recordings, self.options, self._batches, self.epoch)

    def __len__(self) -> int:
        return self._batches

    def __iter__(self) -> Iterator[Batch]:
        return (self[number] for number in range(len(self)))

    def __getitem__(self, number: int) -> Batch:
        if not 0 <= number < len(self):
            raise IndexError(f"batch {number} of an epoch of {len(self)}")
        number += self.epoch * len(self)
        arrays = _tensors(self._inner.batch(number))
        part = {name: arrays.pop(name) for name in list(arrays) if "." not in name}
        types, length_m = part.pop("types"), part.pop("length_m")

        def graph(prefix: str) -> Optional[Graph]:
            of = {name[len(prefix) :]: value for name, value in arrays.items() if name.startswith(prefix)}
            return Graph(types=types, length_m=length_m, **{**of, "present": of["present"].bool()}) if of else None

        history = graph("history.")
        assert history is not None
        flags = {name: part.pop(name).bool() for name in ("forecast", "known")}
        return Batch(number=number, history=history, future=graph("future."), **flags, **part)

    def set_epoch(self, epoch: int) -> None:
        """Draws other batches: those of this epoch. Call it before a `DataLoader` starts to go through them."""
        self.epoch = epoch

    def gradients(self, number: int, weights: Path, *, done: float = 0.0) -> Tuple[Loss, Dict[str, Tensor]]:
        """The trainer's loss of batch `number` for the weights in a file, and its gradients by tensor.

        It checks changed losses and layers: `Plus()(model, batch, done).total.backward()` gives the same gradients for
        the unchanged ones. Batch norms use the batch, as in `model.train()`. `done` is the completed share of a training.

        Raises `InputError` if the file holds another model.
        """
        parts, agents, gradients = self._inner.gradients(number, os.fspath(weights), done)
        values = [torch.tensor(value) for value in parts]
        return self.objective.weighted(*values, agents=agents), _tensors(gradients)

    @property
    def objective(self) -> Union[Plus, Paper]:
        """The loss that the batches are for."""
        ((name, weights),) = self.options["objective"].items()
        return {"plus": Plus, "paper": Paper}[name](**weights)


def windows(
    recordings: Union[Recording, Path, Iterable[Union[Recording, Path]]],
    model: Union[Model, Mapping[str, Any]],
    *,
    objective: Union[Plus, Paper, None] = None,
    seed: int = 1,
    batch_agents: int = 96,
    batches: Optional[int] = None,
    options: Optional[Mapping[str, Any]] = None,
) -> Windows:
    """Training windows of recordings for a model, or for its configuration, with the trainer's augmentation.

    A batch has at least `batch_agents` agents to forecast. An epoch has as many `batches` as that the recordings have
    agents for, unless it is given. Batches are drawn with replacement: `seed`, epoch and number determine one, in any
    process, so `DataLoader` may have any number of workers. `options` holds further options of `stgdat train`, such as
    `{"noisy_history": 0.0}`; `stgdat train FILE --print-options` lists them.

    >>> import stgdat
    >>> from stgdat.torch import Model, windows
    >>> batch = windows(stgdat.generate(agents=12, ticks=200, complete=True), Model.load("onboard"))[0]
    >>> batch.truth_m.shape[1:]  # steps, x and y
    torch.Size([12, 2])

    Raises `InputError` if a recording has no identities, if no agent is there over a whole window, or if an option
    cannot be.
    """
    if isinstance(recordings, (str, os.PathLike, Recording)):
        recordings = [recordings]
    opened = [of if isinstance(of, Recording) else open(of) for of in recordings]
    for of in opened:
        if not of.has_identities:
            raise _stgdat.InputError(f"{of.name}: its detections have no identities, which windows need")
    objective = Plus() if objective is None else objective
    whole = {
        **(options or {}),
        "model": dict(model.config if isinstance(model, Model) else model),
        "objective": {type(objective).__name__.lower(): asdict(objective)},
        "seed": seed,
        "batch_agents": batch_agents,
    }
    return Windows(opened, whole, batches)


def _again(recordings: Sequence[Recording], options: Mapping[str, Any], batches: int, epoch: int) -> Windows:
    made = Windows(recordings, options, batches)
    made.set_epoch(epoch)
    return made


def _tensors(arrays: _Arrays) -> Dict[str, Tensor]:
    return {name: _tensor(shape, is_float, values) for name, shape, is_float, values in arrays}


def _tensor(shape: List[int], is_float: bool, values: bytearray) -> Tensor:
    dtype = torch.float32 if is_float else torch.int64
    return torch.frombuffer(values, dtype=dtype).reshape(shape) if values else torch.zeros(shape, dtype=dtype)
