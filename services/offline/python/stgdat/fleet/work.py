"""What a worker does: the recordings of a task, one after the other."""

from __future__ import annotations

import functools
import hashlib
import json
import time
from dataclasses import dataclass
from typing import Any, List, Optional, Sequence, Tuple

from .. import _stgdat
from . import inputs
from .inputs import Input
from .jobs import Job
from .store import Store

#: Tries before a recording is set aside.
TRIES = 2


@dataclass(frozen=True)
class Spec:
    """What all tasks of a job share."""

    job: Job
    store: Store
    build: str


@dataclass(frozen=True)
class Task:
    """Recordings that one worker takes, each with its place in the job."""

    recordings: Tuple[Tuple[int, Input], ...]
    #: Workers that died on the task, which then has one recording.
    deaths: int = 0

    @property
    def size(self) -> int:
        """Bytes."""
        return sum(recording.size for _, recording in self.recordings)


@dataclass(frozen=True)
class Done:
    """A recording is done: the name of its result."""

    place: int
    key: str
    size: int
    is_found: bool
    error: Optional[str]
    seconds: float


class OtherBuild(Exception):
    """The worker has another build of stgdat than the driver."""


@functools.lru_cache(maxsize=None)
def build() -> str:
    """Identifies the compiled part: another build makes other results."""
    return inputs.digest(str(_stgdat.__file__))


def key_of(spec: Spec, recording: Input, content: str) -> str:
    """The name of a result: a hash of the recording's content and name, the job, its options, and the build."""
    parts = [content, recording.name, spec.job.name, spec.job.identity(), spec.build]
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def run(spec: Spec, task: Task) -> List[Done]:
    """Does the recordings of a task that are not done yet. A recording that fails has its error as its result."""
    if build() != spec.build:
        raise OtherBuild("a worker has another build of stgdat than the driver: install the same wheel on all nodes")
    return [_run(spec, place, recording) for place, recording in task.recordings]


def _run(spec: Spec, place: int, recording: Input) -> Done:
    begin = time.monotonic()
    error = None
    try:
        with inputs.local(recording) as path:
            key = key_of(spec, recording, inputs.digest(path))
            if spec.store.has_result(key):
                error = spec.store.result(key).get("error")
                return Done(place, key, recording.size, True, error, time.monotonic() - begin)
            result, error = _tried(spec, recording, path, key)
    except OSError as failed:
        # Not readable now; a later run of the job tries again.
        key, error = key_of(spec, recording, "unread"), f"{type(failed).__name__}: {failed}"
        result = {}
    spec.store.write_result(key, {**_about(recording), **result, "error": error})
    return Done(place, key, recording.size, False, error, time.monotonic() - begin)


def _tried(spec: Spec, recording: Input, path: str, key: str) -> Tuple[Any, Optional[str]]:
    error = None
    for _ in range(TRIES):
        try:
            return spec.job.work(recording, path, key, spec.store), None
        except (KeyboardInterrupt, SystemExit):
            raise
        except BaseException as failed:  # A panic of Rust is no `Exception`.
            # The path on this machine is not part of the result.
            error = f"{type(failed).__name__}: {failed}".replace(path, recording.name)
    return {}, error


def _about(recording: Input) -> Any:
    return {"name": recording.name, "url": recording.url, "bytes": recording.size}


def set_aside(spec: Spec, place: int, recording: Input, why: str) -> Done:
    """Writes the result of a recording on which workers die."""
    try:
        with inputs.local(recording) as path:
            content = inputs.digest(path)
    except OSError:
        content = "unread"
    key = key_of(spec, recording, content)
    spec.store.write_result(key, {**_about(recording), "error": why})
    return Done(place, key, recording.size, False, why, 0.0)


def tasks(recordings: Sequence[Input], task_bytes: int, cores: int) -> List[Task]:
    """Groups neighbours to tasks of at most `task_bytes`, and to many more tasks than cores."""
    most = max(1, min(64, len(recordings) // (32 * max(cores, 1))))
    grouped: List[Task] = []
    group: List[Tuple[int, Input]] = []
    size = 0
    for place, recording in enumerate(recordings):
        if group and (len(group) >= most or size + recording.size > task_bytes):
            grouped.append(Task(tuple(group)))
            group, size = [], 0
        group.append((place, recording))
        size += recording.size
    if group:
        grouped.append(Task(tuple(group)))
    return grouped
