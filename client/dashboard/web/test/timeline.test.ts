// SPDX-License-Identifier: Apache-2.0
import { describe, expect, it } from "vitest";
import { CameraState, TargetState } from "../src/data/frame";
import { FrameHistory } from "../src/data/history";
import { buildLanes, clock, lensWords, targetWords, tickStep } from "../src/data/timeline";
import { indexAtTime, missing, niceTop, plotData } from "../src/plots/series";
import { frame } from "./frames";

function history(): FrameHistory {
  const h = new FrameHistory();
  for (let i = 0; i < 100; ++i) {
    const camera = { state: i < 20 ? CameraState.INITIALIZING : i < 60 ? CameraState.TRACKED : CameraState.HELD, numInliers: i };
    const targets = i < 30 ? [] : [{ targetId: "car", state: i < 80 ? TargetState.TRACKED : TargetState.PREDICTED, confidence: 0.5 }];
    h.append(frame(i, i / 10, { camera, targets, times: { queueMs: 1, decodeMs: 2, localizeMs: 3, trackMs: 4 } }));
  }
  return h;
}

describe("words for the lens", () => {
  it("say how the one that is seen differs", () => {
    expect(lensWords(undefined)).toBe("");
    expect(lensWords({ focalRatio: 1.25, cornerShare: 0 })).toBe("another lens: focal length × 1.25");
    expect(lensWords({ focalRatio: 1, cornerShare: -0.034 })).toBe("another lens: corners −3 %");
    expect(lensWords({ focalRatio: 0.8, cornerShare: 0.05 })).toBe("another lens: focal length × 0.80, corners +5 %");
  });
});

describe("lanes", () => {
  it("are runs of one state", () => {
    const [camera, car] = buildLanes(history(), 0, 100);
    expect(camera!.runs.map((r) => r.tone)).toEqual(["idle", "good", "warn"]);
    expect(camera!.runs[1]!.fromS).toBeCloseTo(2, 9);
    expect(camera!.runs[1]!.toS).toBeCloseTo(6, 9);
    expect(car!.id).toBe("car");
    expect(car!.runs.map((r) => r.tone)).toEqual(["good", "warn"]);
  });

  it("leave a gap where no frames are", () => {
    const h = new FrameHistory();
    for (const t of [0, 0.1, 0.2, 5, 5.1]) h.append(frame(Math.round(10 * t), t, { camera: { state: CameraState.TRACKED } }));
    const runs = buildLanes(h, 0, 10)[0]!.runs;
    expect(runs).toHaveLength(2);
    expect(runs[0]!.toS).toBeLessThan(0.4);
    expect(runs[1]!.fromS).toBe(5);
  });

  it("hold only what is asked for", () => {
    const runs = buildLanes(history(), 7, 8)[0]!.runs;
    expect(runs).toHaveLength(1);
    expect(runs[0]!.tone).toBe("warn");
  });
});

describe("plots", () => {
  it("take their values from the frames of the span", () => {
    const data = plotData("inliers", history(), 2.05, 3.05, []);
    expect([...data.times]).toHaveLength(11);
    expect(data.lines[0]!.values[0]).toBe(20);
  });

  it("leave out targets that are not there", () => {
    const data = plotData("confidence", history(), 0, 10, ["car"]);
    expect(data.lines[0]!.values[0]).toBeNaN();
    expect(data.lines[0]!.values[50]).toBe(0.5);
  });

  it("tell the frame rate and the frames that are missing", () => {
    const rate = plotData("rate", history(), 0, 10, []).lines[0]!.values;
    expect(rate[50]).toBeCloseTo(10, 6);
    expect(missing(frame(3, 0), frame(7, 0))).toBe(3);
    expect(missing(undefined, frame(7, 0))).toBe(0);
  });

  it("have round axes", () => {
    expect(niceTop(0)).toBe(1);
    expect(niceTop(17)).toBe(20);
    expect(niceTop(0.0031)).toBeCloseTo(0.004, 12);
    expect(indexAtTime(Float64Array.of(1, 2, 3), 2.5)).toBe(1);
    expect(indexAtTime(Float64Array.of(1, 2, 3), 0.5)).toBe(-1);
  });
});

describe("words", () => {
  it("tell times", () => {
    expect(clock(0)).toBe("0:00");
    expect(clock(65.9)).toBe("1:05");
    expect(clock(3725)).toBe("1:02:05");
    expect(clock(-1)).toBe("0:00");
    expect(tickStep(60, 6)).toBe(10);
    expect(tickStep(0.3, 6)).toBe(0.1);
  });

  it("tell states", () => {
    expect(targetWords(TargetState.PREDICTED, 1.25)).toBe("predicted for 1.3 s");
    expect(targetWords(TargetState.TRACKED, 0)).toBe("seen");
  });
});
