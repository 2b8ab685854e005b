// SPDX-License-Identifier: Apache-2.0
// What a map is to be aligned by, as a request.
import { create } from "@bufbuild/protobuf";
import { aboveZero, finite, mapName, whole } from "./checks.js";
import { placeTo, similarityTo, vectorTo } from "./convert.js";
import { badArgument, show } from "./errors.js";
import {
  type AlignMapRequest, AlignMapRequestSchema, type AlignMapRequest_MapPoint, AlignMapRequest_MapPointSchema,
  type AlignMapRequest_Place, AlignMapRequest_PlaceSchema, AlignMapRequest_TerrainSchema,
} from "./gen/groundlock/v1/maps_pb.js";
import { PlaneSchema } from "./gen/groundlock/v1/geometry_pb.js";
import type { AlignMethod, AlignOptions, MapPoint, Place } from "./types.js";

function pointTo(field: string, point: MapPoint): AlignMapRequest_MapPoint {
  const message = create(AlignMapRequest_MapPointSchema);
  if (point && "positionWorld" in point) {
    message.positionWorld = vectorTo(`${field}.positionWorld`, point.positionWorld);
    return message;
  }
  if (!point || !Array.isArray(point.pixels) || point.pixels.length < 2) {
    throw badArgument(field, "needs positionWorld, or pixels in two or more mapping images");
  }
  for (const { image, xPx, yPx } of point.pixels) {
    finite(`${field}.pixels.xPx`, xPx);
    finite(`${field}.pixels.yPx`, yPx);
    message.pixels.push({ $typeName: "groundlock.v1.AlignMapRequest.MapPoint.Pixel", image, xPx, yPx });
  }
  return message;
}

function measuredTo(field: string, place: Place): AlignMapRequest_Place {
  return create(AlignMapRequest_PlaceSchema, {
    place:
      typeof place === "object" && place !== null && "latitudeDeg" in place
        ? { case: "geodetic", value: placeTo(field, place) }
        : { case: "positionM", value: vectorTo(field, place) },
  });
}

function atLeastThree(field: string, count: number): void {
  if (count < 3) throw badArgument(field, `${count} given, needs 3 or more`);
}

function methodTo(method: AlignMethod): AlignMapRequest["method"] {
  if ("newWorldFromSource" in method) {
    const value = similarityTo("newWorldFromSource", method.newWorldFromSource);
    return { case: "newWorldFromSource", value };
  }
  if ("newWorldFromWorld" in method) {
    const value = similarityTo("newWorldFromWorld", method.newWorldFromWorld);
    return { case: "newWorldFromWorld", value };
  }
  if ("knownDistance" in method) {
    const { from, to, distanceM } = method.knownDistance;
    return {
      case: "knownDistance",
      value: {
        $typeName: "groundlock.v1.AlignMapRequest.KnownDistance",
        from: pointTo("knownDistance.from", from),
        to: pointTo("knownDistance.to", to),
        distanceM: aboveZero("knownDistance.distanceM", distanceM),
      },
    };
  }
  if ("controlPoints" in method) {
    atLeastThree("controlPoints", method.controlPoints.length);
    const points = method.controlPoints.map((p, i) => ({
      $typeName: "groundlock.v1.AlignMapRequest.ControlPoint" as const,
      name: p.name,
      point: pointTo(`controlPoints[${i}].point`, p.point),
      place: measuredTo(`controlPoints[${i}].place`, p.place),
    }));
    return { case: "controlPoints", value: { $typeName: "groundlock.v1.AlignMapRequest.ControlPoints", points } };
  }
  if ("cameraPositions" in method) {
    const entries = Object.entries(method.cameraPositions);
    atLeastThree("cameraPositions", entries.length);
    return {
      case: "cameraPositions",
      value: {
        $typeName: "groundlock.v1.AlignMapRequest.CameraPositions",
        positions: entries.map(([image, place]) => ({
          $typeName: "groundlock.v1.AlignMapRequest.CameraPosition" as const,
          image,
          place: measuredTo(`cameraPositions[${show(image)}]`, place),
        })),
        accuracyM: finite("accuracyM", method.accuracyM ?? 0),
      },
    };
  }
  throw badArgument(
    "method",
    "must have one of newWorldFromSource, newWorldFromWorld, knownDistance, controlPoints, cameraPositions",
  );
}

function groundTo(ground: AlignOptions["ground"]): AlignMapRequest["ground"] {
  if (ground === undefined) return { case: undefined };
  if (ground === "automatic") return { case: "groundAutomatic", value: true };
  if (typeof ground === "object" && "normal" in ground) {
    const normal = vectorTo("ground.normal", ground.normal);
    return { case: "groundPlaneWorld", value: create(PlaneSchema, { normal, d: finite("ground.d", ground.d) }) };
  }
  if (typeof ground === "object" && "zM" in ground) {
    if (!(ground.columns >= 3) || ground.zM.length < 3 * ground.columns || ground.zM.length % ground.columns !== 0) {
      throw badArgument("ground.zM", `${ground.zM.length} heights in ${ground.columns} columns must be whole rows, at least 3 of 3`);
    }
    return {
      case: "groundTerrain",
      value: create(AlignMapRequest_TerrainSchema, {
        firstXM: finite("ground.firstXM", ground.firstXM),
        firstYM: finite("ground.firstYM", ground.firstYM),
        stepM: aboveZero("ground.stepM", ground.stepM),
        columns: ground.columns,
        zM: [...ground.zM],
        sigmaM: finite("ground.sigmaM", ground.sigmaM ?? 0),
        fitHeight: ground.fitHeight ?? false,
      }),
    };
  }
  if (!Array.isArray(ground)) {
    throw badArgument("ground", `${show(ground)} must be "automatic", a point, a plane or a terrain`);
  }
  return { case: "groundSeedWorld", value: vectorTo("ground", ground) };
}

export function alignRequest(name: string, method: AlignMethod | null, options: AlignOptions): AlignMapRequest {
  if (method !== null && typeof method !== "object") throw badArgument("method", `${show(method)} must be an object`);
  const request = create(AlignMapRequestSchema, {
    name: mapName("name", name),
    version: BigInt(whole("version", options.version ?? 0)),
    seed: BigInt(whole("seed", options.seed ?? 0)),
    reportOnly: options.reportOnly ?? false,
    ground: groundTo(options.ground),
  });
  if (method !== null) request.method = methodTo(method);
  if (options.origin !== undefined) request.origin = placeTo("origin", options.origin);
  return request;
}
