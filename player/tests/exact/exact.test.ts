/**
 * The exact picture against the native kernel: equal, bit for bit. tests/player/test_exact_picture.py draws the pictures
 * natively, writes them into a folder and runs this with DECOGS_EXACT_CASES naming it.
 */
import assert from "node:assert/strict";
import { readdirSync, readFileSync } from "node:fs";
import { join } from "node:path";
import { before, suite, test } from "node:test";
import { asSeen, recordedPixels } from "../../src/exact/recorded";
import { ExactError, ExactRenderer } from "../../src/exact/renderer";
import type { PinholeCamera } from "../../src/geometry/camera";
import type { Gaussians, StreamHeader } from "../../src/scene";

interface Case {
  readonly count: number;
  readonly shDegree: number;
  readonly camera: PinholeCamera;
  readonly background: readonly number[];
}

const repository = process.env["DECOGS_REPOSITORY"]!;
const folder = process.env["DECOGS_EXACT_CASES"];
const camera: PinholeCamera = {
  width: 64,
  height: 48,
  fx: 60,
  fy: 60,
  cx: 32,
  cy: 24,
  worldToCamera: [
    [1, 0, 0, 0],
    [0, 1, 0, 0],
    [0, 0, 1, 0],
  ],
  near: 0.01,
};

let exact: ExactRenderer;
before(async () => {
  exact = await ExactRenderer.load(readFileSync(join(repository, "player/src/exact/exact.wasm")));
});

/** So many opaque grey Gaussians of this size, 2 before the camera. */
function alike(count: number, logScale: number, behind = 0): Gaussians {
  return {
    count,
    means: Float32Array.from({ length: 3 * count }, (_, at) => (at % 3 === 2 ? 2 + behind : 0)),
    logScales: new Float32Array(3 * count).fill(logScale),
    quaternions: Float32Array.from({ length: 4 * count }, (_, at) => (at % 4 === 0 ? 1 : 0)),
    opacityLogits: new Float32Array(count).fill(8),
    sh: new Float32Array(3 * count),
    order: null,
  };
}

function floats(name: string): Float32Array {
  const bytes = readFileSync(name);
  return new Float32Array(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength));
}

/** The same bits; NaN and the sign of zero count. */
function assertSame(drawn: Float32Array, expected: Float32Array, what: string): void {
  const bits = [drawn, expected].map((values) => new Uint32Array(values.buffer, values.byteOffset, values.length));
  assert.equal(drawn.length, expected.length, what);
  const first = bits[0].findIndex((value, at) => value !== bits[1][at]);
  assert.equal(first, -1, `${what}: value ${first} is ${drawn[first]}, natively ${expected[first]}`);
}

suite("the native kernel's pictures", { skip: folder === undefined && "pytest tests/player writes them" }, () => {
  const names = folder === undefined ? [] : readdirSync(folder).filter((name) => name.endsWith(".json"));
  for (const name of names) {
    test(name, () => {
      const path = join(folder!, name.replace(/\.json$/, ""));
      const { count, shDegree, camera, background } = JSON.parse(readFileSync(`${path}.json`, "utf8")) as Case;
      const values = floats(`${path}.scene`);
      let at = 0;
      const take = (each: number) => values.subarray(at, (at += each * count));
      const gaussians = {
        count,
        means: take(3),
        logScales: take(3),
        quaternions: take(4),
        opacityLogits: take(1),
        sh: take(3 * (shDegree + 1) ** 2),
        order: null,
      };
      assert.equal(at, values.length);
      const planes = exact.planes(gaussians, shDegree, camera, background);
      const plane = camera.width * camera.height;
      const expected = floats(`${path}.planes`);
      assertSame(planes.rgb, expected.subarray(0, 3 * plane), "colour");
      assertSame(planes.alpha, expected.subarray(3 * plane, 4 * plane), "alpha");
      assertSame(planes.depth, expected.subarray(4 * plane), "depth");
      const pixels = exact.draw(gaussians, shDegree, camera, background);
      assert.deepEqual(Buffer.from(pixels.buffer), readFileSync(`${path}.pixels`));
      const subject = { shDegree, background, subject: true } as unknown as StreamHeader;
      const straight = recordedPixels(exact, gaussians, subject, camera, asSeen(camera));
      assert.deepEqual(Buffer.from(straight.buffer), readFileSync(`${path}.straight`));
    });
  }
});

test("a scene of nothing is the background", () => {
  const pixels = exact.draw(alike(0, 0), 0, camera, [1, 0.5, 0]);
  assert.deepEqual([...pixels.subarray(0, 4)], [255, 128, 0, 255]);
  assert.equal(pixels.length, 4 * 64 * 48);
});

test("Gaussians are taken in the stream's order, wherever the decoder keeps them", () => {
  const scene = alike(2, -1);
  scene.sh.set([1, 1, 1], 0);
  const middle = 4 * (24 * 64 + 32);
  const first = (order: Uint32Array | null) => exact.draw({ ...scene, order }, 0, camera, [0, 0, 0])[middle];
  const [bright, grey] = [first(Uint32Array.of(0, 1)), first(Uint32Array.of(1, 0))];
  assert.equal(first(null), bright);
  assert.ok(bright > grey + 50);
});

test("a picture that is covered too many times is refused, and the next one drawn", () => {
  const large = { ...camera, width: 4096, height: 4096, fx: 4000, fy: 4000, cx: 2048, cy: 2048 };
  assert.throws(() => exact.draw(alike(400, 5, 300), 0, large, [0, 0, 0]), {
    name: "ExactError",
    message: /covered too many times/,
  });
  const middle = 4 * (24 * 64 + 32);
  const next = exact.draw(alike(1, -1), 0, camera, [0, 0, 0]);
  assert.deepEqual([...next.subarray(middle, middle + 4)], [126, 126, 126, 255]);
});

test("a picture of no or of too many pixels is refused", () => {
  for (const size of [{ width: 0 }, { width: 100_000, height: 100_000 }, { height: NaN }]) {
    assert.throws(() => exact.draw(alike(1, -1), 0, { ...camera, ...size }, [0, 0, 0]), ExactError);
  }
});

test("what the compiled kernel weighs", () => {
  const bytes = readFileSync(join(repository, "player/src/exact/exact.wasm"));
  assert.ok(bytes.length < 70_000, `${bytes.length} bytes`);
});
