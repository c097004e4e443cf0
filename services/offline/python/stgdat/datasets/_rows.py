"""What the data sets share: the rows of a recording, as text of stgdat's own CSV, and the command line.

Each row is an agent at one time, or the pose of the sensor (`ego`). Positions are metres in the data set's own world
frame, from which an origin may be subtracted. Stamps begin at 0.

The modules of this folder import neither numpy nor the rest of the package, so that the command line runs without the
wheel.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
from typing import Any, Callable, Dict, Hashable, List, Optional, Tuple, TypeVar, Union

T = TypeVar("T")
Origin = Union[str, Tuple[float, float]]
"""`none`, `first`, or what is subtracted from all positions."""
Size = Tuple[float, float]

COLUMNS = "stamp_s,id,type,x_m,y_m,heading_rad,speed_mps,length_m,width_m"
POSITION_MAX_M = 32768.0
"""Coordinates that stgdat reads."""
HEADING_SPEED_MPS = 0.1
"""Speed from which the direction of motion is a heading."""


class Failed(Exception):
    """Input that can't be converted; the message names the file and what is wrong with it."""


def yaw_rad(qw: float, qx: float, qy: float, qz: float) -> float:
    """The turn about z of a rotation, counter-clockwise."""
    return math.atan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))


def motion(kind: str, yaw: float, vx_mps: float, vy_mps: float) -> Tuple[Optional[float], float]:
    """Heading and speed of an agent with a velocity in the world frame. The heading of a slow pedestrian is None.

    Pedestrians walk in any direction, so their heading is that of the velocity.
    """
    speed_mps = math.hypot(vx_mps, vy_mps)
    if kind == "pedestrian":
        return (math.atan2(vy_mps, vx_mps) if speed_mps >= HEADING_SPEED_MPS else None), speed_mps
    return yaw, vx_mps * math.cos(yaw) + vy_mps * math.sin(yaw)


class Rows:
    """The rows of one recording. Times are integer nanoseconds on any clock, in any order."""

    def __init__(self, source: str, name: str, origin: Origin) -> None:
        self.source = source
        self.name = name
        self.origin = origin
        self.frames: Dict[int, List[Tuple[str, float, float, str]]] = {}
        self.ids: Dict[Hashable, int] = {}
        self.left_out: Dict[str, int] = {}

    def ego(self, stamp_ns: int, x_m: float, y_m: float, heading_rad: float) -> None:
        """The pose of the sensor. A frame needs none, and a pose alone makes a frame."""
        self._check("ego", "", x=x_m, y=y_m, heading=heading_rad)
        if self.origin == "first":
            self.origin = (float(math.floor(x_m)), float(math.floor(y_m)))
        self.frames.setdefault(stamp_ns, []).insert(0, self._row("", "ego", x_m, y_m, heading_rad, None, None))

    def agent(
        self,
        stamp_ns: int,
        track: Hashable,
        kind: str,
        x_m: float,
        y_m: float,
        heading_rad: Optional[float] = None,
        speed_mps: Optional[float] = None,
        size: Optional[Size] = None,
    ) -> None:
        """An agent; `track` is its identity in the data set, which the file numbers from 1."""
        number = self.ids.setdefault(track, len(self.ids) + 1)
        length_m, width_m = size if size is not None else (None, None)
        self._check(kind, number, x=x_m, y=y_m, heading=heading_rad, speed=speed_mps)
        self._check(kind, number, length=length_m, width=width_m)
        row = self._row(number, kind, x_m, y_m, heading_rad, speed_mps, size)
        self.frames.setdefault(stamp_ns, []).append(row)

    def leave_out(self, category: str) -> None:
        """Counts an annotation that is no road user."""
        self.left_out[category] = self.left_out.get(category, 0) + 1

    @property
    def origin_m(self) -> Tuple[float, float]:
        """What is subtracted from all positions."""
        return (0.0, 0.0) if isinstance(self.origin, str) else self.origin

    def _check(self, kind: str, number: object, **values: Optional[float]) -> None:
        for name, value in values.items():
            if value is not None and not math.isfinite(value):
                raise Failed(f"{self.source}: {kind} {number}: {name} = {value}: not finite")

    def _row(
        self,
        number: object,
        kind: str,
        x_m: float,
        y_m: float,
        heading_rad: Optional[float],
        speed_mps: Optional[float],
        size: Optional[Size],
    ) -> Tuple[str, float, float, str]:
        own_m = [at - origin for at, origin in zip((x_m, y_m), self.origin_m)]
        if max(map(abs, own_m)) > POSITION_MAX_M:
            raise Failed(
                f"{self.source}: {kind} {number} at ({own_m[0]:.1f}, {own_m[1]:.1f}) m: beyond "
                f"±{POSITION_MAX_M:.0f} m, --origin first or --origin X,Y moves it nearer"
            )
        length = width = ""
        if size is not None and min(size) > 0:
            length, width = (f"{extent_m:.3f}" for extent_m in size)
        heading = "" if heading_rad is None else f"{heading_rad:.5f}"
        speed = "" if speed_mps is None else f"{speed_mps:.4f}"
        return f"{number},{kind}", x_m, y_m, f"{heading},{speed},{length},{width}"

    def text(self, origin_m: Tuple[float, float]) -> str:
        """The rows as CSV, with positions less this origin."""
        if not self.ids:
            raise Failed(f"{self.source}: {self.name}: no road users in it")
        first_ns = min(self.frames)
        lines = [COLUMNS]
        for stamp_ns in sorted(self.frames):
            seconds, rest_ns = divmod(stamp_ns - first_ns, 1_000_000_000)
            for head, x_m, y_m, tail in self.frames[stamp_ns]:
                at = f"{x_m - origin_m[0]:.4f},{y_m - origin_m[1]:.4f}"
                lines.append(f"{seconds}.{rest_ns:09d},{head},{at},{tail}")
        return "\n".join(lines) + "\n"

    def write(self, folder: str) -> None:
        """Writes the file whole or not at all, and prints its content in a line."""
        text, path = self.text(self.origin_m), os.path.join(folder, f"{self.name}.csv")
        part = f"{path}.part"
        with open(part, "w", encoding="utf-8") as file:
            file.write(f"# converted from {os.path.basename(self.source)}\n")
            if not isinstance(self.origin, str):
                file.write(f"# origin_m: {self.origin[0]:.1f} {self.origin[1]:.1f}\n")
            file.write(text)
        os.replace(part, path)
        line = f"{path}: {len(self.frames)} frames, {len(self.ids)} agents"
        if self.left_out:
            line += "; left out " + ", ".join(f"{n} {name}" for name, n in sorted(self.left_out.items()))
        print(line)


def _origin(text: str) -> Origin:
    """The value of --origin."""
    if text in ("none", "first"):
        return text
    try:
        x_m, y_m = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}: expected none, first or X,Y in metres") from None
    return (x_m, y_m)


def parser(description: Optional[str], usual_origin: str) -> argparse.ArgumentParser:
    """A parser with the options of all data sets."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", default=".", metavar="DIR", help="folder for the CSV files (default: here)")
    parser.add_argument(
        "--origin",
        type=_origin,
        default=usual_origin,
        metavar="X,Y",
        help="what to subtract from all positions: `none`, `first` (the first pose of the sensor, whole "
        f"metres) or X,Y in metres (default: {usual_origin})",
    )
    return parser


class Parts:
    """Parts of the input, such as files and scenarios. `convert` names one that can't be converted, and continues."""

    def __init__(self) -> None:
        self.left_out = 0

    def convert(self, part: Callable[..., T], *arguments: Any) -> Optional[T]:
        """The result of `part`; None if its input can't be converted."""
        try:
            return part(*arguments)
        except Failed as failure:
            self.left_out += 1
            _print(failure)
            return None


class Strict(Parts):
    """Parts of the input of which the first that can't be converted is an error."""

    def convert(self, part: Callable[..., T], *arguments: Any) -> Optional[T]:
        """The result of `part`."""
        return part(*arguments)


def run(convert: Callable[[argparse.Namespace, Parts], None], parser: argparse.ArgumentParser) -> None:
    """Runs a converter with its arguments and `Parts`.

    Input that can't be converted is a line on standard error each, and exit code 65 after the rest was converted.
    """
    arguments = parser.parse_args()
    parts = Parts()
    try:
        os.makedirs(arguments.out, exist_ok=True)
        convert(arguments, parts)
        if parts.left_out > 0:
            raise Failed(f"left out: {parts.left_out}, named above")
    except Failed as failure:
        _print(failure)
        sys.exit(65)
    except OSError as error:
        _print(error)
        sys.exit(74)


def _print(error: Exception) -> None:
    print(f"error: {error}", file=sys.stderr)
