/** Every conformance stream decodes to its states; every damaged one ends with its reason code, in its packet. */

import assert from "node:assert/strict";
import { before, test } from "node:test";
import { REASONS } from "../../src/container/errors";
import { DEFAULT_LIMITS } from "../../src/container/limits";
import { startZstd } from "../../src/entropy/zstd";
import { readInOrder } from "./inOrder";
import type { Presentation } from "../../src/scene";
import { EXPECTED, vector, type Expected } from "./vectors";

before(startZstd);

for (const [name, expected] of Object.entries(EXPECTED)) {
  test(name, () => {
    const { limits, failure } = expected;
    const data = vector(name);
    const outcome = readInOrder(
      data,
      limits ? { payloadBytes: limits.payload_bytes, gaussians: limits.gaussians } : DEFAULT_LIMITS,
    );
    assert.equal(outcome.failure?.reason ?? null, failure?.reason ?? null, outcome.failure?.message);
    assert.equal(outcome.failure?.packet ?? null, failure?.packet ?? null);
    assert.deepEqual(outcome.frames, expected.frames);
    assert.deepEqual(outcome.indexes, expected.indexes ?? []);
    if (outcome.header !== null) checkPresentation(outcome.header.presentation, expected.presentation ?? {});
    if (failure !== null) assert.equal(outcome.failure?.offset, failure.offset);
  });
}

function checkPresentation({ title, poster, firstView, transform }: Presentation, told: NonNullable<Expected["presentation"]>): void {
  assert.deepEqual([title, poster, firstView], [told.title ?? "", told.poster ?? null, told.first_view ?? null]);
  const rows = transform?.rotation.map((row, i) => [...row.map((value) => value * transform.scale), transform.shift[i]]);
  assert.equal(rows === undefined, told.transform === undefined);
  // A factor is divided out and multiplied again.
  rows?.flat().forEach((value, i) => {
    assert.ok(Math.abs(value - told.transform!.flat()[i]) <= 1e-15 * transform!.scale);
  });
}

test("the vectors have every reason code", () => {
  const found = new Set(Object.values(EXPECTED).map(({ failure }) => failure?.reason));
  for (const reason of REASONS) assert.ok(found.has(reason), reason);
});
