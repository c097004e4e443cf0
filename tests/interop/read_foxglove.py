#!/usr/bin/env python3
"""Reads Foxglove's websocket by PyPI's `websockets`, until the server ends.

Decodes every message with the descriptors that the server advertises, and writes a line for each: topic, time and bytes in
hexadecimal. With `stall` it subscribes and then reads nothing. Exit code 0: all decoded, 1: not, 77: a module is missing.

    python3 tests/interop/read_foxglove.py ws://127.0.0.1:8765 FILE [stall]
"""

import base64
import json
import struct
import sys
import time
from collections import Counter

try:
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect
except ImportError as error:
    print(f"skipped: {error}: pip install websockets protobuf")
    sys.exit(77)

SUBPROTOCOL = "foxglove.sdk.v1"
MESSAGE_DATA = 1


def decoder(channel):
    """The class of a channel's messages."""
    assert (channel["encoding"], channel["schemaEncoding"]) == ("protobuf", "protobuf"), channel
    files = descriptor_pb2.FileDescriptorSet.FromString(base64.b64decode(channel["schema"]))
    pool = descriptor_pool.DescriptorPool()
    for file in files.file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(channel["schemaName"]))


def channels_of(socket):
    """The channels that the server advertises, after its introduction."""
    info = json.loads(socket.recv())
    assert info["op"] == "serverInfo" and info["name"].startswith("stgdat"), info
    advertised = json.loads(socket.recv())
    assert advertised["op"] == "advertise", advertised
    return advertised["channels"]


def main(url, path, *options):
    counts = Counter()
    with connect(url, subprotocols=[SUBPROTOCOL], max_size=None) as socket, open(path, "w") as file:
        assert socket.subprotocol == SUBPROTOCOL, socket.subprotocol
        channels = channels_of(socket)
        classes = {channel["id"]: decoder(channel) for channel in channels}
        names = {channel["id"]: channel["topic"] for channel in channels}
        # A subscription's number is the channel's number plus 100.
        asked = [{"id": number + 100, "channelId": number} for number in classes]
        socket.send(json.dumps({"op": "subscribe", "subscriptions": asked}))
        print("subscribed", flush=True)
        while "stall" in options:
            time.sleep(1)
        try:
            for message in socket:
                if isinstance(message, str):
                    print("text", json.loads(message)["op"])
                    continue
                operation, subscription, log_ns = struct.unpack_from("<BIQ", message)
                if operation != MESSAGE_DATA:
                    continue
                number, payload = subscription - 100, message[13:]
                classes[number].FromString(payload)
                counts[names[number]] += 1
                file.write(f"{names[number]} {log_ns} {payload.hex()}\n")
        except ConnectionClosed:
            pass
    for topic, count in sorted(counts.items()):
        print(f"{topic} {count}")
    return 0 if counts else 1


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    sys.exit(main(*sys.argv[1:]))
