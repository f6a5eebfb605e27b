// Read MCAP files as Foxglove does, types from the files alone, and print what is in them as JSON.
'use strict';
const fs = require('fs');
const { McapIndexedReader, McapStreamReader } = require('@mcap/core');
const { loadDecompressHandlers } = require('@mcap/support');
const { parse } = require('@foxglove/rosmsg');
const { MessageReader } = require('@foxglove/rosmsg2-serialization');

class FileReadable {
  constructor(path) { this.content = fs.readFileSync(path); }
  async size() { return BigInt(this.content.length); }
  async read(offset, size) {
    return new Uint8Array(this.content.subarray(Number(offset), Number(offset + size)));
  }
}

async function contentOf(path, decompressHandlers) {
  const stream = new McapStreamReader({ decompressHandlers, validateCrcs: true });
  stream.append(fs.readFileSync(path));
  let streamed = 0;
  for (let record; (record = stream.nextRecord());) { streamed += record.type === 'Message'; }
  if (!stream.done()) { throw new Error(`${path}: not read to its end`); }
  const reader = await McapIndexedReader.Initialize(
    { readable: new FileReadable(path), decompressHandlers });
  const readers = new Map();
  const content = { profile: reader.header.profile, streamed, counts: {}, names: [] };
  for await (const message of reader.readMessages({ validateCrcs: true })) {
    const { topic, schemaId } = reader.channelsById.get(message.channelId);
    if (!readers.has(schemaId)) {
      const schema = reader.schemasById.get(schemaId);
      const text = new TextDecoder().decode(schema.data);
      readers.set(schemaId, new MessageReader(parse(text, { ros2: true })));
    }
    const decoded = readers.get(schemaId).readMessage(message.data);
    content.counts[topic] = (content.counts[topic] ?? 0) + 1;
    if (topic === '/name') { content.names.push(decoded.data); }
    if (topic === '/camera' && decoded.data.length !== decoded.step * decoded.height) {
      throw new Error(`${path}: an image lacks pixels`);
    }
  }
  return content;
}

(async () => {
  const handlers = await loadDecompressHandlers();
  const contents = [];
  for (const path of process.argv.slice(2)) { contents.push(await contentOf(path, handlers)); }
  console.log(JSON.stringify(contents));
})();
