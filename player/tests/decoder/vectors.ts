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
  /** Of each layer above the base: frames with it and those below, and the reason with which they end. */
  layers?: { frames: ExpectedFrame[][]; failure: string | null };
  profiles?: string[];
  presentation?: { title?: string; poster?: number; first_view?: string; transform?: number[][] };
}

export const REPOSITORY = process.env["DECOGS_REPOSITORY"] ?? "..";
const VERSIONS = ["1.0", "1.1"];
const FILES = new Map(VERSIONS.flatMap((version) => [...filesOf(readFileSync(join(REPOSITORY, `tests/conformance/${version}.tar`)))]));

export const EXPECTED = Object.fromEntries(
  VERSIONS.flatMap((version) => Object.entries(JSON.parse(new TextDecoder().decode(FILES.get(`${version}/expected.json`))) as Record<string, Expected>)),
);
export const GOOD = Object.keys(EXPECTED).filter((name) => EXPECTED[name].failure === null);

/** A copy, as of a file that was read: a test may hand its buffer to a worker. */
export function vector(name: string): Uint8Array {
  const found = VERSIONS.map((version) => FILES.get(`${version}/${name}.dgs`)).find((data) => data !== undefined);
  if (found === undefined) throw new Error(`${name} is in no archive of tests/conformance`);
  return new Uint8Array(found);
}

/** What this player shows: two layers as far as they are good, else the base. */
export function shownFrames({ frames, layers }: Expected): ExpectedFrame[] {
  const whole = layers?.frames.length === 1 ? layers.frames[0] : [];
  return [...whole, ...frames.slice(whole.length)];
}

/** The files of a USTAR archive of short names: blocks of 512 bytes, a head before each file, zeros at the end. */
function* filesOf(tar: Uint8Array): Generator<[string, Uint8Array]> {
  const text = (start: number, length: number): string =>
    new TextDecoder().decode(tar.subarray(start, start + length)).split("\0")[0];
  for (let at = 0; tar[at] !== 0; ) {
    const size = parseInt(text(at + 124, 12), 8);
    yield [text(at, 100), tar.subarray(at + 512, at + 512 + size)];
    at += 512 + 512 * Math.ceil(size / 512);
  }
}
