"""Frames: what a topic carries at one tick, as numpy arrays."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Any, Iterator, Optional, Tuple, Type, Union, cast

import numpy as np
import numpy.typing as npt

from . import _stgdat, checks, tables
from .numbers import AgentType, Cause, DetectionFlags, Quality

if TYPE_CHECKING:
    import pandas
    import pyarrow

Array = npt.NDArray[Any]
#: Time between ticks of detections that name no other: 12.5 Hz.
INTERVAL_NS = 80_000_000


@functools.lru_cache(maxsize=None)
def dtype(record: str, leading_bytes: Optional[int] = None) -> np.dtype[Any]:
    """The layout of a topic's elements, such as `"forecasts"`, or of a record of the wire, such as `"Header"`.

    >>> dtype("detections").names[:4]
    ('id', 'x_m', 'y_m', 'heading_rad')
    """
    return cast("np.dtype[Any]", np.dtype(cast(Any, _stgdat.layout(record, leading_bytes))))


@functools.lru_cache(maxsize=None)
def _pair(of: np.dtype[Any], first: str) -> np.dtype[Any]:
    """The layout of two neighbouring fields as one."""
    assert of.fields is not None
    offset = of.fields[first][1]
    return np.dtype({"names": ["pair"], "formats": [("<f4", (2,))], "offsets": [offset], "itemsize": of.itemsize})


def array_of(block: _stgdat.Block, layout: Union[np.dtype[Any], str]) -> Array:
    """A read-only array of the block's memory."""
    return np.asarray(block).view(layout)


class Frame:
    """Header and elements of one topic at one tick."""

    records: Array
    """The elements, with one named field for each value; `dtype` has their layout."""

    def __init__(self, frame: _stgdat.Frame) -> None:
        self._frame = frame
        self.records = array_of(frame.elements(), dtype(frame.topic, frame.element_bytes))
        self.header: Array = array_of(frame.header(), dtype("Header"))[0]

    def __len__(self) -> int:
        return len(self.records)

    def __reduce__(self) -> Tuple[Any, ...]:
        return _unpickled, self._frame.parts()

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.seq} at {self.stamp_ns / 1e9:.3f} s: {len(self)} of {self.topic}>"

    @property
    def topic(self) -> str:
        """The topic's name."""
        return self._frame.topic

    @property
    def seq(self) -> int:
        """The number of the tick."""
        return int(self.header["seq"])

    @property
    def stamp_ns(self) -> int:
        """The time at which the content is valid, on the clock of the recording or sensor."""
        return int(self.header["stamp_ns"])

    @property
    def step_s(self) -> float:
        """Time between steps of a forecast or history."""
        return int(self.header["step_ns"]) / 1e9

    @property
    def received_ns(self) -> int:
        """When the frame of a run was received, on CLOCK_MONOTONIC; else 0."""
        return self._frame.received_ns

    @property
    def origin_m(self) -> Tuple[float, float]:
        """The world frame's origin in the recording's own frame."""
        return self._frame.origin_m


class Detections(Frame):
    """What a sensor detected at one tick. `detections` makes it from arrays."""


class _Agents(Frame):
    """Agents with a state at the stamp."""

    @property
    def ids(self) -> Array:
        """Tracks, [agent]. A number is never used again."""
        return self._field("id")

    @property
    def source_ids(self) -> Array:
        """The agents' identities in the recording, [agent]; 0 without one."""
        return self._field("source_id")

    @property
    def types(self) -> Array:
        """`AgentType` as numbers, [agent]."""
        return self._field("agent_type")

    @property
    def positions_m(self) -> Array:
        """Positions at the stamp, [agent, xy]."""
        return self._pair("x_m")

    @property
    def velocities_mps(self) -> Array:
        """Velocities at the stamp, [agent, xy]."""
        return self._pair("vx_mps")

    @property
    def headings_rad(self) -> Array:
        """Headings at the stamp, [agent]."""
        return self._field("heading_rad")

    def _field(self, name: str) -> Array:
        field: Array = self.records[name]
        return field

    def _pair(self, first: str) -> Array:
        pair: Array = self.records.view(_pair(self.records.dtype, first))["pair"]
        return pair

    def _common(self) -> tables.Columns:
        names = ["x_m", "y_m", "vx_mps", "vy_mps", "heading_rad"]
        return {
            "seq": np.full(len(self), self.seq),
            "stamp_s": np.full(len(self), self.stamp_ns / 1e9),
            "id": self.ids,
            "source_id": self.source_ids,
            "type": tables.names(self.types, AgentType),
            **{name: self._field(name) for name in names},
        }


class Tracks(_Agents):
    """The tracks of one tick."""

    @property
    def existence(self) -> Array:
        """Probability that the agent exists, [agent]."""
        return self._field("existence")

    @property
    def covariances(self) -> Array:
        """Covariance of the state, [agent, 25]: row-major, `records["state_len"]` squared values."""
        return self._field("covariance")

    @property
    def history(self) -> Array:
        """Past states of the agents, oldest first, [agent, step]: x_m, y_m, vx_mps, vy_mps, heading_rad, present."""
        return self._field("history")[:, : int(self.header["counts"]["history_len"])]

    def to_pandas(self) -> pandas.DataFrame:
        """A row per agent. Needs `stgdat[pandas]`."""
        return tables.to_pandas(self._columns())

    def to_arrow(self) -> pyarrow.Table:
        """As `to_pandas`."""
        return tables.to_arrow(self._columns())

    def _columns(self) -> tables.Columns:
        return {**self._common(), "existence": self.existence}


class Agent:
    """The forecasts of one agent. Arrays are those of `Forecasts` without their first axis."""

    def __init__(self, forecasts: Forecasts, row: int) -> None:
        self._forecasts, self._row = forecasts, row
        self._modes = int(forecasts.records["modes_len"][row])

    def __repr__(self) -> str:
        x, y = self.position_m
        of = f"{self.type.name.lower()} {self.id} at ({x:.1f}, {y:.1f}) m"
        return f"<Agent {of}: {self.quality.name.lower()}, {self._modes} modes>"

    @property
    def id(self) -> int:
        """The track."""
        return int(self._forecasts.ids[self._row])

    @property
    def source_id(self) -> int:
        """The identity in the recording; 0 without one."""
        return int(self._forecasts.source_ids[self._row])

    @property
    def type(self) -> AgentType:
        """The type."""
        return AgentType(self._forecasts.types[self._row])

    @property
    def quality(self) -> Quality:
        """The origin of the forecast."""
        return Quality(self._forecasts.quality[self._row])

    @property
    def cause(self) -> Cause:
        """Why the forecast is not learned."""
        return Cause(self._forecasts.cause[self._row])

    @property
    def position_m(self) -> Array:
        """Position at the stamp, [xy]."""
        return self._of(self._forecasts.positions_m)

    @property
    def velocity_mps(self) -> Array:
        """Velocity at the stamp, [xy]."""
        return self._of(self._forecasts.velocities_mps)

    @property
    def heading_rad(self) -> float:
        """Heading at the stamp."""
        return float(self._forecasts.headings_rad[self._row])

    @property
    def modes_m(self) -> Array:
        """Positions of this agent's modes, [mode, step, xy]."""
        return self._of(self._forecasts.modes_m)[: self._modes]

    @property
    def probabilities(self) -> Array:
        """Probability of each mode, [mode]."""
        return self._of(self._forecasts.probabilities)[: self._modes]

    @property
    def mode_covariances_m2(self) -> Array:
        """Covariance of the position in each mode, [mode, step, (xx, xy, yy)]."""
        return self._of(self._forecasts.mode_covariances_m2)[: self._modes]

    @property
    def best_m(self) -> Array:
        """The single best forecast, [step, xy]."""
        return self._of(self._forecasts.best_m)

    @property
    def mean_m(self) -> Array:
        """Mean of the mixture of all modes, [step, xy]."""
        return self._of(self._forecasts.mean_m)

    @property
    def covariances_m2(self) -> Array:
        """Covariance of the mixture of all modes, [step, (xx, xy, yy)]."""
        return self._of(self._forecasts.covariances_m2)

    def _of(self, array: Array) -> Array:
        row: Array = array[self._row]
        return row


class Forecasts(_Agents):
    """The forecasts of one tick, as arrays by agent. Iteration gives an `Agent` for each row.

    Step k is `(k + 1) * step_s` after the stamp.

    >>> import stgdat
    >>> *_, last = stgdat.Predictor().run(stgdat.generate(agents=4, ticks=60))
    >>> agent = int(last.quality.argmin())
    >>> stgdat.Quality(last.quality[agent]).name
    'LEARNED'
    >>> likely = last.probabilities[agent].argmax()
    >>> path_m = last.modes_m[agent, likely]  # [step, xy]
    >>> path_m.shape
    (12, 2)
    >>> [of.id for of in last] == last.ids.tolist()
    True
    """

    def __iter__(self) -> Iterator[Agent]:
        return (Agent(self, row) for row in range(len(self)))

    def __repr__(self) -> str:
        from . import pictures

        ahead_s = self.step_s * self._steps
        return f"<Forecasts {self.seq} at {self.stamp_ns / 1e9:.3f} s: {pictures.summary(self)}, to {ahead_s:.1f} s>"

    def _repr_html_(self) -> str:
        from . import pictures

        return pictures.in_html(self)

    @property
    def times_s(self) -> Array:
        """Times of the steps after the stamp, [step]."""
        return self.step_s * np.arange(1, self._steps + 1)

    @property
    def modes_m(self) -> Array:
        """Positions, [agent, mode, step, xy]. An agent with fewer modes has zeros, with probability 0."""
        return self._field("modes")[:, : self._modes, : self._steps]

    @property
    def probabilities(self) -> Array:
        """Probability of each mode, [agent, mode]."""
        return self._field("probability")[:, : self._modes]

    @property
    def mode_covariances_m2(self) -> Array:
        """Covariance of the position in each mode, [agent, mode, step, (xx, xy, yy)]."""
        return self._field("mode_covariance")[:, : self._modes, : self._steps]

    @property
    def experts(self) -> Array:
        """`Expert` that each mode is from, as numbers, [agent, mode]."""
        return self._field("mode_expert")[:, : self._modes]

    @property
    def best_m(self) -> Array:
        """The single best forecast, [agent, step, xy]."""
        return self._field("best")[:, : self._steps]

    @property
    def mean_m(self) -> Array:
        """Mean of the mixture of all modes, [agent, step, xy]."""
        return self._field("mean")[:, : self._steps]

    @property
    def covariances_m2(self) -> Array:
        """Covariance of the mixture of all modes, [agent, step, (xx, xy, yy)]."""
        return self._field("covariance")[:, : self._steps]

    @property
    def quality(self) -> Array:
        """`Quality` as numbers, [agent]."""
        return self._field("quality")

    @property
    def cause(self) -> Array:
        """`Cause` as numbers, [agent]."""
        return self._field("cause")

    @property
    def evidence(self) -> Array:
        """Weight of each `Expert` below 8 from its earlier forecasts, [agent, expert]; zeros without a blend.

        A pedestrian has the experts *standing* and *mean velocity* in the slots 6 and 7.
        """
        return self._field("expert_weights")

    @property
    def out_of_distribution(self) -> Array:
        """Distance of each agent's history from the training data, [agent]; 0 inside."""
        return self._field("out_of_distribution")

    @property
    def conflicts(self) -> Array:
        """The most probable conflicts, [agent, 2], by fields: `other_id`, `probability`, `if_nobody_reacts`, `in_s`.

        The first `conflicts_len` of each agent are valid; the others are zeros, and so are all without the option
        `sampler.conflicts`.
        """
        return self._field("conflicts")

    @property
    def left_out(self) -> int:
        """Number of agents beyond the limit of a tick, 128, that have no forecast."""
        return int(self.header["left_out_len"])

    def to_json(self) -> bytes:
        """The line of `stgdat predict` for this tick, byte for byte."""
        return self._frame.json()

    def to_pandas(self) -> pandas.DataFrame:
        """A row per agent, mode and step. Needs `stgdat[pandas]`."""
        return tables.to_pandas(self._columns())

    def to_arrow(self) -> pyarrow.Table:
        """As `to_pandas`."""
        return tables.to_arrow(self._columns())

    @property
    def _modes(self) -> int:
        return int(self.header["counts"]["modes_len"])

    @property
    def _steps(self) -> int:
        return int(self.header["counts"]["horizon_len"])

    def _columns(self) -> tables.Columns:
        steps = self._steps
        in_use = np.arange(self._modes) < self._field("modes_len")[:, None]
        agent, mode = np.nonzero(in_use)
        agents, modes = np.repeat(agent, steps), np.repeat(mode, steps)
        common = {
            **self._common(),
            "quality": tables.names(self.quality, Quality),
            "cause": tables.names(self.cause, Cause),
        }
        path, spread = self.modes_m[agent, mode].reshape(-1, 2), self.mode_covariances_m2[agent, mode].reshape(-1, 3)
        return {
            **{name: column[agents] for name, column in common.items()},
            "mode": modes,
            "probability": self.probabilities[agents, modes],
            "time_s": np.tile(self.times_s, len(agent)),
            **{name: path[:, axis] for axis, name in enumerate(["mode_x_m", "mode_y_m"])},
            **{name: spread[:, place] for place, name in enumerate(["xx_m2", "xy_m2", "yy_m2"])},
        }


def _unpickled(*parts: Any) -> Frame:
    return frame_of(_stgdat.frame(*parts))


_KINDS = {"detections": Detections, "tracks": Tracks, "forecasts": Forecasts}


def frame_of(frame: _stgdat.Frame) -> Frame:
    """The frame as the class of its topic."""
    kind: Type[Frame] = _KINDS.get(frame.topic, Frame)
    return kind(frame)


def detections(
    stamp_ns: int,
    types: npt.ArrayLike,
    x_m: npt.ArrayLike,
    y_m: npt.ArrayLike,
    *,
    ids: Optional[npt.ArrayLike] = None,
    headings_rad: Optional[npt.ArrayLike] = None,
    speeds_mps: Optional[npt.ArrayLike] = None,
    sizes_m: Optional[npt.ArrayLike] = None,
    scores: npt.ArrayLike = 1.0,
    sigmas_m: npt.ArrayLike = 0.0,
    sensors: npt.ArrayLike = 0,
    offsets_ns: npt.ArrayLike = 0,
    ego: Tuple[float, float, float] = (0.0, 0.0, 0.0),
    seen_from_ego: bool = False,
    interval_ns: int = INTERVAL_NS,
    seq: Optional[int] = None,
    origin: Tuple[float, float] = (0.0, 0.0),
) -> Detections:
    """Makes detections from arrays, a value per detection.

    `types` are numbers of `AgentType`. `ids` are identities that the tracker may trust; without them it associates by
    position. `sizes_m` has two columns, length and width. NaN is an unknown heading, speed or size. `sensors` are
    numbers from 1 to 8; the tracker learns the noise of each. `ego` is the sensor's x, y and heading; if the sensor
    sees from there, set `seen_from_ego`. Stamps must increase. Without `seq`, `Predictor.step` numbers the tick.
    `origin` is subtracted from all positions, which then may be those of a map in UTM; forecasts have it as
    `origin_m`.

    Raises `InputError` for values that cannot be: masked ones, identities that are not whole or appear twice, sizes of
    0, positive offsets, an interval of 0. Raises `TypeError` for values that are no numbers.

    >>> tick = detections(0, [AgentType.PEDESTRIAN], [1.0], [2.0], ids=[7])
    >>> tick.records["x_m"].tolist()
    [1.0]
    """
    x, y = (
        np.atleast_1d(checks.unmasked(name, values)).astype(np.float64) - shift
        for name, values, shift in zip(("x_m", "y_m"), (x_m, y_m), origin)
    )
    ego = (ego[0] - origin[0], ego[1] - origin[1], ego[2])
    records = np.zeros(len(x), dtype("detections"))
    columns = {"x_m": x, "y_m": y, "score": scores, "sigma_m": sigmas_m}
    for name, column in columns.items():
        records[name] = checks.unmasked(name, column)
    records["sensor"] = checks.whole("sensors", sensors, 0, _stgdat.constants()["SENSORS_MAX"])
    records["agent_type"] = checks.whole("types", types, 0, (1 << 32) - 1)
    records["offset_ns"] = checks.times(stamp_ns, interval_ns, offsets_ns)
    if ids is not None:
        records["id"] = checks.identities(ids)
        records["flags"] |= np.uint32(DetectionFlags.HAS_ID)
    flagged = [("heading_rad", headings_rad, DetectionFlags.HAS_HEADING)]
    flagged.append(("speed_mps", speeds_mps, DetectionFlags.HAS_SPEED))
    if sizes_m is not None:
        sizes = checks.sizes(sizes_m, len(x))
        flagged.append(("length_m", sizes[:, 0], DetectionFlags.HAS_SIZE))
        flagged.append(("width_m", sizes[:, 1], DetectionFlags.HAS_SIZE))
    for name, values, flag in flagged:
        if values is not None:
            known = ~np.isnan(checks.unmasked(name, values).astype(np.float32))
            records[name] = np.where(known, values, 0)
            records["flags"] |= np.where(known, flag, 0).astype(np.uint32)
    has_ids = ids is not None
    frame = _stgdat.detections(records.tobytes(), stamp_ns, interval_ns, has_ids, ego, seen_from_ego, seq, origin)
    return Detections(frame)
