// Reads a log by its index with the reader that Foxglove publishes, decodes every message with the decoder of Foxglove
// and Lichtblick, and counts the messages of each topic: indexed.mjs LOG. A log without an index looks empty to it.
import { open } from "node:fs/promises";
import { McapIndexedReader } from "@mcap/core";
import rosmsg from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";
import { decompress } from "fzstd";

const file = await open(process.argv[2]);
const readable = {
  size: async () => BigInt((await file.stat()).size),
  read: async (offset, size) => {
    const bytes = new Uint8Array(Number(size));
    await file.read(bytes, 0, Number(size), Number(offset));
    return bytes;
  },
};
const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers: { zstd: data => decompress(new Uint8Array(data)) } });
const counts = {}, decoders = {}, last_of = {};
let last = 0n, ordered = true;
for await (const message of reader.readMessages()) {
  const { topic, schemaId } = reader.channelsById.get(message.channelId);
  const definition = () => new TextDecoder().decode(reader.schemasById.get(schemaId).data);
  decoders[topic] ??= new MessageReader(rosmsg.parse(definition(), { ros2: true }));
  last_of[topic] = decoders[topic].readMessage(message.data);
  counts[topic] = (counts[topic] ?? 0) + 1;
  ordered &&= message.logTime >= last;
  last = message.logTime;
}
const frames = last_of["/transforms"].transforms.map(frame => frame.child_frame_id);
const markers = last_of["/scene/links"].markers.map(marker => `${marker.ns} ${marker.id} in ${marker.header.frame_id}`);
console.log(JSON.stringify({ counts, ordered, frames, markers }));
