// Finds imports that go round, between files and between folders, types among them: `node circles.mjs [FOLDER]`. Exit code 1 where there are any.
import { readFileSync, readdirSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import ts from "typescript";

const folder = process.argv[2] ?? join(dirname(fileURLToPath(import.meta.url)), "src");
const files = new Set(readdirSync(folder, { recursive: true }).filter((name) => name.endsWith(".ts")));

/** The files of the folder that one of them imports. */
function importsOf(file) {
  const { importedFiles } = ts.preProcessFile(readFileSync(join(folder, file), "utf8"), true, true);
  const own = importedFiles.filter(({ fileName }) => fileName.startsWith("."));
  return own.map(({ fileName }) => `${join(dirname(file), fileName)}.ts`).filter((path) => files.has(path));
}

const byFile = new Map([...files].map((file) => [file, importsOf(file)]));
const byFolder = new Map();
for (const [file, imports] of byFile) {
  const others = imports.map(dirname).filter((other) => other !== dirname(file) && other !== "."); // files beside the folders are nobody's
  if (dirname(file) !== ".") byFolder.set(dirname(file), [...(byFolder.get(dirname(file)) ?? []), ...others]);
}

/** The names of a way that ends where it began; null where there is none. */
function circleIn(graph) {
  const done = new Set();
  const walk = (way, name) => {
    if (way.includes(name)) return [...way.slice(way.indexOf(name)), name];
    if (done.has(name)) return null;
    for (const next of graph.get(name) ?? []) {
      const circle = walk([...way, name], next);
      if (circle !== null) return circle;
    }
    done.add(name);
    return null;
  };
  for (const name of graph.keys()) {
    const circle = walk([], name);
    if (circle !== null) return circle;
  }
  return null;
}

for (const [what, graph] of [["files", byFile], ["folders", byFolder]]) {
  const circle = circleIn(graph);
  if (circle === null) continue;
  console.error(`${what} of ${folder} import each other: ${circle.join(" -> ")}; move what both need into a third`);
  process.exitCode = 1;
}
