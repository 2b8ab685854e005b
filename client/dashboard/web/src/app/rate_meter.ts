// SPDX-License-Identifier: Apache-2.0
// Events per second over the last two seconds.

const WINDOW_MS = 2000;

export class RateMeter {
  private times: number[] = [];

  add(nowMs: number): void {
    this.times.push(nowMs);
    this.drop(nowMs);
  }

  perSecond(nowMs: number): number {
    this.drop(nowMs);
    return (1000 * this.times.length) / WINDOW_MS;
  }

  clear(): void {
    this.times = [];
  }

  private drop(nowMs: number): void {
    while (this.times.length > 0 && this.times[0]! <= nowMs - WINDOW_MS) this.times.shift();
  }
}
