"""Evidence priors for a team's own roads: a file for `--set sampler.prior=FILE`."""

from __future__ import annotations

from pathlib import PurePosixPath
from typing import Dict, Iterator, List, Tuple

from ... import _stgdat
from ..inputs import Input
from ..store import Result, Store
from . import Job, Report, failures, table

#: Name of the file.
FILE = "prior.json"
#: Recordings of a source that contribute. A prior does not change after so many, and memory stays bounded.
RECORDINGS_MAX = 500


class Priors(Job):
    """Learns what experts and modes are worth. The folder of a recording names its source, such as a road."""

    name = "priors"
    columns = {"source": "string"}

    def work(self, recording: Input, path: str, key: str, store: Store) -> Result:
        return {"row": {"source": _source(recording.name)}, "state": _stgdat.learn(self.options.arguments(path))}

    def merge(self, results: Iterator[Result]) -> Report:
        sources: Dict[str, _Kept] = {}
        failed: List[Tuple[str, str]] = []
        for result in results:
            if result["error"] is not None:
                failed.append((result["name"], result["error"]))
            else:
                sources.setdefault(result["row"]["source"], _Kept()).add(result["state"])
        learned = [(name, state) for name, kept in sorted(sources.items()) for state in kept.states]
        text = _stgdat.priors(learned)
        count = sum(kept.count for kept in sources.values())
        body = [[name, str(kept.count), str(len(kept.states))] for name, kept in sorted(sources.items())]
        tables = f"# Priors of {count} recordings\n\n`--set sampler.prior={FILE}` starts from them.\n\n"
        tables += table("Sources", ["source", "recordings", "that contribute"], body)
        figures = {"recordings": count, "sources": {name: kept.count for name, kept in sorted(sources.items())}}
        return Report(tables + failures(failed), figures, {FILE: text.encode() + b"\n"})


class _Kept:
    """States of a source, spread evenly over its recordings: every second one is dropped if they are too many."""

    def __init__(self) -> None:
        self.states: List[str] = []
        self.count = 0
        self._every = 1

    def add(self, state: str) -> None:
        if self.count % self._every == 0:
            self.states.append(state)
        self.count += 1
        if len(self.states) > RECORDINGS_MAX:
            del self.states[1::2]
            self._every *= 2


def _source(name: str) -> str:
    return str(PurePosixPath(name).parent)
