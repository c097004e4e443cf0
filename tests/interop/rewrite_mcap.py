#!/usr/bin/env python3
"""Rewrites a recording with PyPI's `mcap`: other chunks, other numbers of channels, attachments between the messages.

The messages and the metadata are unchanged, so `stgdat diff` finds no difference. MODE is zstd, lz4 or none (compression
of the chunks), `loose` (no chunks), `bare` (no index) or `topics` (topic by topic). Exit code 77: a module is missing.

    python3 tests/interop/rewrite_mcap.py RUN.mcap REWRITTEN.mcap MODE
"""

import sys

try:
    from mcap.reader import make_reader
    from mcap.writer import CompressionType, IndexType, Writer
except ImportError as error:
    print(f"skipped: {error}: pip install mcap")
    sys.exit(77)

MODES = {
    "zstd": {"compression": CompressionType.ZSTD},
    "lz4": {"compression": CompressionType.LZ4},
    "none": {"compression": CompressionType.NONE},
    "loose": {"use_chunking": False},
    "bare": {
        "index_types": IndexType.NONE,
        "repeat_channels": False,
        "repeat_schemas": False,
        "use_statistics": False,
        "use_summary_offsets": False,
    },
    "topics": {"compression": CompressionType.ZSTD},
}


def main(source, target, mode):
    with open(source, "rb") as old, open(target, "wb") as new:
        reader, writer = make_reader(old), Writer(new, chunk_size=200_000, **MODES[mode])
        writer.start(library="rewrite_mcap")
        begin, end = reader.iter_metadata()
        writer.add_metadata(begin.name, begin.metadata)
        # Takes the first number.
        writer.register_channel(topic="camera", message_encoding="jpeg", schema_id=0)
        messages = list(reader.iter_messages())
        if mode == "topics":
            messages.sort(key=lambda message: message[1].topic)
        channels = {}
        for number, (schema, channel, message) in enumerate(messages):
            if channel.id not in channels:
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schema_id, channel.metadata
                )
            if number % 50 == 7:
                writer.add_attachment(message.log_time, message.log_time, "note", "text/plain", b"\x06 no chunk")
            writer.add_message(
                channels[channel.id], message.log_time, message.data, message.publish_time, message.sequence
            )
        writer.add_metadata(end.name, end.metadata)
        writer.finish()
    print(f"{len(messages)} messages")


if __name__ == "__main__":
    if len(sys.argv) != 4 or sys.argv[3] not in MODES:
        sys.exit(__doc__)
    main(*sys.argv[1:])
