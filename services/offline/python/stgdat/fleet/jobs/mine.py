"""The worst ticks of a fleet by error, surprise and near-collision, cut out as small recordings."""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import PurePosixPath
from typing import Any, Dict, Iterator, List, Tuple

from ... import _stgdat
from .. import inputs
from ..inputs import Input
from ..store import Result, Store
from . import Job, Options, Report, failures, table

_UNITS = {"error": "final error, m", "surprise": "-ln density", "near-collision": "braking to avoid it, m/s²"}


class Mine(Job):
    """Ranks ticks. `count` scenes by each criterion are cut out, from `before_s` before to `after_s` after the tick."""

    name = "mine"
    columns = {f"{name.replace('-', '_')}_{what}": "float64" for name in _UNITS for what in ("worst", "at_s")}

    def __init__(self, options: Options, count: int = 10, before_s: float = 5.0, after_s: float = 5.0) -> None:
        super().__init__(options)
        self.count, self.before_s, self.after_s = count, before_s, after_s

    def identity(self) -> Dict[str, Any]:
        return {**super().identity(), "count": self.count, "apart_s": self.before_s + self.after_s}

    def work(self, recording: Input, path: str, key: str, store: Store) -> Result:
        apart_s = self.before_s + self.after_s
        ticks = json.loads(_stgdat.worst(self.options.arguments(path), self.count, apart_s))
        row: Dict[str, Any] = dict.fromkeys(self.columns)
        for tick in reversed(ticks):
            name = tick["criterion"].replace("-", "_")
            row[f"{name}_worst"], row[f"{name}_at_s"] = tick["value"], tick["stamp_ns"] / 1e9
        return {"row": row, "state": ticks}

    def merge(self, results: Iterator[Result]) -> Report:
        ranked: Dict[str, List[Tuple[float, str, Dict[str, Any]]]] = {name: [] for name in _UNITS}
        failed: List[Tuple[str, str]] = []
        count = 0
        for result in results:
            if result["error"] is not None:
                failed.append((result["name"], result["error"]))
                continue
            count += 1
            for tick in result["state"]:
                place = {"recording": result["name"], "url": result["url"], "bytes": result["bytes"]}
                ranked[tick["criterion"]].append((-tick["value"], result["name"], {**place, **tick}))
            for of in ranked.values():
                of.sort(key=lambda item: (item[0], item[1], item[2]["stamp_ns"]))
                del of[self.count :]
        text = f"# Worst scenes of {count} recordings\n"
        files: Dict[str, bytes] = {}
        scenes: List[Dict[str, Any]] = []
        for criterion, of in ranked.items():
            body = []
            for rank, (_, _, tick) in enumerate(of, 1):
                name = f"scenes/{criterion}-{rank:02}-{PurePosixPath(tick['recording']).stem}.csv"
                files[name] = self._cut(tick)
                scenes.append({**tick, "rank": rank, "file": name})
                at_s, other = tick["stamp_ns"] / 1e9, "" if tick["other"] is None else str(tick["other"])
                body.append([name, f"{tick['value']:.2f}", tick["recording"], f"{at_s:.2f}", str(tick["agent"]), other])
            head = ["file", _UNITS[criterion], "recording", "at, s", "agent", "with"]
            text += "\n" + table(criterion.capitalize(), head, body)
        return Report(text + failures(failed), {"recordings": count, "scenes": scenes}, files)

    def _cut(self, tick: Dict[str, Any]) -> bytes:
        """The scene around a tick, in stgdat's own CSV."""
        begin, end = tick["stamp_ns"] - int(self.before_s * 1e9), tick["stamp_ns"] + int(self.after_s * 1e9)
        recording = Input(tick["recording"], tick["url"], tick["bytes"])
        with inputs.local(recording) as path, tempfile.TemporaryDirectory() as folder:
            copy = os.path.join(folder, "scene.csv")
            _stgdat.cut(self.options.reading() + ["--", path], begin, end, copy)
            with open(copy, "rb") as file:
                return file.read()
