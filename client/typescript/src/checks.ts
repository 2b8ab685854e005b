// SPDX-License-Identifier: Apache-2.0
// Checks of what a caller passed; each names the field and what would be right.
// They take `unknown`: a caller may write JavaScript.
import { badArgument, show, unknownChoice } from "./errors.js";

const ID = /^[A-Za-z0-9._-]{1,64}$/;

export function finite(field: string, value: unknown): number {
  if (typeof value !== "number") throw badArgument(field, `${show(value)} is not a number`);
  if (!Number.isFinite(value)) throw badArgument(field, `${value} is not finite`);
  return value;
}

export function aboveZero(field: string, value: unknown): number {
  const number = finite(field, value);
  if (number <= 0) throw badArgument(field, `${number} must be above 0`);
  return number;
}

/** A whole number in [low, high]. */
export function whole(field: string, value: unknown, low = 0, high = Number.MAX_SAFE_INTEGER): number {
  if (typeof value !== "number" || !Number.isSafeInteger(value)) {
    throw badArgument(field, `${show(value)} is not a whole number`);
  }
  if (value < low || value > high) {
    const bound = high === Number.MAX_SAFE_INTEGER ? `${low} or more` : `in [${low}, ${high}]`;
    throw badArgument(field, `${value} must be ${bound}`);
  }
  return value;
}

export function numbers(field: string, value: unknown, size: number): number[] {
  const list = ArrayBuffer.isView(value) ? Array.from(value as Float64Array) : value;
  if (!Array.isArray(list)) throw badArgument(field, `${show(value)} is not ${size} numbers`);
  if (list.length !== size) throw badArgument(field, `has ${list.length} numbers, must have ${size}`);
  return list.map((v) => finite(field, v));
}

/** The id of a session or target. */
export function identifier(field: string, value: unknown, allowEmpty = false): string {
  if (allowEmpty && value === "") return "";
  if (typeof value !== "string" || !ID.test(value)) {
    throw badArgument(field, `${show(value)} must be 1 to 64 of the characters A-Z a-z 0-9 . _ -`);
  }
  return value;
}

export function mapName(field: string, value: unknown): string {
  if (typeof value !== "string" || !ID.test(value) || value.startsWith(".") || value.startsWith("-")) {
    throw badArgument(
      field,
      `${show(value)} must be 1 to 64 of the characters A-Z a-z 0-9 . _ -, and not start with . or -`,
    );
  }
  return value;
}

/** The entry of `table` that `value` names. */
export function choice<T>(field: string, value: unknown, table: Readonly<Record<string, T>>): T {
  if (typeof value !== "string" || !Object.hasOwn(table, value)) {
    throw unknownChoice(field, value, Object.keys(table));
  }
  return table[value] as T;
}
