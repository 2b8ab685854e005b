// SPDX-License-Identifier: Apache-2.0
import { expect, it } from "vitest";
import { jpegSize } from "../src/image/jpeg_size";

const APP0 = [0xff, 0xe0, 0, 4, 1, 2];
const TABLES = [0xff, 0xc4, 0, 3, 9];
const FRAME = [0xff, 0xc2, 0, 11, 8, 0x02, 0xd0, 0x05, 0x00, 1, 0, 0, 0];

it("reads the size from the frame header, whatever comes before it", () => {
  const size = { width: 1280, height: 720 };
  expect(jpegSize(Uint8Array.from([0xff, 0xd8, ...FRAME]))).toEqual(size);
  expect(jpegSize(Uint8Array.from([0xff, 0xd8, ...APP0, ...TABLES, 0xff, ...FRAME]))).toEqual(size);
});

it("knows nothing of what is no JPEG or ends too early", () => {
  expect(jpegSize(new Uint8Array())).toBeNull();
  expect(jpegSize(Uint8Array.from([0x89, 0x50, 0x4e, 0x47]))).toBeNull();
  expect(jpegSize(Uint8Array.from([0xff, 0xd8, ...APP0, ...FRAME.slice(0, 6)]))).toBeNull();
  expect(jpegSize(Uint8Array.from([0xff, 0xd8, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12]))).toBeNull();
  expect(jpegSize(new Uint8Array(64).fill(0xff))).toBeNull();
});
