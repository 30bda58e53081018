#!/usr/bin/env python3
"""Reads a packed log with readers that are not Tectum's.

    check_views.py LOG

`mcap` with `mcap-ros2-support`, and `rosbags`, decode every message. Prints as JSON the number of messages of each
topic, as each of them counts, and all faults found. Where ROS 2 has a type itself, the definition in the log is its
own.
"""
import json
import math
import sys
from collections import Counter
from pathlib import Path

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

SHAPES = {"links": 1, "joints": 2, "target": 2, "path": 4}


def stamp(header):
    return header.stamp.sec * 10**9 + header.stamp.nanosec


def read_mcap(log):
    """Counts of messages and of frames, the joints' names, and faults, as `mcap` and `mcap-ros2-support` see them."""
    faults, counts, frames, last, ends = [], Counter(), Counter(), {}, {}
    with open(log, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, sample in reader.iter_decoded_messages():
            counts[channel.topic] += 1
            last[channel.topic] = sample
            if channel.topic == "/observation":
                loss = -sample.reward
            elif channel.topic == "/loss" and sample.loss != loss:
                faults.append("the loss is not that of its observation")
            elif channel.topic == "/transforms":
                for frame in sample.transforms:
                    frames[frame.child_frame_id] += stamp(frame.header) == message.log_time
                    turn = frame.transform.rotation
                    if abs(math.hypot(turn.z, turn.w) - 1) > 1e-4:
                        faults.append("a rotation is not of length 1")
                end = sample.transforms[-1].transform.translation
                ends[message.log_time] = (end.x, end.y)
            elif channel.topic.startswith("/scene/"):
                for marker in sample.markers:
                    if stamp(marker.header) != message.log_time or SHAPES[marker.ns] != marker.type:
                        faults.append(f"{channel.topic} has a marker of another time or shape")
                if channel.topic == "/scene/path":
                    point = sample.markers[0].points[-1]
                    if (point.x, point.y) != ends[message.log_time]:
                        faults.append("the path does not end at the end-effector")
    return counts, frames, list(last["/joint_states"].name), faults


def read_rosbags(log):
    """Counts of messages, and faults, as `rosbags` sees them."""
    faults, counts, official = [], Counter(), get_typestore(Stores.ROS2_JAZZY)
    with AnyReader([Path(log)]) as reader:
        for connection, time, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            counts[connection.topic] += 1
            if connection.topic == "/joint_states" and stamp(message.header) != time:
                faults.append("joints have another time than their message")
        for name, definition in reader.typestore.fielddefs.items():
            if not name.startswith("tectum/") and definition != official.fielddefs[name]:
                faults.append(f"{name} is not ROS 2's own")
        if "visualization_msgs/msg/Marker" not in reader.typestore.fielddefs:
            faults.append("there is no definition of markers")
    return counts, faults


def main(log):
    counts, frames, names, faults = read_mcap(log)
    rosbags, more = read_rosbags(log)
    print(json.dumps({"counts": counts, "frames": frames, "names": names, "rosbags": rosbags, "faults": faults + more}))


main(*sys.argv[1:])
