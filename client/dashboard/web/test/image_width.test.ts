// SPDX-License-Identifier: Apache-2.0
import { expect, it } from "vitest";
import { wantedImageWidth } from "../src/app/image_width";

it("asks for images about as wide as they are shown", () => {
  for (let shown = 1; shown < 4000; ++shown) {
    const wanted = wantedImageWidth(shown);
    expect(wanted).toBeGreaterThanOrEqual(shown / 1.1);
    expect(wanted).toBeLessThan(shown / 1.1 + 64);
  }
});

it("asks for the same while a window changes a little", () => {
  expect(wantedImageWidth(640)).toBe(wantedImageWidth(660));
});

it("leaves it open while nothing is shown", () => {
  expect(wantedImageWidth(0)).toBe(0);
});
