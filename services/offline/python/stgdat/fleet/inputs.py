"""The recordings of a job: files in folders, lists and any address of fsspec."""

from __future__ import annotations

import contextlib
import fnmatch
import hashlib
import os
import re
import tempfile
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any, Iterable, Iterator, List, Sequence, Tuple, Union

import fsspec

from ..recording import Recording
from .store import Store

Path = Union[str, "os.PathLike[str]"]
Paths = Union[Path, Recording, Iterable[Union[Path, Recording]]]
#: Files of a folder that are recordings.
PATTERNS = ("*.csv", "*.mcap")
_CHUNK = 1 << 20


@dataclass(frozen=True)
class Input:
    """A recording: a name, the address of its file, and the file's size."""

    name: str
    url: str
    size: int


def find(paths: Union[Path, Iterable[Path]], patterns: Sequence[str] = PATTERNS) -> List[Input]:
    """The recordings at these paths, in the order of their names.

    A path is a file, a folder, an address such as `s3://bucket/drives`, or `@FILE` for a list with a path per line.
    `patterns` select the files of a folder. Names begin with the folder, so that they do not depend on its place.
    """
    if isinstance(paths, (str, os.PathLike)):
        paths = [paths]
    found: List[Input] = []
    for path in [os.fspath(path) for path in paths]:
        listed = _lines(path[1:]) if path.startswith("@") else [path]
        for one in listed:
            found += _at(one, patterns)
    return sorted(set(found), key=lambda of: (of.name, of.url))


def stored(paths: Paths, store: Store) -> List[Path]:
    """The paths, with recordings as files. One that has no file is written to the store, which all workers reach."""
    if isinstance(paths, (str, os.PathLike, Recording)):
        paths = [paths]
    return [_stored(path, store) if isinstance(path, Recording) else path for path in paths]


def _stored(recording: Recording, store: Store) -> str:
    if recording.path is not None:
        return recording.path
    content = recording._recording.csv()
    # Two recordings may have the same name.
    name = re.sub(r"[^\w.-]+", "_", recording.name) + "_" + hashlib.sha256(content).hexdigest()[:8]
    store.write(f"recordings/{name}.csv", content)
    return store.address(f"recordings/{name}.csv")


def _lines(path: str) -> List[str]:
    with fsspec.open(path, "rt") as file:
        lines = [line.strip() for line in file]
    return [line for line in lines if line and not line.startswith("#")]


def _at(path: str, patterns: Sequence[str]) -> List[Input]:
    fs, root = fsspec.core.url_to_fs(path)
    if fs.isdir(root):
        top = PurePosixPath(root)
        files: Iterable[Tuple[str, Any]] = fs.find(root, detail=True).items()
        named = [
            (str(PurePosixPath(top.name) / PurePosixPath(file).relative_to(top)), file, about)
            for file, about in files
            if any(fnmatch.fnmatch(PurePosixPath(file).name, pattern) for pattern in patterns)
        ]
    else:
        named = [("/".join(PurePosixPath(root).parts[-2:]), root, fs.info(root))]
    return [Input(name, fs.unstrip_protocol(file), int(about["size"] or 0)) for name, file, about in named]


@contextlib.contextmanager
def local(of: Input) -> Iterator[str]:
    """The path of the recording on this machine; a copy for the time of the block if it is elsewhere."""
    fs, path = fsspec.core.url_to_fs(of.url)
    if isinstance(fs, fsspec.get_filesystem_class("file")):
        yield path
        return
    with tempfile.TemporaryDirectory(prefix="stgdat_fleet_") as folder:
        parts = PurePosixPath(of.name).parts[-2:]
        copy = os.path.join(folder, *parts)
        os.makedirs(os.path.dirname(copy), exist_ok=True)
        fs.get_file(path, copy)
        yield copy


def digest(path: str) -> str:
    """SHA-256 of a file."""
    found = hashlib.sha256()
    with open(path, "rb") as file:
        for chunk in iter(lambda: file.read(_CHUNK), b""):
            found.update(chunk)
    return found.hexdigest()
