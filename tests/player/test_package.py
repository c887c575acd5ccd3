"""The package @decogs/player: what `npm pack` makes of it, in a project of somebody else's; and its table of members.

Needs Node, npm and its registry, and for playing Chromium.
"""

from __future__ import annotations

import gzip
import json
import re
import shutil
import socket
import subprocess
import tarfile
from pathlib import Path

import pytest

import decogs
from node import PLAYER, node

TOOLS = {
    "vite": "8.3.8",
    "webpack": "5.113.0",
    "webpack-cli": "7.3.1",
    "rollup": "4.68.8",
    "@rollup/plugin-node-resolve": "16.0.3",
    "esbuild": "0.28.2",
    "typescript": "6.0.3",
    "react": "19.2.0",
    "@types/react": "19.2.2",
}
ENGINES = ("three", "@types/three", "playcanvas")
"""Those that player/ has itself."""
NO_CHROMIUM = 3
MOST_FIRST_BYTES = 110_000
"""Of what leads to the first picture and plays, gzipped: player, worker, and their WebAssembly."""

MAIN = """
import { DecogsPlayer, type PlayerEvent } from "@decogs/player";
import { createFrameSource } from "@decogs/player/decoder";

const player: DecogsPlayer = document.querySelector("decogs-player")!;
const late: PlayerEvent = "waiting";
player.addEventListener(late, () => console.log(player.buffered.length, player.readyState));
const sentence: string | null = player.error;
player.lookFrom(player.view?.pose ?? { axes: [[1, 0, 0], [0, 1, 0], [0, 0, 1]], centre: [0, 0, 0] }, player.view!.lens);
const [vertex] = await (await createFrameSource("scene.dgs")).getFrame(0);
export const told: [string | null, number] = [sentence, vertex.count];
"""
IN_ENGINES = """
import { DecogsObject } from "@decogs/player/three";
import { DecogsEntity } from "@decogs/player/playcanvas";
import { Application, Entity } from "playcanvas";
import { Scene } from "three";

const object = new DecogsObject("scene.dgs", { loop: true });
new Scene().add(object);
object.position.set(0, 1, 0);
const time: number = object.player.currentTime;
const application = new Application(document.querySelector("canvas")!);
const drawn = new DecogsEntity(application, new Entity(), "scene.dgs", { autoplay: true, layer: 0 });
export const told: [number, boolean] = [time, drawn.player.paused];
"""
WRONG = 'import { DecogsPlayer } from "@decogs/player";\nexport const wrong: number = new DecogsPlayer().src;\n'
PAGE = """<!doctype html><html><head><meta charset="utf-8"><link rel="icon" href="data:,"></head>
<body><decogs-player src="scene.dgs" controls></decogs-player>
<script type="module" src="SCRIPT"></script></body></html>"""
SCRIPT = """
import "@decogs/player";
import { createFrameSource } from "@decogs/player/decoder";
import { DecogsObject } from "@decogs/player/three";
import { PerspectiveCamera, Scene, WebGLRenderer } from "three";

const exact = new URLSearchParams(location.search).get("exact");
createFrameSource("scene.dgs").then(
  async (source) => (globalThis.decoded = (await source.getFrame(0))[0].count > 0),
  (error) => (globalThis.decoded = error.message),
);
if (exact) document.querySelector("decogs-player").setAttribute("exact", exact);
if (document.createElement("canvas").getContext("webgl2")) {
  const renderer = new WebGLRenderer();
  const object = new DecogsObject("scene.dgs");
  const scene = new Scene().add(object);
  const camera = new PerspectiveCamera();
  renderer.setAnimationLoop(() => renderer.render(scene, camera));
  globalThis.inScene = object.player;
}
"""
BUNDLERS = {
    "vite": ["vite", "build", "--outDir", "built/vite"],
    "webpack": ["webpack", "./main.js", "--mode", "production", "-o", "built/webpack"],
    "rollup": ["rollup", "main.js", "-p", "node-resolve", "-d", "built/rollup"],
    "esbuild": ["esbuild", "main.js", "--bundle", "--outdir=built/esbuild"],
    "esbuild, split": [
        "esbuild",
        "main.js",
        "--bundle",
        "--splitting",
        "--format=esm",
        "--outdir=built/esbuild, split",
    ],
}
"""The commands of four, with what they do by themselves."""
PLAYED = {"frame": 0, "error": None, "decoded": True, "drawn": True, "complaints": []}
EACH_WAY = {
    "chosen": PLAYED | {"exact": True, "inScene": 0},
    "webgl2": PLAYED | {"exact": False, "inScene": 0},
    "no webgl": PLAYED | {"exact": True},
}


def ran(*command: str, cwd: Path, timeout: int = 300) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False, timeout=timeout)


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `npm pack` makes."""
    node()
    folder = tmp_path_factory.mktemp("packed")
    packed = ran("npm", "pack", "--json", "--pack-destination", str(folder), cwd=PLAYER)
    assert packed.returncode == 0, packed.stderr
    (archive,) = folder.glob("*.tgz")
    return archive


@pytest.fixture(scope="module")
def project(archive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fresh project that has the package, bundlers and TypeScript from the registry, and a page."""
    folder = tmp_path_factory.mktemp("project")
    package = {
        "private": True,
        "type": "module",
        "dependencies": {"@decogs/player": f"file:{archive}"}
        | {name: f"file:{PLAYER / 'node_modules' / name}" for name in ENGINES},
        "devDependencies": TOOLS,
    }
    (folder / "package.json").write_text(json.dumps(package))
    got = ran("npm", "install", "--no-audit", "--no-fund", cwd=folder)
    if got.returncode:
        pytest.skip(f"the registry gives no bundlers: {got.stderr.strip().splitlines()[-1]}")
    (folder / "index.html").write_text(PAGE.replace("SCRIPT", "./main.js"))
    (folder / "main.js").write_text(SCRIPT)
    (folder / "public").mkdir()
    shutil.copy(PLAYER.parent / "tests/canary/arc.dgs", folder / "public/scene.dgs")
    return folder


def plays(place: Path | str) -> dict[str, object]:
    """What Chromium says of a built page's folder, or of an address."""
    played = ran(node(), str(PLAYER / "tests/browser/packaged.mjs"), str(place), cwd=PLAYER)
    if played.returncode == NO_CHROMIUM:
        pytest.skip("Chromium is not installed")
    assert played.returncode == 0, played.stdout + played.stderr
    told: dict[str, object] = json.loads(played.stdout)
    return told


@pytest.mark.browser
def test_the_package_holds_what_it_names(project: Path) -> None:
    installed = project / "node_modules/@decogs/player"
    told = json.loads((installed / "package.json").read_text())
    assert told["version"] == decogs.__version__
    for entry in told["exports"].values():
        for path in [entry] if isinstance(entry, str) else entry.values():
            assert "*" in path or (installed / path).is_file(), path
    for name in ("README.md", "LICENSE", "dist/licences.txt"):
        assert (installed / name).is_file(), name
    assert not (installed / "src").exists()


@pytest.mark.browser
@pytest.mark.parametrize("resolution", [("esnext", "bundler"), ("nodenext", "nodenext")])
def test_its_types_are_right(project: Path, resolution: tuple[str, str]) -> None:
    module, way = resolution
    (project / "main.ts").write_text(MAIN)
    (project / "engines.ts").write_text(IN_ENGINES)
    readme = (PLAYER / "README.md").read_text()
    (project / "react.tsx").write_text("".join(re.findall(r"```tsx\n(.*?)```", readme, re.DOTALL)))
    (project / "wrong.ts").write_text(WRONG)
    compiler = [str(project / "node_modules/.bin/tsc"), "--ignoreConfig", "--noEmit", "--strict", "--target", "es2022"]
    options = ["--module", module, "--moduleResolution", way, "--lib", "es2022,dom,dom.iterable"]
    right = ran(*compiler, *options, "main.ts", cwd=project)
    assert right.returncode == 0, right.stdout
    others = ran(*compiler, *options, "--jsx", "react-jsx", "--skipLibCheck", "engines.ts", "react.tsx", cwd=project)
    assert others.returncode == 0, others.stdout
    wrong = ran(*compiler, *options, "wrong.ts", cwd=project)
    assert "TS2322" in wrong.stdout


@pytest.mark.browser
@pytest.mark.parametrize("bundler", BUNDLERS)
def test_a_page_that_a_bundler_built_plays(project: Path, bundler: str) -> None:
    """With and without WebGL2, as the worker and its WebAssembly have come with the script; and nothing is missing."""
    program, *words = BUNDLERS[bundler]
    built = ran(str(project / "node_modules/.bin" / program), *words, cwd=project)
    assert built.returncode == 0, built.stdout + built.stderr
    folder = project / "built" / bundler
    if bundler != "vite":
        (folder / "index.html").write_text(PAGE.replace("SCRIPT", "./main.js"))
        shutil.copy(project / "public/scene.dgs", folder)
    assert plays(folder) == EACH_WAY


@pytest.mark.browser
def test_a_page_that_vite_serves_while_it_is_developed_plays(project: Path) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [str(project / "node_modules/.bin/vite"), "--host", "127.0.0.1", "--port", str(port), "--strictPort"]
    with subprocess.Popen(command, cwd=project, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            assert any("Local:" in line for line in server.stdout)
            assert plays(f"http://127.0.0.1:{port}/") == EACH_WAY
        finally:
            server.terminate()


def test_every_entry_is_imported_on_a_server(archive: Path, tmp_path: Path) -> None:
    """Servers evaluate a page's modules, too: there no element is defined; and the decoder decodes."""
    installed = tmp_path / "node_modules" / "@decogs" / "player"
    installed.mkdir(parents=True)
    shutil.unpack_archive(archive, tmp_path)
    (tmp_path / "package").rename(installed)
    for engine in ("three", "playcanvas"):
        (tmp_path / "node_modules" / engine).symlink_to(PLAYER / "node_modules" / engine)
    entries = [name for name in json.loads((installed / "package.json").read_text())["exports"] if "json" not in name]
    scripts = [f"@decogs/player{name[1:]}" for name in entries if "*" not in name]
    scripts += [f"@decogs/player/dist/{path.name}" for path in sorted(installed.glob("dist/*.js"))]
    stream = PLAYER.parent / "tests/canary/arc.dgs"
    program = "\n".join(
        [
            *(f"console.log(Object.keys(await import({name!r})).length > 0);" for name in scripts),
            "import { createFrameSource } from '@decogs/player/decoder';",
            "import { readFileSync } from 'node:fs';",
            f"const source = await createFrameSource(new Uint8Array(readFileSync({str(stream)!r})));",
            "console.log(source.frameCount, (await source.getFrame(0))[0].count > 0);",
        ]
    )
    run = ran(node(), "--input-type=module", "-e", program, cwd=tmp_path)
    assert run.stdout.splitlines() == ["true"] * len(scripts) + ["1 true"], run.stderr
    assert len(scripts) >= 12


def test_what_leads_to_the_first_picture_is_small(archive: Path) -> None:
    with tarfile.open(archive) as packed:
        scripts = [packed.extractfile(f"package/dist/decogs-{name}.js") for name in ("player", "worker")]
        sizes = [len(gzip.compress(script.read(), 9)) for script in scripts if script is not None]
    assert len(sizes) == 2
    assert sum(sizes) <= MOST_FIRST_BYTES, sizes


def test_without_its_packages_the_build_names_the_command(tmp_path: Path) -> None:
    node()
    shutil.copy(PLAYER / "build.mjs", tmp_path)
    run = ran("node", "build.mjs", "--package", cwd=tmp_path)
    assert (run.returncode, run.stdout) == (2, "")
    (line,) = run.stderr.splitlines()
    assert "npm ci" in line
    assert [path.name for path in tmp_path.iterdir()] == ["build.mjs"]


def members_of_the_table() -> tuple[set[str], set[str]]:
    """The members and events that README.md documents."""
    members, events = re.split(r"^\| event ", (PLAYER / "README.md").read_text(), flags=re.MULTILINE)
    rows = [line.split("|")[1] for line in members.splitlines() if line.startswith("| `")]
    sent = [line.split("|")[1] for line in events.splitlines() if line.startswith("| `")]
    return set(re.findall(r"`(\w+)`", " ".join(rows))), set(re.findall(r"`(\w+)`", " ".join(sent)))


def test_the_table_of_members_and_events_is_whole() -> None:
    members, events = members_of_the_table()
    source = "".join((PLAYER / f"src/element/{name}.ts").read_text() for name in ("player", "attributes"))
    found = set(re.findall(r"^  (?:get |set |async )?([a-z]\w*)\(", source, re.MULTILINE))
    of_elements = {
        "constructor",
        *(f"{what}Callback" for what in ("connected", "disconnected", "adopted", "attributeChanged")),
    }
    assert members == found - of_elements
    assert events == set(re.findall(r'\| "(\w+)"', (PLAYER / "src/element/events.ts").read_text()))
