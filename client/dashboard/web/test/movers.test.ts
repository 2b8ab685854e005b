// SPDX-License-Identifier: Apache-2.0
import { create } from "@bufbuild/protobuf";
import { describe, expect, it } from "vitest";
import { FrameResultSchema, MoversState } from "../src/gen/groundlock/v1/tracking_pb";
import { makeRecord } from "../src/data/frame";
import { moverAt, moversWords } from "../src/data/movers";
import { moverSegments } from "../src/scene/mover_glyphs";

const record = makeRecord(
  create(FrameResultSchema, {
    moversState: MoversState.WATCHING,
    movers: [
      {
        moverId: 3n,
        box: { x: 10, y: 20, width: 100, height: 50 },
        groundCenterM: { x: 1, y: 2, z: 0 },
        velocityWorldMS: { x: 3, y: 4, z: 0 },
        confidence: 0.95,
      },
      { moverId: 4n, box: { x: 40, y: 30, width: 20, height: 20 }, confidence: 0.92 },
    ],
  }),
);

describe("movers", () => {
  it("are found by a point, the smallest first", () => {
    expect(moverAt(record, [12, 22])?.moverId).toBe(3n);
    expect(moverAt(record, [45, 35])?.moverId).toBe(4n);
    expect(moverAt(record, [5, 5])).toBeNull();
  });

  it("stand on the ground and point where they will be in a second", () => {
    const points = moverSegments(record.result.movers, 0.5);
    // One of them has a place.
    expect(points).toHaveLength(10);
    expect(points[8]).toEqual([1, 2, 0]);
    expect(points[9]).toEqual([4, 6, 0]);
  });

  it("are looked for, or words say why not", () => {
    expect(moversWords(MoversState.WATCHING)).toBe("");
    expect(moversWords(MoversState.UNSPECIFIED)).toBe("");
    expect(moversWords(MoversState.NO_MAP)).toMatch(/no map/);
    expect(moversWords(MoversState.POSE_CONTRADICTED)).toMatch(/pose/);
  });
});
