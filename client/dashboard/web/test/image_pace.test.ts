// SPDX-License-Identifier: Apache-2.0
import { expect, it } from "vitest";
import { ImagePace } from "../src/app/image_pace";

it("asks for fewer images when they come late, and for all again when they do not", () => {
  const pace = new ImagePace();
  expect(pace.judge(60, 24)).toBe(false);
  expect(pace.perSecond).toBe(0);
  expect(pace.judge(900, 20)).toBe(true);
  expect(pace.perSecond).toBe(12);
  expect(pace.judge(250, 12)).toBe(false);
  for (let i = 0; i < 10; ++i) pace.judge(2000, 3);
  expect(pace.perSecond).toBe(2);
  for (let i = 0; i < 10; ++i) pace.judge(50, pace.perSecond);
  expect(pace.perSecond).toBe(0);
});
