// SPDX-License-Identifier: Apache-2.0
// Puts a map into metres, on its ground, on Earth.
import type { JSX } from "preact";
import { useSignal } from "@preact/signals";
import type { App } from "../app/app";
import { message, toast } from "../app/toasts";
import type { AlignMapResponse, MapInfo } from "../gen/groundlock/v1/maps_pb";
import type { RequestInit } from "../link/connection";
import { parseAlignJson, type Similarity } from "./align_json";
import { parseControlPoints, type ControlPoints } from "./control_points_json";
import { Button, Field, Segmented } from "./controls";

type Method = "distance" | "points" | "file" | "ground";
type AlignValue = Extract<RequestInit, { case: "alignMap" }>["value"];

function point(text: string): { x: number; y: number; z: number } {
  const parts = text.trim().split(/[\s,;]+/).map(Number);
  if (parts.length !== 3 || !parts.every(Number.isFinite)) throw new Error(`'${text}' is not a point: three numbers, x y z`);
  return { x: parts[0]!, y: parts[1]!, z: parts[2]! };
}

// Without "-0.000".
const millimetres = (v: number) => (Math.round(1000 * v) / 1000 || 0).toFixed(3);

export function AlignForm(props: { app: App; map: MapInfo; onDone: () => void }): JSX.Element {
  const { app, map } = props;
  const method = useSignal<Method>("distance");
  const from = useSignal("");
  const to = useSignal("");
  const meters = useSignal("");
  const similarity = useSignal<Similarity | null>(null);
  const points = useSignal<ControlPoints | null>(null);
  const origin = useSignal("");
  const error = useSignal("");
  const busy = useSignal(false);
  const report = useSignal<AlignMapResponse | null>(null);

  const request = (reportOnly: boolean): AlignValue => {
    const base = { name: map.name, reportOnly };
    const place = origin.value.trim() === "" ? {} : (() => {
      const { x, y, z } = point(origin.value);
      return { origin: { latitudeDeg: x, longitudeDeg: y, heightM: z } };
    })();
    switch (method.value) {
      case "ground":
        return { ...base, ...place, ground: { case: "groundAutomatic", value: true } };
      case "file":
        if (!similarity.value) throw new Error("choose align.json first");
        return { ...base, ...place, method: { case: "newWorldFromSource", value: similarity.value } };
      case "points":
        if (!points.value) throw new Error("choose the file of control points first");
        return { ...base, ...place, method: { case: "controlPoints", value: points.value } };
      case "distance": {
        const distanceM = Number(meters.value);
        if (!(distanceM > 0)) throw new Error("the distance must be above 0");
        return {
          ...base, ...place,
          method: {
            case: "knownDistance",
            value: { from: { positionWorld: point(from.value) }, to: { positionWorld: point(to.value) }, distanceM },
          },
        };
      }
    }
  };
  const run = async (reportOnly: boolean) => {
    error.value = "";
    busy.value = true;
    try {
      const reply = await app.model.connection.request("mapAligned", { case: "alignMap", value: request(reportOnly) });
      report.value = reply;
      if (!reportOnly) {
        toast("good", `Map ${map.name} is aligned: version ${reply.map?.version ?? ""}.`);
        props.onDone();
      }
    } catch (e) {
      error.value = message(e);
    } finally {
      busy.value = false;
    }
  };
  const readFile = async <T,>(input: HTMLInputElement, parse: (text: string) => T): Promise<T | null> => {
    error.value = "";
    report.value = null;
    try {
      const file = input.files?.[0];
      return file ? parse(await file.text()) : null;
    } catch (e) {
      error.value = message(e);
      return null;
    }
  };
  const r = report.value;
  return (
    <form
      onSubmit={(e) => {
        e.preventDefault();
        void run(false);
      }}
    >
      <h3>Align {map.name}</h3>
      <Segmented<Method>
        label="Method"
        value={method.value}
        options={[
          { value: "distance", label: "Known distance" },
          { value: "points", label: "Control points" },
          { value: "file", label: "align.json" },
          { value: "ground", label: "Find the ground" },
        ]}
        onChange={(v) => {
          method.value = v;
          report.value = null;
        }}
      />
      {method.value === "distance" ? (
        <div class="row">
          <Field label="From" hint="x y z in the map's present world">{(id) => <input id={id} value={from.value} placeholder="0 0 0" onInput={(e) => (from.value = e.currentTarget.value)} />}</Field>
          <Field label="To" hint="x y z">{(id) => <input id={id} value={to.value} placeholder="1 0 0" onInput={(e) => (to.value = e.currentTarget.value)} />}</Field>
          <Field label="Distance, m">{(id) => <input id={id} inputMode="decimal" value={meters.value} onInput={(e) => (meters.value = e.currentTarget.value)} />}</Field>
        </div>
      ) : method.value === "file" ? (
        <Field label="align.json" hint="p_world = scale R p_source + translation">{(id) => <input id={id} type="file" accept=".json,application/json" onChange={async (e) => (similarity.value = await readFile(e.currentTarget, parseAlignJson))} />}</Field>
      ) : method.value === "points" ? (
        <Field
          label="Control points"
          hint="JSON: at least three points, each with its position in the map or its pixels in two mapping images, and the place that was measured, in metres or on Earth; as groundlock map align --control-points takes it."
        >
          {(id) => <input id={id} type="file" accept=".json,application/json" onChange={async (e) => (points.value = await readFile(e.currentTarget, parseControlPoints))} />}
        </Field>
      ) : (
        <p class="muted">The plane that most landmarks below the cameras lie on becomes z = 0.</p>
      )}
      <Field label="Where world's origin lies on Earth" hint="Latitude, longitude in degrees and height in metres; empty: not georeferenced.">
        {(id) => <input id={id} value={origin.value} placeholder="47.3977 8.5456 410" onInput={(e) => (origin.value = e.currentTarget.value)} />}
      </Field>
      {r ? (
        <div class="report" role="status">
          <p>Fits to {r.rmsErrorM.toFixed(3)} m (median {r.medianErrorM.toFixed(3)} m, worst {r.maxErrorM.toFixed(3)} m).</p>
          {method.value === "points" && r.residuals.length > 0 ? (
            <table class="residuals">
              <thead><tr><th scope="col">Point</th><th scope="col">Error, m</th><th scope="col">x, y, z</th></tr></thead>
              <tbody>
                {r.residuals.map(({ name, errorM: e, used }) => (
                  <tr key={name}>
                    <th scope="row">{name}{used ? "" : " (left out)"}</th>
                    <td>{e ? Math.hypot(e.x, e.y, e.z).toFixed(3) : ""}</td>
                    <td>{e ? [e.x, e.y, e.z].map(millimetres).join(", ") : ""}</td>
                  </tr>
                ))}
              </tbody>
            </table>
          ) : null}
          {r.warnings.map((w) => <p key={w} class="warn-text">{w}</p>)}
        </div>
      ) : null}
      <p class="form-error" role="alert">{error.value}</p>
      <div class="actions">
        <Button disabled={busy.value} onClick={() => void run(true)}>Try</Button>
        <Button kind="primary" type="submit" disabled={busy.value}>Align</Button>
        <Button onClick={props.onDone}>Cancel</Button>
      </div>
    </form>
  );
}
