"""Live runs and records of runs."""

from __future__ import annotations

import functools
import json
import os
from typing import Any, Dict, Iterator, List, Optional

from . import _stgdat
from .arguments import Path
from .frames import Frame, frame_of

#: Wait for the next frame of a live run before the tap is asked again.
_WAIT_S = 3600.0


class Run:
    """A run of `stgdat run` on this machine. `Run.attach` finds it.

    Reading goes through the run's tap, which takes part in no tick. A slow program loses frames, and the run loses
    none.
    """

    name: str
    """The run's name, as `stgdat top` prints it."""
    root: str
    """The run's folder."""
    about: Dict[str, Any]
    """Version, weights, scene, and the settings of all stages."""
    lost: int
    """Frames that this program was too slow for."""

    def __init__(self, name: str, root: str, about: Dict[str, Any]) -> None:
        self.name, self.root, self.about, self.lost = name, root, about, 0

    @classmethod
    def attach(cls, name: Optional[Path] = None) -> Run:
        """The run with this name or folder; the only one on this machine without a name.

        Raises `InputError` if there is none, or more than one.
        """
        found, root, about = _stgdat.living_run(None if name is None else os.fspath(name))
        return cls(found, os.fspath(root), json.loads(about))

    def __repr__(self) -> str:
        return f"<Run {self.name}: {self.about['scene']}>"

    def frames(self, *topics: str, timeout_s: Optional[float] = None) -> Iterator[Frame]:
        """The frames of these topics from now on, in the order of their receipt, until the run ends.

        Ends, too, if no frame arrives for `timeout_s`. A topic is one of `stgdat wire`: `detections`, `tracks`,
        `forecasts`, … Raises `ConnectionError` if the run's tap cannot be read.
        """
        tap = _stgdat.Tap(self.root, _known(topics), False)
        return self._frames(tap, timeout_s)

    def _frames(self, tap: _stgdat.Tap, timeout_s: Optional[float]) -> Iterator[Frame]:
        while True:
            try:
                item = tap.next(_WAIT_S if timeout_s is None else timeout_s)
            except EOFError:
                return
            if isinstance(item, _stgdat.Frame):
                if item.is_tick:
                    yield frame_of(item)
            elif isinstance(item, int):
                self.lost += item
            elif item is None and timeout_s is not None:
                return


class Record:
    """A record of a run: an MCAP file of `stgdat record`, `run --record` or a flight recorder."""

    def __init__(self, path: Path) -> None:
        self._record = _stgdat.Record(path)
        self.path = os.fspath(path)

    @functools.cached_property
    def about(self) -> Dict[str, Any]:
        """Version, weights, scene, and the settings of all stages."""
        about: Dict[str, Any] = json.loads(self._record.about())
        return about

    @property
    def incomplete(self) -> Optional[str]:
        """Why the file has no proper end; `None` if it has."""
        return self._record.incomplete()

    def damages(self) -> List[str]:
        """The damaged parts of the file, which are left out. Reads the whole file."""
        return self._record.damages()

    def frames(self, *topics: str) -> Iterator[Frame]:
        """The frames of these topics, in the order of their receipt."""
        for item in self._record.messages(_known(topics), False):
            if isinstance(item, _stgdat.Frame) and item.is_tick:
                yield frame_of(item)

    def events(self) -> Iterator[Dict[str, Any]]:
        """Events of the run and log lines of its stages, in time order."""
        for item in self._record.messages([], True):
            if isinstance(item, str):
                yield json.loads(item)


def read_record(path: Path) -> Record:
    """Opens a record of a run.

    Raises `InputError` if the file is not a record of this version.
    """
    return Record(path)


def _known(topics: tuple[str, ...]) -> List[str]:
    for topic in topics:
        try:
            _stgdat.layout(topic, None)
        except KeyError:
            raise _stgdat.InputError(f"there is no topic {topic!r}: `stgdat wire --json` lists them") from None
    return list(topics)
