// SPDX-License-Identifier: Apache-2.0
// Light and dark: the choice is kept, the system's is the default. Canvases
// read the same tokens as the style sheets.
import { signal } from "@preact/signals";

export type ThemeChoice = "system" | "light" | "dark";

const KEY = "groundlock.theme";
const dark = matchMedia("(prefers-color-scheme: dark)");

function stored(): ThemeChoice {
  try {
    const value = localStorage.getItem(KEY);
    return value === "light" || value === "dark" ? value : "system";
  } catch {
    return "system"; // storage may be forbidden
  }
}

export const themeChoice = signal<ThemeChoice>(stored());
export const theme = signal<"light" | "dark">("dark");

export interface Palette {
  readonly [token: string]: string;
}
const TOKENS = [
  "bg", "surface", "raised", "line", "text", "muted", "faint", "accent",
  "good", "warn", "bad", "idle", "landmark", "confidence", "box", "front", "ghost", "mover",
  "scene", "grid", "frustum", "mapcam", "trail",
  "series-1", "series-2", "series-3", "series-4", "series-5", "series-6",
] as const;
export type Token = (typeof TOKENS)[number];
export const palette = signal<Record<Token, string>>({} as Record<Token, string>);

function apply(): void {
  const choice = themeChoice.value;
  theme.value = choice === "system" ? (dark.matches ? "dark" : "light") : choice;
  document.documentElement.dataset.theme = theme.value;
  const style = getComputedStyle(document.documentElement);
  palette.value = Object.fromEntries(
    TOKENS.map((t) => [t, style.getPropertyValue(`--${t}`).trim()]),
  ) as Record<Token, string>;
}

export function startTheme(): void {
  dark.addEventListener("change", apply);
  apply();
}

export function chooseTheme(choice: ThemeChoice): void {
  themeChoice.value = choice;
  try {
    if (choice === "system") localStorage.removeItem(KEY);
    else localStorage.setItem(KEY, choice);
  } catch {
    // The choice then lasts as long as the page.
  }
  apply();
}

export const reducedMotion = matchMedia("(prefers-reduced-motion: reduce)");

const SERIES: readonly Token[] = ["series-1", "series-2", "series-3", "series-4", "series-5", "series-6"];

// The colour by which a target is told from others.
export function targetToken(index: number): Token {
  return SERIES[index % SERIES.length]!;
}
