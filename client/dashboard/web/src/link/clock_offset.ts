// SPDX-License-Identifier: Apache-2.0
// The offset of another clock, from the round trips of pings: the one with the
// shortest way there and back bounds it best (RFC 5905, §10, clock filter).

interface Sample {
  readonly delay: number;
  readonly offset: number;
}

const KEEP = 16;

export class ClockOffset {
  private samples: Sample[] = [];

  // Sent and received on our clock, stamped on theirs; ms.
  add(sentMs: number, receivedMs: number, stampedMs: number): void {
    const delay = receivedMs - sentMs;
    if (!(delay >= 0) || !Number.isFinite(stampedMs)) return;
    this.samples.push({ delay, offset: stampedMs - 0.5 * (sentMs + receivedMs) });
    if (this.samples.length > KEEP) this.samples.shift();
  }

  get roundTripMs(): number | null {
    return this.best?.delay ?? null;
  }

  // Our time on their clock; null before the first sample.
  toTheirs(ourMs: number): number | null {
    return this.best ? ourMs + this.best.offset : null;
  }

  private get best(): Sample | undefined {
    return this.samples.reduce<Sample | undefined>(
      (best, s) => (best && best.delay <= s.delay ? best : s),
      undefined,
    );
  }
}
