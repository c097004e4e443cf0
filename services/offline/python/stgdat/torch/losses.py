"""The losses of the trainer [docs/model.md §5].

A loss is a function of the weights and of a batch, which holds the random numbers.
"""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Iterator, Optional, Tuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from .layers import LATENT, TYPES
from .model import History, Model

if TYPE_CHECKING:
    from .batches import Batch

#: Keeps the root of a distance of zero differentiable.
_ROOT_EPSILON_M2 = 1e-6
#: Scales of the kernels of the maximum mean discrepancy.
_KERNEL_SCALES = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)


@dataclass
class Loss:
    """A loss and its parts before they are weighted. Distances are in metres."""

    total: Tensor
    """The weighted sum: call `total.backward()`."""
    trajectory: Tensor
    """Error of the winning modes, or squared displacement of the posterior draw."""
    single: Tensor
    """Error of the single best forecast."""
    probability: Tensor
    """Cross-entropy of the mode probabilities, or divergence of the posterior."""
    spread: Tensor
    """Energy score, or maximum mean discrepancy."""
    agents: int
    """Number of agents that the loss counts."""


@dataclass(frozen=True)
class Plus:
    """The variety loss: the best of the learned points by the unsquared distance d to the truth. Means are over agents.

        w (mean_k d of the winner by mean_k d + last_step · d_K of the winner by d_K
           + random_mode (1 − done) e(random mode) + single · e(single best)
           + probability · cross-entropy to the winner by e + spread · energy score)    e = mean_k d + last_step · d_K

    w is `vehicle` for vehicles and 1 for others. Only the `candidates` modes nearest by the base control can win.
    """

    random_mode: float = 0.05
    single: float = 0.3
    probability: float = 0.05
    spread: float = 0.05
    vehicle: float = 0.3
    candidates: int = 8
    last_step: float = 0.5

    def __call__(self, model: Model, batch: Batch, done: float = 0.0) -> Loss:
        """The loss of a batch. `done` is the completed share of the training.

        Raises `ValueError` if the batch was drawn for another objective.
        """
        if batch.random_mode is None:
            raise ValueError("the batch was drawn for Paper: windows(…, objective=Plus())")
        summary = model.encode(batch.history)
        counted = max(1, int(batch.forecast.sum()))
        zero = summary.sum() * 0.0
        trajectory, single, probability, spread, rest = zero, zero, zero, zero, zero
        for name, index, rows in _types(batch):
            history = History(model, name, batch.history, index, summary[index])
            truth, known = batch.truth_m[index], batch.known[index]
            weight = (self.vehicle if name == TYPES[0] else 1.0) / counted
            with torch.no_grad():
                by_mean, by_last, winner = self._winners(history, truth, known)
            best = torch.full_like(winner, model.config["modes"])
            modes = torch.stack([by_mean, by_last, batch.random_mode[rows], best], 1)
            mean, cholesky = history.controls(history.points(modes), history.base_of(modes))
            error, last = _errors(history.positions(mean), truth, known)
            whole = error + self.last_step * last
            trajectory = trajectory + weight * (error[:, 0] + self.last_step * last[:, 1]).sum()
            rest = rest + weight * self.random_mode * (1.0 - done) * whole[:, 2].sum()
            single = single + weight * whole[:, 3].sum()
            scores = _energy(history, mean.detach(), cholesky, batch.noise[:, rows], truth, known)
            spread = spread + weight * scores.mean(1).sum()
            # The probabilities do not move the layers before the mode head.
            logits = history.decoder.logits(history.hidden.detach(), history.summary.detach())
            entropy = F.cross_entropy(logits, winner, reduction="sum")
            probability = probability + entropy.detach() / counted
            rest = rest + weight * self.probability * entropy
        loss = self.weighted(trajectory, single, probability, spread, agents=counted)
        loss.total = trajectory + self.single * single + self.spread * spread + rest
        return loss

    def weighted(self, trajectory: Tensor, single: Tensor, probability: Tensor, spread: Tensor, *, agents: int) -> Loss:
        """The loss that the trainer's log shows, without random modes and with equal weights of probabilities."""
        total = trajectory + self.single * single + self.probability * probability + self.spread * spread
        return Loss(total, trajectory, single, probability, spread, agents)

    def _winners(self, history: History, truth: Tensor, known: Tensor) -> Tuple[Tensor, Tensor, Tensor]:
        """The best modes of each agent by the mean, by the last step and by both."""
        modes = history.model.config["modes"]
        near = torch.arange(modes, device=truth.device).expand(len(truth), -1)
        candidates = min(max(self.candidates, 1), modes)
        base = history.base_of(near)
        if base is not None and candidates < modes:
            error, last = _errors(history.positions(base), truth, known)
            near = (error + self.last_step * last).argsort(dim=1, stable=True)[:, :candidates]
        mean, _ = history.controls(history.points(near), history.base_of(near))
        error, last = _errors(history.positions(mean), truth, known)

        def best(errors: Tensor) -> Tensor:
            return near.gather(1, errors.argmin(1, keepdim=True))[:, 0]

        return best(error), best(last), best(error + self.last_step * last)


@dataclass(frozen=True)
class Paper:
    """The paper's loss of one posterior draw z = m + `sigma` ε [paper, Eq. loss]. Means are over agents.

    gamma · mean squared displacement + alpha · KL(N(m, sigma²) ‖ N(0, I)) + beta · MMD² of the draws and N(0, I)
    """

    gamma: float = 1.0
    alpha: float = 0.1
    beta: float = 1.0
    sigma: float = 1.0

    def __call__(self, model: Model, batch: Batch, done: float = 0.0) -> Loss:
        """The loss of a batch. `done` has no effect.

        Raises `ValueError` if the batch was drawn for another objective.
        """
        if batch.future is None:
            raise ValueError("the batch was drawn for Plus: windows(…, objective=Paper())")
        with _kept_statistics(model):
            future = model.encode(batch.future)
        summary = model.encode(batch.history)
        types = list(_types(batch))
        counted = max(1, int(batch.forecast.sum()))
        order = torch.cat([index for _, index, _ in types])
        mean = model.encoder(torch.cat([summary[order], future[order]], 1))
        latent = mean + self.sigma * batch.noise[0]
        trajectory = summary.sum() * 0.0
        for name, index, rows in types:
            history = History(model, name, batch.history, index, summary[index])
            controls, _ = history.controls(latent[rows][:, None], None)
            apart = (history.positions(controls)[:, 0] - batch.truth_m[index]).square().sum(2)
            trajectory = trajectory + (apart * batch.known[index]).sum()
        trajectory = trajectory * self.gamma / (counted * model.config["horizon_len"])
        of_sigma = 0.5 * LATENT * (self.sigma**2 - 1.0 - 2.0 * math.log(self.sigma))
        divergence = (0.5 * mean.square().sum(1) + of_sigma).sum() / counted
        spread = _mmd(latent, batch.noise[1]) if len(latent) > 1 else trajectory * 0.0
        return self.weighted(trajectory, trajectory * 0.0, divergence, spread, agents=counted)

    def weighted(self, trajectory: Tensor, single: Tensor, probability: Tensor, spread: Tensor, *, agents: int) -> Loss:
        """The loss of these parts."""
        total = trajectory + self.alpha * probability + self.beta * spread
        return Loss(total, trajectory, single, probability, spread, agents)


@contextlib.contextmanager
def _kept_statistics(model: Model) -> Iterator[None]:
    """Batch norms keep their running values: those are of histories."""
    norms = [(norm, norm.momentum) for norm in model.modules() if isinstance(norm, nn.BatchNorm2d)]
    for norm, _ in norms:
        norm.momentum = 0.0
    try:
        yield
    finally:
        for norm, momentum in norms:
            norm.momentum = momentum


def _types(batch: Batch) -> Iterator[Tuple[str, Tensor, slice]]:
    """The agents to forecast of each type, and their rows among all agents to forecast."""
    first = 0
    for number, name in enumerate(TYPES):
        index = ((batch.history.types == number) & batch.forecast).nonzero()[:, 0]
        if len(index):
            yield name, index, slice(first, first + len(index))
            first += len(index)


def _distance(a: Tensor, b: Tensor) -> Tensor:
    return ((a - b).square().sum(-1) + _ROOT_EPSILON_M2).sqrt()


def _mean(values: Tensor, known: Tensor) -> Tensor:
    """Means [agent, draw] over the known steps."""
    known = known[:, None].to(values.dtype)
    return (values * known).sum(2) / known.sum(2).clamp(min=1.0)


def _errors(positions: Tensor, truth: Tensor, known: Tensor) -> Tuple[Tensor, Tensor]:
    """Distances to the truth [agent, draw]: the mean over the known steps, and that at the last step."""
    apart = _distance(positions, truth[:, None])
    return _mean(apart, known), apart[:, :, -1] * known[:, None, -1]


def _energy(
    history: History, mean: Tensor, cholesky: Tensor, noise: Tensor, truth: Tensor, known: Tensor
) -> Tensor:
    """Energy scores [agent, draw] of two draws about the means, ½ (‖X₁ − y‖ + ‖X₂ − y‖) − ½ ‖X₁ − X₂‖."""
    l11, l21, l22 = cholesky.unbind(-1)

    def drawn(noise: Tensor) -> Tensor:
        by_first, by_second = noise.unbind(-1)
        return history.positions(mean + torch.stack([l11 * by_first, l21 * by_first + l22 * by_second], -1))

    first, second = drawn(noise[0]), drawn(noise[1])
    to_truth = _distance(first, truth[:, None]) + _distance(second, truth[:, None])
    return 0.5 * _mean(to_truth - _distance(first, second), known)


def _mmd(a: Tensor, b: Tensor) -> Tensor:
    """Unbiased squared maximum mean discrepancy of two sets of latents [n, 32], by inverse multiquadric kernels."""

    def mean(x: Tensor, y: Optional[Tensor] = None) -> Tensor:
        of = x if y is None else y
        squared = (x.square().sum(1)[:, None] + of.square().sum(1) - 2.0 * x @ of.T).clamp(min=0.0)
        kernels = sum(c / (c + squared) for c in (2.0 * x.shape[1] * scale for scale in _KERNEL_SCALES))
        assert isinstance(kernels, Tensor)
        if y is None:
            pairs = ~torch.eye(len(x), dtype=torch.bool, device=x.device)
            return kernels[pairs].sum() / (len(x) * (len(x) - 1))
        return kernels.mean()

    return mean(a) + mean(b) - 2.0 * mean(a, b)
