// Times the decoder in Node, on one core: node tests/bench.mjs STREAM.dgs [...]
import { mkdtempSync, readFileSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { basename, dirname, join } from "node:path";
import { fileURLToPath, pathToFileURL } from "node:url";
import { build } from "esbuild";

const ROUNDS = 5;
const here = dirname(fileURLToPath(import.meta.url));
const folder = mkdtempSync(join(tmpdir(), "decogs-player-"));

const median = (values) => [...values].sort((a, b) => a - b)[values.length >> 1];

/** Of the processor, all threads of this process: what others do beside it counts less. */
function processorTime() {
  const { user, system } = process.cpuUsage();
  return (user + system) / 1000;
}

async function timed(work) {
  const start = performance.now();
  const result = await work();
  return [performance.now() - start, result];
}

async function bench(path, createStream) {
  const bytes = new Uint8Array(readFileSync(path));
  const [opening, stream] = await timed(() => createStream(bytes));
  const [first, { gaussians }] = await timed(() => stream.frame(0));
  await stream.prefetch(0);
  const taken = { key: [], delta: [], skip: [] };
  const processor = [];
  let changed = 0;
  for (let frame = 1; frame < stream.frames.length; frame++) {
    const before = processorTime();
    const [ms, { kind, changedRows }] = await timed(() => stream.frame(frame));
    taken[kind].push(ms);
    if (kind !== "delta") continue;
    processor.push(processorTime() - before);
    changed += changedRows.length / gaussians.count;
  }
  const keys = [...stream.frames.keys()].filter((frame) => stream.frames[frame].kind === "key");
  const seeks = [];
  for (let round = 0; round < ROUNDS; round++) {
    for (const key of [...keys].reverse()) {
      await stream.frame(Math.min(key + 1, stream.frames.length - 1));
      seeks.push((await timed(() => stream.frame(key)))[0]);
    }
  }
  const row = {
    stream: basename(path),
    gaussians: gaussians.count,
    changing: taken.delta.length ? `${((100 * changed) / taken.delta.length).toFixed(1)} %` : "",
    "open ms": opening.toFixed(1),
    "first frame ms": first.toFixed(1),
    "delta ms": taken.delta.length ? median(taken.delta).toFixed(2) : "",
    least: taken.delta.length ? Math.min(...taken.delta).toFixed(2) : "",
    "of processor": taken.delta.length ? median(processor).toFixed(2) : "",
    "seek to a key ms": median(seeks).toFixed(1),
  };
  stream.close();
  return row;
}

try {
  const built = join(folder, "stream.mjs");
  const entry = join(here, "../src/stream/index.ts");
  await build({ entryPoints: [entry], outfile: built, bundle: true, format: "esm", platform: "node", target: "node20", loader: { ".wasm": "binary" }, logLevel: "error" });
  const { createStream } = await import(pathToFileURL(built));
  for (const path of process.argv.slice(2)) console.table([await bench(path, createStream)]);
} finally {
  rmSync(folder, { recursive: true, force: true });
}
