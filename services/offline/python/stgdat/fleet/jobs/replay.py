"""Another build or other weights over the same recordings: where forecasts differ, and which got better."""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import PurePosixPath
from typing import Any, Dict, Iterator, List, Optional, Tuple

from ... import _stgdat
from .. import inputs
from ..inputs import Input
from ..store import Result, Store
from . import Job, Options, Report, content, failures, table, write_rows

_COUNTS = ("forecasts", "different", "matured", "better", "worse")
_SUMS = ("before_m", "after_m")
_LISTED = 10
#: Recordings that changed most have a page.
_PAGES = 3


class Replay(Job):
    """Compares forecasts of the options with those that a record holds.

    A record of a run holds the forecasts of the build that made it. For any other recording this build forecasts
    twice: with the weights `before` and default settings, and with the options.
    """

    name = "replay"
    columns = {
        "forecasts": "int64",
        "different": "int64",
        "farthest_m": "float64",
        "matured": "int64",
        "better": "int64",
        "worse": "int64",
        "before_ade_m": "float64",
        "after_ade_m": "float64",
        "before_fde_m": "float64",
        "after_fde_m": "float64",
        "only_before": "int64",
        "only_after": "int64",
    }

    def __init__(self, options: Options, before: Optional[str] = None) -> None:
        super().__init__(options)
        self.before = before

    def identity(self) -> Dict[str, Any]:
        before = None if self.before is None else content(self.before)
        return {**super().identity(), "before": before}

    def check(self) -> None:
        super().check()
        Options(self.before).check()

    def work(self, recording: Input, path: str, key: str, store: Store) -> Result:
        text, columns = _stgdat.differences(self._earlier().arguments(path), self.options.arguments(path))
        if self.options.rows:
            write_rows(recording, columns, key, store)
        state = json.loads(text)
        return {"row": _row(state), "state": state}

    def _earlier(self) -> Options:
        of = self.options
        return Options(self.before, format=of.format, fps=of.fps, origin=of.origin)

    def _page(self, recording: Input) -> bytes:
        """The page that compares both forecasts of a recording."""
        with inputs.local(recording) as path, tempfile.TemporaryDirectory() as folder:
            _stgdat.compare(self._earlier().arguments(path), self.options.arguments(path), folder)
            with open(os.path.join(folder, "page.html"), "rb") as file:
                return file.read()

    def merge(self, results: Iterator[Result]) -> Report:
        types: Dict[str, Dict[str, Any]] = {}
        failed: List[Tuple[str, str]] = []
        rows: List[Tuple[Input, Dict[str, Any]]] = []
        count = only_before = only_after = 0
        for result in results:
            if result["error"] is not None:
                failed.append((result["name"], result["error"]))
                continue
            count += 1
            state = result["state"]
            only_before += state["only_before"]
            only_after += state["only_after"]
            for name, counts in state["types"].items():
                types[name] = counts if name not in types else _sum(types[name], counts)
            rows.append((Input(result["name"], result["url"], result["bytes"]), result["row"]))
            # The recordings that changed most are enough.
            rows.sort(key=lambda item: (-item[1]["farthest_m"], item[0].name))
            del rows[_LISTED:]
        text = f"# Forecasts of {count} recordings, before and after\n\n"
        if only_before or only_after:
            text += f"{only_before} forecasts exist only before, and {only_after} only after.\n\n"
        head = ["agents", "forecasts", "different", "farthest, m", "matured", "better", "worse", "ADE / FDE before, m"]
        body = [_line(name, counts) for name, counts in types.items() if counts["forecasts"]]
        text += table("By type", head + ["after, m"], body) + "\n"
        files: Dict[str, bytes] = {}
        listed = []
        for rank, (recording, row) in enumerate(rows, 1):
            if not row["different"]:
                continue
            page = ""
            if rank <= _PAGES:
                page = f"pages/{rank:02}-{PurePosixPath(recording.name).stem}.html"
                files[page] = self._page(recording)
            counts = [str(row[name]) for name in ("different", "better", "worse")]
            listed.append([recording.name, f"{row['farthest_m']:.2f}", *counts, page])
        if listed:
            head = ["recording", "farthest, m", "different", "better", "worse", "page"]
            text += table("Recordings that changed most", head, listed)
        figures = {"recordings": count, "types": types, "only_before": only_before, "only_after": only_after}
        return Report(text + failures(failed), figures, files)


def _sum(a: Dict[str, Any], b: Dict[str, Any]) -> Dict[str, Any]:
    counts = {name: a[name] + b[name] for name in _COUNTS}
    sums = {name: [x + y for x, y in zip(a[name], b[name])] for name in _SUMS}
    return {**counts, **sums, "farthest_m": max(a["farthest_m"], b["farthest_m"])}


def _row(state: Dict[str, Any]) -> Dict[str, Any]:
    all_types = list(state["types"].values())
    total = all_types[0]
    for counts in all_types[1:]:
        total = _sum(total, counts)
    row = {name: total[name] for name in (*_COUNTS, "farthest_m")}
    for side in ("before", "after"):
        for place, error in enumerate(("ade", "fde")):
            matured = total["matured"]
            row[f"{side}_{error}_m"] = total[f"{side}_m"][place] / matured if matured else None
    return {**row, "only_before": state["only_before"], "only_after": state["only_after"]}


def _line(name: str, counts: Dict[str, Any]) -> List[str]:
    matured = counts["matured"]

    def errors(side: str) -> str:
        return " / ".join(f"{total / matured:.3f}" for total in counts[side]) if matured else "-"

    return [
        name,
        str(counts["forecasts"]),
        str(counts["different"]),
        f"{counts['farthest_m']:.2f}",
        str(matured),
        str(counts["better"]),
        str(counts["worse"]),
        errors("before_m"),
        errors("after_m"),
    ]
