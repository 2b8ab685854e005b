// SPDX-License-Identifier: Apache-2.0
// Keys. Those without a view to act on do nothing.
import type { App } from "../app/app";
import { chooseTheme, theme } from "./theme";

interface Shortcut {
  readonly keys: readonly string[];
  readonly show: readonly string[];
  readonly label: string;
  run(app: App, event: KeyboardEvent): void;
}

const STEP = 24; // frames, with shift

export const SHORTCUTS: readonly Shortcut[] = [
  { keys: ["b"], show: ["B"], label: "draw a box around a target", run: (app) => app.canMark() && app.setMode(app.mode.value === "draw" ? "look" : "draw") },
  { keys: ["m"], show: ["M"], label: "move a target's box", run: (app) => app.canMark() && app.setMode(app.mode.value === "move" ? "look" : "move") },
  {
    keys: ["Delete"], show: ["Del"], label: "drop the selected target",
    run: (app) => {
      const id = app.model.selectedTarget.value;
      if (id && app.canMark()) void app.model.dropTarget(id);
    },
  },
  { keys: ["Escape"], show: ["Esc"], label: "stop drawing; deselect", run: (app) => { if (app.mode.value === "look") app.model.selectedTarget.value = null; app.setMode("look"); app.ground.clear(); } },
  { keys: [" "], show: ["space"], label: "play, stand still", run: (app) => app.togglePlay() },
  { keys: ["ArrowLeft"], show: ["←"], label: "one frame back (shift: a second)", run: (app, e) => app.step(e.shiftKey ? -STEP : -1) },
  { keys: ["ArrowRight"], show: ["→"], label: "one frame on (shift: a second)", run: (app, e) => app.step(e.shiftKey ? STEP : 1) },
  { keys: ["Home"], show: ["Home"], label: "to the beginning", run: (app) => app.jump(-Infinity) },
  { keys: ["l", "End"], show: ["L", "End"], label: "follow what comes in, or to the end", run: (app) => (app.model.player.isLive ? app.goLive() : app.jump(Infinity)) },
  { keys: ["o"], show: ["O"], label: "3D: orbit", run: (app) => (app.viewMode.value = "orbit") },
  { keys: ["c"], show: ["C"], label: "3D: follow the camera", run: (app) => (app.viewMode.value = "follow") },
  { keys: ["u"], show: ["U"], label: "3D: from above", run: (app) => (app.viewMode.value = "top") },
  { keys: ["f"], show: ["F"], label: "3D: show everything", run: (app) => app.scene?.frame() },
  { keys: ["g"], show: ["G"], label: "3D: set the map's ground", run: (app) => app.ground.toggle() },
  { keys: ["v"], show: ["V"], label: "stabilised view", run: (app) => (app.stabilized.value = !app.stabilized.value) },
  { keys: ["1"], show: ["1"], label: "image and scene side by side", run: (app) => (app.layout.value = "split") },
  { keys: ["2"], show: ["2"], label: "larger image", run: (app) => (app.layout.value = "image") },
  { keys: ["3"], show: ["3"], label: "larger scene", run: (app) => (app.layout.value = "scene") },
  { keys: ["r"], show: ["R"], label: "start or end a recording", run: (app) => void app.model.toggleRecording() },
  { keys: ["e"], show: ["E"], label: "export trajectories", run: (app) => { if (app.model.view.value) app.dialog.value = "export"; } },
  { keys: ["s"], show: ["S"], label: "sessions and recordings", run: (app) => (app.dialog.value = "sessions") },
  { keys: ["n"], show: ["N"], label: "new session", run: (app) => (app.dialog.value = "start") },
  { keys: ["p"], show: ["P"], label: "maps", run: (app) => (app.dialog.value = "maps") },
  { keys: ["t"], show: ["T"], label: "light or dark", run: () => chooseTheme(theme.value === "dark" ? "light" : "dark") },
  { keys: ["?"], show: ["?"], label: "this help", run: (app) => (app.dialog.value = "help") },
];

const TIME_KEYS = new Set([" ", "ArrowLeft", "ArrowRight", "Home", "End", "Delete", "l", "b", "m", "r"]);

export function listenForKeys(app: App): () => void {
  const onKey = (event: KeyboardEvent) => {
    if (event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey) return;
    const target = event.target as HTMLElement;
    if (target.closest("input, select, textarea, dialog") || app.dialog.value !== null) return;
    if (app.model.access.value !== "ready") return;
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    // The space bar presses a focused button.
    if (key === " " && target.closest("button, a, summary")) return;
    if (TIME_KEYS.has(key) && !app.model.view.value) return;
    const shortcut = SHORTCUTS.find((s) => s.keys.includes(key));
    if (!shortcut) return;
    event.preventDefault();
    shortcut.run(app, event);
  };
  addEventListener("keydown", onKey);
  return () => removeEventListener("keydown", onKey);
}
