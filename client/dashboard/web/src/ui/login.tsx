// SPDX-License-Identifier: Apache-2.0
import type { JSX } from "preact";
import { useSignal } from "@preact/signals";
import type { App } from "../app/app";
import { Button, Field } from "./controls";

export function Login({ app }: { app: App }): JSX.Element {
  const { model } = app;
  const token = useSignal("");
  const busy = useSignal(false);
  const submit = async (event: Event) => {
    event.preventDefault();
    busy.value = true;
    await model.logIn(token.value.trim());
    busy.value = false;
    token.value = "";
  };
  return (
    <main class="login">
      <form class="login-card" onSubmit={(e) => void submit(e)}>
        <img src="./icon.svg" width="48" height="48" alt="" />
        <h1>Groundlock</h1>
        <p class="muted">This server asks for an access token.</p>
        <Field label="Token">
          {(id) => (
            <input
              id={id}
              name="token"
              type="password"
              autocomplete="current-password"
              autofocus
              required
              value={token.value}
              aria-invalid={model.loginError.value !== ""}
              onInput={(e) => (token.value = e.currentTarget.value)}
            />
          )}
        </Field>
        <p class="form-error" role="alert">{model.loginError.value}</p>
        <Button kind="primary" type="submit" disabled={busy.value || token.value.trim() === ""}>Log in</Button>
        <p class="hint">Whoever runs the server hands tokens out; see “Access” in its operations guide.</p>
      </form>
    </main>
  );
}
