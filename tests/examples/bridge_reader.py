"""Reads the forecasts that another box sends with `stgdat bridge send`, or with a stage of its pipeline.toml.

`python3 bridge_reader.py HOST PORT KEY_FILE [FRAMES]` prints a line for each agent. The layout is in docs/bridge.md.
Needs nothing but Python."""
import hashlib, hmac, os, socket, struct, sys, time, zlib

key = open(sys.argv[3], "rb").read().rstrip(b"\r\n")
code = lambda key, *parts: hmac.new(key, b"".join(parts), hashlib.sha256).digest()
link = socket.create_connection((sys.argv[1], int(sys.argv[2])), timeout=5)
link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
stream = link.makefile("rb")


def read(size):
    data = stream.read(size)
    if len(data) < size:
        sys.exit("the sender has closed the link: has it another key?")
    return data


hello = read(24)
assert hello[:8] == struct.pack("<4sHH", b"STGB", 1, 1), "no bridge, another version, or no forecasts"
mine = struct.pack("<4sHH16sQ", b"STGB", 1, 1, os.urandom(16), time.monotonic_ns())
link.sendall(mine + code(key, b"receiver", hello, mine)[:16])
session = code(key, b"session", hello, mine)
expected, frames, limit = 0, 0, int(sys.argv[4]) if len(sys.argv) > 4 else None
while limit is None or frames < limit:
    head = read(48)
    magic, version, kind, length, crc, counter, token, held_us, waited_us, _ = struct.unpack("<4sHHIIQQIIq", head)
    assert (magic, version) == (b"STGB", 1) and 64 <= length <= 65536
    rest, expected, now = read(length - 48), expected + 1, time.monotonic_ns()
    body, mac = rest[:-16], rest[-16:]
    assert hmac.compare_digest(mac, code(session, b"frame", head, body)[:16]) and counter == expected
    assert crc == zlib.crc32(head[16:] + body)
    ack = struct.pack("<QQ", counter, now)
    link.sendall(ack + code(session, b"ack", ack)[:16])
    if kind == 0:  # the sender is alive
        continue
    age_ms = waited_us / 1e3 + (now - token) / 1e6 - held_us / 1e3  # at most; a planner discards old frames
    _, seq, stamp_ns, dt_ns, x0, y0, *_, agents, _, steps, _, _, _ = struct.unpack_from("<QQqQ2d2ffIHHBBBB", body)
    at, frames = 72, frames + 1
    for _ in range(agents):
        id, _, age_us, x, y, causes, vx, vy, heading, _, _, type, quality, cause, modes, _ = struct.unpack_from(
            "<QQIiiIhhhHHBBBBH", body, at)
        paths, at = [], at + 48
        for mode in range(modes + 1):  # the single best path, then the modes with their probabilities
            p = struct.unpack_from("<H", body, at)[0] / 65535 if mode else None
            at += 2 if mode else 0
            px, py, path = x, y, []
            for dx, dy in struct.iter_unpack("<hh", body[at:at + 4 * steps]):
                px, py = px + dx, py + dy
                path.append((x0 + px / 100, y0 + py / 100))
            paths.append((p, path))
            at += 4 * steps
        print(f"tick {seq} agent {id} at ({x0 + x / 100:.2f}, {y0 + y / 100:.2f}) goes to {paths[0][1][-1]}, {modes} "
              f"modes, quality {quality}, cause {cause}, age {age_us / 1e3:.0f} ms, frame at most {age_ms:.1f} ms old")
    assert at == len(body)
