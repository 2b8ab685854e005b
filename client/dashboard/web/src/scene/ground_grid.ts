// SPDX-License-Identifier: Apache-2.0
// An endless grid on the ground: lines of constant width that fade with the
// distance, every tenth one stronger.
import { Color, DoubleSide, Mesh, PlaneGeometry, Quaternion, ShaderMaterial, Vector3 } from "three";

const VERTEX = /* glsl */ `
  uniform float extent;
  uniform vec2 middle;
  varying vec2 v_xy;
  void main() {
    v_xy = position.xy * extent + middle;
    gl_Position = projectionMatrix * modelViewMatrix * vec4(v_xy, 0.0, 1.0);
  }`;

const FRAGMENT = /* glsl */ `
  uniform float step_m;
  uniform float extent;
  uniform vec2 middle;
  uniform vec3 color;
  varying vec2 v_xy;
  float lines(float s) {
    vec2 g = v_xy / s;
    vec2 w = fwidth(g);
    vec2 d = abs(fract(g - 0.5) - 0.5) / max(w, 1e-6);
    // Where lines are closer than pixels they melt into an even tone.
    float calm = 1.0 - smoothstep(0.2, 0.8, max(w.x, w.y));
    return (1.0 - min(min(d.x, d.y), 1.0)) * calm;
  }
  void main() {
    float fade = 1.0 - smoothstep(0.1, 1.0, length(v_xy - middle) / (0.5 * extent));
    float a = max(0.26 * lines(step_m), 0.5 * lines(10.0 * step_m)) * fade;
    if (a < 0.004) discard;
    gl_FragColor = vec4(color, a);
  }`;

export class GroundGrid {
  readonly mesh: Mesh<PlaneGeometry, ShaderMaterial>;
  step = 1;

  constructor() {
    const material = new ShaderMaterial({
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
      uniforms: {
        step_m: { value: 1 },
        extent: { value: 100 },
        middle: { value: { x: 0, y: 0 } },
        color: { value: new Color() },
      },
      transparent: true,
      depthWrite: false,
      side: DoubleSide,
    });
    this.mesh = new Mesh(new PlaneGeometry(1, 1), material);
    this.mesh.frustumCulled = false;
    this.mesh.renderOrder = -1;
  }

  setColor(color: string): void {
    // The shader writes what the screen shows.
    this.mesh.material.uniforms.color!.value = new Color(color).convertLinearToSRGB();
  }

  // normal . x + d = 0, world.
  setPlane(normal: readonly [number, number, number], d: number): void {
    const n = new Vector3(...normal).normalize();
    this.mesh.quaternion.copy(new Quaternion().setFromUnitVectors(new Vector3(0, 0, 1), n));
    this.mesh.position.copy(n.multiplyScalar(-d));
  }

  // Follows the view: the step is a round number of which about ten fit.
  update(middle: Vector3, distance: number): void {
    const local = this.mesh.worldToLocal(middle.clone());
    const rough = distance / 12;
    this.step = 10 ** Math.floor(Math.log10(Math.max(1e-6, rough)) + 0.3);
    this.mesh.material.uniforms.step_m!.value = this.step;
    this.mesh.material.uniforms.extent!.value = 6 * distance;
    this.mesh.material.uniforms.middle!.value = { x: local.x, y: local.y };
  }

  dispose(): void {
    this.mesh.geometry.dispose();
    this.mesh.material.dispose();
  }
}
