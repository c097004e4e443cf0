"""Converts scenarios of Waymo Open Motion to stgdat's own CSV, a file per scenario: 9 s to 20 s at 10 Hz.

    python -m stgdat.datasets waymo /data/womd/training_20s.tfrecord-00000-of-01000 --out csv [--scenario ID ...]

Reads files of `Scenario` protocol buffers (not of tf.Example) by itself and needs nothing but Python. The
autonomous vehicle is the sensor and no agent. Its first pose is subtracted from all positions unless --origin
says otherwise; the file's second line has it. States that are not valid, and objects of type other or unset,
are left out. A scenario or file that can't be converted is named, and the others are converted; the exit
code is 65 then.
"""

from __future__ import annotations

import argparse
import struct
from typing import Any, BinaryIO, Collection, Dict, Iterator, List, Optional, Sequence, Set, Tuple, Union

from ._rows import Failed, Origin, Parts, Rows, Strict, motion, parser, run

State = Dict[int, float]
Track = Tuple[int, int, List[Optional[State]]]

KINDS = {1: "vehicle", 2: "pedestrian", 3: "cyclist"}
RECORD_MAX = 1 << 30
"""Largest record that is read, bytes."""
STAMP_MAX_S = 4e9
"""Latest time that stgdat reads."""

# Castagnoli's polynomial, reflected: a table for each byte of a word, the last byte's first.
CRC_TABLES: List[List[int]] = [[]]
for _byte in range(256):
    for _ in range(8):
        _byte = (_byte >> 1) ^ (0x82F63B78 if _byte & 1 else 0)
    CRC_TABLES[0].append(_byte)
for _ in range(3):
    CRC_TABLES.append([crc >> 8 ^ CRC_TABLES[0][crc & 0xFF] for crc in CRC_TABLES[-1]])


def masked_crc(data: bytes) -> int:
    """The checksum of a TFRecord's length or data."""
    last, third, second, first = CRC_TABLES
    crc, words = 0xFFFFFFFF, len(data) // 4
    for word in struct.unpack_from(f"<{words}I", data):
        crc ^= word
        crc = first[crc & 0xFF] ^ second[crc >> 8 & 0xFF] ^ third[crc >> 16 & 0xFF] ^ last[crc >> 24]
    for byte in data[4 * words :]:
        crc = (crc >> 8) ^ last[(crc ^ byte) & 0xFF]
    crc ^= 0xFFFFFFFF
    return ((crc >> 15 | crc << 17) + 0xA282EAD8) & 0xFFFFFFFF


def records(path: str, file: BinaryIO) -> Iterator[Tuple[int, Optional[bytes]]]:
    """The records of a TFRecord file with their places; the data of a damaged one is None."""
    while True:
        at = file.tell()
        head = file.read(12)
        if not head:
            return
        rest = "nothing after that can be read"
        if len(head) < 12:
            raise Failed(f"{path}: byte {at}: the file ends within a record's length")
        length, crc = struct.unpack("<QI", head)
        if crc != masked_crc(head[:8]) or length > RECORD_MAX:
            raise Failed(f"{path}: byte {at}: not a TFRecord; {rest}")
        data, crc = file.read(length), file.read(4)
        if len(data) < length or len(crc) < 4:
            raise Failed(f"{path}: byte {at}: the file ends within a record of {length} bytes")
        yield at, data if struct.pack("<I", masked_crc(data)) == crc else None


class Truncated(Exception):
    """A message that ends too early, or is none."""


def varint(data: bytes, at: int) -> Tuple[int, int]:
    """A number and the place after it."""
    value = shift = 0
    while True:
        if at >= len(data) or shift > 63:
            raise Truncated
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value & 0xFFFFFFFFFFFFFFFF, at
        shift += 7


def fields(data: bytes) -> Iterator[Tuple[int, Union[int, bytes]]]:
    """The (number, value) pairs of a message: integers, or bytes of floats, doubles and messages."""
    at = 0
    value: Any
    while at < len(data):
        key, at = varint(data, at)
        wire = key & 7
        if wire == 0:
            value, at = varint(data, at)
        elif wire in (1, 2, 5):
            length = 8 if wire == 1 else 4
            if wire == 2:
                length, at = varint(data, at)
            value = data[at : at + length]
            at += length
            if at > len(data):
                raise Truncated
        else:
            raise Truncated
        yield key >> 3, value


def number(value: Any, code: str) -> float:
    """A float or double."""
    if not isinstance(value, bytes) or len(value) != struct.calcsize(code):
        raise Truncated
    return float(struct.unpack(code, value)[0])


def integer(value: Any) -> int:
    """An integer."""
    if not isinstance(value, int):
        raise Truncated
    return value


def stamps_of(value: Any) -> Tuple[float, ...]:
    """Doubles of a repeated field, packed or one by one."""
    if not isinstance(value, bytes) or len(value) % 8:
        raise Truncated
    return struct.unpack(f"<{len(value) // 8}d", value)


def state_of(data: Any) -> Optional[State]:
    """A valid state as a dictionary by field number, None for one that is not valid."""
    state = {2: 0.0, 3: 0.0, 5: 0.0, 6: 0.0, 8: 0.0, 9: 0.0, 10: 0.0}
    valid = 0
    for key, value in fields(data):
        if key in (2, 3):
            state[key] = number(value, "<d")
        elif key in state:
            state[key] = number(value, "<f")
        elif key == 11:
            valid = integer(value)
    return state if valid else None


def track_of(data: Any) -> Track:
    """Identity, type and states of a track."""
    identity, kind = 0, 0
    states: List[Optional[State]] = []
    for key, value in fields(data):
        if key == 1:
            identity = integer(value)
        elif key == 2:
            kind = integer(value)
        elif key == 3:
            states.append(state_of(value))
    return identity, kind, states


def scenario_of(data: bytes) -> Tuple[Optional[str], List[float], List[Any], Optional[int]]:
    """Name, stamps, tracks and the index of the autonomous vehicle's track."""
    name, own = None, None
    stamps_s: List[float] = []
    tracks: List[Any] = []
    value: Any
    for key, value in fields(data):
        if key == 5:
            name = value.decode("utf-8", "replace")
        elif key == 1:
            stamps_s.extend(stamps_of(value))
        elif key == 2:
            tracks.append(value)
        elif key == 6:
            own = integer(value)
    return name, stamps_s, tracks, own


def scenario(
    where: str, data: Optional[bytes], wanted: Collection[str], origin: Origin, found: Set[str]
) -> Optional[Rows]:
    """The rows of a scenario that is wanted. Adds its name to `found`."""
    if data is None:
        raise Failed(f"{where}: damaged: its checksum differs")
    try:
        name, stamps_s, messages, own = scenario_of(data)
        if not name or not name.replace("_", "").replace("-", "").isalnum() or not stamps_s:
            raise Failed(f"{where}: not a Scenario: no scenario_id or no timestamps_seconds")
        if wanted and name not in wanted:
            return None
        found.add(name)
        where = f"{where}: scenario {name}"
        tracks = [track_of(track) for track in messages]
    except (Truncated, AttributeError, TypeError):
        raise Failed(f"{where}: not a Scenario message") from None
    if own is None or own >= len(tracks):
        raise Failed(f"{where}: sdc_track_index = {own}: expected one of {len(tracks)} tracks")
    recording = Rows(where, name, origin)
    if not all(abs(stamp_s) < STAMP_MAX_S for stamp_s in stamps_s):
        raise Failed(f"{where}: timestamps_seconds = {stamps_s[:3]}…: beyond {STAMP_MAX_S:.0f} s")
    stamps_ns = [round(stamp_s * 1e9) for stamp_s in stamps_s]
    if any(later <= earlier for earlier, later in zip(stamps_ns, stamps_ns[1:])):
        raise Failed(f"{where}: timestamps_seconds do not increase")
    order = [own] + [index for index in range(len(tracks)) if index != own]
    for index in order:
        identity, kind, states = tracks[index]
        if len(states) != len(stamps_ns):
            raise Failed(f"{where}: track {identity}: {len(states)} states, expected {len(stamps_ns)}")
        for stamp_ns, state in zip(stamps_ns, states):
            if state is None:
                continue
            if index == own:
                recording.ego(stamp_ns, state[2], state[3], state[8])
            elif kind not in KINDS:
                recording.leave_out("other")
            else:
                moves = motion(KINDS[kind], state[8], state[9], state[10])
                size = (state[5], state[6])
                recording.agent(stamp_ns, identity, KINDS[kind], state[2], state[3], *moves, size=size)
    return recording


def scenarios(path: str, wanted: Collection[str], origin: Origin, parts: Parts, found: Set[str]) -> Iterator[Rows]:
    """The rows of the scenarios of a file that are wanted. Adds their names to `found`."""
    try:
        file = open(path, "rb")
    except OSError as error:
        raise Failed(f"{path}: {error.strerror}") from error
    with file:
        for at, data in records(path, file):
            rows = parts.convert(scenario, f"{path}: record at byte {at}", data, wanted, origin, found)
            if rows is not None:
                yield rows


def wanted(path: str, names: Collection[str]) -> Iterator[Rows]:
    """The rows of these scenarios of a file, or of all. A missing one is an error."""
    found: Set[str] = set()
    yield from scenarios(path, names, "first", Strict(), found)
    check_found(names, found, [path])


def check_found(names: Collection[str], found: Collection[str], files: Sequence[str]) -> None:
    """Refuses a name that no file contains."""
    missing = [name for name in names if name not in found]
    if missing:
        raise Failed(f"no scenario {missing[0]} in {', '.join(files)}")


def convert(arguments: argparse.Namespace, parts: Parts) -> None:
    """Writes the scenarios that the arguments name."""
    found: Set[str] = set()

    def file(path: str) -> None:
        for rows in scenarios(path, arguments.scenario, arguments.origin, parts, found):
            parts.convert(rows.write, arguments.out)

    for path in arguments.files:
        parts.convert(file, path)
    check_found(arguments.scenario, found, arguments.files)


def main() -> None:
    """Runs the command."""
    options = parser(__doc__, "first")
    options.add_argument("files", nargs="+", metavar="FILE", help="TFRecord of scenarios")
    only = "only this one; repeatable"
    options.add_argument("--scenario", action="append", default=[], metavar="ID", help=only)
    run(convert, options)
