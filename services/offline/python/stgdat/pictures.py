"""Pictures of forecasts: a small one in HTML, and a large one by matplotlib."""

from __future__ import annotations

import html
from collections import Counter
from typing import TYPE_CHECKING, Any, List, Optional

import numpy as np

from .frames import Agent, Array, Forecasts
from .numbers import AgentType, DetectionFlags
from .recording import Recording

if TYPE_CHECKING:
    import matplotlib.axes

#: Colours that colour-blind readers can tell apart, by type.
COLOURS = {AgentType.VEHICLE: "#0072b2", AgentType.CYCLIST: "#009e73", AgentType.PEDESTRIAN: "#d55e00"}
#: Rows of the table in HTML.
_ROWS_MAX = 12
#: Width and height of the picture in HTML, and its margin.
_SIDE_PX, _MARGIN_PX = 320, 8


def plot(
    forecasts: Forecasts,
    recording: Optional[Recording] = None,
    ax: Optional[matplotlib.axes.Axes] = None,
) -> matplotlib.axes.Axes:
    """Draws forecasts: modes as thin lines by their probability, and the best one as a thick line.

    With `recording`, the detections of the agents before and after the stamp are grey and black dots. Positions are
    those of the recording's own frame. Needs `stgdat[plot]`.
    """
    try:
        from matplotlib import pyplot
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError("plot needs matplotlib: pip install 'stgdat[plot]'") from error
    axes: Any = pyplot.subplots()[1] if ax is None else ax
    origin = np.array(forecasts.origin_m)
    for agent in forecasts:
        here, colour = agent.position_m[None], COLOURS[agent.type]
        for path_m, probability in zip(agent.modes_m, agent.probabilities):
            x, y = (np.concatenate([here, path_m]) + origin).T
            axes.plot(x, y, color=colour, linewidth=0.8, alpha=float(np.clip(probability * 3, 0.08, 1)))
        x, y = (np.concatenate([here, agent.best_m]) + origin).T
        axes.plot(x, y, color=colour, linewidth=2)
        axes.plot(*(agent.position_m + origin), "o", color=colour, markersize=5)
    if recording is not None:
        _plot_detections(forecasts, recording, axes)
    for of in sorted(set(forecasts.types.tolist())):
        axes.plot([], [], color=COLOURS[AgentType(of)], label=AgentType(of).name.lower())
    if len(forecasts):
        axes.legend(loc="best", fontsize="small")
    axes.set(xlabel="x, m", ylabel="y, m", title=f"{forecasts.stamp_ns / 1e9:.2f} s", aspect="equal")
    drawn: matplotlib.axes.Axes = axes
    return drawn


def _plot_detections(forecasts: Forecasts, recording: Recording, axes: Any) -> None:
    """The detections in the time of the horizon before and after the stamp."""
    ahead_ns = recording.times_ns - forecasts.stamp_ns
    horizon_ns = int(1e9 * forecasts.times_s[-1])
    rows = recording.detections
    has_id = (rows["flags"] & np.uint32(DetectionFlags.HAS_ID)) > 0
    shown = np.abs(ahead_ns) <= horizon_ns
    if has_id.all():
        shown &= np.isin(rows["id"], forecasts.source_ids)
    for side, colour in ((ahead_ns <= 0, "0.7"), (ahead_ns > 0, "black")):
        x, y = (rows[name][shown & side] + shift for name, shift in zip(("x_m", "y_m"), recording.origin_m))
        axes.plot(x, y, ".", color=colour, markersize=2)


def summary(forecasts: Forecasts) -> str:
    """Counts of types and qualities: `3 agents (2 vehicle, 1 pedestrian; 3 learned)`."""

    def counts(values: List[str]) -> str:
        return ", ".join(f"{count} {value}" for value, count in Counter(values).items())

    types = counts([agent.type.name.lower() for agent in forecasts])
    qualities = counts([agent.quality.name.lower() for agent in forecasts])
    agents = f"{len(forecasts)} agent{'' if len(forecasts) == 1 else 's'}"
    return f"{agents} ({types}; {qualities})" if len(forecasts) else agents


def in_html(forecasts: Forecasts) -> str:
    """A picture and a table."""
    names = ["id", "type", "x, m", "y, m", "speed, m/s", "quality", "modes", "x, y of the best at the end, m"]
    head = "".join(f"<th>{name}</th>" for name in names)
    agents = list(forecasts)
    rows = "".join(f"<tr>{''.join(f'<td>{cell}</td>' for cell in _cells(agent))}</tr>" for agent in agents[:_ROWS_MAX])
    more = f"<div>and {len(agents) - _ROWS_MAX} more</div>" if len(agents) > _ROWS_MAX else ""
    text = html.escape(repr(forecasts))
    return f"<div>{text}</div>{_svg(agents)}<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>{more}"


def _cells(agent: Agent) -> List[str]:
    numbers = [f"{value:.1f}" for value in (*agent.position_m, np.hypot(*agent.velocity_mps))]
    end = ", ".join(f"{value:.1f}" for value in agent.best_m[-1])
    return [str(agent.id), agent.type.name.lower(), *numbers, agent.quality.name.lower(), str(len(agent.modes_m)), end]


def _svg(agents: List[Agent]) -> str:
    if not agents:
        return ""
    places = np.concatenate([np.concatenate([agent.position_m[None], agent.best_m]) for agent in agents])
    low, high = places.min(axis=0), places.max(axis=0)
    scale = (_SIDE_PX - 2 * _MARGIN_PX) / max(float((high - low).max()), 1.0)

    def points(path_m: Array) -> str:
        # The picture has y downwards.
        pixels = (path_m - (low[0], high[1])) * (scale, -scale) + _MARGIN_PX
        return " ".join(f"{x:.1f},{y:.1f}" for x, y in pixels)

    parts = []
    for agent in agents:
        here, colour = agent.position_m[None], COLOURS[agent.type]
        paths = [(path, 1.0, 0.08 + 0.9 * min(float(p), 1.0)) for path, p in zip(agent.modes_m, agent.probabilities)]
        for path_m, width, opacity in [*paths, (agent.best_m, 2.5, 1.0)]:
            line = points(np.concatenate([here, path_m]))
            parts.append(
                f'<polyline points="{line}" fill="none" stroke="{colour}" stroke-width="{width}" opacity="{opacity:.2f}"/>'
            )
        x, y = points(here).split(",")
        parts.append(f'<circle cx="{x}" cy="{y}" r="3.5" fill="{colour}"/>')
    height = int((high - low)[1] * scale) + 2 * _MARGIN_PX
    return f'<svg xmlns="http://www.w3.org/2000/svg" width="{_SIDE_PX}" height="{height}">{"".join(parts)}</svg>'
