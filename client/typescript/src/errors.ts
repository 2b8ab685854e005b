// SPDX-License-Identifier: Apache-2.0
// What goes wrong: one class with the protocol's code and a message that names
// the field, file, line or frame at fault.
import type { ServiceError, StatusObject } from "@grpc/grpc-js";

/** The numbers of google.rpc.Code. */
export const Code = {
  OK: 0,
  CANCELLED: 1,
  UNKNOWN: 2,
  INVALID_ARGUMENT: 3,
  DEADLINE_EXCEEDED: 4,
  NOT_FOUND: 5,
  ALREADY_EXISTS: 6,
  PERMISSION_DENIED: 7,
  RESOURCE_EXHAUSTED: 8,
  FAILED_PRECONDITION: 9,
  ABORTED: 10,
  OUT_OF_RANGE: 11,
  UNIMPLEMENTED: 12,
  INTERNAL: 13,
  UNAVAILABLE: 14,
  DATA_LOSS: 15,
  UNAUTHENTICATED: 16,
} as const;
export type CodeName = keyof typeof Code;
export type Code = (typeof Code)[CodeName];

const NAMES = new Map<number, CodeName>(
  (Object.entries(Code) as [CodeName, Code][]).map(([name, code]) => [code, name]),
);

/** `code` and `codeName`; `field` where an argument was refused before anything was sent. */
export class GroundlockError extends Error {
  readonly code: Code;
  readonly field: string | undefined;

  constructor(code: Code, message: string, field?: string) {
    super(message);
    this.name = "GroundlockError";
    this.code = code;
    this.field = field;
  }

  get codeName(): CodeName {
    return NAMES.get(this.code) ?? "UNKNOWN";
  }
}

/** Unknown codes are UNKNOWN. */
export function errorOf(code: number, message: string): GroundlockError {
  return new GroundlockError(NAMES.has(code) ? (code as Code) : Code.UNKNOWN, message);
}

/** For what a call ended with. */
export function errorOfCall(status: ServiceError | StatusObject | Error, server: string): GroundlockError {
  if (status instanceof GroundlockError) return status;
  if (!("code" in status) || typeof status.code !== "number") {
    return new GroundlockError(Code.INTERNAL, status instanceof Error ? status.message : String(status));
  }
  const details = status.details || (NAMES.get(status.code) ?? "UNKNOWN").toLowerCase().replaceAll("_", " ");
  // gRPC's own words for a server that is not there do not always name it.
  if (status.code === Code.UNAVAILABLE) {
    return errorOf(status.code, `${server}: ${details} (is groundlock-server running there?)`);
  }
  return errorOf(status.code, details);
}

export function badArgument(field: string, problem: string): GroundlockError {
  return new GroundlockError(Code.INVALID_ARGUMENT, `${field}: ${problem}`, field);
}

export function notFound(field: string, problem: string): GroundlockError {
  return new GroundlockError(Code.NOT_FOUND, `${field}: ${problem}`, field);
}

export function unknownChoice(field: string, value: unknown, choices: Iterable<string>): GroundlockError {
  return badArgument(field, `${show(value)} is unknown; one of ${[...choices].join(", ")}`);
}

/** A value as a person would write it. */
export function show(value: unknown): string {
  if (typeof value === "string") return JSON.stringify(value);
  if (typeof value === "bigint") return `${value}`;
  if (typeof value === "number" || value === null || value === undefined) return String(value);
  try {
    return JSON.stringify(value) ?? String(value);
  } catch {
    return String(value);
  }
}
