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
  presentation?: { title?: string; poster?: number; first_view?: string; transform?: number[][] };
}

export const REPOSITORY = process.env["DECOGS_REPOSITORY"] ?? "..";
const FILES = new Map(filesOf(readFileSync(join(REPOSITORY, "tests/conformance/1.0.tar"))));

export const EXPECTED = JSON.parse(new TextDecoder().decode(file("expected.json"))) as Record<string, Expected>;
export const GOOD = Object.keys(EXPECTED).filter((name) => EXPECTED[name].failure === null);

export function vector(name: string): Uint8Array {
  return file(`${name}.dgs`);
}

/** A copy, as of a file that was read: a test may hand its buffer to a worker. */
function file(name: string): Uint8Array {
  const found = FILES.get(`1.0/${name}`);
  if (found === undefined) throw new Error(`${name} is not in tests/conformance/1.0.tar`);
  return new Uint8Array(found);
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
