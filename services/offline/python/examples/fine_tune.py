"""Trains the onboard weights further in PyTorch, on one recording: `python fine_tune.py FILE mine.safetensors`.

The first 80 % of the time train, the rest is judged. It needs `pip install 'stgdat[torch]'` and about two minutes on two
cores. `stgdat run --weights mine.safetensors` uses the result.
"""

import sys
import time
from typing import Dict

import torch
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from torch.utils.data import DataLoader

import stgdat
from stgdat.torch import Model, Plus, windows

UPDATES = 400
WARM_UP = 20
RATE = 1e-3
ROWS = {"network": "ours", "published": "ours, online retrieval, evidence", "constant velocity": "constant velocity"}


def errors(recording: stgdat.Recording, weights: str) -> Dict[str, str]:
    """ADE and FDE of the single best forecasts of all agents, by method."""
    figures = stgdat.evaluate(recording, weights=weights).figures
    found = {}
    for row, method in ROWS.items():
        of = {
            figure["quantity"]: figure["value"]
            for figure in figures
            if (figure["method"], figure["measure"], figure["subset"]) == (method, "K = 1", "all")
        }
        if not of:
            sys.exit(f"{recording.name}: no agent of the held-out part is known over a whole window")
        found[row] = f"{of['ADE, m']:.3f} / {of['FDE, m']:.3f}"
    return found


def main(path: str, out: str) -> None:
    begun = time.monotonic()
    torch.set_num_threads(1)  # products this small gain nothing from more
    train, held_out = stgdat.open(path).split(0.8)
    model = Model.load("onboard").train()
    drawn = windows(train, model, batches=UPDATES)
    optimiser = torch.optim.Adam(model.parameter_groups(RATE))
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, [group["lr"] for group in optimiser.param_groups], UPDATES, WARM_UP / UPDATES, cycle_momentum=False
    )
    average = AveragedModel(model, multi_avg_fn=get_ema_multi_avg_fn(0.98), use_buffers=True)
    loss_of = Plus()
    for batch in DataLoader(drawn, batch_size=None, num_workers=1):
        loss = loss_of(model, batch, done=batch.number / UPDATES)
        optimiser.zero_grad()
        loss.total.backward()
        torch.nn.utils.clip_grad_norm_(model.parameters(), 10.0)
        optimiser.step()
        schedule.step()
        average.update_parameters(model)
        if batch.number % 50 == 0:
            print(f"update {batch.number}: error of the winners {loss.trajectory.item():.3f}, single {loss.single.item():.3f}")
    sha256 = average.module.save(out, updates=UPDATES, windows=drawn)
    before, after = errors(held_out, "onboard"), errors(held_out, out)
    print(f"\n{'held-out part, ADE / FDE, m':30}{'before':>16}{'after':>16}")
    for row in ROWS:
        print(f"{row:30}{before[row]:>16}{after[row]:>16}")
    print(f"\n{out}: fingerprint {sha256[:12]}, {time.monotonic() - begun:.0f} s")


if __name__ == "__main__":
    main(*sys.argv[1:])
