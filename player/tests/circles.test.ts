/** Circles of imports are found, whatever they are made of. */
import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { mkdirSync, mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { test } from "node:test";

/** What the check says of such files; the empty text: it lets them pass. */
function complaints(files: Readonly<Record<string, string>>): string {
  const folder = mkdtempSync(join(tmpdir(), "decogs-circles-"));
  try {
    for (const [name, text] of Object.entries(files)) {
      mkdirSync(join(folder, dirname(name)), { recursive: true });
      writeFileSync(join(folder, name), text);
    }
    const { status, stderr } = spawnSync(process.execPath, [join(process.env.DECOGS_REPOSITORY!, "player/circles.mjs"), folder], { encoding: "utf8" });
    assert.equal(status, stderr === "" ? 0 : 1, stderr);
    return stderr;
  } finally {
    rmSync(folder, { recursive: true });
  }
}

test("files that import each other are named, types and late scripts among them", () => {
  const line = { "a.ts": 'import { b } from "./b";', "b.ts": 'import type { C } from "./in/c";', "in/c.ts": "export type C = 1;" };
  assert.equal(complaints(line), "");
  for (const back of ['import { a } from "../a";', 'import type { A } from "../a";', 'export { a } from "../a";', 'const a = await import("../a");']) {
    assert.match(complaints({ ...line, "in/c.ts": back }), /^files .*: a\.ts -> b\.ts -> in\/c\.ts -> a\.ts; /);
  }
});

test("folders that import each other are, too, where no file does; packages of a file's name are none", () => {
  const files = { "one/a.ts": 'import "../two/b";', "two/b.ts": "", "two/c.ts": "", "one/d.ts": 'import "d";' };
  assert.equal(complaints(files), "");
  assert.match(complaints({ ...files, "two/c.ts": 'import "../one/d";' }), /^folders .*: one -> two -> one; /);
});
