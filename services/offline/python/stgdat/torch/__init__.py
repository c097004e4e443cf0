"""The model in PyTorch: the same numbers as the program's, and a way back.

    >>> from stgdat.torch import Model
    >>> model = Model.load("onboard")
    >>> sha256 = model.save("mine.safetensors")  # for --weights mine.safetensors

Needs the package torch: `pip install 'stgdat[torch]'`.
"""

try:
    import torch as _torch  # noqa: F401
except ModuleNotFoundError as error:
    if error.name != "torch":
        raise
    raise ModuleNotFoundError("stgdat.torch needs torch: pip install 'stgdat[torch]'", name="torch") from error

from .graph import Graph, features
from .losses import Loss, Paper, Plus
from .model import Forecast, History, Model
from .motion import Start
from .batches import Batch, Windows, windows

__all__ = [
    "Batch",
    "Forecast",
    "Graph",
    "History",
    "Loss",
    "Model",
    "Paper",
    "Plus",
    "Start",
    "Windows",
    "features",
    "windows",
]
