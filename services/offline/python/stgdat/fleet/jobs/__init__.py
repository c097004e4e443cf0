"""What a job computes of one recording, and how the results become one."""

from __future__ import annotations

import abc
import hashlib
import os
from dataclasses import dataclass, field
from typing import Any, ClassVar, Dict, Iterator, List, Mapping, Optional, Tuple

from ... import _stgdat
from ...arguments import written
from .. import inputs
from ..inputs import Input
from ..store import Result, Store

#: Types of the columns of rows in Arrow, where they are not numbers with a fraction. A column without a value has its
#: type too, so that the files of all recordings are one table.
_TYPES = {
    **dict.fromkeys(("recording", "type", "quality", "cause"), "string"),
    **dict.fromkeys(("seq", "track", "agent", "contact_with"), "uint64"),
    "stamp_ns": "int64",
}
#: A worker has one core, so each stage has one thread.
_WORKERS = {f"{stage}.workers": 1 for stage in ("encoder", "decoder", "extractor", "sampler")}


@dataclass(frozen=True)
class Options:
    """How recordings are read and forecast. All names of files are as the workers see them."""

    weights: Optional[str] = None
    lanes: Optional[str] = None
    lanes_origin: Optional[str] = None
    map: Optional[str] = None
    settings: Mapping[str, object] = field(default_factory=dict)
    format: Optional[str] = None
    fps: Optional[float] = None
    origin: Optional[Tuple[float, float]] = None
    #: Whether each agent and tick has a row in a Parquet file.
    rows: bool = False

    def arguments(self, path: str) -> List[str]:
        """The arguments of `stgdat predict` for a recording."""
        settings = {**_WORKERS, **self.settings}
        model = written(settings, weights=self.weights, lanes=self.lanes, lanes_origin=self.lanes_origin, map=self.map)
        return [*self.reading(), *model, "--", path]

    def check(self) -> None:
        """Raises `InputError` or `FileNotFoundError` for options that no recording can be read or forecast with."""
        _stgdat.check(self.arguments("")[:-2])

    def reading(self) -> List[str]:
        """The arguments on how recordings are read."""
        return written(format=self.format, fps=self.fps, origin=self.origin)

    def identity(self) -> Dict[str, Any]:
        """Everything that a result depends on, with the content of files instead of their names."""
        settings = {name: content(str(value)) for name, value in self.settings.items()}
        files = {name: getattr(self, name) for name in ("weights", "lanes", "map")}
        return {
            **{name: None if value is None else content(value) for name, value in files.items()},
            "lanes_origin": self.lanes_origin,
            "settings": settings,
            "reading": self.reading(),
            "rows": self.rows,
        }


def content(text: str) -> str:
    """The digest of a file's content, or the text if it is no file, such as the name of shipped weights."""
    return inputs.digest(text) if os.path.isfile(text) else text


@dataclass
class Report:
    """The result of a job."""

    text: str
    """Tables in Markdown."""
    figures: Any
    """The same as numbers, for JSON."""
    files: Dict[str, bytes] = field(default_factory=dict)
    """More files, by name."""


class Job(abc.ABC):
    """A job. Workers receive a copy of it."""

    name: ClassVar[str]
    columns: ClassVar[Mapping[str, str]] = {}
    """The columns of a recording's row besides its name and address, with their types in Arrow."""

    def __init__(self, options: Options) -> None:
        self.options = options

    def check(self) -> None:
        """Raises an error for options that cannot work, before the first recording."""
        self.options.check()

    def identity(self) -> Dict[str, Any]:
        """Everything besides the recording that a result depends on."""
        return self.options.identity()

    @abc.abstractmethod
    def work(self, recording: Input, path: str, key: str, store: Store) -> Result:
        """The result of one recording. `row` has the values of `columns`; `state` is for `merge`."""

    @abc.abstractmethod
    def merge(self, results: Iterator[Result]) -> Report:
        """One result of all, in the order of the recordings' names. A result with an `error` has no state."""


def write_rows(recording: Input, columns: Mapping[str, List[Any]], key: str, store: Store) -> None:
    """Writes a Parquet file of a recording with a row for each agent and tick."""
    import pyarrow
    import pyarrow.parquet

    count = len(next(iter(columns.values()), []))
    named = {"recording": [recording.name] * count, **columns}
    types = [(name, pyarrow.type_for_alias(_TYPES.get(name, "float64"))) for name in named]
    table = pyarrow.table(named, pyarrow.schema(types))
    sink = pyarrow.BufferOutputStream()
    pyarrow.parquet.write_table(table, sink, compression="zstd")
    store.write(f"rows/{key[:2]}/{key}.parquet", sink.getvalue().to_pybytes())


def table(title: str, head: List[str], rows: List[List[str]]) -> str:
    """A table in Markdown: the first column is text, the others are numbers."""
    lines = [head, ["---"] + ["---:"] * (len(head) - 1), *rows]
    return f"## {title}\n\n" + "".join("| " + " | ".join(line) + " |\n" for line in lines)


def failures(failed: List[Tuple[str, str]]) -> str:
    """A list of the recordings that were set aside, with their errors."""
    if not failed:
        return ""
    lines = "".join(f"* {name}: {' '.join(error.split())}\n" for name, error in failed)
    return f"\n## Set aside\n\n{lines}"


__all__ = ["Job", "Options", "Report", "content", "failures", "table", "write_rows", "_stgdat"]
