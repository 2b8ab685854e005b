// SPDX-License-Identifier: Apache-2.0
// Poses, boxes and lenses. Lengths are metres if the map is metric, else the
// map's unit; angles radians; image coordinates pixels with the centre of the
// first pixel at (0.5, 0.5). Frames: world (z up, ground near z = 0), camera (x
// right, y down, z forward), object (x along the heading, y left, z up). A
// transform `targetFromSource` takes points of the source to the target.
import { aboveZero, finite, numbers, whole } from "./checks.js";
import { badArgument, show, unknownChoice } from "./errors.js";
import { readPath } from "./paths.js";

export type Vector3 = readonly [x: number, y: number, z: number];

/** A unit quaternion. */
export interface Quaternion {
  readonly w: number;
  readonly x: number;
  readonly y: number;
  readonly z: number;
}

/** x_target = rotation x_source + translation. */
export interface RigidTransform {
  readonly rotation: Quaternion;
  readonly translation: Vector3;
}

/** x_target = scale rotation x_source + translation. */
export interface SimilarityTransform extends RigidTransform {
  readonly scale: number;
}

/** normal . x + d = 0, with a unit normal. */
export interface Plane {
  readonly normal: Vector3;
  readonly d: number;
}

/** A place on Earth, WGS84. */
export interface GeodeticPosition {
  readonly latitudeDeg: number;
  readonly longitudeDeg: number;
  readonly heightM: number;
}

/** A box in the image, px: it covers [x, x + width) and so on. */
export interface Box2 {
  readonly x: number;
  readonly y: number;
  readonly width: number;
  readonly height: number;
}

/** An upright box in the world: its middle and orientation, and its extent
 * along the object's x (length), y (width) and z (height). */
export interface Box3 {
  readonly worldFromObject: RigidTransform;
  readonly sizeM: Vector3;
}

/** Parameters of the lens models, in order, as COLMAP has them. */
export const CAMERA_MODELS = {
  SIMPLE_PINHOLE: ["f", "cx", "cy"],
  PINHOLE: ["fx", "fy", "cx", "cy"],
  SIMPLE_RADIAL: ["f", "cx", "cy", "k"],
  RADIAL: ["f", "cx", "cy", "k1", "k2"],
  OPENCV: ["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"],
  OPENCV_FISHEYE: ["fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"],
} as const;
export type CameraModelName = keyof typeof CAMERA_MODELS;

/** A lens: COLMAP's name of the model, the image's size, the parameters. */
export interface CameraModel {
  readonly model: CameraModelName;
  readonly widthPx: number;
  readonly heightPx: number;
  readonly params: readonly number[];
}

// --- transforms ---------------------------------------------------------------

/** The rotation matrix, row by row. */
export function rotationMatrix(q: Quaternion): [Vector3, Vector3, Vector3] {
  const { w, x, y, z } = q;
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
    [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
    [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
  ];
}

export function rotate(q: Quaternion, v: Vector3): Vector3 {
  const [a, b, c] = rotationMatrix(q);
  const dot = (r: Vector3): number => r[0] * v[0] + r[1] * v[1] + r[2] * v[2];
  return [dot(a), dot(b), dot(c)];
}

/** The 4x4 homogeneous matrix, row by row; of a similarity with its scale. */
export function toMatrix(t: RigidTransform | SimilarityTransform): number[] {
  const s = "scale" in t ? t.scale : 1;
  const rows = rotationMatrix(t.rotation);
  const out: number[] = [];
  rows.forEach((row, i) => out.push(s * row[0], s * row[1], s * row[2], t.translation[i] as number));
  out.push(0, 0, 0, 1);
  return out;
}

/** A point of the source, in the target. */
export function apply(t: RigidTransform | SimilarityTransform, p: Vector3): Vector3 {
  const s = "scale" in t ? t.scale : 1;
  const r = rotate(t.rotation, p);
  return [s * r[0] + t.translation[0], s * r[1] + t.translation[1], s * r[2] + t.translation[2]];
}

export function inverse(t: RigidTransform): RigidTransform {
  const rotation = { w: t.rotation.w, x: -t.rotation.x, y: -t.rotation.y, z: -t.rotation.z };
  const [x, y, z] = rotate(rotation, t.translation);
  return { rotation, translation: [-x, -y, -z] };
}

/** aFromB, bFromC: aFromC. */
export function compose(a: RigidTransform, b: RigidTransform): RigidTransform {
  const [p, q] = [a.rotation, b.rotation];
  return {
    rotation: {
      w: p.w * q.w - p.x * q.x - p.y * q.y - p.z * q.z,
      x: p.w * q.x + p.x * q.w + p.y * q.z - p.z * q.y,
      y: p.w * q.y - p.x * q.z + p.y * q.w + p.z * q.x,
      z: p.w * q.z + p.x * q.y - p.y * q.x + p.z * q.w,
    },
    translation: apply(a, b.translation),
  };
}

/** The eight corners in world; the lower four first. */
export function corners(box: Box3): Vector3[] {
  const [l, w, h] = box.sizeM;
  const around: [number, number][] = [[-1, -1], [1, -1], [1, 1], [-1, 1]];
  return [-1, 1].flatMap((z) =>
    around.map(([x, y]) => apply(box.worldFromObject, [(x * l) / 2, (y * w) / 2, (z * h) / 2])),
  );
}

/** Intersection over union, in [0, 1]. */
export function iou(a: Box2, b: Box2): number {
  const w = Math.max(0, Math.min(a.x + a.width, b.x + b.width) - Math.max(a.x, b.x));
  const h = Math.max(0, Math.min(a.y + a.height, b.y + b.height) - Math.max(a.y, b.y));
  const union = a.width * a.height + b.width * b.height - w * h;
  return union > 0 ? (w * h) / union : 0;
}

// --- what a caller passes -----------------------------------------------------

/** A box, or [x, y, width, height]. */
export type BoxLike = Box2 | readonly [number, number, number, number];

export function checkBox(field: string, value: BoxLike): Box2 {
  let box = value as Box2;
  if (Array.isArray(value)) {
    const [x, y, width, height] = numbers(field, value, 4) as [number, number, number, number];
    box = { x, y, width, height };
  }
  if (typeof box !== "object" || box === null) {
    throw badArgument(field, `${show(value)} must be a box or [x, y, width, height]`);
  }
  finite(`${field}.x`, box.x);
  finite(`${field}.y`, box.y);
  aboveZero(`${field}.width`, box.width);
  aboveZero(`${field}.height`, box.height);
  return box;
}

export function checkVector(field: string, value: unknown): Vector3 {
  return numbers(field, value, 3) as unknown as Vector3;
}

/** Of any length but 0; becomes a unit quaternion. */
export function checkQuaternion(field: string, q: Quaternion): Quaternion {
  if (typeof q !== "object" || q === null) throw badArgument(field, `${show(q)} must be {w, x, y, z}`);
  const parts = (["w", "x", "y", "z"] as const).map((n) => finite(`${field}.${n}`, q[n]));
  const length = Math.hypot(...parts);
  if (length < 1e-12) throw badArgument(field, "has length 0, must be a rotation");
  const [w, x, y, z] = (Math.abs(length - 1) < 1e-12 ? parts : parts.map((p) => p / length)) as [
    number, number, number, number,
  ];
  return { w, x, y, z };
}

export function checkSimilarity(field: string, s: SimilarityTransform): SimilarityTransform {
  if (typeof s !== "object" || s === null) {
    throw badArgument(field, `${show(s)} must be {scale, rotation, translation}`);
  }
  return {
    scale: aboveZero(`${field}.scale`, s.scale),
    rotation: checkQuaternion(`${field}.rotation`, s.rotation),
    translation: checkVector(`${field}.translation`, s.translation),
  };
}

export function checkPlace(field: string, place: GeodeticPosition): GeodeticPosition {
  for (const [name, bound] of [["latitudeDeg", 90], ["longitudeDeg", 180]] as const) {
    const value = finite(`${field}.${name}`, place?.[name]);
    if (Math.abs(value) > bound) {
      throw badArgument(`${field}.${name}`, `${value} must be in [-${bound}, ${bound}]`);
    }
  }
  finite(`${field}.heightM`, place.heightM);
  return place;
}

export function checkCamera(field: string, camera: CameraModel): CameraModel {
  if (typeof camera !== "object" || camera === null) {
    throw badArgument(field, `${show(camera)} must be a CameraModel or the path of a camera.json`);
  }
  const names = (CAMERA_MODELS as Record<string, readonly string[]>)[camera.model];
  if (names === undefined) throw unknownChoice(`${field}.model`, camera.model, Object.keys(CAMERA_MODELS));
  whole(`${field}.widthPx`, camera.widthPx, 1, 65535);
  whole(`${field}.heightPx`, camera.heightPx, 1, 65535);
  const params = camera.params;
  if (!Array.isArray(params) || params.length !== names.length) {
    const count = Array.isArray(params) ? params.length : 0;
    throw badArgument(
      `${field}.params`,
      `${count} given, but ${camera.model} has ${names.length}: ${names.join(", ")}`,
    );
  }
  names.forEach((name, i) => {
    const check = name.startsWith("f") ? aboveZero : finite;
    check(`${field}.params (${name})`, params[i]);
  });
  return camera;
}

/** A lens, or the path of its camera.json. */
export function cameraOf(field: string, value: CameraModel | string): CameraModel {
  return typeof value === "string" ? readCamera(value) : checkCamera(field, value);
}

/** From a camera.json, as `groundlock track --camera` takes it. */
export function readCamera(path: string): CameraModel {
  const v = readJson(path, ["model", "width", "height", "params"]);
  const camera = { model: v["model"], widthPx: v["width"], heightPx: v["height"], params: v["params"] };
  return checkCamera(path, camera as CameraModel);
}

/** From an align.json, as `groundlock map import --align` takes it. */
export function readAlignment(path: string): SimilarityTransform {
  const v = readJson(path, ["scale", "rotation_wxyz", "translation"]);
  const [w, x, y, z] = numbers(`${path}: rotation_wxyz`, v["rotation_wxyz"], 4) as [
    number, number, number, number,
  ];
  const translation = checkVector(`${path}: translation`, v["translation"]);
  return checkSimilarity(path, { scale: v["scale"] as number, rotation: { w, x, y, z }, translation });
}

export function readJson(path: string, keys: string[]): Record<string, unknown> {
  const text = new TextDecoder().decode(readPath(path, path));
  let values: unknown;
  try {
    values = JSON.parse(text);
  } catch (error) {
    throw badArgument(path, `is not JSON: ${(error as Error).message}`);
  }
  const object = (typeof values === "object" && values !== null ? values : {}) as Record<string, unknown>;
  const missing = keys.find((key) => !(key in object));
  if (missing !== undefined) throw badArgument(path, `${missing} is missing; needs ${keys.join(", ")}`);
  return object;
}
