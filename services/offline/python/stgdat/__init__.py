"""stgdat tracks and forecasts people and vehicles around a robot.

    >>> import stgdat
    >>> recording = stgdat.generate(agents=8, ticks=60)
    >>> predictor = stgdat.Predictor()
    >>> for forecasts in predictor.run(recording):
    ...     pass
    >>> forecasts.modes_m.shape[1:]  # modes, steps, x and y
    (20, 12, 2)

* `open` reads a recording; `generate` makes one, and `Recording.from_pandas` and `from_arrays` of your own data.
* `Predictor` and `Tracker` run the stages in this process.
* `evaluate` compares forecasts with the recorded motion. `Evaluator.state` makes a state of each recording, and
  `merge_states` the same figures from states.
* `stgdat.datasets` reads Argoverse 2, nuScenes, nuPlan and Waymo Open Motion.
* `stgdat.torch` is the model as modules of PyTorch. It needs torch.
* `Run.attach` reads the topics of a live run, `read_record` those of a recorded one.

Arrays are read-only views of memory that Rust owns. Positions are in metres in the world frame, and headings in
radians counter-clockwise from +x. If a recording has an origin, add `origin_m` to get its own frame.
"""

from ._stgdat import InputError, __version__
from .checks import MissingFileError
from .evaluation import Evaluation, Evaluator, combine_states, evaluate, evaluate_state, merge_states
from .frames import Agent, Detections, Forecasts, Frame, Tracks, detections, dtype
from .judged import JudgedForecasts, MethodForecasts
from .lanes import Lane
from .numbers import AgentType, Cause, DetectionFlags, Expert, Quality, TrackStatus
from .pictures import plot
from .recording import Recording, generate, open
from .runs import Record, Run, read_record
from .stages import Predictor, Tracker

__all__ = [
    "Agent",
    "AgentType",
    "Cause",
    "DetectionFlags",
    "Detections",
    "Evaluation",
    "Evaluator",
    "Expert",
    "Forecasts",
    "Frame",
    "InputError",
    "JudgedForecasts",
    "Lane",
    "MethodForecasts",
    "MissingFileError",
    "Predictor",
    "Quality",
    "Record",
    "Recording",
    "Run",
    "TrackStatus",
    "Tracker",
    "Tracks",
    "__version__",
    "combine_states",
    "detections",
    "dtype",
    "evaluate",
    "evaluate_state",
    "generate",
    "merge_states",
    "open",
    "plot",
    "read_record",
]
