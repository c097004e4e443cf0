"""Figures of recordings."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Dict, Iterable, List, Optional, Union

from . import _stgdat
from .arguments import Origin, Path, written
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
    """What was not evaluated, with the reason."""
    doubts: List[str]
    """Probable defects of the recordings."""
    table: str
    """The main table, in Markdown."""
    tables: str
    """All tables, in Markdown, as with `--all`."""

    def to_pandas(self) -> pandas.DataFrame:
        """A row per figure. Needs `stgdat[pandas]`."""
        import pandas

        return pandas.json_normalize(self.figures)


def evaluate(
    recordings: Union[Path, Recording, Iterable[Union[Path, Recording]]],
    weights: Optional[Path] = None,
    *,
    format: Optional[str] = None,
    fps: Optional[float] = None,
    origin: Optional[Origin] = None,
    positions: bool = False,
    threads: Optional[int] = None,
) -> Evaluation:
    """Compares forecasts with the recorded motion, beside constant velocity and other baselines.

    `positions` derives velocities and headings from the positions alone. Figures do not depend on `threads`.

    Raises `InputError` for a recording that cannot be read or has no agent to evaluate.
    """
    if isinstance(recordings, (str, os.PathLike, Recording)):
        recordings = [recordings]
    paths = [_path(recording) for recording in recordings]
    arguments = written(weights=weights, format=format, fps=fps, origin=origin)
    text, table, tables, doubts = _stgdat.evaluate(paths, arguments, positions, threads)
    report = json.loads(text)
    return Evaluation(report["figures"], report["provenance"], report["left_out"], doubts, table, tables)


def _path(recording: Union[Path, Recording]) -> str:
    if not isinstance(recording, Recording):
        return os.fspath(recording)
    if recording.path is None:
        raise _stgdat.InputError("a generated recording has no file to evaluate")
    return recording.path
