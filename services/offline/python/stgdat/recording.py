"""Recordings."""

from __future__ import annotations

import builtins
import functools
import os
from typing import TYPE_CHECKING, Any, Dict, Iterator, List, Mapping, Optional, Tuple, Union

import numpy as np
import numpy.typing as npt

from . import _stgdat, checks, tables
from . import columns as columns_of
from .arguments import Origin, Path, written
from .frames import Array, Detections, array_of, dtype
from .lanes import Lane, read_lanes
from .numbers import AgentType, DetectionFlags

if TYPE_CHECKING:
    import pandas
    import pyarrow

_AGENT = np.dtype([("id", "<u8"), ("agent_type", "<u4"), ("first_ns", "<i8"), ("last_ns", "<i8"), ("rows", "<i8")])


class Recording:
    """A recording: frames of detections in time order.

    `open` and `generate` make it, and `Recording.from_arrays` and `Recording.from_pandas` of your own data. Pickle
    stores how it was made: another process opens the file again, and refuses a file that has changed. A recording from
    arrays is stored itself.

    >>> import stgdat
    >>> recording = stgdat.generate(agents=4, ticks=10)
    >>> len(recording), recording.detections.dtype.names[:3]
    (10, ('id', 'x_m', 'y_m'))
    """

    detections: Array
    """All detections in time order; `dtype("detections")` has their fields."""
    stamps_ns: Array
    """The time of each frame, [frame]."""
    offsets: Array
    """The rows of frame i are `detections[offsets[i]:offsets[i + 1]]`, [frame + 1]."""

    def __init__(self, recording: _stgdat.Recording, remade: Tuple[Any, ...]) -> None:
        self._recording = recording
        self._remade = remade
        self.detections = array_of(recording.detections(), dtype("detections"))
        self.stamps_ns = array_of(recording.stamps_ns(), "<i8")
        self.offsets = array_of(recording.offsets(), "<i8")

    def __reduce__(self) -> Tuple[Any, ...]:
        return self._remade

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def __repr__(self) -> str:
        return f"<Recording {self.name}: {len(self)} frames, {len(self.detections)} detections>"

    @classmethod
    def from_arrays(
        cls,
        types: Union[str, AgentType, npt.ArrayLike],
        x_m: npt.ArrayLike,
        y_m: npt.ArrayLike,
        *,
        stamp_s: Optional[npt.ArrayLike] = None,
        stamp_ns: Optional[npt.ArrayLike] = None,
        ids: Optional[npt.ArrayLike] = None,
        headings_rad: Optional[npt.ArrayLike] = None,
        speeds_mps: Optional[npt.ArrayLike] = None,
        sizes_m: Optional[npt.ArrayLike] = None,
        scores: Optional[npt.ArrayLike] = None,
        sigmas_m: Optional[npt.ArrayLike] = None,
        sensors: Optional[npt.ArrayLike] = None,
        name: str = "arrays",
        origin: Origin = (0.0, 0.0),
    ) -> Recording:
        """Makes a recording of arrays, with a value per detection.

        `types` are `AgentType`, their numbers or names, or one of them for all rows. The names `ego` and `above` mark poses
        of the sensor. Give `stamp_s` or `stamp_ns`, and the latter for clocks since 1970. `sizes_m` has two columns,
        length and width. `sensors` are numbers from 1 to 8. NaN is an unknown value. The rows are read as those of a
        CSV file, with all its checks.

        Raises `InputError` with row, column and value, and `TypeError` for values that are no numbers.

        >>> recording = Recording.from_arrays("vehicle", [0.0, 0.8], [0.0, 0.0], stamp_s=[0.0, 0.1], ids=[1, 1])
        >>> len(recording), recording.interval_ns
        (2, 100000000)
        """
        given = {"stamp_s": stamp_s, "stamp_ns": stamp_ns, "id": ids, "type": types, "x_m": x_m, "y_m": y_m}
        given.update(heading_rad=headings_rad, speed_mps=speeds_mps, score=scores, sigma_m=sigmas_m)
        given.update(sensor=sensors)
        if sizes_m is not None:
            sizes = np.asarray(sizes_m)
            if sizes.ndim != 2 or sizes.shape[1] != 2:
                raise _stgdat.InputError(f"sizes_m has the shape {sizes.shape}: expected two columns, length and width")
            given.update(length_m=sizes[:, 0], width_m=sizes[:, 1])
        labels = {"id": "ids", "type": "types", "heading_rad": "headings_rad", "speed_mps": "speeds_mps"}
        labels.update(score="scores", sigma_m="sigmas_m", sensor="sensors", length_m="sizes_m[:, 0]", width_m="sizes_m[:, 1]")
        return _of_columns({key: values for key, values in given.items() if values is not None}, name, labels, origin)

    @classmethod
    def from_pandas(
        cls,
        frame: pandas.DataFrame,
        columns: Optional[Mapping[str, Any]] = None,
        *,
        name: str = "data frame",
        origin: Origin = (0.0, 0.0),
    ) -> Recording:
        """Makes a recording of a data frame, with a row per detection.

        The columns have the names of the CSV format: `stamp_s` or `stamp_ns`, `type`, `x_m`, `y_m`, and, if they are known,
        `id`, `heading_rad`, `speed_mps`, `length_m`, `width_m`, `score`, `sigma_m`, `sensor`. `columns` names those
        that the frame calls otherwise: `{"x_m": "east", "speed_mps": None}` reads x from `east`, and no speed. The
        unit must be that of the key. Times of pandas can be `stamp_ns`. Columns with other names are left out, but a
        name such as `yaw`, which may have another unit, must be in `columns`.

        Raises `InputError` with row, column and value, and `TypeError` for values that are no numbers. Rows count from
        0, whatever the index.
        """
        found = columns_of.named([str(column) for column in frame.columns], columns or {})
        at = {str(column): place for place, column in enumerate(frame.columns)}
        given = {key: frame.iloc[:, at[column]] for key, column in found.items()}
        labels = {key: f"{column} ({key})" for key, column in found.items() if key != column}
        return _of_columns(given, name, labels, origin)

    def lanes(self, path: Path, *, lanes_origin: Optional[str] = None) -> List[Lane]:
        """The lanes of a Lanelet2 map of the recording's site.

        `lanes_origin` is the position of the world frame's origin in the map, `"LAT,LON"` or `"X,Ym"`. Without it the
        map has the recording's own frame.

        Raises `InputError` for a file that is no map, or whose coordinates need `lanes_origin`.
        """
        return read_lanes(self._recording, path, lanes_origin)

    def split(self, share: float = 0.8) -> Tuple[Recording, Recording]:
        """The recording before and after this share of its time, such as a part to train on and one to validate.

        No frame is in both. With 0.8 the parts are those of `stgdat train FILE`.

        >>> import stgdat
        >>> earlier, later = stgdat.generate(agents=4, ticks=10).split(0.8)
        >>> len(earlier), len(later)
        (8, 2)
        """
        if not 0.0 <= share <= 1.0:
            raise _stgdat.InputError(f"share = {share}: expected 0 to 1")
        earlier, later = _stgdat.split(self._recording, share)
        return Recording(earlier, (_part, (self, share, 0))), Recording(later, (_part, (self, share, 1)))

    def save(self, path: Path) -> None:
        """Writes the recording as CSV, with positions in the world frame. `open` reads it again."""
        with builtins.open(path, "wb") as file:
            file.write(self._recording.csv())

    @property
    def name(self) -> str:
        """Name in reports."""
        return self._recording.name

    @property
    def path(self) -> Optional[str]:
        """The file; `None` for a recording that was generated or made of arrays."""
        return self._recording.path

    @property
    def sha256(self) -> str:
        """SHA-256 of the files; empty for a generated recording."""
        return self._recording.sha256

    @property
    def interval_ns(self) -> int:
        """Nominal time between frames."""
        return self._recording.interval_ns

    @property
    def has_identities(self) -> bool:
        """Whether the detections have identities that the tracker may trust."""
        return self._recording.has_identities

    @property
    def origin_m(self) -> Tuple[float, float]:
        """The world frame's origin in the recording's own frame."""
        return self._recording.origin_m

    @functools.cached_property
    def doubts(self) -> List[str]:
        """Probable defects, such as headings in degrees. `stgdat inspect` names their lines."""
        return self._recording.doubts()

    @property
    def types(self) -> Array:
        """`AgentType` of each detection as numbers, [row]."""
        types: Array = self.detections["agent_type"]
        return types

    @functools.cached_property
    def times_ns(self) -> Array:
        """The time of each detection, [row]."""
        times: Array = np.repeat(self.stamps_ns, np.diff(self.offsets)) + self.detections["offset_ns"]
        return times

    @functools.cached_property
    def agents(self) -> Array:
        """Identities with type, first and last time and number of detections, in the order of their numbers."""
        known = (self.detections["flags"] & np.uint32(DetectionFlags.HAS_ID)) > 0
        named, times_ns = self.detections[known], self.times_ns[known]
        ids, first, agent, rows = np.unique(named["id"], return_index=True, return_inverse=True, return_counts=True)
        agents = np.zeros(len(ids), _AGENT)
        agents["id"], agents["rows"], agents["agent_type"] = ids, rows, named["agent_type"][first]
        agents["first_ns"] = np.iinfo(np.int64).max
        agents["last_ns"] = np.iinfo(np.int64).min
        np.minimum.at(agents["first_ns"], agent, times_ns)
        np.maximum.at(agents["last_ns"], agent, times_ns)
        return agents

    def ticks(self, count: Optional[int] = None) -> Iterator[Detections]:
        """The ticks that `stgdat predict` plays, at most `count`. A recording above 12.5 Hz is thinned."""
        return map(Detections, self._recording.play(count))

    def to_pandas(self) -> pandas.DataFrame:
        """A row per detection. Needs `stgdat[pandas]`."""
        return tables.to_pandas(self._columns())

    def to_arrow(self) -> pyarrow.Table:
        """As `to_pandas`."""
        return tables.to_arrow(self._columns())

    def _columns(self) -> tables.Columns:
        numbers = ["id", "x_m", "y_m", "heading_rad", "speed_mps", "length_m", "width_m", "score"]
        columns = {name: self.detections[name] for name in numbers}
        return {"stamp_s": self.times_ns / 1e9, "type": tables.names(self.types, AgentType), **columns}


def open(
    path: Path,
    *,
    format: Optional[str] = None,
    fps: Optional[float] = None,
    origin: Optional[Origin] = None,
) -> Recording:
    """Reads a recording: any file or folder that `stgdat predict` plays.

    `format` is detected unless it is given. `fps` is the rate of frame numbers, for formats whose files do not hold
    it. `origin` is subtracted from all positions, in metres.

    Raises `InputError` with file, line and value, and `FileNotFoundError` for a missing file.
    """
    return _made(written(format=format, fps=fps, origin=origin) + ["--", os.path.abspath(checks.existing(path))], False)


def generate(*, agents: int = 32, ticks: int = 250, seed: int = 1, complete: bool = False) -> Recording:
    """Generates an intersection, as `stgdat predict` does without a recording.

    With `complete`, all agents are detected in every frame, with their identities, and nothing else is detected. This
    is the scene of `stgdat bench`.
    """
    return _made(written({"source.agents": agents}, ticks=ticks, seed=seed), complete)


def _made(arguments: List[str], complete: bool) -> Recording:
    recording = _stgdat.open(arguments, complete)
    return Recording(recording, (_reopened, (arguments, complete, recording.sha256)))


def _reopened(arguments: List[str], complete: bool, sha256: str) -> Recording:
    recording = _made(arguments, complete)
    if recording.sha256 != sha256:
        raise _stgdat.InputError(f"{recording.path}: the file has changed since the recording was pickled")
    return recording


def _part(recording: Recording, share: float, part: int) -> Recording:
    return recording.split(share)[part]


def _of_columns(columns: Mapping[str, Any], name: str, labels: Mapping[str, str], origin: Origin) -> Recording:
    return parsed(columns_of.written(name, columns, labels), name, dict(labels), origin)


def parsed(text: bytes, name: str, labels: Dict[str, str], origin: Origin) -> Recording:
    shift = (float(origin[0]), float(origin[1]))
    return Recording(_stgdat.parse_columns(text, name, labels, shift), (parsed, (text, name, labels, shift)))
