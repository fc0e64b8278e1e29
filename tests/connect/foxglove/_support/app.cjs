// The layers of the app that meet a robot: its parsers, its client and its reader of logs.
// node app.cjs TYPES (JSON: [[name, schema, hexadecimal message]]) LOG LINK WRONG_LINK; prints JSON.
const fs = require("fs");
const { parse } = require("@foxglove/rosmsg");
const { MessageReader, MessageWriter } = require("@foxglove/rosmsg2-serialization");
const { ros2humble } = require("@foxglove/rosmsg-msgs-common");
const { isMsgDefEqual } = require("@foxglove/message-definition");
const { FoxgloveClient } = require("@foxglove/ws-protocol");
const { McapIndexedReader } = require("@mcap/core");
const { loadDecompressHandlers } = require("@mcap/support");
const { FileHandleReadable } = require("@mcap/nodejs");
const WebSocket = require("ws");

const LIMIT_MS = 20000;

function checkTypes(types) {
  const found = { unreadable: {}, changed: [], known: {} };
  for (const [name, schema, hexadecimal] of types) {
    try {
      const definitions = parse(schema, { ros2: true });
      const bytes = Buffer.from(hexadecimal, "hex");
      const message = new MessageReader(definitions).readMessage(bytes);
      const written = Buffer.from(new MessageWriter(definitions).writeMessage(message));
      if (!written.equals(bytes)) found.changed.push(name);
      for (const one of definitions) {
        const known = ros2humble[(one.name ?? name).replace("/msg/", "/")];
        if (known) found.known[known.name] = isMsgDefEqual({ ...one, name: undefined }, known);
      }
    } catch (error) {
      found.unreadable[name] = String(error);
    }
  }
  return found;
}

async function readLog(path) {
  const file = await fs.promises.open(path);
  const reader = await McapIndexedReader.Initialize({
    readable: new FileHandleReadable(file),
    decompressHandlers: await loadDecompressHandlers(),
  });
  const counts = {};
  for (const channel of reader.channelsById.values()) {
    const schema = reader.schemasById.get(channel.schemaId);
    parse(Buffer.from(schema.data).toString(), { ros2: true });
    counts[channel.topic] ??= Number(reader.statistics.channelMessageCounts.get(channel.id));
  }
  await file.close();
  return counts;
}

function connect(link) {
  return new FoxgloveClient({ ws: new WebSocket(link, [FoxgloveClient.SUPPORTED_SUBPROTOCOL, "foxglove.sdk.v1"]) });
}

function seen(client, event) {
  return new Promise((resolve, reject) => {
    client.on(event, resolve);
    client.on("error", (error) => reject(new Error(`no ${event}: ${error?.message ?? error}`)));
    // Also what keeps this program alive after the end of a connection: it never ends without a word.
    setTimeout(() => reject(new Error(`no ${event}`)), LIMIT_MS);
  });
}

async function live(link) {
  const client = connect(link);
  const info = seen(client, "serverInfo"), channels = seen(client, "advertise"), time = seen(client, "time");
  const channel = (await channels).find((one) => one.topic === "/scan");
  const message = seen(client, "message");
  client.subscribe(channel.id);
  const scan = new MessageReader(parse(channel.schema, { ros2: true })).readMessage((await message).data);
  const at = await time;
  client.close();
  return { metadata: (await info).metadata, ranges: Array.from(scan.ranges), time: String(at.timestamp) };
}

async function refused(link) {
  const client = connect(link);
  const [status] = await Promise.all([seen(client, "status"), seen(client, "close")]);
  return status.message;
}

async function main([types, log, link, wrong]) {
  const found = checkTypes(JSON.parse(fs.readFileSync(types, "utf8")));
  console.log(JSON.stringify({ ...found, log: await readLog(log), live: await live(link), refused: await refused(wrong) }));
}

main(process.argv.slice(2)).then(() => process.exit(0), (error) => { console.error(error); process.exit(1); });
