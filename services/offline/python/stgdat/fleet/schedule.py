"""Gives tasks to workers, and repeats those that are lost."""

from __future__ import annotations

from collections import deque
from typing import Deque, Dict, List, Sequence

from . import work
from .executors import Executor, Lost
from .progress import Progress
from .work import Done, Spec, Task

#: Tasks per core that wait or run, so that no core waits for the driver and memory stays bounded.
IN_FLIGHT = 2
_WAIT_S = 0.5


def run(spec: Spec, tasks: Sequence[Task], executor: Executor, progress: Progress) -> List[Done]:
    """Runs all tasks. Returns what was done, in the order of the recordings.

    If a worker or a node dies, its tasks are repeated recording by recording. A recording on which a worker has died
    twice is set aside. The death of a node does not count, because it is not the recording's fault.
    """
    waiting: Deque[Task] = deque(tasks)
    done: Dict[int, Done] = {}
    running = 0
    while waiting or running:
        while waiting and running < IN_FLIGHT * max(executor.cores, 1):
            executor.submit(waiting.popleft())
            running += 1
        for task, outcome in executor.wait(_WAIT_S):
            running -= 1
            if isinstance(outcome, Lost):
                progress.lost += 1
                again, given_up = _after(spec, task, outcome)
                waiting.extendleft(reversed(again))
                outcome = given_up
            for of in outcome:
                done[of.place] = of
                progress.add(of.size, of.is_found, of.error is not None)
        progress.show()
    progress.show(is_last=True)
    return [done[place] for place in sorted(done)]


def _after(spec: Spec, task: Task, lost: Lost) -> tuple[List[Task], List[Done]]:
    """The tasks that replace a lost one, and the recordings that are set aside."""
    if len(task.recordings) > 1:
        return [Task((one,)) for one in task.recordings], []
    deaths = task.deaths + (1 if lost.is_of_worker else 0)
    if deaths < work.TRIES:
        return [Task(task.recordings, deaths)], []
    ((place, recording),) = task.recordings
    return [], [work.set_aside(spec, place, recording, f"a worker died on it {deaths} times")]
