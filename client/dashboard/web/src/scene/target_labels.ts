// SPDX-License-Identifier: Apache-2.0
// The targets' names over the scene, as text of the page.
import { Vector3, type PerspectiveCamera } from "three";
import type { TargetGlyph } from "./target_glyph";

export class TargetLabels {
  readonly element = document.createElement("div");
  private readonly labelOf = new Map<string, HTMLElement>();

  constructor() {
    this.element.className = "scene-labels";
    this.element.setAttribute("aria-hidden", "true");
  }

  clear(): void {
    for (const label of this.labelOf.values()) label.remove();
    this.labelOf.clear();
  }

  remove(id: string): void {
    this.labelOf.get(id)?.remove();
    this.labelOf.delete(id);
  }

  // width, height: of the view, CSS pixels.
  place(targets: ReadonlyMap<string, TargetGlyph>, view: PerspectiveCamera, width: number, height: number): void {
    const p = new Vector3();
    for (const [id, glyph] of targets) {
      let label = this.labelOf.get(id);
      if (!label) {
        label = document.createElement("span");
        label.className = "scene-label";
        label.textContent = id;
        this.element.append(label);
        this.labelOf.set(id, label);
      }
      if (glyph.anchor) p.set(...glyph.anchor).project(view);
      const visible = glyph.anchor !== null && p.z < 1 && Math.abs(p.x) < 1 && Math.abs(p.y) < 1;
      label.style.visibility = visible ? "visible" : "hidden";
      if (visible) {
        const x = 0.5 * (p.x + 1) * width;
        const y = 0.5 * (1 - p.y) * height;
        label.style.transform = `translate(-50%, -130%) translate(${x.toFixed(1)}px, ${y.toFixed(1)}px)`;
      }
    }
  }
}
