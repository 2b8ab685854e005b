// SPDX-License-Identifier: Apache-2.0
// An inertial measurement unit on the camera: its gyroscope tells how the camera
// turned where the image is smeared. What it measures goes with the frames.
import { finite, numbers } from "./checks.js";
import { badArgument, show } from "./errors.js";
import { type Quaternion, type Vector3, checkQuaternion, checkVector, readJson } from "./geometry.js";
import { readPath } from "./paths.js";

/** A unit that is fixed to the camera. The gyroscope's figures are as a data sheet
 * or a calibration states them; left out = those of a phone's. */
export interface ImuModel {
  readonly imuFromCamera: Quaternion; // turns the camera's axes into the unit's
  readonly gyroscopeNoiseRadSSqrtHz?: number | undefined;
  readonly gyroscopeWalkRadS2SqrtHz?: number | undefined;
  readonly gyroscopeBiasRadS?: number | undefined; // how far off zero at first
}

/** What the unit measured, along its own axes. */
export interface InertialSample {
  readonly timeNs: bigint; // of the clock of captureTimeNs
  readonly angularRateRadS: Vector3;
  readonly accelerationMS2?: Vector3; // specific force: at rest 9.8 upwards
}

// TrackRequest.Frame.inertial
export const MAX_SAMPLES_PER_FRAME = 4096;
const INT64_MAX = (1n << 63n) - 1n;
const COLUMNS = ["timestamp [ns]", "w_x", "w_y", "w_z", "a_x", "a_y", "a_z"];
const GYROSCOPE = {
  gyroscopeNoiseRadSSqrtHz: "gyroscope_noise_rad_s_sqrt_hz",
  gyroscopeWalkRadS2SqrtHz: "gyroscope_walk_rad_s2_sqrt_hz",
  gyroscopeBiasRadS: "gyroscope_bias_rad_s",
} as const;
type Figure = keyof typeof GYROSCOPE;

export function checkImu(field: string, imu: ImuModel): ImuModel {
  if (typeof imu !== "object" || imu === null) {
    throw badArgument(field, `${show(imu)} must be an ImuModel or the path of an imu.json`);
  }
  const figures: Partial<Record<Figure, number>> = {};
  for (const name of Object.keys(GYROSCOPE) as Figure[]) {
    if (imu[name] === undefined) continue;
    const value = finite(`${field}.${name}`, imu[name]);
    if (value < 0) throw badArgument(`${field}.${name}`, `${value} must not be negative`);
    figures[name] = value;
  }
  return { imuFromCamera: checkQuaternion(`${field}.imuFromCamera`, imu.imuFromCamera), ...figures };
}

/** A unit, or the path of its imu.json. */
export function imuOf(field: string, value: ImuModel | string): ImuModel {
  return typeof value === "string" ? readImu(value) : checkImu(field, value);
}

/** From an imu.json, as `groundlock track --imu-model` takes it. */
export function readImu(path: string): ImuModel {
  const values = readJson(path, ["imu_from_camera_wxyz"]);
  const [w, x, y, z] = numbers(`${path}: imu_from_camera_wxyz`, values["imu_from_camera_wxyz"], 4) as [
    number, number, number, number,
  ];
  const figures = Object.fromEntries(Object.entries(GYROSCOPE).map(([ours, theirs]) => [ours, values[theirs]]));
  return checkImu(path, { imuFromCamera: { w, x, y, z }, ...figures });
}

/** From a recording, as `groundlock track --imu` takes it: rows as in EuRoC's
 * imu0/data.csv (time in ns, angular rate x, y, z in rad/s, specific force x, y, z
 * in m/s^2). Lines that begin with # are passed over. */
export function readInertial(path: string): InertialSample[] {
  const samples: InertialSample[] = [];
  new TextDecoder().decode(readPath(path, path)).split("\n").forEach((text, i) => {
    const line = text.trim();
    if (line === "" || line.startsWith("#")) return;
    const cells = line.split(",").map((cell) => cell.trim());
    const wrong = (column: number): never => {
      const kind = column ? "a number, finite" : "a whole number of nanoseconds, not below 0";
      const problem = cells[column] === undefined ? "is missing" : `${show(cells[column])} is not ${kind}`;
      throw badArgument(path, `line ${i + 1}, column ${column + 1} (${COLUMNS[column]}): ${problem}`);
    };
    const values = COLUMNS.slice(1).map((_, k) => {
      const cell = cells[k + 1];
      const value = cell ? Number(cell) : NaN;
      return Number.isFinite(value) ? value : wrong(k + 1);
    }) as [number, number, number, number, number, number];
    const time = /^\d+$/.test(cells[0] ?? "") ? BigInt(cells[0] as string) : -1n;
    if (time < 0n || time > INT64_MAX) wrong(0);
    const [wx, wy, wz, ax, ay, az] = values;
    samples.push({ timeNs: time, angularRateRadS: [wx, wy, wz], accelerationMS2: [ax, ay, az] });
  });
  return checkInertial(path, samples);
}

/** Of a clock that is 0 when theirs says `epochNs`. What was before that is left out. */
export function inertialSince(samples: readonly InertialSample[], epochNs: bigint): InertialSample[] {
  return samples.map((s) => ({ ...s, timeNs: s.timeNs - epochNs })).filter((s) => s.timeNs >= 0n);
}

/** What goes with a frame: those after the frame before (undefined = it is the
 * first) up to the first one that is not before this one; the newest, if they are
 * more than a frame may bring. */
export function inertialBetween(
  samples: readonly InertialSample[],
  previousNs: bigint | undefined,
  captureTimeNs: bigint,
): InertialSample[] {
  const begin = previousNs === undefined ? 0 : firstAtOrAfter(samples, previousNs) + 1;
  const end = Math.min(samples.length, firstAtOrAfter(samples, captureTimeNs) + 1);
  return samples.slice(Math.max(begin, end - MAX_SAMPLES_PER_FRAME), Math.max(begin, end));
}

function firstAtOrAfter(samples: readonly InertialSample[], timeNs: bigint): number {
  let [low, high] = [0, samples.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if ((samples[middle] as InertialSample).timeNs < timeNs) low = middle + 1;
    else high = middle;
  }
  return low;
}

export function checkInertial(field: string, samples: readonly InertialSample[]): InertialSample[] {
  if (!Array.isArray(samples)) throw badArgument(field, `${show(samples)} must be an array of InertialSample`);
  return samples.map((sample: InertialSample, i) => {
    const where = `${field}[${i}]`;
    const time: unknown = sample?.timeNs;
    if (typeof time !== "bigint" || time < 0n || time > INT64_MAX) {
      throw badArgument(`${where}.timeNs`, `${String(time)} must be a bigint, 0n or more`);
    }
    const before = i > 0 ? (samples[i - 1] as InertialSample).timeNs : -1n;
    if (time <= before) throw badArgument(`${where}.timeNs`, `${time} is not above ${before}, the one before`);
    const force = sample.accelerationMS2;
    return {
      timeNs: time,
      angularRateRadS: checkVector(`${where}.angularRateRadS`, sample.angularRateRadS),
      ...(force && { accelerationMS2: checkVector(`${where}.accelerationMS2`, force) }),
    };
  });
}
