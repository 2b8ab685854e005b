// SPDX-License-Identifier: Apache-2.0
// Control points as `groundlock map align --control-points` takes them:
// {"points":[{"name":"corner",
//             "position":[x,y,z] or "pixels":[{"image":"a.jpg","xy":[x,y]},...],
//             "place":[x,y,z] or {"latitude_deg":..,"longitude_deg":..,"height_m":..}}]}
import type { RequestInit } from "../link/connection";

type AlignValue = Extract<RequestInit, { case: "alignMap" }>["value"];
export type ControlPoints = NonNullable<Extract<AlignValue["method"], { case: "controlPoints" }>>["value"];

const MIN_POINTS = 3;

function numbers(value: unknown, count: number, where: string): number[] {
  if (!Array.isArray(value) || value.length !== count || !value.every((v) => typeof v === "number" && Number.isFinite(v))) {
    throw new Error(`${where} must be ${count} numbers`);
  }
  return value as number[];
}

function fieldsOf(value: unknown, where: string): Record<string, unknown> {
  if (typeof value !== "object" || value === null || Array.isArray(value)) throw new Error(`${where} must be an object`);
  return value as Record<string, unknown>;
}

function vector(value: unknown, where: string): { x: number; y: number; z: number } {
  const [x, y, z] = numbers(value, 3, where) as [number, number, number];
  return { x, y, z };
}

function mapPoint(fields: Record<string, unknown>, where: string) {
  if (fields.position !== undefined) return { positionWorld: vector(fields.position, `${where}: position`) };
  if (!Array.isArray(fields.pixels) || fields.pixels.length < 2) {
    throw new Error(`${where}: give a position, or pixels in two images or more`);
  }
  return {
    pixels: fields.pixels.map((pixel: unknown, i) => {
      const at = `${where}: pixels[${i}]`;
      const { image, xy } = fieldsOf(pixel, at);
      if (typeof image !== "string" || image === "") throw new Error(`${at}: image must be a name`);
      const [xPx, yPx] = numbers(xy, 2, `${at}: xy`) as [number, number];
      return { image, xPx, yPx };
    }),
  };
}

function place(value: unknown, where: string) {
  if (Array.isArray(value)) return { place: { case: "positionM" as const, value: vector(value, where) } };
  const fields = fieldsOf(value, where);
  const [latitudeDeg, longitudeDeg, heightM] = numbers(
    [fields.latitude_deg, fields.longitude_deg, fields.height_m ?? 0], 3,
    `${where}: latitude_deg, longitude_deg and height_m`,
  ) as [number, number, number];
  return { place: { case: "geodetic" as const, value: { latitudeDeg, longitudeDeg, heightM } } };
}

// Throws an Error that names the point and the field.
export function parseControlPoints(text: string): ControlPoints {
  let json: unknown;
  try {
    json = JSON.parse(text);
  } catch {
    throw new Error("the file of control points is not JSON");
  }
  const { points } = fieldsOf(json, "the file");
  if (!Array.isArray(points) || points.length < MIN_POINTS) throw new Error(`points must hold at least ${MIN_POINTS}`);
  return {
    points: points.map((point: unknown, i) => {
      const fields = fieldsOf(point, `points[${i}]`);
      const name = typeof fields.name === "string" && fields.name !== "" ? fields.name : `${i + 1}`;
      const where = `point ${name}`;
      return { name, point: mapPoint(fields, where), place: place(fields.place, `${where}: place`) };
    }),
  };
}
