// SPDX-License-Identifier: Apache-2.0
// The live camera: its frustum with the image in it; and the cameras that took
// the map's images.
import {
  BufferAttribute,
  BufferGeometry,
  CanvasTexture,
  DoubleSide,
  Group,
  LineBasicMaterial,
  LineSegments,
  LinearFilter,
  Mesh,
  MeshBasicMaterial,
  SRGBColorSpace,
} from "three";
import type { Camera } from "../math/camera";
import { transform, type Rigid, type Vec3 } from "../math/pose";
import { Segments } from "./segments";

// Corners of the image at a depth, in world: top left, top right, bottom right,
// bottom left. Lenses that have no ray there are taken for pinholes.
function imageCorners(camera: Camera, worldFromCamera: Rigid, depth: number): Vec3[] {
  const { width: w, height: h } = camera;
  return ([[0, 0], [w, 0], [w, h], [0, h]] as const).map((pixel) => {
    const [x, y] = camera.normalized(pixel) ?? [
      (pixel[0] - camera.cx) / camera.fx,
      (pixel[1] - camera.cy) / camera.fy,
    ];
    return transform(worldFromCamera, [x * depth, y * depth, depth]);
  });
}

export class LiveFrustum {
  readonly object = new Group();
  readonly lines = new Segments(2, "#ffffff");
  private readonly picture: Mesh<BufferGeometry, MeshBasicMaterial>;
  private readonly texture: CanvasTexture;

  private readonly small = document.createElement("canvas");
  private changed = false;

  // width: of the texture, pixels. The image is made smaller on its way.
  constructor(
    private readonly image: HTMLCanvasElement,
    width: number,
  ) {
    this.small.width = width;
    this.small.height = Math.round((9 / 16) * width);
    this.texture = new CanvasTexture(this.small);
    this.texture.colorSpace = SRGBColorSpace;
    this.texture.generateMipmaps = false;
    this.texture.minFilter = LinearFilter;
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(new Float32Array(12), 3));
    geometry.setAttribute("uv", new BufferAttribute(new Float32Array([0, 1, 1, 1, 1, 0, 0, 0]), 2));
    geometry.setIndex([0, 2, 1, 0, 3, 2]);
    this.picture = new Mesh(
      geometry,
      new MeshBasicMaterial({ map: this.texture, side: DoubleSide, transparent: true, opacity: 0.92 }),
    );
    this.picture.frustumCulled = false;
    this.object.add(this.picture, this.lines.object);
  }

  imageChanged(): void {
    this.changed = true;
  }

  // Takes the image over, if it changed since.
  beforeDrawing(): void {
    if (!this.changed || !this.picture.visible) return;
    this.changed = false;
    this.small
      .getContext("2d", { alpha: false })!
      .drawImage(this.image, 0, 0, this.small.width, this.small.height);
    this.texture.needsUpdate = true;
  }

  set(camera: Camera | null, pose: Rigid | null, depth: number, withImage: boolean): void {
    this.object.visible = camera !== null && pose !== null;
    if (!camera || !pose) return;
    const corners = imageCorners(camera, pose, depth);
    const c = pose.translation;
    const pairs: Vec3[] = [];
    corners.forEach((p, i) => pairs.push(c, p, p, corners[(i + 1) % 4]!));
    this.lines.setPairs(pairs);
    const position = this.picture.geometry.attributes.position as BufferAttribute;
    corners.forEach((p, i) => position.setXYZ(i, ...p));
    position.needsUpdate = true;
    this.picture.visible = withImage;
  }

  dispose(): void {
    this.texture.dispose();
    this.picture.geometry.dispose();
    this.picture.material.dispose();
    this.lines.dispose();
  }
}

export interface MapCamera {
  readonly camera: Camera;
  readonly worldFromCamera: Rigid;
}

export class MapCameras {
  readonly object: LineSegments<BufferGeometry, LineBasicMaterial>;

  constructor() {
    this.object = new LineSegments(
      new BufferGeometry(),
      new LineBasicMaterial({ transparent: true, opacity: 0.55 }),
    );
    this.object.frustumCulled = false;
  }

  set(cameras: readonly MapCamera[], depth: number): void {
    const points = new Float32Array(cameras.length * 16 * 3);
    let n = 0;
    for (const { camera, worldFromCamera } of cameras) {
      const corners = imageCorners(camera, worldFromCamera, depth);
      corners.forEach((p, i) => {
        for (const q of [worldFromCamera.translation, p, p, corners[(i + 1) % 4]!]) {
          points.set(q, n);
          n += 3;
        }
      });
    }
    this.object.geometry.dispose();
    this.object.geometry = new BufferGeometry();
    this.object.geometry.setAttribute("position", new BufferAttribute(points, 3));
  }

  dispose(): void {
    this.object.geometry.dispose();
    this.object.material.dispose();
  }
}
