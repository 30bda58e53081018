// Connects to `tectum watch --foxglove` with the client that Foxglove publishes, subscribes to every channel, and
// prints what came: foxglove_client.mjs URL SUBPROTOCOL COMMANDS. Every message is decoded, as Foxglove decodes it.
import rosmsg from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";
import protocol from "@foxglove/ws-protocol";
import WebSocket from "ws";

const [url, subprotocol, commands] = process.argv.slice(2);
const client = new protocol.FoxgloveClient({ ws: new WebSocket(url, [subprotocol]) });
const channels = new Map(), decoders = {}, counts = {}, keys = {};
let info;
client.on("error", error => {
  console.error(String(error));
  process.exit(1);
});
client.on("serverInfo", message => { info = message; });
client.on("advertise", list => list.forEach(channel => channels.set(client.subscribe(channel.id), channel)));
client.on("message", ({ subscriptionId, data }) => {
  const { topic, schema } = channels.get(subscriptionId);
  counts[topic] = (counts[topic] ?? 0) + 1;
  decoders[topic] ??= new MessageReader(rosmsg.parse(schema, { ros2: true }));
  keys[topic] = Object.keys(decoders[topic].readMessage(data));
  if (counts["/command"] >= Number(commands) && counts["/budget"] >= Number(commands) - 1) {
    console.log(JSON.stringify({ info, counts, keys }));
    process.exit(0);
  }
});
