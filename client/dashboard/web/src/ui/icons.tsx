// SPDX-License-Identifier: Apache-2.0
// Line icons on a 20 x 20 grid.
import type { JSX } from "preact";

const PATHS = {
  box: "M3 7V4a1 1 0 0 1 1-1h3M13 3h3a1 1 0 0 1 1 1v3M17 13v3a1 1 0 0 1-1 1h-3M7 17H4a1 1 0 0 1-1-1v-3M10 7v6M7 10h6",
  move: "M10 2.500v15M2.500 10h15M10 2.500 8 4.500M10 2.500l2 2M10 17.500l-2-2M10 17.500l2-2M2.500 10l2-2M2.500 10l2 2M17.500 10l-2-2M17.500 10l-2 2",
  drop: "M4 6h12M8 6V4h4v2M6 6l.7 10h6.600L14 6M8.500 9v4.500M11.500 9v4.500",
  steady: "M3 6.500C5 4.500 7 8.500 9 6.500S13 4.500 17 6.500M3 13.500h14",
  layers: "M10 3 2.500 7 10 11l7.500-4zM3.500 10.500 10 14l6.500-3.500M3.500 13.500 10 17l6.500-3.500",
  orbit: "M10 13a3 3 0 1 0 0-6 3 3 0 0 0 0 6zM2.500 10c0-2 3.400-3.500 7.500-3.500s7.500 1.500 7.500 3.500-3.400 3.500-7.500 3.500S2.500 12 2.500 10z",
  follow: "M3 6.500h9v7H3zM12 9l5-2.500v7L12 11",
  top: "M3.500 3.500h13v13h-13zM10 3.500v13M3.500 10h13",
  ground: "M10 2.500v9M7 8.500l3 3 3-3M3 15.500 7 11.500M17 15.500l-4-4M2.500 16.500h15",
  fit: "M3 7.500V3h4.500M12.500 3H17v4.500M17 12.500V17h-4.500M7.500 17H3v-4.500M7.500 10a2.500 2.500 0 1 0 5 0 2.500 2.500 0 0 0-5 0",
  play: "M6 3.500v13l10.500-6.500z",
  pause: "M6 4v12M14 4v12",
  back: "M13 4 7 10l6 6",
  forward: "M7 4l6 6-6 6",
  live: "M10 12a2 2 0 1 0 0-4 2 2 0 0 0 0 4zM6 6a5.700 5.700 0 0 0 0 8M14 6a5.700 5.700 0 0 1 0 8M3.700 3.700a9 9 0 0 0 0 12.600M16.300 3.700a9 9 0 0 1 0 12.600",
  record: "M10 15.500a5.500 5.500 0 1 0 0-11 5.500 5.500 0 0 0 0 11z",
  map: "M2.500 5.500 7.500 3.500l5 2 5-2v11l-5 2-5-2-5 2zM7.500 3.500v11M12.500 5.500v11",
  plus: "M10 4v12M4 10h12",
  export: "M10 12.500V3M6.500 6.500 10 3l3.500 3.500M3.500 12v4.500h13V12",
  upload: "M10 13V4M6.500 7.500 10 4l3.500 3.500M3.500 16.500h13",
  download: "M10 3.500v9M6.500 9 10 12.500 13.500 9M3.500 16.500h13",
  sun: "M10 13.500a3.500 3.500 0 1 0 0-7 3.500 3.500 0 0 0 0 7zM10 2v2M10 16v2M2 10h2M16 10h2M4.300 4.300l1.400 1.400M14.300 14.300l1.400 1.400M15.700 4.300l-1.400 1.400M5.700 14.300l-1.400 1.400",
  moon: "M16.500 11.800A7 7 0 0 1 8.200 3.500a7 7 0 1 0 8.300 8.300z",
  help: "M7.500 7.500a2.500 2.500 0 1 1 3.700 2.200c-.8.400-1.200 1-1.200 1.800M10 14.500v.01",
  close: "M5 5l10 10M15 5 5 15",
  list: "M7 5.500h10M7 10h10M7 14.500h10M3.500 5.500h.01M3.500 10h.01M3.500 14.500h.01",
  exit: "M8 3.500H4v13h4M12 6.500l3.500 3.500-3.500 3.500M15.500 10H8",
  film: "M3 4.500h14v11H3zM7 4.500v11M13 4.500v11M3 8h4M3 12h4M13 8h4M13 12h4",
  stop: "M5 5h10v10H5z",
  check: "M4 10.500l4 4 8-9",
  warning: "M10 3 2.500 16.500h15zM10 8v4M10 14.300v.01",
  search: "M9 14.500a5.500 5.500 0 1 0 0-11 5.500 5.500 0 0 0 0 11zM13 13l4 4",
} as const;

export type IconName = keyof typeof PATHS;

export function Icon({ name, filled = false }: { name: IconName; filled?: boolean }): JSX.Element {
  return (
    <svg class="icon" viewBox="0 0 20 20" width="18" height="18" aria-hidden="true" focusable="false">
      <path
        d={PATHS[name]}
        fill={filled ? "currentColor" : "none"}
        stroke="currentColor"
        stroke-width="1.5"
        stroke-linecap="round"
        stroke-linejoin="round"
      />
    </svg>
  );
}
