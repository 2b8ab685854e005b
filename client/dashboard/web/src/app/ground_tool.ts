// SPDX-License-Identifier: Apache-2.0
// Sets a map's ground in the 3D scene: by three places that were clicked, or
// level through one. The map gets a new version; sessions that run keep theirs.
import { computed, signal } from "@preact/signals";
import { levelPlane, planeThrough, type GroundPlane } from "../math/ground";
import type { Vec3 } from "../math/pose";
import type { Model } from "./model";
import { toast } from "./toasts";

const PLACES = 3;

export class GroundTool {
  readonly active = signal(false);
  readonly places = signal<readonly Vec3[]>([]);
  readonly busy = signal(false);
  private readonly level = signal(false);

  // What is asked for so far; null: not enough, or on a line.
  readonly plane = computed<GroundPlane | null>(() => {
    const [a, b, c] = this.places.value;
    const cameras = this.model.cloud.value?.cameras.map((camera) => camera.worldFromCamera) ?? [];
    if (this.level.value) return a ? levelPlane(a, cameras) : null;
    return a && b && c ? planeThrough(a, b, c, cameras.map((pose) => pose.translation)) : null;
  });

  readonly hint = computed(() => {
    const count = this.places.value.length;
    if (this.plane.value) return this.level.value ? "Level through this place" : "Through these three places";
    if (count === PLACES) return "These places lie on a line: click others";
    return `Click three places on the ground (${count} of ${PLACES})`;
  });

  constructor(private readonly model: Model) {}

  // null: it can be set; else why not.
  refusal(): string | null {
    const map = this.model.cloudMap.value;
    if (this.model.view.value?.kind !== "live" || !map || !this.model.cloud.value) return "no map is shown";
    const newest = this.model.maps.value.find((m) => m.name === map.name);
    // Places are those of the version that is shown.
    if (newest && newest.version !== map.version) {
      return `Map ${map.name} has a newer version (${newest.version}) than this session's (${map.version}): start a session with it`;
    }
    return null;
  }

  toggle(): void {
    const why = this.active.value ? null : this.refusal();
    if (why) {
      toast("bad", why);
      return;
    }
    const active = !this.active.value;
    this.clear();
    this.active.value = active;
  }

  clear(): void {
    this.active.value = false;
    this.level.value = false;
    this.places.value = [];
  }

  add(place: Vec3 | null): void {
    if (!place) {
      toast("bad", "There is no point of the map near that place.");
      return;
    }
    this.level.value = false;
    const before = this.places.value;
    this.places.value = before.length === PLACES ? [place] : [...before, place];
  }

  levelHere(): void {
    this.places.value = this.places.value.slice(-1);
    this.level.value = true;
  }

  async apply(): Promise<void> {
    const plane = this.plane.value;
    const map = this.model.cloudMap.value;
    if (!plane || !map || this.busy.value) return;
    const [x, y, z] = plane.normal;
    this.busy.value = true;
    const done = await this.model.attempt(`The ground of map ${map.name} could not be set`, async () => {
      const reply = await this.model.connection.request("mapAligned", {
        case: "alignMap",
        value: { name: map.name, ground: { case: "groundPlaneWorld", value: { normal: { x, y, z }, d: plane.d } } },
      });
      toast("good", `Map ${map.name} has this ground from version ${reply.map?.version ?? ""} on; sessions that start now use it.`);
    });
    this.busy.value = false;
    if (done) this.clear();
  }
}
