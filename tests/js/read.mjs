// node read.mjs FILE.mcap: counts every message and prints checksums of images and fields, as JSON.
import { createHash } from "node:crypto";
import { readFileSync } from "node:fs";
import { McapIndexedReader } from "@mcap/core";
import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";
import { decompress } from "fzstd";

const bytes = readFileSync(process.argv[2]);
const readable = {
  size: async () => BigInt(bytes.length),
  read: async (offset, length) => new Uint8Array(bytes.subarray(Number(offset), Number(offset + length))),
};
const decompressHandlers = { zstd: (data, size) => decompress(data, new Uint8Array(Number(size))) };
const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });

const decoders = new Map();
for (const schema of reader.schemasById.values()) {
  const definition = parse(new TextDecoder().decode(schema.data), { ros2: true });
  decoders.set(schema.id, new MessageReader(definition));
}

const counts = {};
const pixels = {};
const states = [];
for await (const message of reader.readMessages()) {
  const channel = reader.channelsById.get(message.channelId);
  const content = decoders.get(channel.schemaId).readMessage(message.data);
  counts[channel.topic] = (counts[channel.topic] ?? 0) + 1;
  if (channel.topic.includes("/image_")) {
    const hash = (pixels[channel.topic] ??= createHash("sha256"));
    hash.update(content.data);
  }
  if (channel.topic === "/step") {
    states.push({ tip_m: Array.from(content.tip_m), objects: content.objects.map((o) => Array.from(o.world_from_obj)) });
  }
}
const digests = Object.fromEntries(Object.entries(pixels).map(([topic, hash]) => [topic, hash.digest("hex")]));
console.log(JSON.stringify({ profile: reader.header.profile, counts, pixels: digests, states }));
