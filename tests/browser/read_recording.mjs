// SPDX-License-Identifier: Apache-2.0
// Reads a recording by the reference implementation of MCAP, by its index and
// from end to end, and prints what is in it.
//   node tests/browser/read_recording.mjs FILE.mcap
import { createRequire } from "node:module";
import { open } from "node:fs/promises";
import { fileURLToPath } from "node:url";

const web = createRequire(
  fileURLToPath(new URL("../../client/dashboard/web/package.json", import.meta.url)));
const { McapIndexedReader, McapStreamReader } = web("@mcap/core");
const { decompress } = web("fzstd");

const handles = { zstd: (bytes, size) => decompress(bytes, new Uint8Array(Number(size))) };
const file = await open(process.argv[2], "r");
const size = BigInt((await file.stat()).size);

const readable = {
  size: async () => size,
  read: async (offset, length) => {
    const buffer = new Uint8Array(Number(length));
    await file.read(buffer, 0, Number(length), Number(offset));
    return buffer;
  },
};

const counts = {};
const count = (topic) => { counts[topic] = (counts[topic] ?? 0) + 1; };

const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers: handles });
for await (const message of reader.readMessages()) {
  count(reader.channelsById.get(message.channelId).topic);
}
for (const [id, schema] of reader.schemasById) {
  if (schema.encoding !== "protobuf" || schema.data.length === 0) {
    throw new Error(`schema ${id} (${schema.name}) is not protobuf`);
  }
}
const expected = Number(reader.statistics.messageCount);
const indexed = Object.values(counts).reduce((a, b) => a + b, 0);
if (indexed !== expected) throw new Error(`${indexed} messages by the index, ${expected} promised`);

let streamed = 0;
const stream = new McapStreamReader({ decompressHandlers: handles, validateCrcs: true });
stream.append(await readable.read(0n, size));
for (let record; (record = stream.nextRecord()); ) {
  if (record.type === "Message") ++streamed;
}
if (streamed !== expected) throw new Error(`${streamed} messages from end to end, ${expected} promised`);
await file.close();
console.log(JSON.stringify({ messages: counts, chunks: reader.chunkIndexes.length }));
