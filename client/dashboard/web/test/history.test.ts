// SPDX-License-Identifier: Apache-2.0
import { describe, expect, it } from "vitest";
import { FrameHistory, ImageStore } from "../src/data/history";
import { frame } from "./frames";

const fill = (history: FrameHistory, from: number, to: number) => {
  for (let i = from; i < to; ++i) history.append(frame(i, i / 10));
};

describe("a history", () => {
  it("forgets the oldest frames and stays ordered", () => {
    const history = new FrameHistory(100);
    fill(history, 0, 5000);
    expect(history.length).toBe(100);
    expect(history.first!.sequence).toBe(4900);
    expect(history.last!.sequence).toBe(4999);
    expect(history.at(100)).toBeUndefined();
    expect(history.at(-1)).toBeUndefined();
  });

  it("finds frames by time and by number", () => {
    const history = new FrameHistory(100);
    fill(history, 0, 250);
    expect(history.at(history.indexAt(20.05))!.sequence).toBe(200);
    expect(history.indexAt(0)).toBe(-1);
    expect(history.at(history.indexAt(1e9))!.sequence).toBe(249);
    expect(history.at(history.indexOf(177))!.sequence).toBe(177);
    expect(history.indexOf(3)).toBe(-1);
  });

  it("takes older frames in between, and keeps the live ones", () => {
    const history = new FrameHistory();
    history.append(frame(5, 0.5, {}, 7));
    history.append(frame(6, 0.6));
    history.merge([frame(3, 0.3), frame(4, 0.4), frame(5, 0.5)]);
    expect([0, 1, 2, 3].map((i) => history.at(i)!.sequence)).toEqual([3, 4, 5, 6]);
    expect(history.at(2)!.skipped).toBe(7);
    expect(history.first!.timeS).toBeCloseTo(0.3, 9);
  });

  it("has an axis that goes on when the source starts anew", () => {
    const history = new FrameHistory();
    history.append(frame(0, 0));
    history.append(frame(1, 8));
    history.append(frame(2, 0)); // the video from its beginning
    history.append(frame(3, 0.1));
    const times = [0, 1, 2, 3].map((i) => history.at(i)!.timeS);
    expect(times[2]).toBeCloseTo(8 + 1 / 24, 9);
    expect(times[3]! - times[2]!).toBeCloseTo(0.1, 9);
  });

  it("drops the matched landmarks of old frames", () => {
    const history = new FrameHistory();
    for (let i = 0; i < 700; ++i) history.append(frame(i, i / 24, { camera: { matchXyPx: [1, 2] } }));
    expect(history.first!.result.camera!.matchXyPx).toEqual([]);
    expect(history.last!.result.camera!.matchXyPx).toEqual([1, 2]);
  });
});

describe("kept images", () => {
  it("are bounded in bytes, the oldest going first", () => {
    const images = new ImageStore(1000);
    for (let i = 0; i < 20; ++i) images.set(i, new Uint8Array(100));
    expect(images.bytes).toBe(1000);
    expect(images.size).toBe(10);
    expect(images.get(9)).toBeUndefined();
    expect(images.get(10)).toBeDefined();
  });

  it("count a replaced image once and refuse what does not fit", () => {
    const images = new ImageStore(1000);
    images.set(1, new Uint8Array(400));
    images.set(1, new Uint8Array(300));
    expect(images.bytes).toBe(300);
    images.set(2, new Uint8Array(2000));
    expect(images.bytes).toBe(300);
  });

  it("are found a few frames back", () => {
    const images = new ImageStore();
    images.set(10, new Uint8Array(1));
    expect(images.atOrBefore(13, 5)).toBe(10);
    expect(images.atOrBefore(20, 5)).toBeNull();
    expect(images.atOrBefore(9, 5)).toBeNull();
  });
});
