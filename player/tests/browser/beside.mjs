// Beside Spark and PlayCanvas: the same splats, camera and size, pictures a second while the camera circles, in turn, in software.
//   node tests/browser/beside.mjs PAGE ROUNDS STREAM.dgs ...     medians as JSON lines
import { mkdtempSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { basename, dirname, join, resolve } from "node:path";
import { fileURLToPath } from "node:url";
import { build } from "esbuild";
import { chromiumPath, launched } from "./chromium.mjs";
import { served } from "./server.mjs";

const [page, rounds, ...streams] = process.argv.slice(2);
const skip = (reason) => {
  console.error(reason);
  process.exit(77);
};
if (chromiumPath === undefined) skip("Chromium is not installed (DECOGS_CHROMIUM names another place)");
for (const name of ["three", "@sparkjsdev/spark", "playcanvas"]) {
  try {
    import.meta.resolve(name);
  } catch {
    skip(`${name} is missing (npm ci in player/)`);
  }
}
const median = (values) => [...values].sort((a, b) => a - b)[values.length >> 1];

const folder = mkdtempSync(join(tmpdir(), "decogs-beside-"));
const entry = join(dirname(fileURLToPath(import.meta.url)), "beside_page.mjs");
await build({ entryPoints: [entry], outfile: join(folder, "beside.js"), bundle: true, format: "esm", logLevel: "error" });
const browser = await launched();
try {
  for (const stream of streams) {
    const server = await served({ page: resolve(page), beside: folder, data: dirname(resolve(stream)) });
    const runs = [];
    for (let round = 0; round < Number(rounds); round++) {
      for (const who of ["decogs, WebGL2", "decogs, as it chooses", "Spark", "PlayCanvas"]) {
        const context = await browser.newContext({ viewport: { width: 640, height: 480 } });
        const tab = await context.newPage();
        tab.on("pageerror", (error) => console.error(who, String(error)));
        await tab.goto(`${server.address}/page/index.html?src=/data/${basename(stream)}`);
        await tab.waitForFunction(() => document.querySelector("decogs-player")?.info != null, null, { timeout: 120_000 });
        await tab.addScriptTag({ type: "module", url: "/beside/beside.js" });
        await tab.waitForFunction(() => globalThis.measured !== undefined);
        runs.push({ who, ...(await tab.evaluate((who) => globalThis.measured(who, 480, 272), who)) });
        await context.close();
      }
    }
    await server.close();
    for (const who of new Set(runs.map((run) => run.who))) {
      const own = runs.filter((run) => run.who === who);
      console.log(JSON.stringify({ stream: basename(stream), who, gaussians: own[0].gaussians, pictures: median(own.map((run) => run.pictures)), likeOurs: own[0].likeOurs }));
    }
  }
} finally {
  await browser.close();
  rmSync(folder, { recursive: true, force: true });
}
