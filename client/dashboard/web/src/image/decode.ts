// SPDX-License-Identifier: Apache-2.0
// Compressed images to something that a canvas can draw, off the page's thread
// and in their own size: browsers make them smaller on this one.

export type Picture = ImageBitmap | VideoFrame;

export function widthOf(picture: Picture): number {
  return "displayWidth" in picture ? picture.displayWidth : picture.width;
}

export function heightOf(picture: Picture): number {
  return "displayHeight" in picture ? picture.displayHeight : picture.height;
}

// Null for bytes that are no image the browser knows.
export async function decodeImage(data: Uint8Array): Promise<Picture | null> {
  try {
    if (canDecodeAtOnce) {
      const decoder = new ImageDecoder({ data: data as BufferSource, type: typeOf(data) });
      try {
        return (await decoder.decode()).image;
      } finally {
        decoder.close();
      }
    }
    return await createImageBitmap(new Blob([data as BlobPart]));
  } catch {
    return null;
  }
}

// From the bytes as they are; a Blob goes through another process first. Only
// over HTTPS and on localhost, and not in every browser.
const canDecodeAtOnce = "ImageDecoder" in globalThis;

function typeOf(data: Uint8Array): string {
  return data[0] === 0x89 ? "image/png" : "image/jpeg";
}
