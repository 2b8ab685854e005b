// SPDX-License-Identifier: Apache-2.0
import { describe, expect, it } from "vitest";
import { Camera, ModelId, parseCameraJson, type CameraParams } from "../src/math/camera";

const SIZE = { width: 1280, height: 720 };
const MODELS: Record<string, CameraParams> = {
  SIMPLE_PINHOLE: { model: ModelId.SimplePinhole, ...SIZE, params: [1000, 640, 360] },
  PINHOLE: { model: ModelId.Pinhole, ...SIZE, params: [1000, 1010, 641, 359] },
  SIMPLE_RADIAL: { model: ModelId.SimpleRadial, ...SIZE, params: [1050, 640, 360, -0.045] },
  RADIAL: { model: ModelId.Radial, ...SIZE, params: [900, 640, 360, -0.12, 0.03] },
  OPENCV: { model: ModelId.OpenCv, ...SIZE, params: [950, 960, 640, 360, -0.1, 0.02, 0.001, -0.002] },
  OPENCV_FISHEYE: { model: ModelId.OpenCvFisheye, ...SIZE, params: [600, 605, 640, 360, -0.02, 0.004, -0.001, 0.0002] },
};

describe.each(Object.entries(MODELS))("%s", (_, spec) => {
  const camera = new Camera(spec);

  it("puts the optical axis on the principal point", () => {
    const p = camera.project([0, 0, 5])!;
    expect(p[0]).toBeCloseTo(camera.cx, 9);
    expect(p[1]).toBeCloseTo(camera.cy, 9);
  });

  it("is undone by normalized() all over the image", () => {
    for (let u = 0; u <= 1280; u += 160) {
      for (let v = 0; v <= 720; v += 120) {
        const x = camera.normalized([u, v]);
        expect(x, `no ray at ${u}, ${v}`).not.toBeNull();
        const p = camera.project([3 * x![0], 3 * x![1], 3])!;
        expect(Math.hypot(p[0] - u, p[1] - v)).toBeLessThan(1e-6);
      }
    }
  });

  it("has no pixel for what is behind", () => {
    expect(camera.project([0.1, 0.1, -1])).toBeNull();
    expect(camera.project([0.1, 0.1, 0])).toBeNull();
    expect(camera.project([NaN, 0, 1])).toBeNull();
  });
});

describe("formulas", () => {
  it("SIMPLE_RADIAL is (1 + k r^2) x", () => {
    const p = new Camera(MODELS.SIMPLE_RADIAL!).project([0.4, -0.2, 1])!;
    const s = 1 - 0.045 * 0.2;
    expect(p[0]).toBeCloseTo(640 + 1050 * 0.4 * s, 9);
    expect(p[1]).toBeCloseTo(360 - 1050 * 0.2 * s, 9);
  });

  it("OPENCV is OpenCV's", () => {
    const [x, y, r2] = [0.3, 0.2, 0.13];
    const radial = 1 - 0.1 * r2 + 0.02 * r2 * r2;
    const xd = x * radial + 2 * 0.001 * x * y - 0.002 * (r2 + 2 * x * x);
    const yd = y * radial + 0.001 * (r2 + 2 * y * y) - 2 * 0.002 * x * y;
    const p = new Camera(MODELS.OPENCV!).project([x, y, 1])!;
    expect(p[0]).toBeCloseTo(950 * xd + 640, 9);
    expect(p[1]).toBeCloseTo(960 * yd + 360, 9);
  });

  it("OPENCV_FISHEYE bends by the angle", () => {
    const r = Math.hypot(0.8, 0.6);
    const theta = Math.atan(r);
    const t2 = theta * theta;
    const d = theta * (1 + t2 * (-0.02 + t2 * (0.004 + t2 * (-0.001 + t2 * 0.0002))));
    const p = new Camera(MODELS.OPENCV_FISHEYE!).project([0.8, 0.6, 1])!;
    expect(p[0]).toBeCloseTo(640 + (600 * 0.8 * d) / r, 9);
    expect(p[1]).toBeCloseTo(360 + (605 * 0.6 * d) / r, 9);
  });

  it("points beyond the fold have no pixel", () => {
    // 1 + 3 k r^2 = 0 at r = sqrt(1 / 0.6) = 1.29.
    const camera = new Camera({ model: ModelId.SimpleRadial, ...SIZE, params: [500, 640, 360, -0.2] });
    expect(camera.project([1.28, 0, 1])).not.toBeNull();
    expect(camera.project([1.3, 0, 1])).toBeNull();
  });
});

describe("bad cameras", () => {
  it("are refused with a reason", () => {
    expect(() => new Camera({ ...MODELS.RADIAL!, params: [1, 2, 3] })).toThrow(/RADIAL has 5 params, got 3/);
    expect(() => new Camera({ ...MODELS.RADIAL!, params: [900, 640, NaN, 0, 0] })).toThrow(/not a number/);
    expect(() => new Camera({ ...MODELS.RADIAL!, params: [-1, 640, 360, 0, 0] })).toThrow(/focal length/);
    expect(() => new Camera({ ...MODELS.RADIAL!, width: 0 })).toThrow(/empty/);
    expect(() => new Camera({ ...MODELS.RADIAL!, model: 99 as ModelId })).toThrow(/unknown camera model/);
  });

  it("camera.json names what is wrong", () => {
    const good = '{"width":1280,"height":720,"model":"SIMPLE_RADIAL","params":[1050,640,360,-0.045]}';
    expect(parseCameraJson(good)).toEqual(MODELS.SIMPLE_RADIAL);
    expect(() => parseCameraJson("{")).toThrow(/not JSON/);
    expect(() => parseCameraJson("null")).toThrow(/no object/);
    expect(() => parseCameraJson('{"model":"FOV"}')).toThrow(/"FOV"/);
    expect(() => parseCameraJson(good.replace("1280", '"a"'))).toThrow(/width and height/);
    expect(() => parseCameraJson(good.replace("1050", "null"))).toThrow(/list of numbers/);
    expect(() => parseCameraJson(good.replace(",-0.045", ""))).toThrow(/4 params, got 3/);
  });
});
