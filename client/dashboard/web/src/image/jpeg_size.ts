// SPDX-License-Identifier: Apache-2.0
// Width and height of a JPEG from its frame header (ITU-T T.81, B.2.2).

// Null for anything else.
export function jpegSize(data: Uint8Array): { width: number; height: number } | null {
  if (data[0] !== 0xff || data[1] !== 0xd8) return null;
  let at = 2;
  while (at + 9 < data.length && data[at] === 0xff) {
    const marker = data[at + 1]!;
    const word = (offset: number) => (data[at + offset]! << 8) | data[at + offset + 1]!;
    // Start of frame: C0 to CF but the tables C4, C8 and CC.
    if (marker >= 0xc0 && marker <= 0xcf && marker !== 0xc4 && marker !== 0xc8 && marker !== 0xcc) {
      return { height: word(5), width: word(7) };
    }
    at += marker === 0xff ? 1 : 2 + word(2);
  }
  return null;
}
