// SPDX-License-Identifier: Apache-2.0
// Local east, north, up to WGS84, by way of the earth-centred frame (EPSG
// method 9837 and its inverse).
import type { Vec3 } from "./pose";

export interface Geodetic {
  readonly latitude_deg: number;
  readonly longitude_deg: number;
  readonly height_m: number; // above the ellipsoid
}

const A = 6_378_137;
const F = 1 / 298.257223563;
const E2 = F * (2 - F);
const RAD = Math.PI / 180;

export function ecefFromGeodetic(g: Geodetic): Vec3 {
  const lat = g.latitude_deg * RAD;
  const lon = g.longitude_deg * RAD;
  const n = A / Math.sqrt(1 - E2 * Math.sin(lat) ** 2);
  return [
    (n + g.height_m) * Math.cos(lat) * Math.cos(lon),
    (n + g.height_m) * Math.cos(lat) * Math.sin(lon),
    (n * (1 - E2) + g.height_m) * Math.sin(lat),
  ];
}

// Iterates the latitude (Bowring's start): below 1e-12 rad after two rounds
// near the ground.
export function geodeticFromEcef([x, y, z]: Vec3): Geodetic {
  const p = Math.hypot(x, y);
  const b = A * (1 - F);
  const theta = Math.atan2(z * A, p * b);
  let lat = Math.atan2(
    z + ((E2 * A * A) / b) * Math.sin(theta) ** 3,
    p - E2 * A * Math.cos(theta) ** 3,
  );
  let n = A;
  for (let i = 0; i < 3; ++i) {
    n = A / Math.sqrt(1 - E2 * Math.sin(lat) ** 2);
    lat = Math.atan2(z + E2 * n * Math.sin(lat), p);
  }
  n = A / Math.sqrt(1 - E2 * Math.sin(lat) ** 2);
  // The form without a quotient that vanishes at the poles.
  const height = p * Math.cos(lat) + z * Math.sin(lat) - (A * A) / n;
  return {
    latitude_deg: lat / RAD,
    longitude_deg: Math.atan2(y, x) / RAD,
    height_m: height,
  };
}

export function geodeticFromLocal(origin: Geodetic, [east, north, up]: Vec3): Geodetic {
  const lat = origin.latitude_deg * RAD;
  const lon = origin.longitude_deg * RAD;
  const o = ecefFromGeodetic(origin);
  const [sl, cl] = [Math.sin(lat), Math.cos(lat)];
  const [so, co] = [Math.sin(lon), Math.cos(lon)];
  return geodeticFromEcef([
    o[0] - so * east - sl * co * north + cl * co * up,
    o[1] + co * east - sl * so * north + cl * so * up,
    o[2] + cl * north + sl * up,
  ]);
}
