/** The rule of formats/geometry/up_direction.py and the point of decoder/cameras/moves.py: same inputs, same outputs. */
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { lookedAt } from "../../src/camera/looked_at";
import { upOf } from "../../src/camera/up_direction";
import { poseOf } from "../../src/geometry/poses";

interface Case {
  name: string;
  up: number[];
  /** null where there is no such point: then the player takes one before the camera. */
  looked_at: number[] | null;
  cameras: number[][][];
}

const file = join(process.env.DECOGS_REPOSITORY!, "player/tests/camera/up_cases.json");
for (const { name, up, looked_at, cameras } of JSON.parse(readFileSync(file, "utf8")) as Case[]) {
  const posed = cameras.map((worldToCamera) => ({ worldToCamera }));
  test(`up: ${name}`, () => {
    near(upOf(posed), up, 1e-7);
  });
  test(`looked at: ${name}`, () => {
    if (looked_at === null) assert.ok(lookedAt(posed.map(poseOf)).every(Number.isFinite));
    else near(lookedAt(posed.map(poseOf)), looked_at, 1e-6);
  });
}

function near(found: readonly number[], expected: readonly number[], tolerance: number): void {
  found.forEach((value, i) => {
    assert.ok(Math.abs(value - expected[i]) < tolerance, `${found.join(", ")} is not ${expected.join(", ")}`);
  });
}
