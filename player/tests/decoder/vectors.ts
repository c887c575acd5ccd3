/** The conformance streams of tests/conformance and the outcome of each (its README says what the members mean). */

import { readFileSync } from "node:fs";
import { join } from "node:path";

export interface ExpectedFrame {
  gaussians: number;
  digest: string;
  integers: string;
  floats: string;
  corrections?: Record<string, Record<string, number>>;
}

export interface Expected {
  frames: ExpectedFrame[];
  failure: { reason: string; packet: number | null; offset: number } | null;
  limits?: { payload_bytes: number; gaussians: number };
  indexes?: boolean[];
}

export const REPOSITORY = process.env["DECOGS_REPOSITORY"] ?? "..";
const FOLDER = join(REPOSITORY, "tests/conformance/1.0");

export const EXPECTED = JSON.parse(readFileSync(join(FOLDER, "expected.json"), "utf8")) as Record<string, Expected>;
export const GOOD = Object.keys(EXPECTED).filter((name) => EXPECTED[name].failure === null);

export function vector(name: string): Uint8Array {
  return new Uint8Array(readFileSync(join(FOLDER, `${name}.dgs`)));
}
