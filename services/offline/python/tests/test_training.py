"""Tests of training in PyTorch: windows, losses, and changed models. `check.sh` runs them if torch can be imported.

`STGDAT_GOLDEN` is the folder of the golden vectors, and `STGDAT_PROGRAM` the executable `stgdat` of the same sources.
"""

from __future__ import annotations

import doctest
import importlib
import json
import os
import pickle
import shutil
import subprocess
import sys
import tempfile
import unittest
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Dict, List, Union

import torch
from torch import Tensor
from torch.utils.data import DataLoader

import stgdat
from stgdat.torch import Batch, Graph, Model, Paper, Plus, Windows, windows

PROGRAM = os.environ.get("STGDAT_PROGRAM", "stgdat")
GOLDEN = Path(os.environ.get("STGDAT_GOLDEN", Path(__file__).parents[4] / "tests" / "golden"))
#: Maximum error of a gradient, relative to the largest value of its layer.
TOLERANCE = 1e-4


def crossing(seed: int = 1, ticks: int = 260) -> stgdat.Recording:
    """Vehicles, cyclists and pedestrians."""
    return stgdat.generate(agents=24, ticks=ticks, seed=seed, complete=True)


def values(of: Union[Batch, Graph], prefix: str = "") -> List[Any]:
    """All tensors of a batch."""
    found: List[Any] = []
    for field in fields(of):
        value = getattr(of, field.name)
        found += values(value, field.name + ".") if isinstance(value, Graph) else [(prefix + field.name, value)]
    return [(name, value) for name, value in found if isinstance(value, Tensor)]


class Gradients(unittest.TestCase):
    """A step in PyTorch has the gradients of the trainer."""

    def compared(self, weights: Path, objective: Union[Plus, Paper], numbers: List[int], done: float = 0.25) -> None:
        drawn = windows(crossing(), Model.load(weights), objective=objective, batch_agents=32)
        worst, reached = 0.0, 0
        for number in numbers:
            expected, gradients = drawn.gradients(number, weights, done=done)
            # A step moves the running values of the batch norms, so each one starts with the file's.
            model = Model.load(weights).train().double()
            loss = objective(model, drawn[number].to(torch.float64), done)
            loss.total.backward()
            self.assertEqual(loss.agents, expected.agents)
            self.assertGreaterEqual(loss.agents, 32)
            # The trainer does not compute terms that have no weight.
            parts = [name for name in ("trajectory", "single", "probability", "spread") if getattr(objective, name, 1.0)]
            for part in parts:
                found, wanted = float(getattr(loss, part).detach()), float(getattr(expected, part))
                self.assertAlmostEqual(found, wanted, delta=TOLERANCE * max(abs(wanted), 1e-3), msg=part)
            own = dict(model.named_parameters())
            self.assertEqual(own.keys(), gradients.keys())
            layers: Dict[str, float] = {}
            for name, wanted in gradients.items():
                layer = name.rsplit(".", 1)[0]
                layers[layer] = max(layers.get(layer, 0.0), float(wanted.abs().max()))
            for name, wanted in gradients.items():
                gradient, largest = own[name].grad, layers[name.rsplit(".", 1)[0]]
                if gradient is None or largest == 0.0:
                    self.assertEqual(largest, 0.0, name)
                    self.assertTrue(gradient is None or float(gradient.abs().max()) == 0.0, name)
                    continue
                off = float((gradient - wanted).abs().max()) / largest
                self.assertLess(off, TOLERANCE, f"{name} of batch {number}: largest {largest}")
                worst, reached = max(worst, off), reached + 1
        print(f"{objective}: {reached} gradients, at most {worst:.1e} of the largest value apart")
        self.assertGreater(reached, 50)

    def test_every_term_of_plus(self) -> None:
        path = shipped()
        self.compared(path, Plus(), [0, 1, 2])
        none = Plus(random_mode=0.0, single=0.0, probability=0.0, spread=0.0)
        for term in (
            replace(none, random_mode=1.0),
            replace(none, single=1.0),
            replace(none, probability=1.0),
            replace(none, spread=1.0),
        ):
            self.compared(path, term, [3])
        self.compared(path, replace(none, vehicle=2.0, candidates=20, last_step=2.0), [0])

    def test_every_term_of_the_papers_loss(self) -> None:
        for name in ("vehicle", "pedestrian", "literal"):
            for objective in (Paper(), Paper(gamma=0.0, alpha=1.0, beta=0.0, sigma=0.5), Paper(gamma=0.0, alpha=0.0)):
                self.compared(GOLDEN / name / "weights.safetensors", objective, [0])


class OfWindows(unittest.TestCase):
    """Batches and loaders."""

    def setUp(self) -> None:
        self.config = Model.load("onboard").config
        self.windows = windows(crossing(), self.config, seed=3, batch_agents=48, batches=6)

    def same(self, batch: Batch, other: Batch) -> bool:
        pairs = list(zip(values(batch), values(other)))
        self.assertGreaterEqual(len(pairs), 15)
        return batch.number == other.number and all(a[0] == b[0] and torch.equal(a[1], b[1]) for a, b in pairs)

    def test_loaders_with_any_number_of_workers_give_the_same_batches(self) -> None:
        expected = list(self.windows)
        for workers, start in ((0, None), (1, "fork"), (2, "fork"), (2, "spawn")):
            loader = DataLoader(self.windows, batch_size=None, num_workers=workers, multiprocessing_context=start)
            found = list(loader)
            self.assertEqual(len(found), 6)
            for batch, other in zip(expected, found):
                self.assertTrue(self.same(batch, other), f"{workers} workers by {start}")

    def test_epochs_and_seeds_differ_and_repeat(self) -> None:
        first = list(self.windows)
        self.assertEqual([batch.number for batch in first], list(range(6)))
        self.windows.set_epoch(2)
        again = pickle.loads(pickle.dumps(self.windows))
        third = list(again)
        self.assertEqual([batch.number for batch in third], list(range(12, 18)))
        self.assertTrue(all(self.same(a, b) for a, b in zip(third, self.windows)))
        self.assertFalse(any(torch.equal(a.truth_m, b.truth_m) for a, b in zip(first, third)))
        other = windows(crossing(), self.config, seed=4, batch_agents=48)
        self.assertFalse(torch.equal(other[0].truth_m, first[0].truth_m))
        self.assertEqual(len(other), other.agent_count // 48)

    def test_the_truth_is_the_recorded_motion(self) -> None:
        options = {"short_history": 0.0, "noisy_history": 0.0, "differenced_history": 0.0}
        batch = windows(crossing(), self.config, options=options)[0]
        scale, dt_s = self.config["position_scale"], self.config["dt_s"]
        history, counted = batch.history, batch.forecast
        self.assertTrue(batch.known[counted].all() and history.present[counted][:, -2:].all())
        # The agent frame has the newest position as its origin, so the truth goes on from there.
        newest = history.state[:, -1, :2] / scale
        self.assertLess(float(newest[counted].abs().max()), 1e-6)
        velocity = history.state[:, -1, 2:4] / self.config["velocity_scale"]
        off = (batch.truth_m[:, 0] - velocity * dt_s)[counted].norm(dim=1)
        self.assertLess(float(off.max()), 2.0)
        self.assertGreater(float(batch.truth_m[counted].norm(dim=2).max()), 10.0)

    def test_examples_in_the_documentation(self) -> None:
        for name in ("model", "batches"):
            result = doctest.testmod(importlib.import_module(f"stgdat.torch.{name}"))
            self.assertGreater(result.attempted, 1, name)
            self.assertEqual(result.failed, 0, name)

    def test_what_cannot_be_is_refused(self) -> None:
        with self.assertRaisesRegex(stgdat.InputError, "arrays: no agent is known over a window of 8"):
            windows(stgdat.Recording.from_arrays("vehicle", [0.0, 1.0], [0.0, 0.0], stamp_s=[0, 0.1], ids=[1, 1]), self.config)
        with self.assertRaisesRegex(stgdat.InputError, "its detections have no identities"):
            windows(stgdat.generate(agents=8, ticks=300), self.config)
        with self.assertRaisesRegex(stgdat.InputError, "noisy_histories"):
            windows(crossing(), self.config, options={"noisy_histories": 0.0})
        with self.assertRaisesRegex(stgdat.InputError, "batch_agents.* must be 1 or more"):
            windows(crossing(), self.config, batch_agents=0)
        with self.assertRaisesRegex(stgdat.InputError, "its model is another one"):
            self.windows.gradients(0, GOLDEN / "plus" / "weights.safetensors")
        with self.assertRaisesRegex(ValueError, "drawn for Plus"):
            Paper()(Model.load("onboard"), self.windows[0])
        with self.assertRaises(IndexError):
            self.windows[6]

    def test_a_recording_is_split_in_time(self) -> None:
        recording = crossing()
        earlier, later = recording.split(0.75)
        self.assertEqual(earlier.stamps_ns.tolist() + later.stamps_ns.tolist(), recording.stamps_ns.tolist())
        self.assertAlmostEqual(len(earlier) / len(recording), 0.75, delta=0.01)
        again = pickle.loads(pickle.dumps(later))
        self.assertEqual((again.detections == later.detections).all(), True)
        with self.assertRaisesRegex(stgdat.InputError, "share = 1.5: expected 0 to 1"):
            recording.split(1.5)


class Trained(unittest.TestCase):
    def setUp(self) -> None:
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.path = Path(folder.name) / "mine.safetensors"

    def run_program(self, *arguments: str) -> str:
        done = subprocess.run([PROGRAM, *arguments], capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stderr)
        return done.stdout

    def test_a_changed_decoder_learns_and_runs_in_the_program(self) -> None:
        model = Model.load("onboard", hidden=96).train()
        self.assertEqual({name.split(".")[0] for name in model.fresh}, {"decoder"})
        drawn = windows(crossing(), model, batch_agents=48, batches=8)
        optimiser = torch.optim.Adam(model.parameter_groups(3e-3))
        losses = []
        # Each pass has the same batches.
        for _ in range(6):
            for batch in drawn:
                loss = Plus()(model, batch)
                optimiser.zero_grad()
                loss.total.backward()
                optimiser.step()
                losses.append(loss.total.item())
        self.assertLess(sum(losses[-8:]), 0.9 * sum(losses[:8]))
        model.save(self.path, updates=48, windows=drawn)
        card = json.loads(self.run_program("card", str(self.path), "--json"))
        self.assertEqual((card["step"], card["options"]["begin_with"]), (48, ["onboard"]))
        self.assertEqual(card["recordings"][-1]["name"], drawn.recordings[0].name)
        assert model.card is not None
        self.assertEqual(card["training"]["agents"] - model.card["training"]["agents"], drawn.agent_count)
        predicted = self.run_program("predict", "--weights", str(self.path), "--ticks", "40")
        self.assertEqual(len(predicted.splitlines()), 40)

    def test_a_model_of_a_changed_configuration_has_a_card(self) -> None:
        model = Model.load("onboard", changes={"modes": 10, "rounds": 1})
        self.assertIn("base.vehicle.anchors", model.fresh)
        self.assertNotIn("base.vehicle.ridge", model.fresh)
        model.save(self.path)
        again = Model.load(self.path)
        self.assertEqual((again.config["modes"], again.fresh), (10, []))
        assert again.card is not None
        self.assertEqual(again.card["options"]["model"], again.config)
        new = Model(again.config)
        new.save(self.path, updates=5, recordings=[crossing(ticks=40)])
        card = json.loads(self.run_program("card", str(self.path), "--json"))
        self.assertEqual((card["step"], len(card["recordings"]), card["licences"]), (5, 1, {"own": "as of the recordings"}))
        self.assertEqual(card["options"]["model"]["modes"], 10)
        with self.assertRaisesRegex(stgdat.InputError, "changes\\['mode'\\]: expected one of width, "):
            Model.load("onboard", changes={"mode": 10})

    def test_saved_weights_have_the_golden_vectors(self) -> None:
        for name in ("vehicle", "plus"):
            folder = self.path.parent / name
            shutil.copytree(GOLDEN / name, folder)
            Model.load(GOLDEN / name / "weights.safetensors").save(folder / "weights.safetensors", updates=1)
            self.run_program("verify", str(folder))
            model = Model.load(GOLDEN / name / "weights.safetensors")
            with torch.no_grad():
                model.fe.relation[0].bias += 1.0
            model.save(folder / "weights.safetensors")
            done = subprocess.run([PROGRAM, "verify", str(folder)], capture_output=True, text=True)
            self.assertNotEqual(done.returncode, 0, done.stdout)

    def test_heads_learn_in_their_units(self) -> None:
        model = Model.load("onboard")
        groups = model.parameter_groups(1e-3)
        self.assertEqual(sum(len(group["params"]) for group in groups), len(list(model.parameters())))
        rates = {id(p): group["lr"] for group in groups for p in group["params"]}
        self.assertAlmostEqual(rates[id(model.decoder["vehicle"].head.weight)], 1e-5)
        self.assertAlmostEqual(rates[id(model.decoder["pedestrian"].head.bias)], 1e-4)
        self.assertAlmostEqual(rates[id(model.gdat.temporal.value.weight)], 1e-3)

    def test_the_example_fine_tunes(self) -> None:
        folder = self.path.parent
        crossing(ticks=700).save(folder / "mine.csv")
        example = Path(__file__).parents[1] / "examples" / "fine_tune.py"
        text = example.read_text().replace("UPDATES = 400", "UPDATES = 20")
        (folder / "short.py").write_text(text)
        command = [sys.executable, "short.py", "mine.csv", "mine.safetensors"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stderr)
        rows = [line.split() for line in done.stdout.splitlines() if line.startswith(("network", "published", "constant"))]
        self.assertEqual([row[0] for row in rows], ["network", "published", "constant"])
        self.assertNotEqual(rows[0][1:4], rows[0][4:])
        self.assertEqual(rows[2][2:5], rows[2][5:])


def shipped() -> Path:
    """The embedded weights as a file."""
    folder = Path(tempfile.mkdtemp())
    Model.load("onboard").save(folder / "onboard.safetensors")
    return folder / "onboard.safetensors"


if __name__ == "__main__":
    torch.set_num_threads(1)
    unittest.main()
