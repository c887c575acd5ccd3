// Builds the player's page: `node build.mjs [FOLDER]`. Without a folder it writes where the wheel takes it from.
// `node build.mjs --package` builds what the package @decogs/player holds, in `dist`, for bundlers to take apart.
import { execFileSync } from "node:child_process";
import { cpSync, mkdirSync, readFileSync, readdirSync, rmSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

const { build, transform } = await import("esbuild").catch(() => {
  console.error("build.mjs: the player's packages are missing; in player/, run npm ci");
  process.exit(2);
});

const here = dirname(fileURLToPath(import.meta.url));
const forPackage = process.argv[2] === "--package";
const folder = forPackage ? join(here, "dist") : (process.argv[2] ?? join(here, "../decoder/viewing/page"));

// Each is a bundle of its own, so that none waits for another: the page loads the player, which starts the worker beside it.
const bundles = {
  "decogs-player": "element/index.ts",
  "decogs-worker": "worker/index.ts",
  // What the sources import() comes when it is needed: controls behind the first picture, the others when they are asked for.
  "decogs-controls": "controls/index.ts",
  "decogs-recorded": "draw/recorded_pass.ts",
  "decogs-xr": "xr/show.ts",
  "decogs-crop": "controls/crop.ts",
  "decogs-sound": "sound/index.ts",
  ...(forPackage
    ? { "decogs-decoder": "decoder.ts", "decogs-three": "engine/three.ts", "decogs-playcanvas": "engine/playcanvas.ts", "decogs-exact": "exact/exact.wasm" }
    : { "decogs-exact": "worker/exact_pictures.ts", "decogs-ply": "export/ply.ts" }),
};

// Bundlers carry what is imported, and nothing else alike: so the package's scripts import the worker as a text that is one
// whole script, and WebAssembly as scripts that hold it. In the page both are files.
const late = {
  name: "late",
  setup({ onResolve }) {
    if (forPackage) onResolve({ filter: /\/worker_script$/ }, () => ({ path: "./decogs-worker.js", external: true }));
    onResolve({ filter: /^\./ }, ({ path, kind, importer, resolveDir }) => {
      if (kind !== "dynamic-import" || (forPackage && importer.startsWith(join(here, "src/worker")))) return null;
      const source = join(resolveDir, path);
      const found = Object.entries(bundles).find(([, file]) => [source, `${source}.ts`].includes(join(here, "src", file)));
      if (found) return { path: `./${found[0]}.js`, external: true };
      return path.endsWith(".wasm") ? null : { errors: [{ text: `${path} is no bundle of build.mjs` }] };
    });
  },
};

// zstd's WebAssembly, which its package holds as a text.
const zstd = {
  name: "zstd",
  setup({ onResolve, onLoad }) {
    onResolve({ filter: /\/zstd\.wasm$/ }, () => ({ path: "zstd.wasm", namespace: "zstd" }));
    onLoad({ filter: /.*/, namespace: "zstd" }, () => {
      const [, text] = /const wasm = "([A-Za-z0-9+/=]+)"/.exec(readFileSync(join(here, "node_modules/zstddec/dist/zstddec.mjs"), "utf8"));
      return { contents: Buffer.from(text, "base64"), loader: forPackage ? "binary" : "file" };
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

if (forPackage) rmSync(folder, { recursive: true, force: true }); // all that lies there is packed
mkdirSync(folder, { recursive: true });
const entry = (source) => join(here, "src", source);
const options = {
  bundle: true,
  plugins: [late, texts, zstd],
  external: ["three", "playcanvas"],
  loader: { ".wasm": forPackage ? "binary" : "file" },
  assetNames: "decogs-[name]",
  alias: { zstddec: entry("entropy/zstd_apart.ts") },
  format: "esm",
  target: "es2022",
  minify: true,
  legalComments: "inline",
  charset: "utf8",
  // Nothing of the package is asked for beside its scripts, which bundlers move.
  define: forPackage ? { "import.meta.url": '""' } : {},
};
if (forPackage) {
  const { "decogs-worker": worker } = bundles;
  delete bundles["decogs-worker"];
  // No module, which browsers take from no text in a sandboxed frame.
  const built = await build({ ...options, entryPoints: [entry(worker)], format: "iife", write: false });
  writeFileSync(join(folder, "decogs-worker.js"), `export const address = null;\nexport const text = ${JSON.stringify(built.outputFiles[0].text)};\n`);
}
await build({ ...options, entryPoints: Object.fromEntries(Object.entries(bundles).map(([name, source]) => [name, entry(source)])), outdir: folder });
const statics = join(here, "static");
if (forPackage) {
  cpSync(join(statics, "licences.txt"), join(folder, "licences.txt"));
  cpSync(join(here, "../LICENSE"), join(here, "LICENSE"));
  writeTypes(join(folder, "types"));
} else {
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
