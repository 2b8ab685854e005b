// SPDX-License-Identifier: Apache-2.0
// A new map: another tool's reconstruction, or built here from a video or
// photos.
import type { JSX } from "preact";
import { useSignal } from "@preact/signals";
import type { App } from "../app/app";
import { message, toast } from "../app/toasts";
import { CameraModelId } from "../gen/groundlock/v1/geometry_pb";
import { MapFormat } from "../gen/groundlock/v1/maps_pb";
import { RequestError } from "../link/connection";
import { upload, type UploadFile } from "../link/http";
import { parseCameraJson, type CameraParams } from "../math/camera";
import { parseAlignJson, type Similarity } from "./align_json";
import { Button, Field, ProgressBar, Segmented } from "./controls";
import { bytes } from "./format";

const NAME = /^[A-Za-z0-9_][A-Za-z0-9._-]{0,63}$/;

// Paths below the folder that was chosen.
export function uploadFiles(files: Iterable<File>): UploadFile[] {
  return [...files].map((file) => {
    const whole = file.webkitRelativePath || file.name;
    const slash = file.webkitRelativePath ? whole.indexOf("/") : -1;
    return { path: slash >= 0 ? whole.slice(slash + 1) : whole, file };
  });
}

export function MapUploadForm(props: { app: App; onDone: (name: string) => void }): JSX.Element {
  const { app } = props;
  const { model } = app;
  const kind = useSignal<"import" | "build">("import");
  const name = useSignal("");
  const files = useSignal<readonly UploadFile[]>([]);
  const align = useSignal<Similarity | null>(null);
  const camera = useSignal<CameraParams | null>(null);
  const error = useSignal("");
  const stage = useSignal("");
  const fraction = useSignal<number | null>(null);
  const abort = useSignal<AbortController | null>(null);
  const requestId = useSignal(0n);

  const total = files.value.reduce((sum, f) => sum + f.file.size, 0);
  const limits = model.hello.value?.limits;
  const tooLarge = limits && limits.maxMapBytes > 0n && BigInt(total) > limits.maxMapBytes;
  const ready = NAME.test(name.value) && files.value.length > 0 && !tooLarge && stage.value === "";

  const parse = async <T,>(input: HTMLInputElement, read: (text: string) => T): Promise<T | null> => {
    error.value = "";
    try {
      const file = input.files?.[0];
      return file ? read(await file.text()) : null;
    } catch (e) {
      error.value = message(e);
      return null;
    }
  };
  const run = async () => {
    error.value = "";
    abort.value = new AbortController();
    try {
      stage.value = "Uploading";
      const uploadId = await upload("map", name.value, files.value, (sent, all, path) => {
        fraction.value = all > 0 ? sent / all : null;
        stage.value = `Uploading ${path}`;
      }, abort.value.signal);
      stage.value = kind.value === "import" ? "Importing" : "Building the map";
      fraction.value = null;
      const own = camera.value;
      const { id, reply } = model.connection.send(
        kind.value === "import"
          ? { case: "importMap", value: { uploadId, name: name.value, format: MapFormat.UNSPECIFIED, ...(align.value ? { worldFromSource: align.value } : {}) } }
          : { case: "buildMap", value: { uploadId, name: name.value, ...(own ? { camera: { model: own.model as number as CameraModelId, widthPx: own.width, heightPx: own.height, params: [...own.params] } } : {}) } },
        (what, share, note) => {
          stage.value = note ? `${what}: ${note}` : what;
          fraction.value = share;
        },
      );
      requestId.value = id;
      const answer = await reply;
      if (answer.case === "error") throw new RequestError(answer.value.code, answer.value.message);
      if (answer.case !== "mapImported") throw new Error("unexpected reply");
      for (const warning of answer.value.warnings) toast("info", warning);
      toast("good", `Map ${name.value} is there: ${answer.value.map?.numLandmarks ?? 0} landmarks.`);
      props.onDone(name.value);
    } catch (e) {
      error.value = message(e);
    } finally {
      stage.value = "";
      requestId.value = 0n;
      abort.value = null;
    }
  };
  const cancel = () => {
    abort.value?.abort();
    if (requestId.value > 0n) {
      void model.attempt("It could not be cancelled", () =>
        model.connection.request("done", { case: "cancel", value: { requestId: requestId.value } }),
      );
    }
  };
  const directory = { webkitdirectory: true } as JSX.InputHTMLAttributes<HTMLInputElement>;
  return (
    <form
      onSubmit={(e) => {
        e.preventDefault();
        void run();
      }}
    >
      <h3>A new map</h3>
      <Segmented<"import" | "build">
        label="Kind"
        value={kind.value}
        options={[{ value: "import", label: "A reconstruction" }, { value: "build", label: "From a video or photos" }]}
        onChange={(v) => {
          kind.value = v;
          files.value = [];
        }}
      />
      <Field label="Name" hint="Letters, digits, . _ -. An existing name gets a new version.">
        {(id) => <input id={id} value={name.value} maxLength={64} aria-invalid={name.value !== "" && !NAME.test(name.value)} onInput={(e) => (name.value = e.currentTarget.value)} />}
      </Field>
      <div class="row">
        {kind.value === "import" ? (
          <Field label="Folder" hint="COLMAP's model with its database; OpenSfM, OpenMVG, Bundler, VisualSFM.">
            {(id) => <input id={id} type="file" multiple {...directory} onChange={(e) => (files.value = uploadFiles(e.currentTarget.files ?? []))} />}
          </Field>
        ) : null}
        <Field label={kind.value === "import" ? "or single files" : "Video or photos"} hint={kind.value === "import" ? "For instance a .glmap file." : "One video, or photos in the order of their names."}>
          {(id) => <input id={id} type="file" multiple onChange={(e) => (files.value = uploadFiles(e.currentTarget.files ?? []))} />}
        </Field>
      </div>
      {kind.value === "import" ? (
        <Field label="align.json" hint="Optional: metres and which way is up. Without it the ground is found and the unit is kept.">
          {(id) => <input id={id} type="file" accept=".json,application/json" onChange={async (e) => (align.value = await parse(e.currentTarget, parseAlignJson))} />}
        </Field>
      ) : (
        <Field label="camera.json" hint="Optional: the lens; else it is estimated.">
          {(id) => <input id={id} type="file" accept=".json,application/json" onChange={async (e) => (camera.value = await parse(e.currentTarget, parseCameraJson))} />}
        </Field>
      )}
      {files.value.length > 0 ? <p class="muted">{files.value.length} file{files.value.length === 1 ? "" : "s"}, {bytes(total)}</p> : null}
      {tooLarge ? <p class="form-error">The dashboard takes at most {bytes(limits.maxMapBytes)}.</p> : null}
      {stage.value ? <div role="status"><p>{stage.value}</p><ProgressBar value={fraction.value} label={stage.value} /></div> : null}
      <p class="form-error" role="alert">{error.value}</p>
      <div class="actions">
        <Button kind="primary" icon="upload" type="submit" disabled={!ready}>{kind.value === "import" ? "Upload" : "Build"}</Button>
        {stage.value ? <Button onClick={cancel}>Cancel</Button> : null}
      </div>
    </form>
  );
}
