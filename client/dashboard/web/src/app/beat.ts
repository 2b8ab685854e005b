// SPDX-License-Identifier: Apache-2.0
// When that is drawn which need not follow every frame: plots, numbers. Each
// time the page paints costs much on a machine without a GPU, so such work is
// done just before a frame is painted anyway, a little with each; while none
// comes, by a timer.

interface Waiting {
  readonly due: number;
  readonly run: () => void;
}

// So long after it was due, work is done even if no frame has come.
const PATIENCE_MS = 120;
// With one frame, no further piece is begun after so long.
const SHARE_MS = 2;

export class Beat {
  private waiting: Waiting[] = [];
  private timer: ReturnType<typeof setTimeout> | undefined;

  // Returns how to call it off.
  after(ms: number, run: () => void): () => void {
    const entry = { due: performance.now() + ms, run };
    const at = this.waiting.findIndex((w) => w.due > entry.due);
    this.waiting.splice(at < 0 ? this.waiting.length : at, 0, entry);
    this.arm();
    return () => {
      const index = this.waiting.indexOf(entry);
      if (index >= 0) this.waiting.splice(index, 1);
    };
  }

  // A frame is about to be painted.
  frame(): void {
    const begin = performance.now();
    while (this.waiting.length > 0 && this.waiting[0]!.due <= begin) {
      this.waiting.shift()!.run();
      if (performance.now() - begin > SHARE_MS) return;
    }
  }

  private arm(): void {
    if (this.timer !== undefined || this.waiting.length === 0) return;
    const wait = this.waiting[0]!.due + PATIENCE_MS - performance.now();
    this.timer = setTimeout(() => {
      this.timer = undefined;
      const late = performance.now() - PATIENCE_MS;
      while (this.waiting.length > 0 && this.waiting[0]!.due <= late) this.waiting.shift()!.run();
      this.arm();
    }, Math.max(0, wait));
  }
}
