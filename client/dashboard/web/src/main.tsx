// SPDX-License-Identifier: Apache-2.0
import { render } from "preact";
import { App } from "./app/app";
import "./styles/tokens.css";
import "./styles/base.css";
import "./styles/page.css";
import { Page } from "./ui/page";
import { startTheme } from "./ui/theme";

declare global {
  interface Window {
    // For support and for the browser tests: what the page knows.
    groundlock: App;
  }
}

startTheme();
const app = new App();
window.groundlock = app;
render(<Page app={app} />, document.getElementById("app")!);
void app.model.start();
