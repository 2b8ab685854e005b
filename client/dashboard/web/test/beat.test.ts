// SPDX-License-Identifier: Apache-2.0
import { afterEach, beforeEach, expect, it, vi } from "vitest";
import { Beat } from "../src/app/beat";

beforeEach(() => void vi.useFakeTimers());
afterEach(() => void vi.useRealTimers());

it("does with a frame what is due, the oldest first, and nothing else", () => {
  const done: string[] = [];
  const beat = new Beat();
  beat.after(30, () => done.push("later"));
  beat.after(10, () => done.push("first"));
  beat.after(20, () => done.push("second"));
  vi.advanceTimersByTime(5);
  beat.frame();
  expect(done).toEqual([]);
  vi.advanceTimersByTime(20);
  beat.frame();
  expect(done).toEqual(["first", "second"]);
});

it("does a part with each frame when it is much", () => {
  const done: number[] = [];
  const beat = new Beat();
  for (let i = 0; i < 3; ++i) {
    beat.after(0, () => {
      done.push(i);
      vi.advanceTimersByTime(3);
    });
  }
  beat.frame();
  expect(done).toEqual([0]);
  beat.frame();
  expect(done).toEqual([0, 1]);
});

it("does not wait for frames that never come", () => {
  const done: number[] = [];
  const beat = new Beat();
  beat.after(50, () => {
    done.push(1);
    beat.after(50, () => done.push(2));
  });
  vi.advanceTimersByTime(1000);
  expect(done).toEqual([1, 2]);
});

it("leaves out what was called off", () => {
  const done: number[] = [];
  const beat = new Beat();
  const callOff = beat.after(10, () => done.push(1));
  callOff();
  vi.advanceTimersByTime(1000);
  beat.frame();
  expect(done).toEqual([]);
});
