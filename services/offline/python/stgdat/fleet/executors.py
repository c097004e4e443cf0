"""Where tasks run: in this process, in processes of this machine, or on a cluster of Ray."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
from collections import deque
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import Any, Deque, Dict, List, Optional, Protocol, Tuple, Union

from . import work
from .work import Done, Spec, Task


@dataclass(frozen=True)
class Lost:
    """A task whose worker or node died."""

    why: str
    #: Whether the worker alone died, and not its node.
    is_of_worker: bool


Outcome = Tuple[Task, Union[List[Done], Lost]]


class Executor(Protocol):
    """Runs tasks, each on one core."""

    @property
    def cores(self) -> int:
        """Tasks that run at the same time now."""

    def submit(self, task: Task) -> None:
        """Starts a task when a core is free."""

    def wait(self, timeout_s: float) -> List[Outcome]:
        """The tasks that have ended, after at most this time."""

    def close(self) -> None:
        """Ends the workers."""


class Here:
    """Runs tasks in this process, one after the other."""

    cores = 1

    def __init__(self, spec: Spec) -> None:
        self._spec = spec
        self._tasks: Deque[Task] = deque()

    def submit(self, task: Task) -> None:
        self._tasks.append(task)

    def wait(self, timeout_s: float) -> List[Outcome]:
        task = self._tasks.popleft()
        return [(task, work.run(self._spec, task))]

    def close(self) -> None:
        self._tasks.clear()


def _serve(spec: Spec, connection: Connection) -> None:
    """A worker: answers each task with what was done, or with the error that ends the job."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    while True:
        try:
            task = connection.recv()
        except EOFError:
            return
        try:
            connection.send(work.run(spec, task))
        except Exception as error:
            connection.send(error)


class _Worker:
    """A process with a pipe to it. The end of the process closes the pipe."""

    def __init__(self, spec: Spec) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(spec, theirs), daemon=True)
        self.process.start()
        theirs.close()
        self.task: Optional[Task] = None


class Processes:
    """Runs tasks in processes of this machine."""

    def __init__(self, spec: Spec, processes: Optional[int] = None) -> None:
        self._spec = spec
        self._workers = [_Worker(spec) for _ in range(processes or len(os.sched_getaffinity(0)))]
        self._waiting: Deque[Task] = deque()

    @property
    def cores(self) -> int:
        return len(self._workers)

    def submit(self, task: Task) -> None:
        self._waiting.append(task)
        self._feed()

    def _feed(self) -> None:
        for worker in self._workers:
            if worker.task is None and self._waiting:
                worker.task = self._waiting.popleft()
                with contextlib.suppress(OSError):  # A dead worker loses the task, which `wait` reports.
                    worker.connection.send(worker.task)

    def wait(self, timeout_s: float) -> List[Outcome]:
        busy = [worker for worker in self._workers if worker.task is not None]
        ready = set(wait([worker.connection for worker in busy], timeout_s))
        outcomes = [self._outcome(worker) for worker in busy if worker.connection in ready]
        self._feed()
        return outcomes

    def _outcome(self, worker: _Worker) -> Outcome:
        task, worker.task = worker.task, None
        assert task is not None
        try:
            outcome = worker.connection.recv()
        except (EOFError, OSError):
            worker.process.join()
            worker.connection.close()
            self._workers[self._workers.index(worker)] = _Worker(self._spec)
            return task, Lost(f"exit code {worker.process.exitcode}", is_of_worker=True)
        if isinstance(outcome, Exception):
            raise outcome
        return task, outcome

    def close(self) -> None:
        for worker in self._workers:
            worker.connection.close()
            if worker.task is not None:
                worker.process.terminate()
            worker.process.join()


class Ray:
    """Runs tasks on a cluster of Ray; Ray chooses the node of each."""

    def __init__(self, spec: Spec, address: str) -> None:
        try:
            import ray
        except ModuleNotFoundError as error:
            raise ModuleNotFoundError("a cluster needs Ray: pip install 'stgdat[fleet]'") from error
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        self._ray: Any = ray
        self._is_own = not ray.is_initialized()
        if self._is_own:
            ray.init(address=address, log_to_driver=False, include_dashboard=None if address != "local" else False)
        # A task that is lost comes back to the scheduler, which knows what to blame.
        self._run: Any = ray.remote(num_cpus=1, max_retries=0)(work.run)
        self._spec = ray.put(spec)
        self._tasks: Dict[Any, Task] = {}

    @property
    def cores(self) -> int:
        return int(self._ray.cluster_resources().get("CPU", 1))

    def submit(self, task: Task) -> None:
        self._tasks[self._run.remote(self._spec, task)] = task

    def wait(self, timeout_s: float) -> List[Outcome]:
        references = list(self._tasks)
        ended, _ = self._ray.wait(references, num_returns=len(references), timeout=0)
        if not ended:
            ended, _ = self._ray.wait(references, num_returns=1, timeout=timeout_s)
        return [self._outcome(reference) for reference in ended]

    def _outcome(self, reference: Any) -> Outcome:
        task = self._tasks.pop(reference)
        errors = self._ray.exceptions
        try:
            return task, self._ray.get(reference)
        except errors.RayTaskError:
            raise
        except (errors.WorkerCrashedError, errors.OutOfMemoryError) as error:
            return task, Lost(_first_line(error), is_of_worker=True)
        except errors.RayError as error:
            return task, Lost(_first_line(error), is_of_worker=False)

    def close(self) -> None:
        for reference in self._tasks:
            self._ray.cancel(reference, force=True)
        if self._is_own:
            self._ray.shutdown()


def _first_line(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0]
