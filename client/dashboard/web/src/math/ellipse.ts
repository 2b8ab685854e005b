// SPDX-License-Identifier: Apache-2.0
// The ellipse of a 2x2 covariance.

export interface Ellipse {
  readonly major: number; // one sigma
  readonly minor: number;
  readonly angle: number; // of the major axis, rad
}

// covariance: row by row. Null if it is not one (negative, not finite).
export function ellipseOf(covariance: readonly number[]): Ellipse | null {
  const [a, b, c, d] = covariance;
  if (a === undefined || b === undefined || c === undefined || d === undefined) return null;
  const off = 0.5 * (b + c);
  const mean = 0.5 * (a + d);
  const root = Math.hypot(0.5 * (a - d), off);
  const low = mean - root;
  // Rounding may take the smaller eigenvalue of a flat ellipse below zero.
  if (!(mean + root >= 0) || !(low >= -1e-9 * Math.max(1, mean))) return null;
  return {
    major: Math.sqrt(mean + root),
    minor: Math.sqrt(Math.max(0, low)),
    angle: 0.5 * Math.atan2(2 * off, a - d),
  };
}

// Of 95 % of a 2D normal distribution: sqrt(chi2inv(0.95, 2)).
export const SIGMAS_95 = 2.4477;

// Standard deviations of the camera's centre (m) and rotation (rad) from the
// 6x6 covariance of (dp, dtheta): root of the trace of each block.
export function poseSigmas(covariance: readonly number[]): { position: number; rotation: number } | null {
  if (covariance.length !== 36) return null;
  const sum = (from: number) =>
    covariance[from * 7]! + covariance[(from + 1) * 7]! + covariance[(from + 2) * 7]!;
  const position = Math.sqrt(sum(0));
  const rotation = Math.sqrt(sum(3));
  return Number.isFinite(position) && Number.isFinite(rotation) ? { position, rotation } : null;
}
