#!/usr/bin/env python3
"""Reads a log with public packages only and checks that it is complete and consistent.

    check_log.py LOG

Decodes every message. Prints as JSON the number of messages per topic, whether the ticks are 0, N, 2N .. (N is the
run's `every`), whether sequence numbers have no gap, the names of metadata and attachments, and all faults found. The
exit code is 1 if there is a fault.
"""
import json
import math
import sys
from collections import defaultdict

from mcap.reader import NonSeekingReader, make_reader
from mcap_ros2.decoder import DecoderFactory


def main(path):
    faults = []
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        try:
            summary = reader.get_summary()
        except Exception as error:  # a torn or foreign file can make the package raise any exception
            summary = None
            faults.append(f"no summary: {error!r}")
        if summary is None:  # a torn log is read from the start up to where it is torn
            faults.append("the log is torn")
            metadata, attachments = {}, []
        else:
            metadata = {record.name: dict(record.metadata) for record in reader.iter_metadata()}
            attachments = [record.name for record in reader.iter_attachments()]
    ticks, sequences, wrong = defaultdict(list), defaultdict(list), defaultdict(int)
    with open(path, "rb") as file:
        reader = NonSeekingReader(file, decoder_factories=[DecoderFactory()])
        try:
            for _, channel, message, sample in reader.iter_decoded_messages(log_time_order=False):
                if channel.topic == "/gap":
                    ticks["/gap"].append(None)
                    continue
                ticks[channel.topic].append(sample.header.tick)
                sequences[channel.topic].append(sample.header.sequence)
                wrong[channel.topic] += message.sequence != sample.header.sequence % 2**32
                arrays = (getattr(sample, name, ()) for name in ("inputs", "applied", "mean", "drawn", "noise"))
                wrong[channel.topic] += not all(math.isfinite(x) for array in arrays for x in array)
        except Exception as error:
            faults.append(f"reading stopped: {error!r}")

    run, totals = metadata.get("tectum.run", {}), metadata.get("tectum.totals", {})
    every = int(run.get("every", 1))
    topics = {}
    for topic in sorted(ticks):
        topics[topic] = {"messages": len(ticks[topic])}
        if topic == "/gap":
            faults.append("the log states that samples are missing")
            continue
        n = len(ticks[topic])
        topics[topic]["ticks_in_order"] = ticks[topic] == list(range(0, n * every, every))
        first = sequences[topic][0]
        topics[topic]["sequences_gapless"] = sequences[topic] == list(range(first, first + n * every, every))
        for key in ("ticks_in_order", "sequences_gapless"):
            if not topics[topic][key]:
                faults.append(f"{topic}: not {key}")
        if wrong[topic]:
            faults.append(f"{topic}: {wrong[topic]} messages are inconsistent")
    for name in ("observation", "command", "learning"):
        topic = run.get(f"topic.{name}", f"/{name}")
        n = topics.get(topic, {}).get("messages", 0)
        if n == 0 or str(n) != totals.get(f"{name}.written"):
            faults.append(f"{topic}: {n} messages, but the totals state {totals.get(f'{name}.written')}")
        if totals.get(f"{name}.lost") != "0":
            faults.append(f"{topic}: {totals.get(f'{name}.lost')} lost")
    if totals.get("complete") != "true":
        faults.append("the run is not complete")
    if "scenario.toml" not in attachments:
        faults.append("no scenario")
    keys = {name: sorted(record) for name, record in metadata.items()}
    print(json.dumps({"topics": topics, "metadata": keys, "attachments": attachments, "faults": faults}, indent=1))
    return 1 if faults else 0


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    sys.exit(main(sys.argv[1]))
