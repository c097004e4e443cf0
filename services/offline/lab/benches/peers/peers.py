"""The layers of the network in ONNX Runtime and PyTorch, timed alternating with ours by the bench `peers`.

    python3 peers.py environment FOLDER      makes a virtual environment with the libraries; prints its interpreter
    python peers.py serve                    answers requests `LIBRARY LAYER SECONDS`, a line each, with the best time
                                             of a call in seconds, until its input ends

Layers and batches are those of `stgdat bench`; the numbers in them are random: no operation takes longer for them. Each
library has one thread, folded batch norms, and the fastest of the ways that it offers. Where a library is missing, the
first line says so, and its layers answer `none`.
"""

import os
import pathlib
import subprocess
import sys
import time
import venv

# What the figures were measured with. PyTorch's own index has builds without CUDA, which are a tenth as large.
PACKAGES = ["numpy==2.4.6", "onnx==1.23.2", "onnxruntime==1.32.0"]
TORCH = "torch==2.9.1"
TORCH_INDEX = "https://download.pytorch.org/whl/cpu"

SIDE = 512
ROWS, HIDDEN, STEPS = 672, 128, 12
EDGES, RELATION = 4096, [6, 128, 128, 128, 16]
PATCHES, CHANNELS, PATCH_SIDE, WIDTH, EMBEDDING = 64, 3, 16, 16, 32
OPSET = 17


def environment(folder):
    folder = pathlib.Path(folder)
    python = folder / "bin" / "python"
    done = folder / "complete"
    if done.exists() and done.read_text() == "\n".join([*PACKAGES, TORCH]):
        print(python)
        return
    venv.create(folder, with_pip=True, clear=True)
    pip = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, *PACKAGES], check=True, stdout=sys.stderr)
    without_cuda = subprocess.run(
        [*pip, "--timeout", "10", "--retries", "1", "--index-url", TORCH_INDEX, "--no-deps", TORCH], stdout=sys.stderr, stderr=subprocess.DEVNULL
    )
    # The dependencies, or all of it from the common index.
    subprocess.run([*pip, TORCH], check=without_cuda.returncode == 0, stdout=sys.stderr)
    done.write_text("\n".join([*PACKAGES, TORCH]))
    print(python)


def convolutions():
    """(name, inputs, outputs, kernel, stride) of the context CNN, a ResNet-18 of width 16."""
    inputs = WIDTH
    yield "stem", CHANNELS, WIDTH, 3, 2
    for stage in range(4):
        outputs = WIDTH << stage
        for block in range(2):
            stride = 2 if stage > 0 and block == 0 else 1
            yield f"{stage}.{block}.first", inputs, outputs, 3, stride
            if stride > 1:
                yield f"{stage}.{block}.around", inputs, outputs, 1, stride
            yield f"{stage}.{block}.second", outputs, outputs, 3, 1
            inputs = outputs


class OnnxRuntime:
    name = "ONNX Runtime"

    def __init__(self):
        import numpy
        import onnx
        import onnxruntime

        self.np, self.onnx, self.runtime = numpy, onnx, onnxruntime
        self.version = onnxruntime.__version__
        self.random = numpy.random.default_rng(1)

    def values(self, *shape):
        return (self.random.random(shape, dtype="float32") - 0.5) * 0.2

    def session(self, nodes, inputs, outputs, weights):
        helper, numpy_helper = self.onnx.helper, self.onnx.numpy_helper
        described = [
            [helper.make_tensor_value_info(n, self.onnx.TensorProto.FLOAT, s) for n, s in ends.items()]
            for ends in ({n: v.shape for n, v in inputs.items()}, dict.fromkeys(outputs))
        ]
        constants = [numpy_helper.from_array(value, name) for name, value in weights.items()]
        graph = helper.make_graph(nodes, "layer", *described, constants)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=8)
        options = self.runtime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        session = self.runtime.InferenceSession(
            model.SerializeToString(), options, providers=["CPUExecutionProvider"]
        )
        return lambda: session.run(outputs, inputs)

    def product(self):
        node = self.onnx.helper.make_node
        weights = {"b": self.values(SIDE, SIDE)}
        return [self.session([node("MatMul", ["a", "b"], ["y"])], {"a": self.values(SIDE, SIDE)}, ["y"], weights)]

    def decoder(self):
        node = self.onnx.helper.make_node
        weights = {"r": self.values(HIDDEN, 3 * HIDDEN), "b": self.values(3 * HIDDEN)}
        weights |= {"idle": self.values(3 * HIDDEN)}
        weights["parts"] = self.np.array([HIDDEN] * 3, "int64")
        nodes, state = [node("Split", ["idle", "parts"], ["i_r", "i_z", "in"], axis=0)], "h"
        for t in range(STEPS):
            nodes += [
                node("Gemm", [state, "r", "b"], [f"g{t}"]),
                node("Split", [f"g{t}", "parts"], [f"gr{t}", f"gz{t}", f"gn{t}"], axis=1),
                node("Add", [f"gr{t}", "i_r"], [f"ar{t}"]),
                node("Add", [f"gz{t}", "i_z"], [f"az{t}"]),
                node("Sigmoid", [f"ar{t}"], [f"r{t}"]),
                node("Sigmoid", [f"az{t}"], [f"z{t}"]),
                node("Mul", [f"r{t}", f"gn{t}"], [f"rn{t}"]),
                node("Add", [f"rn{t}", "in"], [f"an{t}"]),
                node("Tanh", [f"an{t}"], [f"n{t}"]),
                node("Sub", [state, f"n{t}"], [f"d{t}"]),
                node("Mul", [f"z{t}", f"d{t}"], [f"zd{t}"]),
                node("Add", [f"n{t}", f"zd{t}"], [f"h{t}"]),
            ]
            state = f"h{t}"
        written_out = self.session(nodes, {"h": self.values(ROWS, HIDDEN)}, [state], weights)
        gru = node(
            "GRU", ["x", "w", "r", "b", "", "h"], ["y"], hidden_size=HIDDEN, linear_before_reset=1
        )
        weights = {"w": self.values(1, 3 * HIDDEN, 1), "r": self.values(1, 3 * HIDDEN, HIDDEN)}
        weights["b"] = self.values(1, 6 * HIDDEN)
        inputs = {"x": self.np.zeros((STEPS, ROWS, 1), "float32"), "h": self.values(1, ROWS, HIDDEN)}
        return [written_out, self.session([gru], inputs, ["y"], weights)]

    def relation(self):
        node, weights, nodes, last = self.onnx.helper.make_node, {}, [], "x"
        for i, (inputs, outputs) in enumerate(zip(RELATION, RELATION[1:])):
            weights |= {f"w{i}": self.values(inputs, outputs), f"b{i}": self.values(outputs)}
            nodes.append(node("Gemm", [last, f"w{i}", f"b{i}"], [f"y{i}"]))
            last = f"y{i}"
            if i + 2 < len(RELATION):
                nodes.append(node("Relu", [last], [f"a{i}"]))
                last = f"a{i}"
        return [self.session(nodes, {"x": self.values(EDGES, RELATION[0])}, [last], weights)]

    def context(self):
        node, weights, nodes = self.onnx.helper.make_node, {}, []

        def conv(name, x):
            _, inputs, outputs, kernel, stride = layers[name]
            weights.update({f"{name}.w": self.values(outputs, inputs, kernel, kernel), f"{name}.b": self.values(outputs)})
            pad = kernel // 2
            nodes.append(
                node("Conv", [x, f"{name}.w", f"{name}.b"], [name], pads=[pad] * 4, strides=[stride] * 2)
            )
            return name

        def relu(x):
            nodes.append(node("Relu", [x], [f"{x}.relu"]))
            return f"{x}.relu"

        layers = {layer[0]: layer for layer in convolutions()}
        x = relu(conv("stem", "x"))
        for stage in range(4):
            for block in range(2):
                name = f"{stage}.{block}"
                around = conv(f"{name}.around", x) if f"{name}.around" in layers else x
                y = conv(f"{name}.second", relu(conv(f"{name}.first", x)))
                nodes.append(node("Add", [y, around], [name]))
                x = relu(name)
        nodes += [node("GlobalAveragePool", [x], ["pool"]), node("Flatten", ["pool"], ["flat"])]
        weights |= {"fc": self.values(WIDTH * 8, EMBEDDING), "bias": self.values(EMBEDDING)}
        nodes.append(node("Gemm", ["flat", "fc", "bias"], ["y"]))
        patches = self.values(PATCHES, CHANNELS, PATCH_SIDE, PATCH_SIDE)
        return [self.session(nodes, {"x": patches}, ["y"], weights)]


class Torch:
    name = "PyTorch"

    def __init__(self):
        import torch

        self.torch, self.version = torch, torch.__version__
        torch.set_num_threads(1)
        torch.manual_seed(1)

    def call(self, work):
        def without_gradient():
            with self.torch.inference_mode():
                return work()

        return without_gradient

    def product(self):
        a, b, y = (self.torch.rand(SIDE, SIDE) for _ in range(3))
        return [self.call(lambda: self.torch.mm(a, b, out=y))]

    def decoder(self):
        torch = self.torch
        weight, bias = torch.rand(HIDDEN, 3 * HIDDEN) * 0.2 - 0.1, torch.rand(3 * HIDDEN)
        start, idle = torch.rand(ROWS, HIDDEN), torch.rand(3 * HIDDEN)
        input_r, input_z, input_n = idle.chunk(3)

        def written_out():
            h = start
            for _ in range(STEPS):
                gr, gz, gn = torch.addmm(bias, h, weight).chunk(3, 1)
                r, z = torch.sigmoid(gr + input_r), torch.sigmoid(gz + input_z)
                n = torch.tanh(torch.addcmul(input_n, r, gn))
                h = torch.lerp(n, h, z)
            return h

        gru, x = torch.nn.GRU(1, HIDDEN), torch.zeros(STEPS, ROWS, 1)
        return [self.call(written_out), self.call(lambda: gru(x, start[None]))]

    def relation(self):
        nn, layers = self.torch.nn, []
        for inputs, outputs in zip(RELATION, RELATION[1:]):
            layers += [nn.Linear(inputs, outputs), nn.ReLU(inplace=True)]
        mlp, x = nn.Sequential(*layers[:-1]), self.torch.rand(EDGES, RELATION[0])
        return [self.call(lambda: mlp(x))]

    def context(self):
        torch, nn = self.torch, self.torch.nn
        layers = {
            name: nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2)
            for name, inputs, outputs, kernel, stride in convolutions()
        }
        fc = nn.Linear(WIDTH * 8, EMBEDDING)

        def run(x):
            x = torch.relu_(layers["stem"](x))
            for stage in range(4):
                for block in range(2):
                    name = f"{stage}.{block}"
                    around = layers[f"{name}.around"](x) if f"{name}.around" in layers else x
                    y = layers[f"{name}.second"](torch.relu_(layers[f"{name}.first"](x)))
                    x = torch.relu_(y.add_(around))
            return fc(x.mean((2, 3)))

        patches = torch.rand(PATCHES, CHANNELS, PATCH_SIDE, PATCH_SIDE)
        plain = self.call(lambda: run(patches))
        plain()
        # A layout that other builds of the library prefer.
        last = patches.to(memory_format=torch.channels_last)
        return [plain, self.call(lambda: run(last))]


def best(call, seconds):
    least, start = float("inf"), time.perf_counter()
    while True:
        before = time.perf_counter()
        call()
        now = time.perf_counter()
        least = min(least, now - before)
        if now - start >= seconds:
            return least


def serve():
    libraries, told = {}, []
    for key, library in (("onnxruntime", OnnxRuntime), ("torch", Torch)):
        try:
            libraries[key] = library()
            told.append(f"{library.name} {libraries[key].version}")
        except ImportError as error:
            told.append(f"{library.name} is missing ({error})")
    print("; ".join(told), flush=True)
    ready = {}
    for line in sys.stdin:
        library, layer, seconds = line.split()
        if library not in libraries:
            print("none", flush=True)
            continue
        if (library, layer) not in ready:
            # The fastest way counts, found out once.
            ways = getattr(libraries[library], layer)()
            ready[library, layer] = min(ways, key=lambda way: best(way, 0.2))
        print(best(ready[library, layer], float(seconds)), flush=True)


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    if len(sys.argv) == 3 and sys.argv[1] == "environment":
        environment(sys.argv[2])
    elif sys.argv[1:] == ["serve"]:
        serve()
    else:
        sys.exit(__doc__)
