// SPDX-License-Identifier: Apache-2.0
// align.json: {"scale":s,"rotation_wxyz":[w,x,y,z],"translation":[x,y,z]}.

export interface Similarity {
  scale: number;
  rotation: { w: number; x: number; y: number; z: number };
  translation: { x: number; y: number; z: number };
}

function numbers(value: unknown, count: number, field: string): number[] {
  if (!Array.isArray(value) || value.length !== count || !value.every((v) => typeof v === "number" && Number.isFinite(v))) {
    throw new Error(`align.json: ${field} must be ${count} numbers`);
  }
  return value as number[];
}

// Throws an Error that names the field.
export function parseAlignJson(text: string): Similarity {
  let json: unknown;
  try {
    json = JSON.parse(text);
  } catch {
    throw new Error("align.json is not JSON");
  }
  if (typeof json !== "object" || json === null) throw new Error("align.json holds no object");
  const fields = json as Record<string, unknown>;
  const scale = fields.scale;
  if (typeof scale !== "number" || !(scale > 0)) throw new Error("align.json: scale must be above 0");
  const [w, x, y, z] = numbers(fields.rotation_wxyz, 4, "rotation_wxyz") as [number, number, number, number];
  if (Math.abs(Math.hypot(w, x, y, z) - 1) > 1e-3) throw new Error("align.json: rotation_wxyz must have length 1");
  const [tx, ty, tz] = numbers(fields.translation, 3, "translation") as [number, number, number];
  return { scale, rotation: { w, x, y, z }, translation: { x: tx, y: ty, z: tz } };
}
