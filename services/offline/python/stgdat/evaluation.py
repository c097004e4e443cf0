"""Figures of recordings."""

from __future__ import annotations

import json
import os
import tempfile
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Dict, Iterable, List, Optional, Tuple, Union

from . import _stgdat, checks
from .arguments import Origin, Path, written
from .judged import JudgedForecasts, judged
from .recording import Recording

if TYPE_CHECKING:
    import pandas


@dataclass(frozen=True)
class Evaluation:
    """What `stgdat evaluate FILE…` prints."""

    figures: List[Dict[str, Any]]
    """Every figure, as in `--json`."""
    provenance: List[Dict[str, Any]]
    """The weights behind the figures of each recording."""
    left_out: List[str]
    """What was not evaluated because no agent is there long enough, one line each."""
    failed: List[str]
    """Recordings that could not be evaluated, with the reason."""
    doubts: List[str]
    """Probable defects of the recordings; empty if there are too many recordings to keep each."""
    doubt_counts: Dict[str, Dict[str, int]]
    """Recordings, rows and examined rows by the kind of doubt."""
    text: str
    """What `stgdat evaluate` prints: the main table, and what is not in it."""
    table: str
    """The main table, in Markdown."""
    tables: str
    """All tables, in Markdown, as with `--all`."""
    forecasts: Optional[JudgedForecasts] = None
    """Every forecast behind the tables, if `forecasts=True` asked for them."""

    def to_pandas(self) -> pandas.DataFrame:
        """A row per figure. Needs `stgdat[pandas]`."""
        import pandas

        return pandas.json_normalize(self.figures)


class Evaluator:
    """Evaluates one recording after the other with the same weights, which it loads once.

    `map` is `"online"` or `"none"`. `lanes` is the Lanelet2 map of the recordings' site, along whose lanes vehicles are
    forecast. `positions` derives velocities and headings from the positions alone. States do not depend on `threads`.
    """

    def __init__(
        self,
        weights: Optional[Path] = None,
        *,
        lanes: Optional[Path] = None,
        lanes_origin: Optional[str] = None,
        map: Optional[str] = None,
        format: Optional[str] = None,
        fps: Optional[float] = None,
        origin: Optional[Origin] = None,
        positions: bool = False,
        threads: Optional[int] = None,
    ) -> None:
        if map not in (None, "online", "none"):
            raise _stgdat.InputError(f"map = {map!r}: expected 'online' or 'none'")
        arguments = written(
            weights=weights, lanes=lanes, lanes_origin=lanes_origin, format=format, fps=fps, origin=origin
        )
        self._arguments = (arguments, map != "none", positions, threads)
        self._inner = _stgdat.Evaluator(*self._arguments, None)

    def __getstate__(self) -> Dict[str, Any]:
        return {"_arguments": self._arguments}

    def __setstate__(self, state: Dict[str, Any]) -> None:
        self._arguments = state["_arguments"]
        self._inner = _stgdat.Evaluator(*self._arguments, None)

    def state(self, path: Union[Path, Recording], name: Optional[str] = None) -> bytes:
        """The sums behind the tables of one recording. `merge_states` makes tables from such states.

        A `Recording` is evaluated as it was read. `path` may be the record of a run, whose detections are evaluated.
        `name` replaces the name of the recording in tables: for a file that was copied to a temporary place. Raises
        `InputError` for a recording that cannot be read.
        """
        if isinstance(path, Recording):
            return self._inner.state_of(path._recording, name)
        return self._inner.state(checks.existing(path), name)

    def evaluate(
        self, recordings: Union[Path, Recording, Iterable[Union[Path, Recording]]], forecasts: bool = False
    ) -> Evaluation:
        """The figures of recordings. See `stgdat.evaluate`."""
        if forecasts:
            with tempfile.TemporaryDirectory() as folder:
                path = os.path.join(folder, "forecasts.jsonl")
                writing = Evaluator.__new__(Evaluator)
                writing._arguments = self._arguments
                writing._inner = _stgdat.Evaluator(*self._arguments, path)
                evaluation = writing.evaluate(recordings)
                writing._inner.finish_lines()
                with open(path, encoding="utf-8") as lines:
                    return replace(evaluation, forecasts=judged(lines))
        if isinstance(recordings, (str, os.PathLike, Recording)):
            recordings = [recordings]
        opened, paths = [], []
        for recording in recordings:
            if isinstance(recording, Recording):
                opened.append(self._inner.state_of(recording._recording, None))
            else:
                paths.append(checks.existing(recording))
        return _evaluation(combine_states(opened + [self._inner.states(paths)] if paths or not opened else opened))


def evaluate(
    recordings: Union[Path, Recording, Iterable[Union[Path, Recording]]],
    weights: Optional[Path] = None,
    *,
    format: Optional[str] = None,
    fps: Optional[float] = None,
    origin: Optional[Origin] = None,
    positions: bool = False,
    threads: Optional[int] = None,
    forecasts: bool = False,
) -> Evaluation:
    """Compares forecasts with the recorded motion, beside constant velocity and other baselines.

    `positions` derives velocities and headings from the positions alone. Figures do not depend on `threads`.
    `forecasts=True` also returns every forecast behind the tables with its truth: about 30 kB per agent and time.

    A recording that cannot be read is a line of `failed`. Raises `InputError` if no recording can be evaluated.
    """
    evaluator = Evaluator(weights, format=format, fps=fps, origin=origin, positions=positions, threads=threads)
    return evaluator.evaluate(recordings, forecasts)


def evaluate_state(
    path: Union[Path, Recording],
    weights: Optional[Path] = None,
    *,
    lanes: Optional[Path] = None,
    map: Optional[str] = None,
    threads: Optional[int] = None,
) -> bytes:
    """The state of one recording. Use an `Evaluator` for several, or for further options."""
    return Evaluator(weights, lanes=lanes, map=map, threads=threads).state(path)


def combine_states(states: Iterable[bytes], failures: Iterable[Tuple[str, str]] = ()) -> bytes:
    """Merges states into one. Every split and every order gives the same bytes.

    `failures` are recordings without a state, with the reason. Raises `InputError` if there is no state, or if states
    have different weights, options or versions.
    """
    return _stgdat.combine(states, list(failures))


def merge_states(states: Iterable[bytes], failures: Iterable[Tuple[str, str]] = ()) -> Evaluation:
    """The figures of the recordings behind states: the same as `evaluate` of all recordings at once."""
    return _evaluation(combine_states(states, failures))


def _evaluation(state: bytes) -> Evaluation:
    text, printed, table, tables, doubts = _stgdat.report(state)
    report = json.loads(text)
    return Evaluation(
        figures=report["figures"],
        provenance=report["provenance"],
        left_out=report["left_out"],
        failed=report["failed"],
        doubts=doubts,
        doubt_counts=report["doubts"],
        text=printed,
        table=table,
        tables=tables,
    )
