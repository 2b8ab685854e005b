// SPDX-License-Identifier: Apache-2.0
// Files that arguments name by their paths: Node has some, a browser has none.
import { badArgument } from "./errors.js";

type Read = (path: string) => Uint8Array;
let readFile: Read | undefined;

/** Said by the entry for Node (nodeFiles.ts). */
export function readFilesWith(read: Read): void {
  readFile = read;
}

/** The bytes of a file; errors name the field. */
export function readPath(field: string, path: string): Uint8Array {
  if (readFile === undefined) throw badArgument(field, "a browser reads no files: give what is in it");
  try {
    return readFile(path);
  } catch (error) {
    const cause = (error as Error).message;
    throw badArgument(field, field === path ? `cannot be read: ${cause}` : `${path}: cannot be read: ${cause}`);
  }
}
