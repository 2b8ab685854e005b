// SPDX-License-Identifier: Apache-2.0
// Files, where there are any.
import { readFileSync, writeFileSync } from "node:fs";
import { type CameraModel, checkCamera } from "./geometry.js";
import { readFilesWith } from "./paths.js";

readFilesWith((path) => readFileSync(path));

/** As a camera.json. */
export function writeCamera(path: string, camera: CameraModel): void {
  const { model, widthPx: width, heightPx: height, params } = checkCamera("camera", camera);
  writeFileSync(path, `${JSON.stringify({ width, height, model, params })}\n`);
}
