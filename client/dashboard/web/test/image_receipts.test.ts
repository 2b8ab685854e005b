// SPDX-License-Identifier: Apache-2.0
import { afterEach, beforeEach, expect, it, vi } from "vitest";
import { imagesInFlight, ImageReceipts } from "../src/app/image_receipts";

beforeEach(() => void vi.useFakeTimers());
afterEach(() => void vi.useRealTimers());

it("tells what was drawn, once", () => {
  const told: number[] = [];
  const receipts = new ImageReceipts((s) => told.push(s));
  receipts.arrived(1);
  receipts.taken(1);
  vi.advanceTimersByTime(5000);
  expect(told).toEqual([1]);
});

it("takes in the end what is never drawn", () => {
  const told: number[] = [];
  const receipts = new ImageReceipts((s) => told.push(s));
  receipts.arrived(1);
  receipts.arrived(2);
  receipts.taken(1);
  expect(told).toEqual([1]);
  vi.advanceTimersByTime(5000);
  expect(told).toEqual([1, 2]);
  receipts.arrived(3);
  receipts.clear(); // another session
  vi.advanceTimersByTime(5000);
  expect(told).toEqual([1, 2]);
});

it("has more under way where the way is long", () => {
  expect(imagesInFlight(null)).toBe(2);
  expect(imagesInFlight(4)).toBe(2);
  expect(imagesInFlight(120)).toBe(6);
  expect(imagesInFlight(10_000)).toBe(24);
});
