#!/usr/bin/env python3
"""Reads a packed log with readers that are not Tectum's.

    check_views.py LOG LOG_WITHOUT_VIEWS

`mcap` and `mcap-ros2-support` read the first, `rosbags` the second, because it refuses files with JSON topics. Prints
as JSON the number of messages of each topic, and all faults found.
"""
import json
import math
import sys
from collections import Counter
from pathlib import Path

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader


def main(log, bare):
    faults, counts, frames = [], Counter(), {}
    with open(log, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        decoded = []
        for schema, channel, message in reader.iter_messages():
            counts[channel.topic] += 1
            if channel.message_encoding != "json":
                decoded.append(channel.topic)
                continue
            content = json.loads(message.data)
            if sorted(content) != sorted(json.loads(schema.data)["properties"]):
                faults.append(f"{channel.topic} has other fields than its schema")
            if channel.topic == "/transforms":
                for frame in content["transforms"]:
                    stamp = frame["timestamp"]["sec"] * 10**9 + frame["timestamp"]["nsec"]
                    frames.setdefault(frame["child_frame_id"], 0)
                    frames[frame["child_frame_id"]] += stamp == message.log_time
                    turn = frame["rotation"]
                    if abs(math.hypot(turn["z"], turn["w"]) - 1) > 1e-4:
                        faults.append("a rotation is not of length 1")
        last = {}
        for _, channel, message, sample in reader.iter_decoded_messages(topics=sorted(set(decoded))):
            last[channel.topic] = sample
            if channel.topic == "/observation":
                loss = -sample.reward
            elif channel.topic == "/loss" and sample.loss != loss:
                faults.append("the loss is not that of its observation")
        names = list(last["/joint_states"].name)
    with AnyReader([Path(bare)]) as reader:
        rosbags = Counter(connection.topic for connection, _, _ in reader.messages())
    print(json.dumps({"counts": counts, "frames": frames, "names": names, "rosbags": rosbags, "faults": faults}))


main(*sys.argv[1:])
