// SPDX-License-Identifier: Apache-2.0
// From a frame's capture to its being on the page. The capture time is on the
// dashboard's clock only if the client runs on its host and stamps live frames;
// otherwise the way from the dashboard to the page is measured.
import { signal } from "@preact/signals";
import type { FrameRecord } from "../data/frame";
import type { ClockOffset } from "../link/clock_offset";

// A capture time farther off than that is on another clock.
const SAME_CLOCK_MS = 10_000;
const KEEP = 480;

export class LatencyMeter {
  readonly median = signal<number | null>(null);
  readonly fromCapture = signal(false);
  private samples: number[] = [];
  private counted = 0;

  clear(): void {
    this.samples = [];
    this.median.value = null;
  }

  get recent(): readonly number[] {
    return this.samples;
  }

  // Call when the frame has been drawn; counts until after the next paint, and
  // calls painted then.
  drawn(record: FrameRecord, clock: ClockOffset, painted: () => void): void {
    requestAnimationFrame(() => {
      painted();
      const channel = new MessageChannel();
      channel.port1.onmessage = () => {
        channel.port1.close();
        this.add(record, clock.toTheirs(performance.now()));
      };
      channel.port2.postMessage(null);
    });
  }

  private add(record: FrameRecord, nowMs: number | null): void {
    if (nowMs === null) return;
    const sinceCapture = nowMs - Number(record.captureNs) / 1e6;
    const same = sinceCapture > -5 && sinceCapture < SAME_CLOCK_MS;
    const sinceReceived = nowMs - Number(record.receivedNs) / 1e6;
    const sample = same ? sinceCapture : sinceReceived;
    if (!same && record.receivedNs === 0n) return;
    if (same !== this.fromCapture.peek()) {
      this.samples = [];
      this.fromCapture.value = same;
    }
    this.samples.push(sample);
    if (this.samples.length > KEEP) this.samples.shift();
    if (++this.counted % 12 === 0) this.median.value = medianOf(this.samples.slice(-48));
  }
}

export function medianOf(values: readonly number[]): number | null {
  if (values.length === 0) return null;
  const sorted = [...values].sort((a, b) => a - b);
  const middle = sorted.length >> 1;
  return sorted.length % 2 ? sorted[middle]! : 0.5 * (sorted[middle - 1]! + sorted[middle]!);
}
