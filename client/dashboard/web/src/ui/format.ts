// SPDX-License-Identifier: Apache-2.0
// Numbers and words for people.
import { BodyKind } from "../gen/groundlock/v1/tracking_pb";
import type { Timestamp } from "@bufbuild/protobuf/wkt";

export function bytes(n: number | bigint): string {
  const value = Number(n);
  for (const [unit, size] of [["GB", 1e9], ["MB", 1e6], ["kB", 1e3]] as const) {
    if (value >= size) return `${(value / size).toFixed(value >= 100 * size ? 0 : 1)} ${unit}`;
  }
  return `${value} B`;
}

export function count(n: number | bigint): string {
  return Number(n).toLocaleString("en-US");
}

// Lengths; maps that are not metric have units of their own.
export function length(m: number, metric = true): string {
  const unit = metric ? "m" : "u";
  const a = Math.abs(m);
  if (metric && a < 1) return `${(100 * m).toFixed(a < 0.1 ? 1 : 0)} cm`;
  return `${m.toFixed(a < 10 ? 2 : a < 100 ? 1 : 0)} ${unit}`;
}

export const BODY_KINDS = [
  BodyKind.CAR, BodyKind.VAN, BodyKind.TRUCK, BodyKind.BUS,
  BodyKind.MOTORCYCLE, BodyKind.BICYCLE, BodyKind.PERSON, BodyKind.BOAT,
] as const;

export function kindWord(kind: BodyKind): string {
  return (BodyKind[kind] ?? `kind ${kind}`).toLowerCase();
}

export function degrees(rad: number, digits = 1): string {
  return `${((180 * rad) / Math.PI).toFixed(digits)}°`;
}

export function when(t: Timestamp | undefined): string {
  if (!t) return "";
  return new Date(Number(t.seconds) * 1000).toLocaleString(undefined, {
    dateStyle: "medium",
    timeStyle: "short",
  });
}
