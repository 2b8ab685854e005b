// SPDX-License-Identifier: Apache-2.0
// The stabilised view (Robinson 2014, §3.8): the camera's rotation low-passed
// by slerp, the image warped by H = K R_P K^-1, where R_P takes directions in
// the raw camera to the stabilised one. Lens distortion is neglected: it moves
// H's image by the change of distortion between the two places of a pixel, at
// SIMPLE_RADIAL k = -0.05, f = 1020 and a correction of 2 degrees by 2 px in
// the corners.
import { Camera } from "./camera";
import {
  angleBetween,
  conjugate,
  matrixFromQuat,
  multiply,
  multiply3,
  slerp,
  type Mat3,
  type Quat,
} from "./pose";

// alpha at the frame rate for which the thesis gives it.
const ALPHA = 0.2;
const NOMINAL_RATE_HZ = 24;
// A jump beyond it is a cut or a new localisation, not shaking.
const MAX_CORRECTION_RAD = 0.35;
// A pause beyond it starts the filter anew.
const MAX_GAP_S = 1;

// The share of a step that the filter takes over dt_s: the same time constant
// at every frame rate.
export function smoothingFactor(dtS: number): number {
  return 1 - (1 - ALPHA) ** (dtS * NOMINAL_RATE_HZ);
}

export class Stabilizer {
  private smooth: Quat | null = null; // world_from_stabilised
  private last = 0;

  reset(): void {
    this.smooth = null;
  }

  // The filtered world_from_camera rotation at time_s; frames without a pose
  // (rotation null) leave the filter where it is.
  update(rotation: Quat | null, timeS: number): Quat | null {
    if (rotation === null) return this.smooth;
    const dt = timeS - this.last;
    if (
      this.smooth === null ||
      dt < 0 ||
      dt > MAX_GAP_S ||
      angleBetween(this.smooth, rotation) > MAX_CORRECTION_RAD
    ) {
      this.smooth = rotation;
    } else {
      this.smooth = slerp(this.smooth, rotation, smoothingFactor(dt));
    }
    this.last = timeS;
    return this.smooth;
  }
}

// H = K R_P K^-1, raw pixel to stabilised pixel.
export function stabilizingHomography(camera: Camera, raw: Quat, smooth: Quat): Mat3 {
  const stabilizedFromRaw = matrixFromQuat(multiply(conjugate(smooth), raw));
  return multiply3(
    multiply3(camera.calibration(), stabilizedFromRaw),
    camera.inverseCalibration(),
  );
}

export function invert3(m: Mat3): Mat3 {
  const [a, b, c, d, e, f, g, h, i] = m;
  const A = e * i - f * h;
  const B = f * g - d * i;
  const C = d * h - e * g;
  const s = 1 / (a * A + b * B + c * C);
  return [
    A * s, (c * h - b * i) * s, (b * f - c * e) * s,
    B * s, (a * i - c * g) * s, (c * d - a * f) * s,
    C * s, (b * g - a * h) * s, (a * e - b * d) * s,
  ];
}

export function applyHomography(h: Mat3, x: number, y: number): [number, number] {
  const w = h[6] * x + h[7] * y + h[8];
  return [(h[0] * x + h[1] * y + h[2]) / w, (h[3] * x + h[4] * y + h[5]) / w];
}
