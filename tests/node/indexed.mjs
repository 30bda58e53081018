// Reads a log by its index with the reader that Foxglove publishes, and counts the messages of each topic:
// indexed.mjs LOG. A log without an index looks empty to it.
import { open } from "node:fs/promises";
import { McapIndexedReader } from "@mcap/core";
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
const counts = {};
let last = 0n, ordered = true;
for await (const message of reader.readMessages()) {
  const { topic } = reader.channelsById.get(message.channelId);
  counts[topic] = (counts[topic] ?? 0) + 1;
  ordered &&= message.logTime >= last;
  last = message.logTime;
}
console.log(JSON.stringify({ counts, ordered }));
