// SPDX-License-Identifier: Apache-2.0
import { describe, expect, it } from "vitest";
import { BOX_EDGES, boxCorners, projectBox, projectSegment, type Box3 } from "../src/math/box3";
import { Camera, ModelId } from "../src/math/camera";
import { ellipseOf, poseSigmas } from "../src/math/ellipse";
import { IDENTITY_QUAT, inverse, type Rigid } from "../src/math/pose";

const camera = new Camera({ model: ModelId.SimplePinhole, width: 1280, height: 720, params: [1000, 640, 360] });
// Looks along world y, z up: x right, y down, z forward.
const s = Math.SQRT1_2;
const worldFromCamera: Rigid = { rotation: [s, -s, 0, 0], translation: [0, -5, 0] };
const box: Box3 = { worldFromObject: { rotation: IDENTITY_QUAT, translation: [0, 0, 0] }, size: [2, 1, 0.5] };

describe("boxes", () => {
  it("have corners by the bits of their index", () => {
    expect(boxCorners(box)[0]).toEqual([-1, -0.5, -0.25]);
    expect(boxCorners(box)[7]).toEqual([1, 0.5, 0.25]);
  });

  it("have edges that join corners one bit apart", () => {
    expect(new Set(BOX_EDGES.map(String)).size).toBe(12);
    for (const [a, b] of BOX_EDGES) expect([1, 2, 4]).toContain(a ^ b);
  });

  it("project where the pinhole says", () => {
    const p = projectBox(camera, worldFromCamera, box);
    expect(p.edges).toHaveLength(12);
    expect(p.center![0]).toBeCloseTo(640, 9);
    expect(p.center![1]).toBeCloseTo(360, 9);
    // The front face is at +x: right of the middle, 4.5 to 5.5 away.
    const xs = p.front!.map((q) => q[0]);
    expect(Math.min(...xs)).toBeCloseTo(640 + 1000 / 5.5, 6);
    expect(Math.max(...xs)).toBeCloseTo(640 + 1000 / 4.5, 6);
  });

  it("lose the front face but keep edges when the camera stands inside", () => {
    const inside: Rigid = { ...worldFromCamera, translation: [0.9, 0, 0] };
    const p = projectBox(camera, inside, box);
    expect(p.front).toBeNull();
    expect(p.edges.length).toBeGreaterThan(0);
  });
});

describe("segments", () => {
  it("are cut at the camera", () => {
    const cut = projectSegment(camera, inverse(worldFromCamera), [0, 0, 0], [0, -20, 1]);
    expect(cut).not.toBeNull();
    expect(cut![0][0]).toBeCloseTo(640, 6);
    expect(cut![1][1]).toBeLessThan(0); // far above
    expect(projectSegment(camera, inverse(worldFromCamera), [0, -6, 0], [0, -20, 1])).toBeNull();
  });
});

describe("ellipses", () => {
  it("have the axes of the covariance", () => {
    const [c, n] = [Math.cos(0.4), Math.sin(0.4)];
    const e = ellipseOf([4 * c * c + n * n, 3 * c * n, 3 * c * n, 4 * n * n + c * c])!;
    expect(e.major).toBeCloseTo(2, 9);
    expect(e.minor).toBeCloseTo(1, 9);
    expect(e.angle).toBeCloseTo(0.4, 9);
  });

  it("may be flat, but not of anything else", () => {
    expect(ellipseOf([1, 0, 0, 0])!.minor).toBe(0);
    expect(ellipseOf([1, 0, 0, -1])).toBeNull();
    expect(ellipseOf([NaN, 0, 0, 1])).toBeNull();
    expect(ellipseOf([1, 0])).toBeNull();
  });

  it("pose sigmas are the roots of the blocks' traces", () => {
    const c = Array<number>(36).fill(0);
    [1, 1, 2, 0.01, 0.02, 0.06].forEach((v, i) => (c[7 * i] = v));
    expect(poseSigmas(c)!.position).toBeCloseTo(2, 12);
    expect(poseSigmas(c)!.rotation).toBeCloseTo(0.3, 12);
    expect(poseSigmas([])).toBeNull();
  });
});
