// SPDX-License-Identifier: Apache-2.0
// What the page remembers of a session: results in order of their sequence
// numbers, and as many of the newest images as fit a bound in bytes.
import type { FrameRecord } from "./frame";

// At 24 frames/s: 14 minutes of results.
const DEFAULT_MAX_FRAMES = 20_000;
const DEFAULT_MAX_IMAGE_BYTES = 96 << 20;
// Matched landmarks are most of a result; only recent ones are kept.
const KEEP_MATCHES = 600;
// A step of the capture time beyond it is a new run of the source, s.
const MAX_STEP_S = 60;
const STEP_AFTER_JUMP_S = 1 / 24;

// Images by sequence number, the oldest thrown out first.
export class ImageStore {
  private readonly images = new Map<number, Uint8Array>();
  private bytes_ = 0;
  constructor(private readonly maxBytes = DEFAULT_MAX_IMAGE_BYTES) {}

  get bytes(): number {
    return this.bytes_;
  }
  get size(): number {
    return this.images.size;
  }

  set(sequence: number, data: Uint8Array): void {
    if (data.byteLength > this.maxBytes) return;
    const old = this.images.get(sequence);
    if (old) {
      this.bytes_ -= old.byteLength;
      this.images.delete(sequence);
    }
    this.images.set(sequence, data);
    this.bytes_ += data.byteLength;
    for (const [oldest, bytes] of this.images) {
      if (this.bytes_ <= this.maxBytes) break;
      this.images.delete(oldest);
      this.bytes_ -= bytes.byteLength;
    }
  }

  get(sequence: number): Uint8Array | undefined {
    return this.images.get(sequence);
  }

  // The newest image at or before a frame, at most `within` frames older.
  atOrBefore(sequence: number, within: number): number | null {
    for (let s = sequence; s >= sequence - within; --s) {
      if (this.images.has(s)) return s;
    }
    return null;
  }

  clear(): void {
    this.images.clear();
    this.bytes_ = 0;
  }
}

export class FrameHistory {
  private frames: FrameRecord[] = [];
  private start = 0; // frames before it have been forgotten
  readonly images: ImageStore;

  constructor(
    private readonly maxFrames = DEFAULT_MAX_FRAMES,
    maxImageBytes = DEFAULT_MAX_IMAGE_BYTES,
  ) {
    this.images = new ImageStore(maxImageBytes);
  }

  get length(): number {
    return this.frames.length - this.start;
  }
  // 0 is the oldest.
  at(index: number): FrameRecord | undefined {
    return index < 0 ? undefined : this.frames[this.start + index];
  }
  get first(): FrameRecord | undefined {
    return this.at(0);
  }
  get last(): FrameRecord | undefined {
    return this.at(this.length - 1);
  }

  clear(): void {
    this.frames = [];
    this.start = 0;
    this.images.clear();
  }

  // A frame that was just made. A sequence number that is there is replaced.
  append(record: FrameRecord): void {
    const last = this.last;
    if (last && record.sequence <= last.sequence) {
      this.merge([record]);
      return;
    }
    record.timeS = timeAfter(last, record);
    this.frames.push(record);
    const stale = this.at(this.length - 1 - KEEP_MATCHES);
    if (stale?.result.camera) {
      stale.result.camera.matchXyPx = [];
      stale.result.camera.matchXyzM = [];
    }
    this.trim();
  }

  // Frames of any age, in order among themselves.
  merge(records: readonly FrameRecord[]): void {
    const bySequence = new Map<number, FrameRecord>();
    for (const r of records) bySequence.set(r.sequence, r);
    // What came live is fuller than what comes from the history.
    for (const r of this.frames.slice(this.start)) bySequence.set(r.sequence, r);
    this.frames = [...bySequence.values()].sort((a, b) => a.sequence - b.sequence);
    this.start = 0;
    let previous: FrameRecord | undefined;
    for (const r of this.frames) {
      r.timeS = Number(r.captureNs) / 1e9;
      r.timeS = timeAfter(previous, r);
      previous = r;
    }
    this.trim();
  }

  // Index of the last frame at or before timeS; -1 if there is none.
  indexAt(timeS: number): number {
    let low = 0;
    let high = this.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.at(middle)!.timeS <= timeS) low = middle + 1;
      else high = middle;
    }
    return low - 1;
  }

  indexOf(sequence: number): number {
    let low = 0;
    let high = this.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.at(middle)!.sequence < sequence) low = middle + 1;
      else high = middle;
    }
    return this.at(low)?.sequence === sequence ? low : -1;
  }

  private trim(): void {
    const excess = this.length - this.maxFrames;
    if (excess > 0) this.start += excess;
    // Moves the rest now and then, so that appending stays cheap.
    if (this.start > 1024 && this.start > this.frames.length / 2) {
      this.frames = this.frames.slice(this.start);
      this.start = 0;
    } else if (excess > 0) {
      for (let i = this.start - excess; i < this.start; ++i) {
        (this.frames as (FrameRecord | undefined)[])[i] = undefined;
      }
    }
  }
}

// Sources that start anew jump back; the axis goes on.
function timeAfter(previous: FrameRecord | undefined, record: FrameRecord): number {
  if (!previous) return Number(record.captureNs) / 1e9;
  const step = Number(record.captureNs - previous.captureNs) / 1e9;
  return previous.timeS + (step >= 0 && step < MAX_STEP_S ? step : STEP_AFTER_JUMP_S);
}
