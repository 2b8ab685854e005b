// SPDX-License-Identifier: Apache-2.0
import { expect, it } from "vitest";
import { parseControlPoints } from "../src/ui/control_points_json";

const text = (points: unknown) => JSON.stringify({ points });
const at = (name: string) => ({ name, position: [1, 2, 3], place: [4, 5, 6] });

it("reads points of the map and of images, local and on Earth", () => {
  const { points } = parseControlPoints(text([
    at("a"),
    { name: "b", pixels: [{ image: "1.jpg", xy: [10, 20.5] }, { image: "2.jpg", xy: [30, 40] }], place: [0, 0, 0] },
    { position: [0, 0, 1], place: { latitude_deg: 47.4, longitude_deg: 8.5 } },
  ]));
  expect(points![0]).toEqual({
    name: "a",
    point: { positionWorld: { x: 1, y: 2, z: 3 } },
    place: { place: { case: "positionM", value: { x: 4, y: 5, z: 6 } } },
  });
  expect(points![1]!.point).toEqual({ pixels: [{ image: "1.jpg", xPx: 10, yPx: 20.5 }, { image: "2.jpg", xPx: 30, yPx: 40 }] });
  expect(points![2]).toMatchObject({
    name: "3",
    place: { place: { case: "geodetic", value: { latitudeDeg: 47.4, longitudeDeg: 8.5, heightM: 0 } } },
  });
});

it.each([
  ["no JSON", "{", /not JSON/],
  ["no object", "[]", /must be an object/],
  ["too few", text([at("a"), at("b")]), /at least 3/],
  ["no place", text([at("a"), at("b"), { name: "c", position: [1, 2, 3] }]), /point c: place/],
  ["a place of two numbers", text([at("a"), at("b"), { ...at("c"), place: [1, 2] }]), /point c: place must be 3 numbers/],
  ["neither position nor pixels", text([at("a"), at("b"), { name: "c", place: [1, 2, 3] }]), /point c: give a position/],
  ["a pixel without an image", text([at("a"), at("b"), { name: "c", pixels: [{ xy: [1, 2] }, { xy: [1, 2] }], place: [1, 2, 3] }]), /pixels\[0\]: image/],
  ["no number", text([at("a"), at("b"), { ...at("c"), position: [1, "2", 3] }]), /point c: position/],
])("names what is wrong: %s", (_what, file, error) => {
  expect(() => parseControlPoints(file)).toThrow(error);
});
