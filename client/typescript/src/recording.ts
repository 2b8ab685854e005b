// SPDX-License-Identifier: Apache-2.0
// Reads the recordings of the dashboard: MCAP files, whole or interrupted, by
// the reference implementation of the format, as the dashboard's page does.
// Topics: see the end of proto/groundlock/dashboard/v1/dashboard.proto.
import { type FileHandle, open } from "node:fs/promises";
import { type DescMessage, type MessageShape, fromBinary } from "@bufbuild/protobuf";
import { BinaryReader } from "@bufbuild/protobuf/wire";
import { McapIndexedReader, McapStreamReader } from "@mcap/core";
import { decompress } from "fzstd";
import { mapFrom, pointCloudFrom, resultFrom, sessionFrom } from "./convert.js";
import { Code, GroundlockError } from "./errors.js";
import { type GetPointCloudResponse, GetPointCloudResponseSchema, MapInfoSchema } from "./gen/groundlock/v1/maps_pb.js";
import { FrameResultSchema, SessionSchema } from "./gen/groundlock/v1/tracking_pb.js";
import type { Image } from "./images.js";
import type { FrameResult, MapInfo, PointCloud, SessionInfo } from "./types.js";

const MAGIC = Buffer.from("\x89MCAP0\r\n", "latin1");
// Larger than any chunk that is written: a message more than was asked for.
const MAX_CHUNK_BYTES = 1 << 27;
const READ_BYTES = 1 << 20;

const handlers = {
  zstd: (bytes: Uint8Array, size: bigint): Uint8Array => {
    if (size > MAX_CHUNK_BYTES) throw new Error(`a chunk of ${size} bytes is too large`);
    return decompress(bytes, new Uint8Array(Number(size)));
  },
};

interface RawMessage {
  readonly topic: string;
  readonly publishTime: bigint;
  readonly data: Uint8Array;
}

/** The image of the result with the same capture time. */
export interface RecordedImage {
  readonly captureTimeNs: bigint;
  readonly image: Image;
}

/** A session in a file. complete: its writer has finished it. */
export class Recording {
  readonly #file: FileHandle;

  private constructor(
    readonly path: string,
    file: FileHandle,
    readonly complete: boolean,
    readonly session: SessionInfo,
    readonly map: MapInfo | undefined,
  ) {
    this.#file = file;
  }

  /** NOT_FOUND; DATA_LOSS: this is no recording, or it is damaged. */
  static async open(path: string): Promise<Recording> {
    let file: FileHandle;
    try {
      file = await open(path, "r");
    } catch (error) {
      throw new GroundlockError(Code.NOT_FOUND, `${path}: ${(error as Error).message}`);
    }
    try {
      const magic = Buffer.alloc(MAGIC.length);
      const { bytesRead } = await file.read(magic, 0, magic.length, 0);
      if (bytesRead !== magic.length || !magic.equals(MAGIC)) throw damaged(path, "is no MCAP file");
      const complete = (await indexed(file)) !== undefined;
      let session: SessionInfo | undefined;
      let map: MapInfo | undefined;
      for await (const message of messages(path, file, ["/session/info", "/session/map"])) {
        if (message.topic === "/session/info") session = parse(path, SessionSchema, message, sessionFrom);
        else map = parse(path, MapInfoSchema, message, mapFrom);
      }
      if (session === undefined) throw damaged(path, "holds no session");
      return new Recording(path, file, complete, session, map);
    } catch (error) {
      await file.close();
      throw error;
    }
  }

  /** The results, in the order of the file. */
  async *results(): AsyncGenerator<FrameResult> {
    for await (const message of messages(this.path, this.#file, ["/session/result"])) {
      yield parse(this.path, FrameResultSchema, message, resultFrom);
    }
  }

  /** The images, in the order of the file. */
  async *images(): AsyncGenerator<RecordedImage> {
    for await (const message of messages(this.path, this.#file, ["/session/image"])) {
      yield { captureTimeNs: message.publishTime, image: compressedImage(this.path, message.data) };
    }
  }

  /** The subsample of the map that was recorded; empty if there is none. */
  async pointCloud(): Promise<PointCloud> {
    const blocks: GetPointCloudResponse[] = [];
    for await (const message of messages(this.path, this.#file, ["/session/points"])) {
      blocks.push(parse(this.path, GetPointCloudResponseSchema, message, (block) => block));
    }
    return pointCloudFrom(blocks);
  }

  close(): Promise<void> {
    return this.#file.close();
  }
}

function damaged(path: string, why: string): GroundlockError {
  return new GroundlockError(Code.DATA_LOSS, `${path}: ${why}`);
}

function parse<D extends DescMessage, T>(path: string, schema: D, message: RawMessage, convert: (m: MessageShape<D>) => T): T {
  try {
    return convert(fromBinary(schema, message.data));
  } catch (error) {
    throw damaged(path, `a message of ${message.topic} is damaged: ${(error as Error).message}`);
  }
}

/** Of foxglove.CompressedImage, what is needed: 2 the bytes, 3 their format. */
function compressedImage(path: string, bytes: Uint8Array): Image {
  let data = new Uint8Array();
  let format = "";
  try {
    const reader = new BinaryReader(bytes);
    while (reader.pos < reader.len) {
      const [field, wire] = reader.tag();
      if (field === 2) data = new Uint8Array(reader.bytes());
      else if (field === 3) format = reader.string();
      else reader.skip(wire);
    }
  } catch (error) {
    throw damaged(path, `an image is damaged: ${(error as Error).message}`);
  }
  return { encoding: format === "jpeg" || format === "png" ? format : "auto", data, widthPx: 0, heightPx: 0 };
}

/** The reader of a file that has its index. */
async function indexed(file: FileHandle): Promise<McapIndexedReader | undefined> {
  const size = BigInt((await file.stat()).size);
  const readable = {
    size: () => Promise.resolve(size),
    read: async (offset: bigint, length: bigint): Promise<Uint8Array> => {
      // Bounded before anything is allocated.
      if (offset + length > size) throw new Error("points behind the file's end");
      const buffer = new Uint8Array(Number(length));
      const { bytesRead } = await file.read(buffer, 0, buffer.length, Number(offset));
      if (bytesRead !== buffer.length) throw new Error("cannot be read");
      return buffer;
    },
  };
  try {
    return await McapIndexedReader.Initialize({ readable, decompressHandlers: handlers });
  } catch {
    return undefined;
  }
}

/** Messages of the topics, in the order of the file. Chunks without them are not
 * read where there is an index; else up to the last whole record. */
async function* messages(path: string, file: FileHandle, topics: readonly string[]): AsyncGenerator<RawMessage> {
  const reader = await indexed(file);
  try {
    if (reader) {
      for await (const { channelId, publishTime, data } of reader.readMessages({ topics })) {
        const topic = reader.channelsById.get(channelId)?.topic ?? "";
        yield { topic, publishTime, data };
      }
      return;
    }
    yield* scan(file, topics);
  } catch (error) {
    throw error instanceof GroundlockError ? error : damaged(path, (error as Error).message);
  }
}

async function* scan(file: FileHandle, topics: readonly string[]): AsyncGenerator<RawMessage> {
  const stream = new McapStreamReader({ decompressHandlers: handlers, validateCrcs: true });
  const channels = new Map<number, string>();
  for (let offset = 0; ; ) {
    const buffer = new Uint8Array(READ_BYTES);
    const { bytesRead } = await file.read(buffer, 0, buffer.length, offset);
    if (bytesRead === 0) return;
    offset += bytesRead;
    stream.append(buffer.subarray(0, bytesRead));
    for (let record; (record = stream.nextRecord()); ) {
      if (record.type === "Channel") channels.set(record.id, record.topic);
      if (record.type !== "Message") continue;
      const topic = channels.get(record.channelId) ?? "";
      if (topics.includes(topic)) yield { topic, publishTime: record.publishTime, data: record.data };
    }
    if (stream.done()) return;
  }
}
