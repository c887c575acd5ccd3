// Builds the player's page: `node build.mjs [FOLDER]`. Without a folder it writes where the wheel takes it from.
// `node build.mjs --package` builds what the package @decogs/player holds, in `dist`, for bundlers to take apart.
import { execFileSync } from "node:child_process";
import { cpSync, mkdirSync, readFileSync, readdirSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { build, transform } from "esbuild";

const here = dirname(fileURLToPath(import.meta.url));
const forPackage = process.argv[2] === "--package";
const folder = forPackage ? join(here, "dist") : (process.argv[2] ?? join(here, "../decoder/viewing/page"));

// Each is a bundle of its own, so that none waits for another: the page loads the player, which starts the worker beside it.
const bundles = {
  "decogs-player": "element/index",
  "decogs-worker": "worker/index",
  // What the sources import() comes when it is needed: controls behind the first picture, the others when they are asked for.
  "decogs-controls": "controls/index",
  "decogs-recorded": "draw/recorded_pass",
  "decogs-xr": "xr/show",
  "decogs-crop": "controls/crop",
  "decogs-sound": "sound/index",
  // A worker of several files, or WebAssembly beside it, is more than bundlers can be trusted with.
  ...(forPackage ? { "decogs-decoder": "decoder", "decogs-three": "engine/three", "decogs-playcanvas": "engine/playcanvas" } : { "decogs-exact": "worker/exact_pictures", "decogs-ply": "export/ply" }),
};

const late = {
  name: "late",
  setup({ onResolve }) {
    onResolve({ filter: /^\./ }, ({ path, kind, resolveDir }) => {
      if (kind !== "dynamic-import") return null;
      const found = Object.entries(bundles).find(([, source]) => join(here, "src", source) === join(resolveDir, path));
      if (forPackage && !found) return null;
      return found ? { path: `./${found[0]}.js`, external: true } : { errors: [{ text: `${path} is no bundle of build.mjs` }] };
    });
  },
};

// Shaders and style sheets without what is there for their readers.
const texts = {
  name: "texts",
  setup({ onLoad }) {
    onLoad({ filter: /shaders?\.ts$/ }, ({ path }) => {
      const lines = readFileSync(path, "utf8").split("\n").map((line) => line.trim());
      return { loader: "ts", contents: lines.filter((line) => line !== "" && !line.startsWith("//")).join("\n") };
    });
    onLoad({ filter: /\.css$/ }, async ({ path }) => {
      const { code } = await transform(readFileSync(path, "utf8"), { loader: "css", minify: true, target: "es2022" });
      return { loader: "text", contents: code.trim() };
    });
  },
};

mkdirSync(folder, { recursive: true });
await build({
  entryPoints: Object.fromEntries(Object.entries(bundles).map(([name, source]) => [name, join(here, "src", `${source}.ts`)])),
  outdir: folder,
  bundle: true,
  plugins: [late, texts],
  external: ["three", "playcanvas"],
  // WebAssembly lies in files of its own, compiled while they come; the package carries its own as base64, half of all the
  // script there was.
  loader: { ".wasm": forPackage ? "binary" : "file" },
  assetNames: "decogs-[name]",
  alias: forPackage ? {} : { zstddec: join(here, "src/entropy/zstd_apart.ts") },
  format: "esm",
  target: "es2022",
  minify: true,
  legalComments: "inline",
  charset: "utf8",
});
const statics = join(here, "static");
if (forPackage) {
  cpSync(join(here, "../decoder/viewing/page/decogs-exact.wasm"), join(folder, "decogs-exact.wasm"));
  cpSync(join(statics, "licences.txt"), join(folder, "licences.txt"));
  cpSync(join(here, "../LICENSE"), join(here, "LICENSE"));
  writeTypes(join(folder, "types"));
} else {
  const [, zstd] = /const wasm = "([A-Za-z0-9+/=]+)"/.exec(readFileSync(join(here, "node_modules/zstddec/dist/zstddec.mjs"), "utf8"));
  writeFileSync(join(folder, "decogs-zstd.wasm"), Buffer.from(zstd, "base64"));
  for (const name of readdirSync(statics)) cpSync(join(statics, name), join(folder, name));
}

/** Declarations, with the endings that Node's way of finding modules wants. */
function writeTypes(folder) {
  const entries = ["src/element/index.ts", "src/decoder.ts", "src/engine/three.ts", "src/engine/playcanvas.ts", "src/imports.d.ts"];
  const options = ["--ignoreConfig", "--declaration", "--emitDeclarationOnly", "--outDir", folder, "--rootDir", "src", "--skipLibCheck", "--strict", "--types", "webxr"];
  const language = ["--target", "es2022", "--module", "es2022", "--moduleResolution", "bundler", "--lib", "es2022,dom,dom.iterable,webworker"];
  execFileSync(process.execPath, [join(here, "node_modules/typescript/bin/tsc"), ...entries, ...options, ...language], { cwd: here, stdio: "inherit" });
  for (const name of readdirSync(folder, { recursive: true }).filter((each) => each.endsWith(".d.ts"))) {
    const path = join(folder, name);
    writeFileSync(path, readFileSync(path, "utf8").replace(/((?:from|import\() ?"\.[^"]*?)"/g, '$1.js"'));
  }
}
