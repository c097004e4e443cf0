"""Tests of `stgdat.torch`: `check.sh` runs them if torch and safetensors can be imported.

`STGDAT_GOLDEN` is the folder of the golden vectors, and `STGDAT_PROGRAM` the executable `stgdat` of the same sources.
"""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
import unittest
from pathlib import Path
from typing import Any, Dict, List, Tuple

import numpy as np
import torch
from safetensors.torch import load_file
from torch import Tensor, nn

import stgdat
from stgdat.torch import Graph, History, Model, Start, features
from stgdat.torch.motion import bicycle_covariances, driven

PROGRAM = os.environ.get("STGDAT_PROGRAM", "stgdat")
GOLDEN = Path(os.environ.get("STGDAT_GOLDEN", Path(__file__).parents[4] / "tests" / "golden"))
#: Maximum error, relative to the largest value.
TOLERANCE = 1e-4
TYPES = ["vehicle", "cyclist", "pedestrian"]


class Golden:
    """A folder of golden vectors, whose tensors have the step as the first axis and the agent as the second."""

    def __init__(self, name: str) -> None:
        folder = GOLDEN / name
        self.name, self.worst = name, 0.0
        self.model = Model.load(folder / "weights.safetensors")
        self.tensors: Dict[str, Tensor] = load_file(folder / "tensors.safetensors")
        self.scene: Dict[str, Any] = json.loads((folder / "scene.json").read_text())

    def check(self, name: str, found: Tensor) -> None:
        expected = self.tensors[name]
        assert found.shape == expected.shape, f"{self.name} {name}: {found.shape} is not {expected.shape}"
        off = float((found - expected).abs().max() / expected.abs().max())
        self.worst = max(self.worst, off)
        assert off <= TOLERANCE, f"{self.name} {name}: off by {off}"

    def graph(self, part: str) -> Tuple[Graph, Tensor]:
        """The graph, and step, receiver and sender of each edge."""
        length = self.tensors[f"{part}.state"].shape[0]
        first = 0 if part == "history" else self.scene["history_len"]
        present = torch.tensor(self.scene["present"], dtype=torch.bool)[first : first + length]
        joined = self.tensors[f"{part}.adjacency"].nonzero()
        step, receiver, sender = joined.unbind(1)
        types = torch.tensor([TYPES.index(name) for name in self.scene["types"]])
        graph = Graph(
            types=types,
            state=self.tensors[f"{part}.state"].transpose(0, 1),
            present=present.T,
            receiver=receiver * length + step,
            sender=sender * length + step,
            length_m=torch.zeros(len(types)),
            relation=self.tensors[f"{part}.relation"][step, receiver, sender],
        )
        if part == "history":
            graph.patches = self.tensors["history.patches"].flatten(0, 1)
            graph.patch_of_node = torch.arange(len(types))[:, None] + len(types) * torch.arange(length)
        return graph, joined


def by_step(rows: Tensor, graph: Graph) -> Tensor:
    return rows.unflatten(0, graph.present.shape).transpose(0, 1)


class GoldenVectors(unittest.TestCase):
    def test_every_tensor_of_the_golden_vectors(self) -> None:
        for name in ("vehicle", "pedestrian", "plus", "literal"):
            with self.subTest(name), torch.no_grad():
                golden = Golden(name)
                self.model(golden)
                print(f"{name}: at most {golden.worst:.1e} of the largest value")

    def model(self, golden: Golden) -> None:
        model = golden.model
        summaries = {}
        for part in ("history", "future"):
            graph, joined = golden.graph(part)
            if part == "future":
                # The golden patches are those of the history.
                rows = golden.tensors["future.node"].transpose(0, 1).flatten(0, 1)
                node, edge = rows, model.fe.relation(graph.relation)
            else:
                node, edge = model.embed(graph)
                golden.check("history.node", by_step(node, graph))
            for number, layer in enumerate(model.gdat.topological):
                expected = golden.tensors[f"{part}.topo{number}.alpha"]
                node, edge, alpha = layer(node, edge, graph.receiver, graph.sender)
                dense = torch.zeros_like(expected)
                dense[joined[:, 0], :, joined[:, 1], joined[:, 2]] = alpha
                golden.check(f"{part}.topo{number}.alpha", dense)
                golden.check(f"{part}.topo{number}.node", by_step(node, graph))
            summary, beta = model.gdat.temporal(node.unflatten(0, graph.present.shape), graph.present)
            golden.check(f"{part}.beta", beta.transpose(0, 1))
            golden.check(f"{part}.temporal", summary)
            summaries[part] = summary
        golden.check("latent.mean", model.encoder(torch.cat([summaries["history"], summaries["future"]], 1)))
        self.decoder(golden, summaries["history"])

    def decoder(self, golden: Golden, summary: Tensor) -> None:
        graph, _ = golden.graph("history")
        latents = golden.tensors["latent.z"].transpose(0, 1)
        mean = torch.zeros(*latents.shape[:2], golden.scene["horizon_len"], 2)
        cholesky = torch.zeros(*mean.shape[:3], 3)
        for number, name in enumerate(TYPES):
            index = (graph.types == number).nonzero()[:, 0]
            if len(index):
                of_type = History(golden.model, name, graph, index, summary[index])
                mean[index], cholesky[index] = of_type.controls(latents[index], None)
        golden.check("control.mean", mean.transpose(0, 1))
        factor = torch.zeros(*mean.shape, 2)
        factor[..., 0, 0], factor[..., 1, 0], factor[..., 1, 1] = cholesky.unbind(-1)
        golden.check("control.cholesky", factor.transpose(0, 1))
        self.bicycles(golden, mean[golden.scene["vehicles"]], factor[golden.scene["vehicles"]])

    def bicycles(self, golden: Golden, controls: Tensor, factor: Tensor) -> None:
        x, y, heading, speed, slip = golden.tensors["bicycle.initial"].unbind(1)
        start = Start(torch.zeros(len(x), 2), heading, speed, slip, torch.full_like(x, golden.scene["rear_axle_m"]))
        config = {**golden.model.config, "slip_limit_rad": None}
        config.update({name: golden.scene[name] for name in ("accel_limit_mps2", "slip_rate_limit_radps")})
        limits = torch.tensor([config["accel_limit_mps2"], config["slip_rate_limit_radps"]])
        acting = (1 - torch.tanh(controls / limits).square())[..., None] * factor
        for integrator, prefix in (("euler", ""), ("midpoint", "midpoint_")):
            config["integrator"] = integrator
            places = driven(config, start, controls) + torch.stack([x, y], 1)[:, None, None]
            expected = golden.tensors[f"bicycle.{prefix}mean"][..., :2].transpose(0, 1)
            off = float((places - expected).abs().max() / expected.abs().max())
            self.assertLess(off, TOLERANCE)
            found = bicycle_covariances(config, start, controls, acting)
            covariances = golden.tensors[f"bicycle.{prefix}covariance"].transpose(0, 1)
            largest = covariances.abs().amax((-1, -2), keepdim=True)
            self.assertLess(float(((found - covariances).abs() / largest).max()), TOLERANCE)


class OfThePipeline(unittest.TestCase):
    """The network's part of the pipeline, computed again in PyTorch."""

    def compared(self, recording: stgdat.Recording, weights: str, ticks: int) -> None:
        model, predictor = Model.load(weights), stgdat.Predictor(None if weights == "onboard" else weights)
        worst, agents_len = 0.0, 0
        modes, steps = model.config["modes"], model.config["horizon_len"]
        for tick in recording.ticks(ticks):
            predictor.step(tick)
            network = predictor.network
            controls = network[1].records
            if len(network[0]) == 0 or len(controls) == 0:
                continue
            with torch.no_grad():
                graph, ids = features(network[0])
                forecast = model(graph)
            row = [int(np.flatnonzero(ids == number)[0]) for number in controls["id"]]
            agents_len += len(row)

            def off(found: Tensor, expected: Any) -> float:
                wanted = torch.from_numpy(np.array(expected))
                return float((found[row] - wanted).abs().max() / wanted.abs().max().clamp(min=1.0))

            of_modes = controls["modes"][:, :modes, :steps]
            worst = max(
                worst,
                off(forecast.mean[:, :-1], of_modes["mean"]),
                off(forecast.mean[:, -1], controls["best"]["mean"][:, :steps]),
                off(forecast.cholesky[:, :-1], of_modes["cholesky"]),
                off(forecast.probabilities, controls["probability"][:, :modes]),
                off(forecast.outside, controls["out_of_distribution"]),
            )
        print(f"{recording.name}, {weights}: {agents_len} forecasts, controls at most {worst:.1e} apart")
        self.assertGreater(agents_len, 0)
        self.assertLess(worst, TOLERANCE)

    def test_controls_are_those_of_the_pipeline(self) -> None:
        for weights in ("onboard", "onboard-free"):
            self.compared(stgdat.generate(agents=24, ticks=50), weights, 50)

    def test_controls_of_a_recording(self) -> None:
        folder = Path(os.environ.get("STGDAT_DATA", GOLDEN.parents[1].parent / "shared" / "data"))
        found = sorted(folder.glob("driving/*/*.csv"))[:1] + sorted(folder.glob("eth_ucy/*/*.txt"))[:1]
        if not found:
            self.skipTest(f"no recordings in {folder}")
        for path in found:
            self.compared(stgdat.open(path), "onboard", 60)


class ThereAndBack(unittest.TestCase):
    def setUp(self) -> None:
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.path = Path(folder.name) / "mine.safetensors"

    def run_program(self, *arguments: str) -> str:
        done = subprocess.run([PROGRAM, *arguments], capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stderr)
        return done.stdout

    def lines(self, weights: object) -> List[bytes]:
        predictor = stgdat.Predictor(str(weights))
        return [forecasts.to_json() for forecasts in predictor.run(stgdat.generate(agents=12, ticks=40))]

    def test_saved_weights_forecast_the_same_bytes(self) -> None:
        expected = self.lines("onboard-free")
        for half in (False, True):
            sha256 = Model.load("onboard-free").save(self.path, half=half)
            again = Model.load(self.path)
            self.assertEqual(again.sha256, sha256)
            self.assertEqual(self.lines(self.path), expected)
            self.assertEqual(again.card, Model.load("onboard-free").card)
        self.assertIn("parameters", self.run_program("card", str(self.path)))

    def test_every_form_of_the_model_comes_back(self) -> None:
        for name in ("vehicle", "pedestrian", "plus", "literal"):
            model = Model.load(GOLDEN / name / "weights.safetensors")
            model.save(self.path)
            again = Model.load(self.path)
            self.assertEqual(again.config, model.config)
            for (key, value), (_, other) in zip(model.state_dict().items(), again.state_dict().items()):
                self.assertTrue(torch.equal(value, other), key)

    def test_changed_weights_have_an_honest_card(self) -> None:
        model = Model.load("onboard")
        with torch.no_grad():
            model.decoder["vehicle"].head.bias += 0.01
        recording = stgdat.generate(agents=4, ticks=10)
        model.save(self.path, updates=7, recordings=[recording])
        card = json.loads(self.run_program("card", str(self.path), "--json"))
        self.assertEqual((card["step"], card["options"]["begin_with"]), (7, ["onboard"]))
        self.assertEqual((card["validation"], card["gains"], card["calibration"]), ([], [], {}))
        self.assertEqual(card["recordings"][-1]["sha256"], recording.sha256)
        self.assertIn("update 7 from onboard", self.run_program("card", str(self.path)))

    def test_a_smaller_decoder_runs_in_the_program(self) -> None:
        model = Model(Model.load("onboard").config, hidden=96).eval()
        model.base.load_state_dict(Model.load("onboard").base.state_dict())
        model.save(self.path)
        again = Model.load(self.path)
        predictor = stgdat.Predictor(str(self.path))
        for tick in stgdat.generate(agents=12, ticks=40).ticks():
            forecasts = predictor.step(tick)
        graph, _ = features(predictor.network[0])
        with torch.no_grad():
            small, large = model(graph), again(graph)
        self.assertLess(float((small.mean - large.mean).abs().max()), 1e-5)
        self.assertLess(float((small.probabilities - large.probabilities).abs().max()), 1e-6)
        self.assertGreater(len(forecasts), 0)

    def test_what_the_program_cannot_run_is_refused(self) -> None:
        config = Model.load("onboard").config
        with self.assertRaisesRegex(stgdat.InputError, "hidden = 160: the program's decoder has at most 128"):
            Model(config, hidden=160).save(self.path)
        model = Model(config)
        model.gdat.temporal.score = nn.Linear(64, 8, bias=False)
        with self.assertRaisesRegex(stgdat.InputError, "gdat.temporal.score.weight has shape"):
            model.save(self.path)
        model = Model(config)
        with torch.no_grad():
            model.fe.relation[0].bias[3] = float("nan")
        with self.assertRaisesRegex(stgdat.InputError, "fe.relation.0.bias: value 3 is NaN"):
            model.save(self.path)
        self.assertFalse(self.path.exists())

    def test_missing_files_and_other_files_are_refused(self) -> None:
        with self.assertRaises(stgdat.MissingFileError):
            Model.load("none.safetensors")
        self.path.write_text("no weights")
        with self.assertRaisesRegex(stgdat.InputError, "mine.safetensors"):
            Model.load(self.path)


if __name__ == "__main__":
    torch.set_num_threads(1)
    unittest.main()
