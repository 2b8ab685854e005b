// SPDX-License-Identifier: Apache-2.0
// A recording (MCAP) read over HTTP: by its index where it has one, so that
// only what is looked at is fetched; else from front to back.
import { fromBinary } from "@bufbuild/protobuf";
import { BinaryReader } from "@bufbuild/protobuf/wire";
import { McapIndexedReader, McapStreamReader, type McapTypes } from "@mcap/core";
import { decompress } from "fzstd";
import { makeRecord, type FrameRecord } from "../data/frame";
import {
  GetPointCloudResponseSchema,
  MapInfoSchema,
  type GetPointCloudResponse,
  type MapInfo,
} from "../gen/groundlock/v1/maps_pb";
import { FrameResultSchema, SessionSchema, type Session } from "../gen/groundlock/v1/tracking_pb";
import { HttpReadable } from "./http_readable";

const INFO = "/session/info";
const MAP = "/session/map";
const POINTS = "/session/points";
const RESULT = "/session/result";
const IMAGE = "/session/image";

// Images are fetched so far ahead of the cursor, ns.
const AHEAD_NS = 2_000_000_000n;
const BEHIND_NS = 200_000_000n;
const RESULTS_PER_BATCH = 480;

const decompressHandlers: McapTypes.DecompressHandlers = {
  zstd: (data, size) => decompress(data, new Uint8Array(Number(size))),
};

export interface RecordingEvents {
  onSession(session: Session): void;
  onMap(map: MapInfo): void;
  onPoints(block: GetPointCloudResponse): void;
  onResults(records: FrameRecord[]): void;
  onImage(sequence: number, data: Uint8Array): void;
  onProgress(fraction: number): void;
}

export class Recording {
  private reader: McapIndexedReader | null = null;
  private readonly topics = new Map<number, string>();
  // By capture time: an image has its result's.
  private readonly sequenceOf = new Map<bigint, number>();
  private readonly logTimeOf = new Map<number, bigint>();
  private pendingImages = new Map<bigint, Uint8Array>();
  private loads: Promise<void> = Promise.resolve();
  private readonly abort = new AbortController();

  constructor(
    private readonly url: string,
    private readonly events: RecordingEvents,
  ) {}

  close(): void {
    this.abort.abort();
  }

  get closed(): boolean {
    return this.abort.signal.aborted;
  }

  // Reads everything but images, telling of it as it comes. Errors say what is
  // wrong with the recording.
  async read(): Promise<void> {
    const readable = new HttpReadable(this.url, this.abort.signal);
    await readable.open();
    try {
      this.reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
    } catch (error) {
      if (this.closed) return;
      if (readable.failed) throw error;
      await this.readWhole(); // without an index: still written, or broken off
      return;
    }
    for (const [id, channel] of this.reader.channelsById) this.topics.set(id, channel.topic);
    for await (const m of this.reader.readMessages({ topics: [INFO, MAP, POINTS] })) this.take(m);
    const total = Number(this.reader.statistics?.messageCount ?? 0n);
    let batch: FrameRecord[] = [];
    let seen = 0;
    for await (const m of this.reader.readMessages({ topics: [RESULT] })) {
      if (this.closed) return;
      batch.push(this.result(m));
      if (batch.length >= RESULTS_PER_BATCH) {
        seen += batch.length;
        this.events.onResults(batch);
        this.events.onProgress(total > 0 ? Math.min(1, seen / total) : 0);
        batch = [];
      }
    }
    this.events.onResults(batch);
    this.events.onProgress(1);
  }

  // Fetches the images around a frame. One fetch at a time.
  load(record: FrameRecord): Promise<void> {
    const logTime = this.logTimeOf.get(record.sequence);
    if (!this.reader || logTime === undefined) return Promise.resolve();
    this.wanted = record.sequence;
    this.loads = this.loads.then(async () => {
      // The cursor has moved on, or an earlier fetch brought it.
      if (this.wanted !== record.sequence || this.loaded(logTime)) return;
      await this.fetch(logTime - BEHIND_NS, logTime + AHEAD_NS);
    });
    return this.loads;
  }

  ahead(record: FrameRecord): void {
    const logTime = this.logTimeOf.get(record.sequence);
    const end = this.window?.[1];
    if (logTime === undefined || end === undefined || this.fetching) return;
    if (!this.loaded(logTime) || logTime + AHEAD_NS / 2n < end) return;
    this.loads = this.loads.then(() => this.fetch(end, end + AHEAD_NS));
  }

  // Log times whose images have been fetched, the last of them excluded.
  private window: [bigint, bigint] | null = null;
  private fetching = false;
  private wanted = -1;

  private loaded(logTime: bigint): boolean {
    return this.window !== null && logTime >= this.window[0] && logTime < this.window[1];
  }

  private async fetch(startTime: bigint, endTime: bigint): Promise<void> {
    if (this.closed || !this.reader) return;
    this.fetching = true;
    try {
      for await (const m of this.reader.readMessages({ topics: [IMAGE], startTime, endTime })) {
        if (this.closed) return;
        this.image(m);
      }
      this.window = [startTime, endTime];
    } catch {
      // The frames are then shown without their images.
    } finally {
      this.fetching = false;
    }
  }

  private async readWhole(): Promise<void> {
    const response = await fetch(this.url, { signal: this.abort.signal });
    if (!response.ok || !response.body) throw new Error(`the recording cannot be read (${response.status})`);
    const total = Number(response.headers.get("Content-Length") ?? 0);
    const stream = new McapStreamReader({ decompressHandlers });
    const body = response.body.getReader();
    let got = 0;
    let batch: FrameRecord[] = [];
    for (;;) {
      const { value, done } = await body.read();
      if (value) {
        got += value.byteLength;
        stream.append(value);
      }
      for (;;) {
        let next: McapTypes.TypedMcapRecord | undefined;
        try {
          next = stream.nextRecord();
        } catch {
          break; // cut off in the middle of a record
        }
        if (!next) break;
        if (next.type === "Channel") this.topics.set(next.id, next.topic);
        if (next.type !== "Message") continue;
        if (this.topics.get(next.channelId) === RESULT) batch.push(this.result(next));
        else this.take(next);
      }
      if (batch.length > 0) this.events.onResults(batch);
      batch = [];
      this.events.onProgress(total > 0 ? got / total : 0);
      if (done) break;
    }
  }

  private take(m: McapTypes.TypedMcapRecords["Message"]): void {
    switch (this.topics.get(m.channelId)) {
      case INFO: return this.events.onSession(fromBinary(SessionSchema, m.data));
      case MAP: return this.events.onMap(fromBinary(MapInfoSchema, m.data));
      case POINTS: return this.events.onPoints(fromBinary(GetPointCloudResponseSchema, m.data));
      case IMAGE: return this.image(m);
    }
  }

  private result(m: McapTypes.TypedMcapRecords["Message"]): FrameRecord {
    const record = makeRecord(fromBinary(FrameResultSchema, m.data), 0, true);
    this.sequenceOf.set(m.publishTime, record.sequence);
    this.logTimeOf.set(record.sequence, m.logTime);
    const waiting = this.pendingImages.get(m.publishTime);
    if (waiting) {
      this.pendingImages.delete(m.publishTime);
      queueMicrotask(() => this.events.onImage(record.sequence, waiting));
    }
    return record;
  }

  private image(m: McapTypes.TypedMcapRecords["Message"]): void {
    const data = compressedImageData(m.data);
    if (!data) return;
    const sequence = this.sequenceOf.get(m.publishTime);
    if (sequence !== undefined) this.events.onImage(sequence, data);
    else if (this.pendingImages.size < 64) this.pendingImages.set(m.publishTime, data);
  }
}

// Field 2 of foxglove.CompressedImage, its only one of interest. Null if there
// is none.
export function compressedImageData(message: Uint8Array): Uint8Array | null {
  const reader = new BinaryReader(message);
  let data: Uint8Array | null = null;
  while (reader.pos < reader.len) {
    const [field, wireType] = reader.tag();
    if (field === 2) data = reader.bytes();
    else reader.skip(wireType, field);
  }
  return data;
}
