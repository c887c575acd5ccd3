// Builds the page with the stand-in in place of the decoder: node tests/stand_in/build.mjs FOLDER
import { cpSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { build } from "esbuild";

const here = dirname(fileURLToPath(import.meta.url));
const source = join(here, "../../src");
const folder = process.argv[2];
await build({
  entryPoints: { "decogs-player": join(source, "element/index.ts"), "decogs-worker": join(source, "worker/index.ts") },
  outdir: folder,
  bundle: true,
  format: "esm",
  target: "es2022",
  plugins: [
    {
      name: "stand-in",
      setup: (build) => build.onResolve({ filter: /\/stream\/index$/ }, () => ({ path: join(here, "stream.ts") })),
    },
  ],
});
cpSync(join(here, "../../static/index.html"), join(folder, "index.html"));
