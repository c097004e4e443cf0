"""The doubts of the input audit over a fleet: degrees instead of radians, jumps of identities, gaps."""

from __future__ import annotations

import json
from typing import Dict, Iterator, List, Tuple

from ... import _stgdat
from ..inputs import Input
from ..store import Result, Store
from . import Job, Report, failures, table

#: Recordings that a table lists for each kind of doubt.
_LISTED = 10


class Audit(Job):
    """Examines recordings, as `stgdat inspect` does."""

    name = "audit"
    columns = {
        "sha256": "string",
        "frames": "int64",
        "rows": "int64",
        "span_s": "float64",
        "interval_ms": "float64",
        "gaps": "int64",
        "identities": "bool",
        "doubts": "string",
    }

    def work(self, recording: Input, path: str, key: str, store: Store) -> Result:
        text = _stgdat.inspect(self.options.arguments(path)).replace(path, recording.name)
        found = json.loads(text)
        doubts = [of for of in found["findings"] if of["doubtful"]]
        row = {name: found[name] for name in self.columns if name != "doubts"}
        row["doubts"] = ", ".join(of["kind"] for of in doubts)
        return {"row": row, "state": doubts}

    def merge(self, results: Iterator[Result]) -> Report:
        kinds: Dict[str, List[Tuple[str, Result]]] = {}
        failed: List[Tuple[str, str]] = []
        count = doubtful = rows = 0
        for result in results:
            if result["error"] is not None:
                failed.append((result["name"], result["error"]))
                continue
            count += 1
            rows += result["row"]["rows"]
            doubtful += bool(result["state"])
            for doubt in result["state"]:
                kinds.setdefault(doubt["kind"], []).append((result["name"], doubt))
        ranked = sorted(kinds.items(), key=lambda item: (-len(item[1]), item[0]))
        text = f"# Doubts about {count} recordings\n\n{doubtful} recordings are doubtful, of {rows} rows in all.\n\n"
        head = ["doubt", "recordings", "rows"]
        body = [[kind, str(len(of)), str(sum(doubt["rows"] or 0 for _, doubt in of))] for kind, of in ranked]
        text += table("Kinds", head, body)
        for kind, of in ranked:
            worst = sorted(of, key=lambda item: (-(item[1]["share"] or 0.0), item[0]))[:_LISTED]
            text += f"\n## {kind}\n\n"
            for name, doubt in worst:
                first = f" (first: {doubt['first']})" if doubt["first"] else ""
                text += f"* {name}: {doubt['sentence']}{first}\n"
        figures = {
            "recordings": count,
            "doubtful": doubtful,
            "rows": rows,
            "kinds": {kind: [name for name, _ in of] for kind, of in ranked},
            "set_aside": [{"name": name, "error": error} for name, error in failed],
        }
        return Report(text + failures(failed), figures)
