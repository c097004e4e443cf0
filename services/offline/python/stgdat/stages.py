"""The stages in this process."""

from __future__ import annotations

from typing import Iterator, List, Mapping, Optional, Tuple, Union

from . import _stgdat
from .arguments import Origin, Path, written
from .frames import Detections, Forecasts, Frame, Tracks
from .recording import Recording
from .recording import open as open_recording


class Predictor:
    """All stages in one process, from detections to forecasts.

    >>> import stgdat
    >>> predictor = stgdat.Predictor()
    >>> for tick in stgdat.generate(agents=4, ticks=3).ticks():
    ...     forecasts = predictor.step(tick)

    `weights`, `lanes` and `map` are files; without them the embedded weights, no lanes, and the online map are used.
    `settings` sets options of stages, as `--set` does: `{"tracker.fov": (90, 80)}`. The other arguments are those of
    `stgdat predict`.

    A predictor may be shared by threads: one step runs at a time, without Python's global lock. A process that was
    forked later cannot use it, and gets a `RuntimeError`.

    Raises `FileNotFoundError` for a missing file and `InputError` for a file or value that cannot be used.
    """

    _doubts = 0

    def __init__(
        self,
        weights: Optional[Path] = None,
        lanes: Optional[Path] = None,
        map: Optional[Path] = None,
        *,
        lanes_origin: Optional[str] = None,
        origin: Optional[Origin] = None,
        seed: Optional[int] = None,
        associate: bool = False,
        retrieval: bool = True,
        memory: Optional[Path] = None,
        settings: Optional[Mapping[str, object]] = None,
    ) -> None:
        self._stages = _stgdat.Predictor(
            written(
                settings,
                weights=weights,
                lanes=lanes,
                map=map,
                lanes_origin=lanes_origin,
                origin=origin,
                seed=seed,
                associate=associate,
                no_retrieval=not retrieval,
                memory=memory,
            )
        )

    def step(self, detections: Detections) -> Forecasts:
        """Takes the detections of the next tick through all stages.

        Raises `InputError` for detections that the tracker refuses, such as those of a stamp that it has seen. A tick
        that is late, but recent, is taken into account: its forecasts are empty, and the next ones know of it.
        """
        forecasts = Forecasts(self._stages.step(_frame(detections)))
        self._doubts = int(forecasts.header["input"]["doubts"])
        return forecasts

    @property
    def doubts(self) -> List[str]:
        """Probable defects of the detections so far, such as headings in degrees: the findings of the input audit.

        The audit looks for them every 32 ticks. `reset` and `run` forget them.
        """
        return _stgdat.doubts_of(self._doubts)

    @property
    def tracks(self) -> Tracks:
        """The tracks of the last tick."""
        return Tracks(self._stages.tracks())

    @property
    def network(self) -> Tuple[Frame, Frame]:
        """What entered the attention and what left the decoder at the last tick: topics `features` and `controls`."""
        features, controls = self._stages.network()
        return Frame(features), Frame(controls)

    def run(self, recording: Union[Recording, Path], ticks: Optional[int] = None) -> Iterator[Forecasts]:
        """Plays a recording from the start, as `stgdat predict` does; the forecasts have the same bytes.

        The stages start empty, in the recording's frame and interval.
        """
        played = _opened(recording)
        self._stages.begin(played._recording)
        self._doubts = 0
        return (self.step(tick) for tick in played.ticks(ticks))

    def reset(self) -> None:
        """Forgets all earlier ticks."""
        self._stages.begin(None)
        self._doubts = 0

    def save_memory(self) -> None:
        """Writes the retrieval memory to the file of `memory`."""
        self._stages.save_memory()


class Tracker:
    """The tracker: detections to tracks.

    >>> import stgdat
    >>> tracker = stgdat.Tracker()
    >>> for tick in stgdat.generate(agents=4, ticks=20).ticks():
    ...     tracks = tracker.step(tick)
    >>> len(tracks) > 0
    True

    With `prior="learned"`, forecasts predict each track over gaps, which runs all stages. With `"kinematic"` the
    tracker runs alone. The other arguments are those of `stgdat track`.
    """

    def __init__(
        self,
        *,
        prior: str = "kinematic",
        weights: Optional[Path] = None,
        origin: Optional[Origin] = None,
        associate: bool = False,
        settings: Optional[Mapping[str, object]] = None,
    ) -> None:
        options = {"tracker.prior": prior, **(settings or {})}
        self._stages = _stgdat.Tracker(written(options, weights=weights, origin=origin, associate=associate))

    def step(self, detections: Detections) -> Tracks:
        """Takes the detections of the next tick.

        Raises `InputError` for detections that the tracker refuses.
        """
        return Tracks(self._stages.step(_frame(detections)))

    def run(self, recording: Union[Recording, Path], ticks: Optional[int] = None) -> Iterator[Tracks]:
        """Plays a recording from the start, as `stgdat track` does."""
        played = _opened(recording)
        self._stages.begin(played._recording)
        return (self.step(tick) for tick in played.ticks(ticks))

    def reset(self) -> None:
        """Forgets all earlier ticks."""
        self._stages.begin(None)


def _frame(detections: Detections) -> _stgdat.Frame:
    if not isinstance(detections, Detections):
        raise TypeError(f"expected Detections, such as those of stgdat.detections, not {type(detections).__name__}")
    return detections._frame


def _opened(recording: Union[Recording, Path]) -> Recording:
    return recording if isinstance(recording, Recording) else open_recording(recording)
