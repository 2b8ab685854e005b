// SPDX-License-Identifier: Apache-2.0
// How wide images should come for the width at which they are shown, both in
// pixels of the screen. In steps, so that small changes of a window change
// nothing; a little enlargement is not seen.

const ENLARGED = 1.1;
const STEP_PX = 64;

export function wantedImageWidth(shownPx: number): number {
  return STEP_PX * Math.ceil(shownPx / ENLARGED / STEP_PX);
}
