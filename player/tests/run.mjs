// Runs the unit tests under Node: bundles every tests/**/*.test.ts and hands them to Node's own runner.
//   node tests/run.mjs [PART_OF_A_NAME ...]
import { spawnSync } from "node:child_process";
import { mkdtempSync, readdirSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { build } from "esbuild";

const here = dirname(fileURLToPath(import.meta.url));
const wanted = process.argv.slice(2);
const sources = readdirSync(here, { recursive: true })
  .filter((name) => name.endsWith(".test.ts"))
  .filter((name) => wanted.length === 0 || wanted.some((part) => name.includes(part)));
const folder = mkdtempSync(join(tmpdir(), "decogs-player-"));
let status = 1;
try {
  await build({
    entryPoints: sources.map((name) => join(here, name)),
    outdir: folder,
    outbase: here,
    outExtension: { ".js": ".mjs" },
    bundle: true,
    loader: { ".wasm": "binary", ".css": "text" },
    format: "esm",
    platform: "node",
    target: "node20",
    sourcemap: "inline",
  });
  const built = sources.map((name) => join(folder, name.replace(/\.ts$/, ".mjs")));
  // Tests find the repository's files by this, not by where their bundle lies.
  const env = { ...process.env, DECOGS_REPOSITORY: join(here, "../..") };
  status = spawnSync(process.execPath, ["--enable-source-maps", "--test", ...built], { stdio: "inherit", env }).status ?? 1;
} finally {
  rmSync(folder, { recursive: true, force: true });
}
process.exit(status);
