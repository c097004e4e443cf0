"""The results of a job in a folder that all workers reach.

A worker writes the result of a recording under a temporary name and renames it. The name is a hash of everything
that the result depends on. So a task that runs twice writes the same file, a file is whole or absent, and a job that
starts again finds what is done.
"""

from __future__ import annotations

import gzip
import json
import os
import uuid
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Dict, Iterator, Sequence

import fsspec

Result = Dict[str, Any]
#: Results that are read at the same time.
_READERS = 16
_BLOCK = 256


class Store:
    """Files under a folder or an address of fsspec."""

    def __init__(self, url: str) -> None:
        self.url = url
        self._fs, self._root = fsspec.core.url_to_fs(url)
        self._is_local = isinstance(self._fs, fsspec.get_filesystem_class("file"))

    def __reduce__(self) -> Any:
        return Store, (self.url,)

    def path(self, name: str) -> str:
        """The place of a file, for messages and for other programs."""
        return f"{self._root}/{name}"

    def address(self, name: str) -> str:
        """The address of a file, for workers."""
        return str(self._fs.unstrip_protocol(self.path(name)))

    def exists(self, name: str) -> bool:
        """Whether the file is there, and whole."""
        return bool(self._fs.exists(self.path(name)))

    def write(self, name: str, content: bytes) -> None:
        """Writes a file, whole or not at all."""
        path = self.path(name)
        if not self._is_local:
            # An object store shows an object when it is whole.
            self._fs.pipe_file(path, content)
            return
        os.makedirs(os.path.dirname(path), exist_ok=True)
        part = f"{path}.{uuid.uuid4().hex}.part"
        try:
            with open(part, "wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            os.replace(part, path)
        except BaseException:
            if os.path.exists(part):
                os.unlink(part)
            raise

    def write_result(self, key: str, result: Result) -> None:
        """Writes the result of a recording."""
        text = json.dumps(result, sort_keys=True, separators=(",", ":"))
        self.write(_name(key), gzip.compress(text.encode(), compresslevel=6, mtime=0))

    def has_result(self, key: str) -> bool:
        """Whether the recording is done."""
        return self.exists(_name(key))

    def result(self, key: str) -> Result:
        """The result of a recording."""
        result: Result = json.loads(gzip.decompress(self._fs.cat_file(self.path(_name(key)))))
        return result

    def results(self, keys: Sequence[str]) -> Iterator[Result]:
        """The results in the order of the keys. A few are in memory at a time."""
        with ThreadPoolExecutor(_READERS) as readers:
            for begin in range(0, len(keys), _BLOCK):
                yield from readers.map(self.result, keys[begin : begin + _BLOCK])


def _name(key: str) -> str:
    return f"results/{key[:2]}/{key}.json.gz"
