// SPDX-License-Identifier: Apache-2.0
// Images as they are sent: pixels as they are, or the bytes of a file.
import { choice, whole } from "./checks.js";
import { badArgument, show } from "./errors.js";
import { readPath } from "./paths.js";

/** auto: JPEG or PNG, told by the bytes. */
export type Encoding = "auto" | "jpeg" | "png" | "gray8" | "bgr8" | "rgb8";
const CHANNELS = { gray8: 1, bgr8: 3, rgb8: 3 } as const;

/** Raw ones: rows of 1 or 3 bytes a pixel without padding, and their size. */
export interface Image {
  readonly encoding: Encoding;
  readonly data: Uint8Array;
  readonly widthPx: number;
  readonly heightPx: number;
}

/** An image; or the bytes or the path of a JPEG or PNG, which is sent as it is. */
export type ImageLike = Image | Uint8Array | string;

/** Pixels in the order of the network's or a library's: sharp's is rgb8. */
export function rawImage(encoding: keyof typeof CHANNELS, data: Uint8Array, widthPx: number, heightPx: number): Image {
  return imageOf("image", { encoding, data, widthPx, heightPx });
}

export function imageOf(field: string, value: ImageLike): Image {
  if (typeof value === "string") return { encoding: "auto", data: readPath(field, value), widthPx: 0, heightPx: 0 };
  if (value instanceof Uint8Array) return { encoding: "auto", data: value, widthPx: 0, heightPx: 0 };
  if (typeof value !== "object" || value === null || !(value.data instanceof Uint8Array)) {
    throw badArgument(field, `${show(typeof value)} must be an Image, or the bytes or path of a JPEG or PNG`);
  }
  const channels = (CHANNELS as Partial<Record<Encoding, number>>)[value.encoding];
  if (channels === undefined) {
    choice(`${field}.encoding`, value.encoding, { auto: 0, jpeg: 0, png: 0, ...CHANNELS });
    return value;
  }
  const bytes = channels * whole(`${field}.widthPx`, value.widthPx, 1) * whole(`${field}.heightPx`, value.heightPx, 1);
  if (value.data.length !== bytes) {
    throw badArgument(
      `${field}.data`,
      `has ${value.data.length} bytes, but ${value.widthPx}x${value.heightPx} ${value.encoding} has ${bytes}`,
    );
  }
  return value;
}
