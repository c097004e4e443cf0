"""Forecasts against observed motion: the state of each recording, and the tables of all."""

from __future__ import annotations

import base64
import functools
from typing import Any, Dict, Iterator, List, Optional, Tuple

from ... import _stgdat
from ...evaluation import Evaluation, Evaluator, combine_states, merge_states
from ..inputs import Input
from ..store import Result, Store
from . import Job, Options, Report, failures, write_rows

#: States that are in memory at a time.
_TOGETHER = 256
#: Figures of the row, by method and measure, and by quantity.
_FIGURES = {
    ("ours, online retrieval, evidence", "K = 1"): "best_",
    ("ours, online retrieval, evidence", "minADE₂₀ / minFDE₂₀"): "min_",
    ("constant velocity", "K = 1"): "constant_velocity_",
}
_QUANTITIES = {"ADE, m": "ade_m", "FDE, m": "fde_m"}


class Evaluate(Job):
    """Evaluates recordings, as `stgdat evaluate FILE…` does."""

    name = "evaluate"
    columns = {
        "agents": "int64",
        **{f"{method}_{of}_m": "float64" for method in ("best", "min", "constant_velocity") for of in ("ade", "fde")},
        "doubts": "int64",
    }

    def __init__(self, options: Options, positions: bool = False) -> None:
        super().__init__(options)
        if options.settings:
            names = ", ".join(options.settings)
            raise _stgdat.InputError(f"{names}: the evaluation has no options of stages; `replay` compares them")
        self.positions = positions

    def identity(self) -> Dict[str, Any]:
        return {**super().identity(), "positions": self.positions}

    def work(self, recording: Input, path: str, key: str, store: Store) -> Result:
        if self.options.rows:
            write_rows(recording, _stgdat.outcomes(self.options.arguments(path)), key, store)
        state = _evaluator(self.options, self.positions).state(path)
        return {"row": _row(merge_states([state])), "state": base64.b64encode(state).decode()}

    def merge(self, results: Iterator[Result]) -> Report:
        whole: Optional[bytes] = None
        states: List[bytes] = []
        failed: List[Tuple[str, str]] = []
        for result in results:
            if result["error"] is not None:
                failed.append((result["name"], result["error"]))
                continue
            states.append(base64.b64decode(result["state"]))
            if len(states) == _TOGETHER:
                whole, states = combine_states(([] if whole is None else [whole]) + states), []
        states = ([] if whole is None else [whole]) + states
        if not states:
            return Report("# Recordings\n" + failures(failed), {"failed": [f"{name}: {why}" for name, why in failed]})
        evaluation = merge_states(states, failed)
        figures = {name: getattr(evaluation, name) for name in ("figures", "left_out", "failed", "doubt_counts")}
        return Report(evaluation.text, figures, {"all-tables.md": evaluation.tables.encode()})


@functools.lru_cache(maxsize=1)
def _loaded(arguments: Tuple[Tuple[str, Any], ...], positions: bool) -> Evaluator:
    return Evaluator(**dict(arguments), positions=positions, threads=1)


def _evaluator(of: Options, positions: bool) -> Evaluator:
    """The evaluator of this worker, which loads the weights once."""
    names = ("weights", "lanes", "lanes_origin", "map", "format", "fps", "origin")
    return _loaded(tuple((name, getattr(of, name)) for name in names), positions)


def _row(evaluation: Evaluation) -> Dict[str, Any]:
    """The published forecasts and constant velocity over the whole horizon, all agents together."""
    of_all = [of for of in evaluation.figures if of["subset"] == "all"]
    horizon_s = max((of["horizon_s"] for of in of_all), default=0.0)
    row: Dict[str, Any] = {"agents": 0, "doubts": len(evaluation.doubts)}
    for of in of_all:
        prefix = _FIGURES.get((of["method"], of["measure"]))
        if prefix is not None and of["horizon_s"] == horizon_s and of["quantity"] in _QUANTITIES:
            row[prefix + _QUANTITIES[of["quantity"]]] = of["value"]
            row["agents"] = max(row["agents"], of["agents"])
    return row
