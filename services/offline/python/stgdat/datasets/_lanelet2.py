"""Maps of lanes with links, written as Lanelet2.

Lanelet2 has no links. A lane follows another one if both its bounds begin at the nodes at which the other's bounds end,
and two lanes are neighbours if they share the way between them. So the ends of bounds that links join become one node.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot
from typing import Dict, List, Optional, Sequence, Tuple
from xml.sax.saxutils import quoteattr

Point = Tuple[float, float]
End = Tuple[int, int, int]
"""A lane, a side (0 is left), and an end (0 is the first point)."""

NEAR_M = 1.0
"""Greatest distance between the ends of the two bounds that neighbours share."""
METRES_PER_DEGREE = 111_319.5
"""Length of a degree at latitude 0, longitude 0."""


@dataclass(frozen=True)
class LaneLine:
    """A lane between two bounds in its direction."""

    id: int
    bounds_m: Tuple[List[Point], List[Point]]
    """The left and the right bound."""
    lines: Tuple[Dict[str, str], Dict[str, str]]
    """The tags of the bounds."""
    tags: Dict[str, str]
    successors: Sequence[int] = ()
    neighbours: Tuple[Optional[int], Optional[int]] = (None, None)
    """The lanes to the left and right that run in the same direction."""


def written(lanes: Sequence[LaneLine]) -> str:
    """The text of a map whose own frame is that of the points."""
    by_id = {lane.id: lane for lane in lanes}
    shared = _shared(by_id)
    nodes = _joined(by_id, shared)
    numbers: Dict[End, int] = {}
    texts: List[str] = []
    ways: List[str] = []
    way_of: Dict[Tuple[int, int], int] = {}
    first_way = 1 + sum(len(bound) for lane in lanes for bound in lane.bounds_m)

    def node(point: Point) -> int:
        x_m, y_m = point
        at = f'lat="{y_m / METRES_PER_DEGREE:.9f}" lon="{x_m / METRES_PER_DEGREE:.9f}"'
        local = _tags({"local_x": f"{x_m:.3f}", "local_y": f"{y_m:.3f}"})
        texts.append(f'<node id="{len(texts) + 1}" {at}>{local}</node>')
        return len(texts)

    def end(of: End, point: Point) -> int:
        first = _first(nodes, of)
        if first not in numbers:
            numbers[first] = node(point)
        return numbers[first]

    for lane in lanes:
        for side, points in enumerate(lane.bounds_m):
            if (lane.id, side) in shared:
                continue
            places = [end((lane.id, side, 0), points[0]), *map(node, points[1:-1]), end((lane.id, side, 1), points[-1])]
            members = "".join(f'<nd ref="{place}"/>' for place in places)
            way_of[lane.id, side] = first_way + len(ways)
            ways.append(f'<way id="{first_way + len(ways)}">{members}{_tags(lane.lines[side])}</way>')
    texts += ways
    for place, lane in enumerate(lanes):
        bounds = [way_of[shared.get((lane.id, side), (lane.id, side))] for side in (0, 1)]
        members = "".join(f'<member type="way" ref="{way}" role="{of}"/>' for way, of in zip(bounds, ("left", "right")))
        tags = _tags({"type": "lanelet", **lane.tags})
        texts.append(f'<relation id="{first_way + len(ways) + place}">{members}{tags}</relation>')
    return '<?xml version="1.0"?>\n<osm version="0.6">\n' + "\n".join(texts) + "\n</osm>\n"


def _shared(lanes: Dict[int, LaneLine]) -> Dict[Tuple[int, int], Tuple[int, int]]:
    """The right bounds that are the left bound of the right neighbour."""
    shared = {}
    for lane in lanes.values():
        right = lanes.get(lane.neighbours[1]) if lane.neighbours[1] is not None else None
        if right is None or right.neighbours[0] != lane.id:
            continue
        own, other = lane.bounds_m[1], right.bounds_m[0]
        if all(hypot(own[at][0] - other[at][0], own[at][1] - other[at][1]) <= NEAR_M for at in (0, -1)):
            shared[lane.id, 1] = (right.id, 0)
    return shared


def _joined(lanes: Dict[int, LaneLine], shared: Dict[Tuple[int, int], Tuple[int, int]]) -> Dict[End, End]:
    """Ends of bounds that are one node: each refers to another one of the node."""
    joined: Dict[End, End] = {}

    def join(a: End, b: End) -> None:
        a, b = _first(joined, a), _first(joined, b)
        if a != b:
            joined[max(a, b)] = min(a, b)

    for (lane, side), (other, other_side) in shared.items():
        for at in (0, 1):
            join((lane, side, at), (other, other_side, at))
    for line in lanes.values():
        for following in line.successors:
            for side in (0, 1) if following in lanes else ():
                join((line.id, side, 1), (following, side, 0))
    return joined


def _first(joined: Dict[End, End], end: End) -> End:
    while end in joined:
        end = joined[end]
    return end


def _tags(tags: Dict[str, str]) -> str:
    return "".join(f"<tag k={quoteattr(key)} v={quoteattr(value)}/>" for key, value in tags.items())
