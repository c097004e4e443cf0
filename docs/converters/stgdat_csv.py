"""What the converters share: stgdat's own CSV, one file per recording, and the command line.

Each row is an agent at one time, or the pose of the sensor (`ego`). Positions are metres in the data set's
own world frame, from which an origin may be subtracted; stamps begin at 0.
"""

import argparse
import math
import os
import sys

COLUMNS = "stamp_s,id,type,x_m,y_m,heading_rad,speed_mps,length_m,width_m"
POSITION_MAX_M = 32768.0
"""Coordinates that stgdat reads."""
HEADING_SPEED_MPS = 0.1
"""Speed from which the direction of motion is a heading."""


class Failed(Exception):
    """Input that can't be converted; the message names the file and what is wrong with it."""


def yaw_rad(qw, qx, qy, qz):
    """The turn about z of a rotation, counter-clockwise."""
    return math.atan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))


def motion(kind, yaw, vx_mps, vy_mps):
    """Heading and speed of an agent with a velocity in the world frame; either may be None.

    Pedestrians walk in any direction, so that their heading is that of the velocity.
    """
    speed_mps = math.hypot(vx_mps, vy_mps)
    if kind == "pedestrian":
        return (math.atan2(vy_mps, vx_mps) if speed_mps >= HEADING_SPEED_MPS else None), speed_mps
    return yaw, vx_mps * math.cos(yaw) + vy_mps * math.sin(yaw)


class Recording:
    """The rows of one recording. Times are integer nanoseconds on any clock, in any order."""

    def __init__(self, source, origin):
        self.source = source
        self.origin = origin
        self.frames = {}
        self.ids = {}
        self.left_out = {}

    def ego(self, stamp_ns, x_m, y_m, heading_rad):
        """The pose of the sensor; a frame needs none of it, and without agents exists by it."""
        self._check("ego", "", x=x_m, y=y_m, heading=heading_rad)
        if self.origin == "first":
            self.origin = (float(math.floor(x_m)), float(math.floor(y_m)))
        row = self._row("", "ego", x_m, y_m, heading_rad, None, None)
        self.frames.setdefault(stamp_ns, []).insert(0, row)

    def agent(self, stamp_ns, track, kind, x_m, y_m, heading_rad=None, speed_mps=None, size=None):
        """An agent; `track` is its identity in the data set, which the file numbers from 1."""
        number = self.ids.setdefault(track, len(self.ids) + 1)
        length_m, width_m = size if size is not None else (None, None)
        self._check(kind, number, x=x_m, y=y_m, heading=heading_rad, speed=speed_mps)
        self._check(kind, number, length=length_m, width=width_m)
        row = self._row(number, kind, x_m, y_m, heading_rad, speed_mps, size)
        self.frames.setdefault(stamp_ns, []).append(row)

    def leave_out(self, category):
        """Counts an annotation that is no road user."""
        self.left_out[category] = self.left_out.get(category, 0) + 1

    def _check(self, kind, number, **values):
        for name, value in values.items():
            if value is not None and not math.isfinite(value):
                raise Failed(f"{self.source}: {kind} {number}: {name} = {value}: not finite")

    def _row(self, number, kind, x_m, y_m, heading_rad, speed_mps, size):
        if isinstance(self.origin, tuple):
            x_m, y_m = x_m - self.origin[0], y_m - self.origin[1]
        if abs(x_m) > POSITION_MAX_M or abs(y_m) > POSITION_MAX_M:
            raise Failed(
                f"{self.source}: {kind} {number} at ({x_m:.1f}, {y_m:.1f}) m: beyond "
                f"±{POSITION_MAX_M:.0f} m, --origin first or --origin X,Y moves it nearer"
            )
        length = width = ""
        if size is not None and min(size) > 0:
            length, width = (f"{extent_m:.3f}" for extent_m in size)
        heading = "" if heading_rad is None else f"{heading_rad:.5f}"
        speed = "" if speed_mps is None else f"{speed_mps:.4f}"
        return f"{number},{kind},{x_m:.4f},{y_m:.4f},{heading},{speed},{length},{width}"

    def write(self, path):
        """Writes the file whole or not at all, and says what it holds."""
        if not self.ids:
            raise Failed(f"{self.source}: no road users in it")
        first_ns = min(self.frames)
        part = f"{path}.part"
        with open(part, "w", encoding="utf-8") as file:
            file.write(f"# converted from {os.path.basename(self.source)}\n")
            if isinstance(self.origin, tuple):
                file.write(f"# origin_m: {self.origin[0]:.1f} {self.origin[1]:.1f}\n")
            file.write(COLUMNS + "\n")
            for stamp_ns in sorted(self.frames):
                seconds, rest_ns = divmod(stamp_ns - first_ns, 1_000_000_000)
                for row in self.frames[stamp_ns]:
                    file.write(f"{seconds}.{rest_ns:09d},{row}\n")
        os.replace(part, path)
        line = f"{path}: {len(self.frames)} frames, {len(self.ids)} agents"
        if self.left_out:
            line += "; left out " + ", ".join(f"{n} {name}" for name, n in sorted(self.left_out.items()))
        print(line)


def origin(text):
    """The value of --origin."""
    if text in ("none", "first"):
        return text
    try:
        x_m, y_m = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}: expected none, first or X,Y in metres") from None
    return (x_m, y_m)


def parser(description, usual_origin):
    """A parser with the options that all converters have."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", default=".", metavar="DIR", help="folder for the CSV files (default: here)")
    parser.add_argument(
        "--origin",
        type=origin,
        default=usual_origin,
        metavar="X,Y",
        help="what to subtract from all positions: `none`, `first` (the first pose of the sensor, whole "
        f"metres) or X,Y in metres (default: {usual_origin})",
    )
    return parser


class Parts:
    """Parts of the input, such as files and scenarios: one that can't be converted is named, and the others go on."""

    def __init__(self):
        self.left_out = 0

    def convert(self, part, *arguments):
        """The result of `part`; None if its input can't be converted."""
        try:
            return part(*arguments)
        except Failed as failure:
            self.left_out += 1
            return _failed(failure, None)


def run(convert, parser):
    """Runs a converter with its arguments and `Parts`.

    Input that can't be converted is a line on standard error each, and exit code 65 after the rest was converted."""
    arguments = parser.parse_args()
    parts = Parts()
    try:
        os.makedirs(arguments.out, exist_ok=True)
        convert(arguments, parts)
        if parts.left_out > 0:
            raise Failed(f"left out: {parts.left_out}, named above")
    except Failed as failure:
        sys.exit(_failed(failure, 65))
    except OSError as error:
        sys.exit(_failed(error, 74))


def _failed(error, code):
    print(f"error: {error}", file=sys.stderr)
    return code
