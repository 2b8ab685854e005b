// SPDX-License-Identifier: Apache-2.0
// Puts the blocks of a map's points together.
import { cameraOf, rigid } from "../data/frame";
import type { GetPointCloudResponse } from "../gen/groundlock/v1/maps_pb";
import type { MapCamera } from "../scene/camera_glyphs";
import type { CloudData } from "../scene/scene_view";

export class CloudAssembler {
  private blocks: { xyz: Float32Array; rgb: Uint8Array }[] = [];
  private readonly cameras: MapCamera[] = [];

  add(block: GetPointCloudResponse): void {
    for (const c of block.cameras) {
      const camera = cameraOf(c.camera);
      const worldFromCamera = rigid(c.worldFromCamera);
      if (camera && worldFromCamera) this.cameras.push({ camera, worldFromCamera });
    }
    const count = Math.floor(block.xyzM.length / 3);
    const xyz = new Float32Array(3 * count);
    xyz.set(block.xyzM.slice(0, 3 * count));
    const rgb = new Uint8Array(3 * count).fill(160); // grey where none is told
    rgb.set(block.rgb.subarray(0, 3 * count));
    this.blocks.push({ xyz, rgb });
  }

  get points(): number {
    return this.blocks.reduce((sum, b) => sum + b.xyz.length / 3, 0);
  }

  finish(): CloudData {
    const positions = new Float32Array(3 * this.points);
    const colors = new Uint8Array(3 * this.points);
    let at = 0;
    for (const { xyz, rgb } of this.blocks) {
      positions.set(xyz, at);
      colors.set(rgb, at);
      at += xyz.length;
    }
    return { positions, colors, cameras: this.cameras };
  }
}
