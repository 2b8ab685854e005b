// SPDX-License-Identifier: Apache-2.0
import type { JSX } from "preact";
import type { App } from "../app/app";
import { SHORTCUTS } from "./shortcuts";
import { Dialog } from "./controls";

const LEGEND = [
  ["var(--landmark)", "matched landmarks"],
  ["#ffffff", "2D box of a target that is seen"],
  ["var(--box)", "3D box; dashed where it is predicted"],
  ["var(--front)", "its front face, and the dot at its centre"],
  ["var(--confidence)", "confidence bar"],
  ["var(--mover)", "moves and is no target yet: click it"],
  ["var(--good)", "seen, localised"],
  ["var(--warn)", "predicted, held"],
  ["var(--bad)", "lost"],
] as const;

export function HelpDialog({ app }: { app: App }): JSX.Element {
  const hello = app.model.hello.value;
  return (
    <Dialog title="Keys and colours" wide onClose={() => (app.dialog.value = null)}>
      <div class="help">
        <table>
          <caption class="visually-hidden">Keys</caption>
          <tbody>
            {SHORTCUTS.map((s) => (
              <tr key={s.label}>
                <th scope="row">{s.show.map((k) => <kbd key={k}>{k}</kbd>)}</th>
                <td>{s.label}</td>
              </tr>
            ))}
          </tbody>
        </table>
        <div>
          <ul class="legend">
            {LEGEND.map(([color, text]) => <li key={text}><i style={{ background: color }} />{text}</li>)}
          </ul>
          <p class="muted">In the scene: drag turns, right-drag or two fingers shift, wheel or pinch zooms. On the timeline: click jumps, wheel zooms.</p>
          {hello ? <p class="muted">Dashboard {hello.version}, server {hello.serverAddress}</p> : null}
        </div>
      </div>
    </Dialog>
  );
}
