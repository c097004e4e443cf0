"""Runs a job: finds the recordings, distributes them, and merges the results in the order of their names."""

from __future__ import annotations

import json
import os
import sys
from dataclasses import dataclass, field
from typing import Any, Callable, Dict, Iterator, List, Mapping, Optional, Sequence, TextIO, Union

from . import inputs, schedule, work
from .executors import Executor, Here, Processes, Ray
from .inputs import Path, Paths
from .jobs import Job, Report
from .progress import Progress
from .store import Result, Store
from .work import Done, Spec

#: Rows of the table of recordings that are in memory at a time.
_ROWS = 10_000
_MIB = 1 << 20


@dataclass(frozen=True)
class Place:
    """Where a job runs, and what limits it."""

    address: Optional[str] = None
    """A cluster of Ray: `auto`, `ray://HOST:10001`, or `local` to start one here; processes of this machine without."""
    processes: Optional[int] = None
    """Processes of this machine without a cluster: one per core unless given; 0 computes in this process."""
    task_mib: float = 64.0
    """Largest sum of the sizes of a task's recordings. A larger recording is a task of its own."""
    patterns: Sequence[str] = field(default=inputs.PATTERNS)
    """The files of a folder that are recordings."""
    progress: Optional[TextIO] = sys.stderr
    """Where the progress goes."""

    def executor(self, spec: Spec) -> Executor:
        """Starts the workers."""
        if self.address is not None:
            return Ray(spec, self.address)
        return Here(spec) if self.processes == 0 else Processes(spec, self.processes)


@dataclass(frozen=True)
class Finished:
    """A job that is done."""

    report: Report
    done: List[Done]
    """What was done for each recording, in the order of their names."""
    output: str
    """The folder of the results."""

    @property
    def failed(self) -> List[Done]:
        """The recordings that were set aside."""
        return [done for done in self.done if done.error is not None]


def run(
    job: Job,
    paths: Paths,
    output: Path,
    place: Place = Place(),
    executor: Optional[Callable[[Spec], Executor]] = None,
) -> Finished:
    """Runs a job over the recordings at `paths`. What an earlier run has done is not done again.

    Raises `FileNotFoundError` if there is no recording, and `InputError` for options that cannot work.
    """
    if place.address is None:
        # The files of the options are on this machine, too.
        job.check()
    store = Store(os.fspath(output))
    recordings = inputs.find(inputs.stored(paths, store), place.patterns)
    if not recordings:
        raise FileNotFoundError(f"no recording: folders are searched for {', '.join(place.patterns)}")
    spec = Spec(job, store, work.build())
    workers = (executor or place.executor)(spec)
    try:
        tasks = work.tasks(recordings, int(place.task_mib * _MIB), workers.cores)
        progress = Progress(len(recordings), sum(of.size for of in recordings), place.progress)
        done = schedule.run(spec, tasks, workers, progress)
    finally:
        workers.close()
    report = _merged(job, store, [of.key for of in done])
    store.write("tables.md", report.text.encode())
    store.write("figures.json", (json.dumps(report.figures, indent=1) + "\n").encode())
    for name, content in report.files.items():
        store.write(name, content)
    return Finished(report, done, store.url)


def _merged(job: Job, store: Store, keys: Sequence[str]) -> Report:
    """Merges the results, and writes the table of recordings while they pass."""
    with _Rows(job.columns) as rows:

        def passing() -> Iterator[Result]:
            for result in store.results(keys):
                rows.add(result)
                yield result

        report = job.merge(passing())
    store.write("recordings.parquet", rows.content())
    return report


class _Rows:
    """A Parquet file with a row per recording, in memory."""

    def __init__(self, columns: Mapping[str, str]) -> None:
        import pyarrow
        import pyarrow.parquet

        self._columns = {"name": "string", "url": "string", "bytes": "int64", "error": "string", **columns}
        types: List[Any] = [(name, pyarrow.type_for_alias(of)) for name, of in self._columns.items()]
        self._arrow: Any = pyarrow
        self._schema = pyarrow.schema(types)
        self._sink = pyarrow.BufferOutputStream()
        self._writer = pyarrow.parquet.ParquetWriter(self._sink, self._schema, compression="zstd")
        self._rows: List[Dict[str, Any]] = []

    def __enter__(self) -> _Rows:
        return self

    def __exit__(self, *_: object) -> None:
        self._flush()
        self._writer.close()

    def add(self, result: Result) -> None:
        own = {name: result.get(name) for name in ("name", "url", "bytes", "error")}
        self._rows.append({**own, **result.get("row", {})})
        if len(self._rows) >= _ROWS:
            self._flush()

    def _flush(self) -> None:
        if self._rows:
            self._writer.write_table(self._arrow.Table.from_pylist(self._rows, self._schema))
            self._rows = []

    def content(self) -> bytes:
        content: bytes = self._sink.getvalue().to_pybytes()
        return content
