// SPDX-License-Identifier: Apache-2.0
// Trajectories of what the page has kept, as files.
import type { JSX } from "preact";
import { useSignal } from "@preact/signals";
import type { App } from "../app/app";
import { message } from "../app/toasts";
import type { FrameRecord } from "../data/frame";
import { clock } from "../data/timeline";
import { toCsv, toGeoJson, toKml, toTum, type TrajectoryFormat } from "../data/trajectory";
import type { Geodetic } from "../math/geodesy";
import { Button, Dialog, Field, Segmented } from "./controls";
import { count } from "./format";

const KINDS: Record<TrajectoryFormat, { label: string; mime: string; about: string }> = {
  csv: { label: "CSV", mime: "text/csv", about: "Everything, one row per frame and target, as groundlock track writes it." },
  tum: { label: "TUM", mime: "text/plain", about: "Time, position and quaternion of the camera or of one target." },
  kml: { label: "KML", mime: "application/vnd.google-earth.kml+xml", about: "Ways on Earth, for Google Earth." },
  geojson: { label: "GeoJSON", mime: "application/geo+json", about: "Ways on Earth, for GIS." },
};

function parseOrigin(text: string): Geodetic {
  const [lat, lon, height = 0] = text.trim().split(/[\s,;]+/).map(Number);
  if (lat === undefined || lon === undefined || !(Math.abs(lat) <= 90) || !(Math.abs(lon) <= 180) || !Number.isFinite(height)) {
    throw new Error("the place must be latitude and longitude in degrees, then the height in metres");
  }
  return { latitude_deg: lat, longitude_deg: lon, height_m: height };
}

function save(name: string, type: string, text: string): void {
  const url = URL.createObjectURL(new Blob([text], { type }));
  const link = document.createElement("a");
  link.href = url;
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(url), 1000);
}

export function ExportDialog({ app }: { app: App }): JSX.Element {
  const { model } = app;
  const known = model.cloudMap.value?.origin;
  const format = useSignal<TrajectoryFormat>("csv");
  const of = useSignal("");
  const scope = useSignal<"all" | "span">("all");
  const origin = useSignal(known ? `${known.latitudeDeg} ${known.longitudeDeg} ${known.heightM}` : "");
  const error = useSignal("");
  model.player.grown.value;
  const { history } = model.player;
  const onEarth = format.value === "kml" || format.value === "geojson";

  const frames = function* (): Generator<FrameRecord> {
    const { from, to } = app.time.range.peek();
    for (let i = 0; i < history.length; ++i) {
      const r = history.at(i)!;
      if (scope.value === "all" || (r.timeS >= from && r.timeS <= to)) yield r;
    }
  };
  const run = () => {
    error.value = "";
    try {
      const kind = format.value;
      const text =
        kind === "csv" ? toCsv(frames())
        : kind === "tum" ? toTum(frames(), of.value || null)
        : kind === "kml" ? toKml(frames(), parseOrigin(origin.value))
        : toGeoJson(frames(), parseOrigin(origin.value));
      const what = kind === "tum" ? `_${of.value || "camera"}` : "";
      save(`${model.view.value?.id ?? "session"}${what}.${kind === "tum" ? "txt" : kind}`, KINDS[kind].mime, text);
      app.dialog.value = null;
    } catch (e) {
      error.value = message(e);
    }
  };
  const seconds = (history.last?.timeS ?? 0) - (history.first?.timeS ?? 0);
  return (
    <Dialog
      title="Export trajectories"
      onClose={() => (app.dialog.value = null)}
      footer={<><p class="form-error grow" role="alert">{error.value}</p><Button kind="primary" icon="download" disabled={history.length === 0} onClick={run}>Export</Button></>}
    >
      <Segmented<TrajectoryFormat>
        label="Format"
        value={format.value}
        options={(Object.keys(KINDS) as TrajectoryFormat[]).map((value) => ({ value, label: KINDS[value].label }))}
        onChange={(v) => (format.value = v)}
      />
      <p class="muted">{KINDS[format.value].about}</p>
      {format.value === "tum" ? (
        <Field label="Of">
          {(id) => (
            <select id={id} value={of.value} onChange={(e) => (of.value = e.currentTarget.value)}>
              <option value="">camera</option>
              {app.targetOrder.value.map((t) => <option key={t} value={t}>{t}</option>)}
            </select>
          )}
        </Field>
      ) : null}
      {onEarth ? (
        <Field label="World's origin on Earth" hint={known ? "From the map." : "The map is not georeferenced: tell latitude, longitude and height; x is then east and y north."}>
          {(id) => <input id={id} value={origin.value} placeholder="47.3977 8.5456 410" onInput={(e) => (origin.value = e.currentTarget.value)} />}
        </Field>
      ) : null}
      <Segmented<"all" | "span">
        label="Frames"
        value={scope.value}
        options={[{ value: "all", label: `Everything: ${count(history.length)} frames, ${clock(seconds)}` }, { value: "span", label: "What the plots show" }]}
        onChange={(v) => (scope.value = v)}
      />
    </Dialog>
  );
}
