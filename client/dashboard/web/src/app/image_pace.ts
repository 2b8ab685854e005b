// SPDX-License-Identifier: Apache-2.0
// How many images a second the page asks for. A machine that cannot draw them
// as they come would show them later and later; it asks for fewer.

const LATE_MS = 400;
const EASY_MS = 150;
const DOWN = 0.6;
const UP = 1.5;
const MIN_PER_S = 2;
// From here on all are asked for.
const ALL_PER_S = 40;

export class ImagePace {
  private limit = 0; // 0 = all

  get perSecond(): number {
    return this.limit;
  }

  reset(): void {
    this.limit = 0;
  }

  // Once in a while: the median time from the dashboard to the page, and how
  // many images were shown a second. True if the limit changed.
  judge(delayMs: number, shownPerS: number): boolean {
    const before = this.limit;
    if (delayMs > LATE_MS) {
      const now = before > 0 ? Math.min(before, shownPerS) : shownPerS;
      this.limit = Math.max(MIN_PER_S, Math.floor(DOWN * now));
    } else if (delayMs < EASY_MS && before > 0) {
      const more = Math.ceil(UP * before);
      this.limit = more >= ALL_PER_S ? 0 : more;
    }
    return this.limit !== before;
  }
}
