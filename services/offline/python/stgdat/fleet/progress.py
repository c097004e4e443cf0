"""A line on standard error: how much is done, how fast, and how long it takes yet."""

from __future__ import annotations

import sys
import time
from typing import Callable, Optional, TextIO

#: Seconds between lines in a terminal and in a log.
_EVERY_S = (0.5, 15.0)


class Progress:
    """Counts recordings and bytes. The time left follows both, because neither alone shows the work that is left."""

    def __init__(
        self,
        recordings: int,
        size: int,
        output: Optional[TextIO] = sys.stderr,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.recordings, self.size = recordings, max(size, 1)
        self.done = self.found = self.failed = self.lost = 0
        self._bytes = self._new_bytes = 0
        self._output, self._clock = output, clock
        self._begin = self._shown = clock()

    def add(self, size: int, is_found: bool, is_failed: bool) -> None:
        """Counts a recording. `is_found`: an earlier run of the job had done it."""
        self.done += 1
        self.found += is_found
        self.failed += is_failed
        self._bytes += size
        self._new_bytes += 0 if is_found else size
        self.show()

    def show(self, is_last: bool = False) -> None:
        """Prints the line if it is time."""
        if self._output is None:
            return
        terminal, now = self._output.isatty(), self._clock()
        if not is_last and now - self._shown < _EVERY_S[0 if terminal else 1]:
            return
        self._shown = now
        end = "\n" if is_last or not terminal else ""
        self._output.write(("\r\x1b[K" if terminal else "") + self.line() + end)
        self._output.flush()

    def line(self) -> str:
        """The line."""
        passed_s = max(self._clock() - self._begin, 1e-9)
        parts = [f"{self.done}/{self.recordings} recordings"]
        new = self.done - self.found
        if new:
            parts.append(f"{new / passed_s:.3g}/s")
        if self._new_bytes and self.done < self.recordings:
            of_bytes = (self.size - self._bytes) / self._new_bytes
            left_s = passed_s * (of_bytes + (self.recordings - self.done) / new) / 2
            parts.append(f"{_time(left_s)} left")
        for count, what in [(self.found, "done before"), (self.failed, "set aside"), (self.lost, "tasks repeated")]:
            if count:
                parts.append(f"{count} {what}")
        return ", ".join(parts)


def _time(seconds: float) -> str:
    whole = int(seconds + 0.5)
    hours, minutes = divmod(whole // 60, 60)
    return f"{hours}:{minutes:02}:{whole % 60:02}" if hours else f"{minutes}:{whole % 60:02}"
