// SPDX-License-Identifier: Apache-2.0
// Brings results and images together: a frame is shown when its image is
// decoded, results without an image at once. One image is decoded at a time;
// while it is, only the newest one waits.
import type { FrameRecord } from "../data/frame";
import { decodeImage, type Picture } from "./decode";

export interface Shown {
  readonly record: FrameRecord;
  // The image that belongs to it, or an older one (then imageSequence differs).
  readonly picture: Picture | null;
  readonly imageSequence: number;
}

// A result whose image has not come after so long is shown without it.
const IMAGE_PATIENCE_MS = 250;

export class Presenter {
  private decoding = false;
  private next: { record: FrameRecord; data: Uint8Array } | null = null;
  private picture: Picture | null = null;
  private imageSequence = -1;
  private shownSequence = -1;
  private imageAt = -Infinity;
  private generation = 0;

  constructor(private readonly show: (shown: Shown) => void) {}

  // A new session, or another place in time.
  reset(): void {
    this.generation++;
    this.next = null;
    this.decoding = false;
    this.shownSequence = -1;
    this.imageAt = -Infinity;
  }

  clear(): void {
    this.reset();
    this.picture?.close();
    this.picture = null;
    this.imageSequence = -1;
  }

  offerResult(record: FrameRecord): void {
    const expectsImage = record.hasImage && performance.now() - this.imageAt < IMAGE_PATIENCE_MS;
    if (!expectsImage) this.present(record);
  }

  offerImage(record: FrameRecord, data: Uint8Array): void {
    this.next = { record, data };
    this.imageAt = performance.now();
    if (!this.decoding) void this.decode();
  }

  // A frame of the past, with the nearest image there is (null: none).
  async showPast(record: FrameRecord, imageSequence: number, data: Uint8Array | null): Promise<void> {
    this.reset();
    const generation = this.generation;
    if (data && imageSequence !== this.imageSequence) {
      const picture = await decodeImage(data);
      if (generation !== this.generation) {
        picture?.close();
        return;
      }
      this.replace(picture, imageSequence);
    } else if (!data) {
      this.replace(null, -1);
    }
    this.show({ record, picture: this.picture, imageSequence: this.imageSequence });
  }

  private async decode(): Promise<void> {
    this.decoding = true;
    const generation = this.generation;
    while (this.next) {
      const { record, data } = this.next;
      this.next = null;
      const picture = await decodeImage(data);
      if (generation !== this.generation) {
        picture?.close();
        return;
      }
      if (picture) this.replace(picture, record.sequence);
      this.present(record);
    }
    this.decoding = false;
  }

  private replace(picture: Picture | null, sequence: number): void {
    this.picture?.close();
    this.picture = picture;
    this.imageSequence = picture ? sequence : -1;
  }

  private present(record: FrameRecord): void {
    if (record.sequence < this.shownSequence) return;
    this.shownSequence = record.sequence;
    this.show({ record, picture: this.picture, imageSequence: this.imageSequence });
  }
}
