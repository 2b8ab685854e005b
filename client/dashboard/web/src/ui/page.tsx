// SPDX-License-Identifier: Apache-2.0
// The whole page.
import type { JSX } from "preact";
import { useEffect } from "preact/hooks";
import { useSignal } from "@preact/signals";
import type { App } from "../app/app";
import { dismiss, toasts } from "../app/toasts";
import { ServerState_State, SubscriptionState_State } from "../gen/groundlock/dashboard/v1/dashboard_pb";
import { Button, IconButton } from "./controls";
import { ExportDialog } from "./export_dialog";
import { HelpDialog } from "./help_dialog";
import { Home } from "./home";
import { Login } from "./login";
import { MapsDialog } from "./maps_dialog";
import { Plots } from "./plots";
import { SessionsDialog } from "./sessions_dialog";
import { listenForKeys } from "./shortcuts";
import { ImagePane, ScenePane } from "./stage";
import { StartDialog } from "./start_dialog";
import { Targets } from "./targets";
import { TimelineBar } from "./timeline_bar";
import { TopBar } from "./top_bar";

function Banner({ app }: { app: App }): JSX.Element | null {
  const { model } = app;
  const now = useSignal(performance.now());
  const link = model.link.value;
  const waiting = link === "waiting" || link === "refused";
  useEffect(() => {
    if (!waiting) return;
    const timer = setInterval(() => (now.value = performance.now()), 250);
    return () => clearInterval(timer);
  }, [waiting]);
  if (waiting || (link === "connecting" && model.everConnected.value)) {
    const seconds = Math.max(0, Math.ceil((model.retryAt.value - now.value) / 1000));
    return (
      <div class="banner" data-tone="bad" role="alert">
        <span>{model.serverUnknown.value ? "The Groundlock server does not answer yet." : "The dashboard does not answer."} {waiting && seconds > 0 ? `Trying again in ${seconds} s.` : "Trying again…"}</span>
        {waiting ? <Button onClick={() => model.connection.retryNow()}>Try now</Button> : null}
      </div>
    );
  }
  const server = model.server.value;
  if (server?.state === ServerState_State.UNREACHABLE) {
    return (
      <div class="banner" data-tone="bad" role="alert">
        <span title={server.message}>The Groundlock server {model.hello.value?.serverAddress} does not answer; it is being tried again.</span>
      </div>
    );
  }
  const subscription = model.subscription.value;
  if (subscription?.state === SubscriptionState_State.RECONNECTING) {
    return <div class="banner" data-tone="warn" role="status">Waiting for the session to come back. {subscription.message}</div>;
  }
  if (subscription?.state === SubscriptionState_State.ENDED) {
    return (
      <div class="banner" data-tone="warn" role="status">
        <span>The session has ended. What was seen of it can still be looked at.</span>
        <Button onClick={() => app.go(null)}>Start page</Button>
      </div>
    );
  }
  return null;
}

function Toasts(): JSX.Element {
  return (
    <div class="toasts" aria-live="polite">
      {toasts.value.map((t) => (
        <div key={t.id} class="toast" data-tone={t.tone} role={t.tone === "bad" ? "alert" : "status"}>
          <span>{t.text}</span>
          <IconButton icon="close" label="Dismiss" onClick={() => dismiss(t.id)} />
        </div>
      ))}
    </div>
  );
}

function Dialogs({ app }: { app: App }): JSX.Element | null {
  switch (app.dialog.value) {
    case "start": return <StartDialog app={app} />;
    case "maps": return <MapsDialog app={app} />;
    case "sessions": return <SessionsDialog app={app} />;
    case "export": return <ExportDialog app={app} />;
    case "help": return <HelpDialog app={app} />;
    default: return null;
  }
}

export function Page({ app }: { app: App }): JSX.Element {
  useEffect(() => listenForKeys(app), []);
  const access = app.model.access.value;
  if (access === "login") return <Login app={app} />;
  const view = app.model.view.value;
  return (
    <div class="page">
      <TopBar app={app} />
      <Banner app={app} />
      {view ? (
        <main class="workspace" data-layout={app.layout.value}>
          <h1 class="visually-hidden">{view.kind === "replay" ? "Recording" : "Session"} {view.id}</h1>
          <div class="column left">
            <ImagePane app={app} />
            <Plots app={app} />
          </div>
          <div class="column right">
            <ScenePane app={app} />
            <Targets app={app} />
          </div>
          <TimelineBar app={app} />
        </main>
      ) : (
        <Home app={app} />
      )}
      <Dialogs app={app} />
      <Toasts />
    </div>
  );
}
