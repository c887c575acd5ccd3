// Runs the browser tests: node tests/browser/run.mjs DATA [PART_OF_A_NAME ...], DATA as tests/player/browser_data.py wrote it.
import { spawnSync } from "node:child_process";
import { mkdtempSync, readdirSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { dirname, join, resolve } from "node:path";
import { fileURLToPath } from "node:url";
import { chromiumPath } from "./chromium.mjs";

const here = dirname(fileURLToPath(import.meta.url));
const [data, ...parts] = process.argv.slice(2);
if (chromiumPath === undefined) {
  console.error("Chromium is not installed (DECOGS_CHROMIUM names another place)");
  process.exit(77);
}
const page = mkdtempSync(join(tmpdir(), "decogs-page-"));
let status = 1;
try {
  const run = (script, ...rest) =>
    spawnSync(process.execPath, [script, ...rest], {
      stdio: "inherit",
      env: { ...process.env, DECOGS_PAGE: page, DECOGS_BROWSER_DATA: resolve(data) },
    }).status ?? 1;
  status = run(join(here, "../../build.mjs"), page);
  const tests = readdirSync(here).filter((name) => name.endsWith(".test.mjs"));
  const wanted = tests.filter((name) => parts.length === 0 || parts.some((part) => name.includes(part)));
  if (status === 0) status = run("--experimental-websocket", "--test", "--test-concurrency=1", "--test-timeout=300000", ...wanted.map((name) => join(here, name)));
} finally {
  rmSync(page, { recursive: true, force: true });
}
process.exit(status);
