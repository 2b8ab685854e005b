// SPDX-License-Identifier: Apache-2.0
// A session that a page watches.
import type { MessageInitShape } from "@bufbuild/protobuf";
import * as c from "./convert.js";
import type { GroundlockError } from "./errors.js";
import type * as dp from "./gen/groundlock/dashboard/v1/dashboard_pb.js";
import type * as t from "./types.js";

export type Request = NonNullable<MessageInitShape<typeof dp.ClientMessageSchema>["request"]>;

// Results that wait for who iterates; older ones are left out and counted.
const MAX_WAITING = 256;

/** What has come of a session, and who waits for it. */
export class Watch {
  readonly #ready: t.WatchUpdate[] = [];
  #held: dp.FrameUpdate | undefined; // its image is to follow
  #skipped = 0;
  #wake: (() => void) | undefined;
  #ended = false;
  #error: GroundlockError | undefined;

  constructor(readonly sessionId: string, readonly images: boolean, readonly widthPx: number) {}

  request(): Request {
    this.#held = undefined;
    return {
      case: "subscribe",
      value: {
        sessionId: this.sessionId, includeImages: this.images, skipHistory: true,
        maxImagesInFlight: 2, imageWidthPx: this.widthPx,
      },
    };
  }

  result(update: dp.FrameUpdate): void {
    this.#release(undefined); // its image was replaced by a newer one
    if (this.images && update.hasImage) this.#held = update;
    else this.#push(update, undefined);
  }
  image(image: dp.FrameImage): void {
    if (this.#held?.result?.sequence === image.sequence) this.#release(image);
  }
  end(error?: GroundlockError): void {
    this.#ended = true;
    this.#error = error;
    this.#wake?.();
  }

  async next(): Promise<t.WatchUpdate | undefined> {
    for (;;) {
      const update = this.#ready.shift();
      if (update) return update;
      if (this.#error) throw this.#error;
      if (this.#ended) return undefined;
      await new Promise<void>((resolve) => (this.#wake = resolve));
    }
  }

  #release(image: dp.FrameImage | undefined): void {
    const update = this.#held;
    this.#held = undefined;
    if (update) this.#push(update, image);
  }
  #push(update: dp.FrameUpdate, image: dp.FrameImage | undefined): void {
    if (this.#ready.length >= MAX_WAITING) {
      this.#ready.shift();
      ++this.#skipped;
    }
    this.#ready.push({
      result: c.resultFrom(update.result),
      image: image?.image && c.imageFrom(image.image),
      skipped: Number(update.skipped) + this.#skipped,
    });
    this.#skipped = 0;
    this.#wake?.();
  }
}
