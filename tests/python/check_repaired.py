#!/usr/bin/env python3
"""Reads a repaired log through its summary, as seeking tools do, and prints its content as JSON.

    check_repaired.py LOG
"""
import json
import sys
from collections import Counter

from mcap.reader import SeekingReader
from mcap_ros2.decoder import DecoderFactory


def main(path):
    with open(path, "rb") as file:
        reader = SeekingReader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        summary = reader.get_summary()
        stated = {summary.channels[i].topic: n for i, n in summary.statistics.channel_message_counts.items()}
        messages, last = Counter(), None
        for _, channel, _, sample in reader.iter_decoded_messages():
            messages[channel.topic] += 1
            last = getattr(getattr(sample, "header", None), "tick", last)
        metadata = {record.name: dict(record.metadata) for record in reader.iter_metadata()}
        attachments = [record.name for record in reader.iter_attachments()]
    content = {"messages": messages, "stated": stated, "last_tick": last}
    print(json.dumps({**content, "metadata": metadata, "attachments": attachments}))


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(sys.argv[1])
