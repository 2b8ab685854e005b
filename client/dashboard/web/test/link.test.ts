// SPDX-License-Identifier: Apache-2.0
import { describe, expect, it } from "vitest";
import { medianOf } from "../src/app/latency_meter";
import { RateMeter } from "../src/app/rate_meter";
import { ClockOffset } from "../src/link/clock_offset";
import { compressedImageData } from "../src/replay/recording";
import { parseAlignJson } from "../src/ui/align_json";

describe("the other clock", () => {
  it("is known best by the fastest answer", () => {
    const clock = new ClockOffset();
    expect(clock.toTheirs(0)).toBeNull();
    clock.add(100, 180, 5100); // slow on its way back: off by 40
    clock.add(200, 204, 5202);
    clock.add(300, 350, 5310);
    expect(clock.toTheirs(1000)).toBe(6000);
    expect(clock.roundTripMs).toBe(4);
  });

  it("takes no nonsense", () => {
    const clock = new ClockOffset();
    clock.add(100, 90, 0);
    clock.add(100, 110, NaN);
    expect(clock.toTheirs(0)).toBeNull();
  });
});

describe("meters", () => {
  it("count over two seconds", () => {
    const meter = new RateMeter();
    for (let t = 0; t < 4000; t += 50) meter.add(t);
    expect(meter.perSecond(3950)).toBe(20);
    expect(meter.perSecond(10_000)).toBe(0);
  });

  it("have a median", () => {
    expect(medianOf([])).toBeNull();
    expect(medianOf([3, 1, 2])).toBe(2);
    expect(medianOf([4, 1, 2, 3])).toBe(2.5);
  });
});

describe("foxglove.CompressedImage", () => {
  it("has its bytes in field 2", () => {
    const message = Uint8Array.of(
      0x0a, 0x02, 0x08, 0x05, // timestamp { seconds: 5 }
      0x22, 0x03, 0x63, 0x61, 0x6d, // frame_id "cam"
      0x12, 0x03, 1, 2, 3, // data
      0x1a, 0x04, 0x6a, 0x70, 0x65, 0x67, // format "jpeg"
    );
    expect([...compressedImageData(message)!]).toEqual([1, 2, 3]);
    expect(compressedImageData(message.subarray(0, 9))).toBeNull();
    expect(() => compressedImageData(Uint8Array.of(0x12, 0x7f, 1))).toThrow();
  });
});

describe("align.json", () => {
  const good = '{"scale":0.5,"rotation_wxyz":[1,0,0,0],"translation":[1,2,3]}';
  it("is read", () => {
    expect(parseAlignJson(good)).toEqual({
      scale: 0.5, rotation: { w: 1, x: 0, y: 0, z: 0 }, translation: { x: 1, y: 2, z: 3 },
    });
  });
  it("names what is wrong", () => {
    expect(() => parseAlignJson("[")).toThrow(/not JSON/);
    expect(() => parseAlignJson(good.replace("0.5", "0"))).toThrow(/scale/);
    expect(() => parseAlignJson(good.replace("[1,0,0,0]", "[1,0,0]"))).toThrow(/rotation_wxyz must be 4 numbers/);
    expect(() => parseAlignJson(good.replace("[1,0,0,0]", "[1,1,0,0]"))).toThrow(/length 1/);
    expect(() => parseAlignJson(good.replace("[1,2,3]", "null"))).toThrow(/translation/);
  });
});
