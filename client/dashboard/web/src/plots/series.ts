// SPDX-License-Identifier: Apache-2.0
// What is plotted, taken out of a history.
import type { FrameRecord } from "../data/frame";
import type { FrameHistory } from "../data/history";
import { poseSigmas } from "../math/ellipse";

export interface Line {
  readonly name: string;
  readonly token: string; // a colour
  // One value per frame of the range; NaN = none.
  readonly values: Float64Array;
  readonly unit: string;
  readonly digits: number;
}

export interface PlotData {
  readonly times: Float64Array;
  readonly lines: readonly Line[];
  readonly stacked: boolean;
  readonly bars: boolean;
  // Fixed upper end; otherwise that of the values.
  readonly top: number | null;
  // A line across.
  readonly mark: number | null;
}

export type PlotId = "confidence" | "inliers" | "uncertainty" | "stages" | "rate" | "drops";

export const PLOTS: readonly { id: PlotId; title: string }[] = [
  { id: "confidence", title: "Confidence" },
  { id: "inliers", title: "Inliers" },
  { id: "uncertainty", title: "Uncertainty" },
  { id: "stages", title: "Stages, ms" },
  { id: "rate", title: "Frame rate" },
  { id: "drops", title: "Dropped frames" },
];

const RATE_WINDOW = 12; // frames over which a rate is taken

function slice(history: FrameHistory, from: number, to: number): FrameRecord[] {
  const records: FrameRecord[] = [];
  for (let i = Math.max(0, history.indexAt(from)); i < history.length; ++i) {
    const r = history.at(i)!;
    if (r.timeS > to) break;
    records.push(r);
  }
  return records;
}

// Frames that were left out between two results: gaps in the numbers.
export function missing(previous: FrameRecord | undefined, record: FrameRecord): number {
  return previous ? Math.max(0, record.sequence - previous.sequence - 1) : 0;
}

export function plotData(id: PlotId, history: FrameHistory, from: number, to: number, targets: readonly string[]): PlotData {
  const records = slice(history, from, to);
  const times = Float64Array.from(records, (r) => r.timeS);
  const line = (name: string, token: string, unit: string, digits: number, of: (r: FrameRecord, i: number) => number | undefined): Line => ({
    name, token, unit, digits,
    values: Float64Array.from(records, (r, i) => of(r, i) ?? NaN),
  });
  const base = { times, stacked: false, bars: false, top: null, mark: null };
  switch (id) {
    case "confidence":
      return {
        ...base,
        top: 1,
        mark: 0.5,
        lines: targets.map((target, k) =>
          line(target, `series-${(k % 6) + 1}`, "", 2, (r) => r.result.targets.find((t) => t.targetId === target)?.confidence),
        ),
      };
    case "inliers":
      return { ...base, lines: [line("landmarks", "landmark", "", 0, (r) => r.result.camera?.numInliers)] };
    case "uncertainty": {
      const sigma = records.map((r) => poseSigmas(r.result.camera?.covariance ?? []));
      return {
        ...base,
        lines: [
          line("position", "series-1", "cm", 1, (_, i) => { const s = sigma[i]; return s ? 100 * s.position : undefined; }),
          line("rotation", "series-2", "mrad", 1, (_, i) => { const s = sigma[i]; return s ? 1000 * s.rotation : undefined; }),
        ],
      };
    }
    case "stages":
      return {
        ...base,
        stacked: true,
        lines: [
          line("wait", "idle", "", 0, (r) => r.result.times?.queueMs),
          line("decode", "series-3", "", 0, (r) => r.result.times?.decodeMs),
          line("pose", "series-4", "", 0, (r) => r.result.times?.localizeMs),
          line("track", "series-2", "", 0, (r) => r.result.times?.trackMs),
        ],
      };
    case "rate":
      return {
        ...base,
        lines: [
          line("results", "series-3", "/s", 1, (r, i) => {
            const before = records[i - Math.min(i, RATE_WINDOW)]!;
            const span = r.timeS - before.timeS;
            return span > 0 ? Math.min(i, RATE_WINDOW) / span : undefined;
          }),
        ],
      };
    case "drops":
      return {
        ...base,
        bars: true,
        lines: [line("frames", "bad", "", 0, (r, i) => missing(records[i - 1], r))],
      };
  }
}

// Index of the last time at or before t; -1 if none.
export function indexAtTime(times: Float64Array, t: number): number {
  let low = 0;
  let high = times.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle]! <= t) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}

// A round upper end for an axis that must hold `value`.
export function niceTop(value: number): number {
  if (!(value > 0)) return 1;
  const power = 10 ** Math.floor(Math.log10(value));
  for (const step of [1, 1.5, 2, 3, 4, 5, 6, 8, 10]) {
    if (step * power >= value) return step * power;
  }
  return 10 * power;
}
