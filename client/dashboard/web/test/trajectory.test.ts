// SPDX-License-Identifier: Apache-2.0
import { describe, expect, it } from "vitest";
import { CameraState, TargetState } from "../src/data/frame";
import { toCsv, toGeoJson, toKml, toTum } from "../src/data/trajectory";
import { ecefFromGeodetic, geodeticFromEcef, geodeticFromLocal } from "../src/math/geodesy";
import { frame } from "./frames";

const pose = {
  rotation: { w: 0.6, x: -0.8, y: 0, z: 0 },
  translation: { x: 1, y: 2, z: 3 },
};
const seen = frame(7, 1.5, {
  camera: { state: CameraState.TRACKED, worldFromCamera: pose, numInliers: 200 },
  targets: [{
    targetId: "c<r",
    state: TargetState.TRACKED,
    confidence: 0.9,
    box: { x: 1, y: 2, width: 3, height: 4 },
    boxWorld: { worldFromObject: { rotation: { w: 1, x: 0, y: 0, z: 0 }, translation: { x: 5, y: 6, z: 0.5 } }, sizeM: { x: 2, y: 1, z: 1 } },
    groundCenterM: { x: 5, y: 6, z: 0 },
    headingRad: 0.25,
  }],
  times: { decodeMs: 1, localizeMs: 2, trackMs: 3, totalMs: 6 },
});
const lost = frame(8, 1.54, { camera: { state: CameraState.LOST } });
const zurich = { latitude_deg: 47.3977, longitude_deg: 8.5456, height_m: 410 };

describe("CSV", () => {
  const lines = toCsv([seen, lost]).trimEnd().split("\n");

  it("has the columns of groundlock track", () => {
    expect(lines[0]!.split(",")).toHaveLength(29);
    for (const line of lines) expect(line.split(",")).toHaveLength(29);
  });

  it("has a row per frame and target, empty where nothing is known", () => {
    expect(lines).toHaveLength(3);
    expect(lines[1]).toBe(
      "7,1.500000,TRACKED,1.000000,2.000000,3.000000,0.600000000,-0.800000000,0.000000000,0.000000000,200," +
      "c<r,TRACKED,0.9000,1.00,2.00,3.00,4.00,5.0000,6.0000,0.0000,0.25000,2.0000,1.0000,1.0000,1.000,2.000,3.000,6.000",
    );
    expect(lines[2]).toBe("8,1.540000,LOST,,,,,,,,0,,,,,,,,,,,,,,,,,,");
  });
});

describe("TUM", () => {
  it("has time, position and x y z w", () => {
    expect(toTum([seen, lost], null).split("\n")[1]).toBe(
      "1.500000 1.000000 2.000000 3.000000 -0.800000000 0.000000000 0.000000000 0.600000000",
    );
    expect(toTum([seen, lost], null).trimEnd().split("\n")).toHaveLength(2);
  });

  it("is of a target if asked", () => {
    expect(toTum([seen], "c<r").split("\n")[1]).toMatch(/^1\.500000 5\.000000 6\.000000 0\.500000 /);
    expect(toTum([seen], "other").trimEnd().split("\n")).toHaveLength(1);
  });
});

describe("on Earth", () => {
  it("a round trip ends where it began", () => {
    for (const latitude_deg of [-90, -33.9, 0, 47.4, 89.999]) {
      const g = { latitude_deg, longitude_deg: 151.2, height_m: 1234 };
      const back = geodeticFromEcef(ecefFromGeodetic(g));
      expect(back.latitude_deg).toBeCloseTo(latitude_deg, 9);
      expect(back.height_m).toBeCloseTo(1234, 5);
    }
  });

  it("east, north and up are what they say", () => {
    const north = geodeticFromLocal(zurich, [0, 1000, 0]);
    // The meridian's radius of curvature at 47.4 degrees: 6,370,1xx m.
    expect((north.latitude_deg - zurich.latitude_deg) * (Math.PI / 180) * 6_370_130).toBeCloseTo(1000, 0);
    expect(north.longitude_deg).toBeCloseTo(zurich.longitude_deg, 9);
    expect(geodeticFromLocal(zurich, [100, 0, 0]).longitude_deg).toBeGreaterThan(zurich.longitude_deg);
    expect(geodeticFromLocal(zurich, [0, 0, 25]).height_m).toBeCloseTo(435, 6);
  });

  it("GeoJSON is longitude first", () => {
    const json = JSON.parse(toGeoJson([seen], zurich)) as {
      features: { properties: { name: string }; geometry: { type: string; coordinates: number[][] } }[];
    };
    expect(json.features.map((f) => f.properties.name)).toEqual(["camera", "target c<r"]);
    const [lon, lat, h] = json.features[0]!.geometry.coordinates[0]!;
    expect(lon).toBeCloseTo(8.5456, 3);
    expect(lat).toBeCloseTo(47.3977, 3);
    expect(h).toBeCloseTo(413, 2);
  });

  it("KML is escaped", () => {
    const kml = toKml([seen], zurich);
    expect(kml).toContain("<name>target c&#60;r</name>");
    expect(kml).toMatch(/<coordinates>8\.5456\d+,47\.3977\d+,413\.\d+<\/coordinates>/);
  });
});
