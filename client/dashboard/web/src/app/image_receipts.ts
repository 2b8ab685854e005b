// SPDX-License-Identifier: Apache-2.0
// Tells the dashboard which images the page is done with. It sends the next one
// then, the newest there is: a machine that cannot draw them as they come gets
// fewer, and none that has grown old in a queue.

// What was not drawn by then (the page is hidden, or shows the past) is taken
// all the same.
const PATIENCE_MS = 1000;
// One is drawn while the next one comes,
const AT_WORK = 2;
// and on a long way more are under way: one per so many ms there and back.
const SPACING_MS = 30;
const MAX_IN_FLIGHT = 24;

export function imagesInFlight(roundTripMs: number | null): number {
  return Math.min(MAX_IN_FLIGHT, AT_WORK + Math.floor((roundTripMs ?? 0) / SPACING_MS));
}

export class ImageReceipts {
  private newest: number | null = null; // that was not told yet
  private timer: ReturnType<typeof setTimeout> | undefined;

  constructor(private readonly tell: (sequence: number) => void) {}

  clear(): void {
    this.newest = null;
    clearTimeout(this.timer);
    this.timer = undefined;
  }

  arrived(sequence: number): void {
    this.newest = sequence;
    this.timer ??= setTimeout(() => {
      this.timer = undefined;
      if (this.newest !== null) this.taken(this.newest);
    }, PATIENCE_MS);
  }

  // This image, and with it those that came before it.
  taken(sequence: number): void {
    if (this.newest === sequence) this.clear();
    this.tell(sequence);
  }
}
