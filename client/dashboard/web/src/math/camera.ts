// SPDX-License-Identifier: Apache-2.0
// The six camera models under COLMAP's names, parameter orders and pixel
// convention (the first pixel's centre is (0.5, 0.5)). The same formulas as the
// server's camera_model.h, so that boxes are drawn where the server sees them.
import type { Mat3, Vec2, Vec3 } from "./pose";

// Numbers of groundlock.v1.CameraModelId.
export enum ModelId {
  SimplePinhole = 1, // f, cx, cy
  Pinhole = 2, // fx, fy, cx, cy
  SimpleRadial = 3, // f, cx, cy, k
  Radial = 4, // f, cx, cy, k1, k2
  OpenCv = 5, // fx, fy, cx, cy, k1, k2, p1, p2
  OpenCvFisheye = 6, // fx, fy, cx, cy, k1, k2, k3, k4
}

const NUM_PARAMS: Record<ModelId, number> = {
  [ModelId.SimplePinhole]: 3,
  [ModelId.Pinhole]: 4,
  [ModelId.SimpleRadial]: 4,
  [ModelId.Radial]: 5,
  [ModelId.OpenCv]: 8,
  [ModelId.OpenCvFisheye]: 8,
};

const NAMES: Record<ModelId, string> = {
  [ModelId.SimplePinhole]: "SIMPLE_PINHOLE",
  [ModelId.Pinhole]: "PINHOLE",
  [ModelId.SimpleRadial]: "SIMPLE_RADIAL",
  [ModelId.Radial]: "RADIAL",
  [ModelId.OpenCv]: "OPENCV",
  [ModelId.OpenCvFisheye]: "OPENCV_FISHEYE",
};

export interface CameraParams {
  readonly model: ModelId;
  readonly width: number;
  readonly height: number;
  readonly params: readonly number[];
}

// Where bisection looks for the end of a polynomial's rise: 89.99 degrees.
const MAX_TESTED_RADIUS = 1e4;
const MAX_FISHEYE_ANGLE = Math.PI / 2 - 1e-7;

export class Camera {
  readonly fx: number;
  readonly fy: number;
  readonly cx: number;
  readonly cy: number;
  // 1 + c1 u + c2 u^2 + ..., u = the argument squared.
  private readonly c: readonly [number, number, number, number];
  private readonly tangential: readonly [number, number];
  private readonly fisheye: boolean;
  private readonly maxRadius: number; // |x| up to which distortion rises

  // Throws an Error that names what is wrong.
  constructor(readonly spec: CameraParams) {
    const count = NUM_PARAMS[spec.model];
    if (count === undefined) throw new Error(`unknown camera model ${spec.model}`);
    const p = spec.params;
    if (p.length !== count) {
      throw new Error(`${NAMES[spec.model]} has ${count} params, got ${p.length}`);
    }
    if (!p.every(Number.isFinite)) {
      throw new Error(`${NAMES[spec.model]}: a parameter is not a number`);
    }
    if (!(spec.width >= 1 && spec.height >= 1)) {
      throw new Error(`the image size ${spec.width}x${spec.height} is empty`);
    }
    const focals =
      spec.model === ModelId.Pinhole ||
      spec.model === ModelId.OpenCv ||
      spec.model === ModelId.OpenCvFisheye ? 2 : 1;
    this.fx = p[0]!;
    this.fy = p[focals - 1]!;
    this.cx = p[focals]!;
    this.cy = p[focals + 1]!;
    if (!(this.fx > 0 && this.fy > 0)) {
      throw new Error(`${NAMES[spec.model]}: the focal length must be above 0`);
    }
    this.fisheye = spec.model === ModelId.OpenCvFisheye;
    const k = p.slice(focals + 2);
    this.c = this.fisheye
      ? [k[0]!, k[1]!, k[2]!, k[3]!]
      : [k[0] ?? 0, k[1] ?? 0, 0, 0];
    this.tangential =
      spec.model === ModelId.OpenCv ? [k[2]!, k[3]!] : [0, 0];
    this.maxRadius = this.computeMaxRadius();
  }

  get width(): number {
    return this.spec.width;
  }
  get height(): number {
    return this.spec.height;
  }

  // K without distortion.
  calibration(): Mat3 {
    return [this.fx, 0, this.cx, 0, this.fy, this.cy, 0, 0, 1];
  }

  inverseCalibration(): Mat3 {
    return [
      1 / this.fx, 0, -this.cx / this.fx,
      0, 1 / this.fy, -this.cy / this.fy,
      0, 0, 1,
    ];
  }

  // Pixel of a point in the camera frame (x right, y down, z forward); null if
  // it is not in front of the camera or beyond the radius up to which the
  // distortion rises. The pixel may lie outside the image.
  project(p: Vec3): Vec2 | null {
    if (!(p[2] > 0)) return null;
    const x = p[0] / p[2];
    const y = p[1] / p[2];
    if (!(Math.hypot(x, y) <= this.maxRadius)) return null;
    const [dx, dy] = this.distort(x, y);
    const u = this.fx * dx + this.cx;
    const v = this.fy * dy + this.cy;
    return Number.isFinite(u) && Number.isFinite(v) ? [u, v] : null;
  }

  // Undistorted coordinates on z = 1 of a pixel; null if nothing maps there.
  normalized(pixel: Vec2): Vec2 | null {
    const xd = (pixel[0] - this.cx) / this.fx;
    const yd = (pixel[1] - this.cy) / this.fy;
    const start = this.undistortRadial(xd, yd);
    const [p1, p2] = this.tangential;
    if (p1 === 0 && p2 === 0) return start;
    return this.undistortTangential(xd, yd, start ?? [xd, yd]);
  }

  private rising(theta: number): number {
    const u = theta * theta;
    const [c1, c2, c3, c4] = this.c;
    return 1 + u * (3 * c1 + u * (5 * c2 + u * (7 * c3 + u * 9 * c4)));
  }

  private radial(r: number): number {
    const u = r * r;
    const [c1, c2, c3, c4] = this.c;
    return r * (1 + u * (c1 + u * (c2 + u * (c3 + u * c4))));
  }

  // The first place where the polynomial stops rising.
  private computeMaxRadius(): number {
    const limit = this.fisheye ? MAX_FISHEYE_ANGLE : MAX_TESTED_RADIUS;
    const steps = 4096;
    let low = 0;
    for (let i = 1; i <= steps; ++i) {
      // Dense near the axis, where lenses fold.
      const high = limit * (this.fisheye ? i / steps : (i / steps) ** 3);
      if (this.rising(high) <= 0) {
        let a = low;
        let b = high;
        for (let k = 0; k < 60; ++k) {
          const middle = 0.5 * (a + b);
          if (this.rising(middle) > 0) a = middle;
          else b = middle;
        }
        return this.fisheye ? Math.tan(a) : a;
      }
      low = high;
    }
    return this.fisheye ? Math.tan(limit) : Infinity;
  }

  private distort(x: number, y: number): Vec2 {
    const u = x * x + y * y;
    let s: number;
    if (this.fisheye) {
      const r = Math.sqrt(u);
      s = r > 1e-8 ? this.radial(Math.atan(r)) / r : 1;
    } else {
      s = 1 + u * (this.c[0] + u * this.c[1]);
    }
    const [p1, p2] = this.tangential;
    return [
      s * x + 2 * p1 * x * y + p2 * (u + 2 * x * x),
      s * y + 2 * p2 * x * y + p1 * (u + 2 * y * y),
    ];
  }

  private undistortRadial(xd: number, yd: number): Vec2 | null {
    const rd = Math.hypot(xd, yd);
    if (rd < 1e-12) return [xd, yd];
    const top = this.fisheye ? Math.atan(this.maxRadius) : this.maxRadius;
    // Bracket, then bisect with Newton steps inside the bracket.
    let high = Number.isFinite(top) ? top : Math.max(1, rd);
    while (!Number.isFinite(top) && this.radial(high) < rd) {
      high *= 2;
      if (high > 1e9) return null;
    }
    if (this.radial(high) < rd) return null;
    let low = 0;
    let r = Math.min(rd, high);
    for (let i = 0; i < 80; ++i) {
      const error = this.radial(r) - rd;
      if (Math.abs(error) < 1e-14 * (1 + rd)) break;
      if (error > 0) high = r;
      else low = r;
      const slope = this.rising(r);
      const newton = slope > 1e-12 ? r - error / slope : NaN;
      r = newton > low && newton < high ? newton : 0.5 * (low + high);
    }
    const undistorted = this.fisheye ? Math.tan(r) : r;
    return [(xd * undistorted) / rd, (yd * undistorted) / rd];
  }

  // Fixed-point iterations: the tangential part is small in every real lens.
  private undistortTangential(xd: number, yd: number, start: Vec2): Vec2 | null {
    let [x, y] = start;
    for (let i = 0; i < 100; ++i) {
      const [dx, dy] = this.distort(x, y);
      const ex = dx - xd;
      const ey = dy - yd;
      if (Math.hypot(ex, ey) < 1e-12) return [x, y];
      // Numerical Jacobian: the model has eight parameters, and this is drawn,
      // not estimated.
      const h = 1e-6;
      const [ax, ay] = this.distort(x + h, y);
      const [bx, by] = this.distort(x, y + h);
      const j11 = (ax - dx) / h;
      const j21 = (ay - dy) / h;
      const j12 = (bx - dx) / h;
      const j22 = (by - dy) / h;
      const det = j11 * j22 - j12 * j21;
      if (!(det > 1e-9)) return null;
      x -= (j22 * ex - j12 * ey) / det;
      y -= (j11 * ey - j21 * ex) / det;
    }
    return null;
  }
}

export function cameraModelName(model: number): string {
  return NAMES[model as ModelId] ?? `model ${model}`;
}

// Reads camera.json: {"width":..,"height":..,"model":"..","params":[..]}.
// Throws an Error that names the field.
export function parseCameraJson(text: string): CameraParams {
  let json: unknown;
  try {
    json = JSON.parse(text);
  } catch {
    throw new Error("camera.json is not JSON");
  }
  if (typeof json !== "object" || json === null) {
    throw new Error("camera.json holds no object");
  }
  const fields = json as Record<string, unknown>;
  const known = Object.entries(NAMES).find(([, name]) => name === fields.model);
  if (!known) {
    throw new Error(
      `camera.json: model is ${JSON.stringify(fields.model)}, known are ` +
        Object.values(NAMES).join(", "),
    );
  }
  if (!Number.isInteger(fields.width) || !Number.isInteger(fields.height)) {
    throw new Error("camera.json: width and height must be whole numbers");
  }
  const params = fields.params;
  if (!Array.isArray(params) || !params.every((p) => typeof p === "number")) {
    throw new Error("camera.json: params must be a list of numbers");
  }
  const spec: CameraParams = {
    model: Number(known[0]) as ModelId,
    width: fields.width as number,
    height: fields.height as number,
    params: params as number[],
  };
  new Camera(spec); // checks the rest
  return spec;
}
