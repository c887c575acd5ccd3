// Builds the player's page: `node build.mjs [FOLDER]`. Without a folder it writes where the wheel takes it from.
import { cpSync, existsSync, mkdirSync, readFileSync, readdirSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { build } from "esbuild";

const here = dirname(fileURLToPath(import.meta.url));
const folder = process.argv[2] ?? join(here, "../decoder/viewing/page");

// Each is a bundle of its own: the page loads the player, the player starts the worker beside it.
const bundles = {
  "decogs-player": "src/element/index.ts",
  "decogs-worker": "src/worker/index.ts",
};

mkdirSync(folder, { recursive: true });
await build({
  entryPoints: Object.fromEntries(
    Object.entries(bundles)
      .map(([name, source]) => [name, join(here, source)])
      .filter(([, source]) => existsSync(source)),
  ),
  outdir: folder,
  bundle: true,
  // WebAssembly lies in files of its own, compiled while they come; the package carries its own as base64, half of all the
  // script there was.
  loader: { ".wasm": "file" },
  assetNames: "decogs-[name]",
  alias: { zstddec: join(here, "src/entropy/zstd_apart.ts") },
  format: "esm",
  target: "es2022",
  minify: true,
  legalComments: "inline",
  charset: "utf8",
});
const [, zstd] = /const wasm = "([A-Za-z0-9+/=]+)"/.exec(readFileSync(join(here, "node_modules/zstddec/dist/zstddec.mjs"), "utf8"));
writeFileSync(join(folder, "decogs-zstd.wasm"), Buffer.from(zstd, "base64"));
const statics = join(here, "static");
if (existsSync(statics)) {
  for (const name of readdirSync(statics)) cpSync(join(statics, name), join(folder, name));
}
