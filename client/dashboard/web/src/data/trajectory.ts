// SPDX-License-Identifier: Apache-2.0
// A history's trajectories as files: the results CSV of `groundlock track`, TUM
// (time, position, quaternion), and KML and GeoJSON for maps on Earth.
import { geodeticFromLocal, type Geodetic } from "../math/geodesy";
import type { Vec3 } from "../math/pose";
import { box3, CameraState, TargetState, vec3, worldFromCamera, type FrameRecord } from "./frame";

export type TrajectoryFormat = "csv" | "tum" | "kml" | "geojson";

const CSV_HEADER =
  "frame,t_s,camera_state,cam_x,cam_y,cam_z,cam_qw,cam_qx,cam_qy,cam_qz,inliers,target,target_state,confidence," +
  "box_x,box_y,box_w,box_h,ground_x,ground_y,ground_z,heading_rad,length_m,width_m,height_m," +
  "decode_ms,localize_ms,track_ms,total_ms";

function number(value: number | undefined, digits: number): string {
  return value === undefined || !Number.isFinite(value) ? "" : value.toFixed(digits);
}

function numbers(values: readonly number[] | null, count: number, digits: number): string[] {
  return Array.from({ length: count }, (_, i) => number(values?.[i], digits));
}

function seconds(record: FrameRecord): string {
  const ns = record.captureNs;
  return `${ns / 1_000_000_000n}.${String(ns % 1_000_000_000n).padStart(9, "0").slice(0, 6)}`;
}

export function toCsv(records: Iterable<FrameRecord>): string {
  const lines = [CSV_HEADER];
  for (const record of records) {
    const { camera, targets, times } = record.result;
    const pose = worldFromCamera(record);
    const head = [
      String(record.sequence),
      seconds(record),
      CameraState[camera?.state ?? CameraState.UNSPECIFIED] ?? "",
      ...numbers(pose && pose.translation, 3, 6),
      ...numbers(pose && pose.rotation, 4, 9),
      String(camera?.numInliers ?? 0),
    ];
    const tail = numbers(
      times ? [times.decodeMs, times.localizeMs, times.trackMs, times.totalMs] : null, 4, 3);
    if (targets.length === 0) {
      lines.push([...head, ...Array<string>(14).fill(""), ...tail].join(","));
    }
    for (const t of targets) {
      const box = t.box;
      const box_3d = box3(t.boxWorld);
      lines.push([
        ...head,
        t.targetId,
        TargetState[t.state] ?? "",
        number(t.confidence, 4),
        ...numbers(box ? [box.x, box.y, box.width, box.height] : null, 4, 2),
        ...numbers(vec3(t.groundCenterM), 3, 4),
        box_3d ? number(t.headingRad, 5) : "",
        ...numbers(box_3d && box_3d.size, 3, 4),
        ...tail,
      ].join(","));
    }
  }
  return lines.join("\n") + "\n";
}

// target null: the camera. Frames without a pose are left out.
export function toTum(records: Iterable<FrameRecord>, target: string | null): string {
  const lines = ["# timestamp tx ty tz qx qy qz qw"];
  for (const record of records) {
    const pose =
      target === null
        ? worldFromCamera(record)
        : (box3(record.result.targets.find((t) => t.targetId === target)?.boxWorld)
            ?.worldFromObject ?? null);
    if (!pose) continue;
    const [w, x, y, z] = pose.rotation;
    lines.push([
      seconds(record),
      ...numbers(pose.translation, 3, 6),
      ...numbers([x, y, z, w], 4, 9),
    ].join(" "));
  }
  return lines.join("\n") + "\n";
}

// The ways of the camera and of every target, in world.
export function paths(records: Iterable<FrameRecord>): Map<string, Vec3[]> {
  const result = new Map<string, Vec3[]>();
  const add = (id: string, p: Vec3) => {
    const path = result.get(id);
    if (path) path.push(p);
    else result.set(id, [p]);
  };
  for (const record of records) {
    const pose = worldFromCamera(record);
    if (pose) add("camera", pose.translation);
    for (const t of record.result.targets) {
      const p = vec3(t.groundCenterM);
      if (p) add(`target ${t.targetId}`, p);
    }
  }
  return result;
}

export function toGeoJson(records: Iterable<FrameRecord>, origin: Geodetic): string {
  const features = [...paths(records)].map(([name, path]) => ({
    type: "Feature",
    properties: { name },
    geometry: {
      type: "LineString",
      coordinates: path.map((p) => {
        const g = geodeticFromLocal(origin, p);
        return [round(g.longitude_deg, 9), round(g.latitude_deg, 9), round(g.height_m, 3)];
      }),
    },
  }));
  return JSON.stringify({ type: "FeatureCollection", features }, null, 1) + "\n";
}

export function toKml(records: Iterable<FrameRecord>, origin: Geodetic): string {
  const placemarks = [...paths(records)].map(([name, path]) => {
    const coordinates = path.map((p) => {
      const g = geodeticFromLocal(origin, p);
      return `${g.longitude_deg.toFixed(9)},${g.latitude_deg.toFixed(9)},${g.height_m.toFixed(3)}`;
    });
    return (
      `  <Placemark><name>${escapeXml(name)}</name><LineString>` +
      `<altitudeMode>absolute</altitudeMode>\n   <coordinates>${coordinates.join(" ")}` +
      `</coordinates></LineString></Placemark>`
    );
  });
  return (
    `<?xml version="1.0" encoding="UTF-8"?>\n` +
    `<kml xmlns="http://www.opengis.net/kml/2.2"><Document><name>Groundlock</name>\n` +
    `${placemarks.join("\n")}\n</Document></kml>\n`
  );
}

function round(value: number, digits: number): number {
  return Number(value.toFixed(digits));
}

function escapeXml(text: string): string {
  return text.replace(/[<>&"']/g, (c) => `&#${c.charCodeAt(0)};`);
}
