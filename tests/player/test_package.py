"""The package @decogs/player: what `npm pack` makes of it, in a project of somebody else's; and its table of members.

Needs Node, npm and its registry, and for playing Chromium.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

import decogs
from node import PLAYER, node

VITE = "8.3.8"
TYPESCRIPT = "6.0.3"
REACT = {"react": "19.2.0", "@types/react": "19.2.2"}
ENGINES = ("three", "@types/three", "playcanvas")
"""Those that player/ has itself."""
NO_CHROMIUM = 3

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
PAGE = """<!doctype html><html><head><link rel="icon" href="data:,"></head>
<body><decogs-player src="scene.dgs" controls></decogs-player>
<script type="module">
import "@decogs/player";
import { DecogsObject } from "@decogs/player/three";
import { PerspectiveCamera, Scene, WebGLRenderer } from "three";

const renderer = new WebGLRenderer();
const object = new DecogsObject("scene.dgs");
const scene = new Scene().add(object);
const camera = new PerspectiveCamera();
renderer.setAnimationLoop(() => renderer.render(scene, camera));
globalThis.inScene = object.player;
</script></body></html>"""


def ran(*command: str, cwd: Path, timeout: int = 300) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False, timeout=timeout)


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fresh project that has the package, Vite and TypeScript from the registry."""
    node()
    folder = tmp_path_factory.mktemp("project")
    packed = ran("npm", "pack", "--json", "--pack-destination", str(folder), cwd=PLAYER)
    assert packed.returncode == 0, packed.stderr
    (archive,) = folder.glob("*.tgz")
    package = {
        "private": True,
        "type": "module",
        "dependencies": {"@decogs/player": f"file:{archive.name}"}
        | {name: f"file:{PLAYER / 'node_modules' / name}" for name in ENGINES},
        "devDependencies": {"vite": VITE, "typescript": TYPESCRIPT} | REACT,
    }
    (folder / "package.json").write_text(json.dumps(package))
    got = ran("npm", "install", "--no-audit", "--no-fund", cwd=folder)
    if got.returncode:
        pytest.skip(f"the registry gives no Vite: {got.stderr.strip().splitlines()[-1]}")
    return folder


@pytest.mark.browser
def test_the_package_holds_what_it_names(project: Path) -> None:
    installed = project / "node_modules/@decogs/player"
    told = json.loads((installed / "package.json").read_text())
    assert told["version"] == decogs.__version__
    for entry in told["exports"].values():
        for path in [entry] if isinstance(entry, str) else entry.values():
            assert "*" in path or (installed / path).is_file(), path
    for name in ("README.md", "LICENSE", "dist/licences.txt", "dist/decogs-exact.wasm"):
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
def test_a_page_built_by_vite_plays(project: Path) -> None:
    (project / "index.html").write_text(PAGE)
    (project / "public").mkdir(exist_ok=True)
    shutil.copy(PLAYER.parent / "tests/canary/arc.dgs", project / "public/scene.dgs")
    built = ran(str(project / "node_modules/.bin/vite"), "build", cwd=project)
    assert built.returncode == 0, built.stdout + built.stderr
    played = ran(node(), str(PLAYER / "tests/browser/packaged.mjs"), str(project / "dist"), cwd=project)
    if played.returncode == NO_CHROMIUM:
        pytest.skip("Chromium is not installed")
    assert played.returncode == 0, played.stdout + played.stderr
    assert json.loads(played.stdout) == {
        "frame": 0,
        "exact": True,
        "controls": True,
        "error": None,
        "inScene": 0,
        "complaints": [],
    }


def test_its_decoder_runs_in_node(tmp_path: Path) -> None:
    program = node()
    built = ran(program, "build.mjs", "--package", cwd=PLAYER)
    assert built.returncode == 0, built.stderr
    stream = PLAYER.parent / "tests/canary/arc.dgs"
    script = (
        f"import {{ createFrameSource }} from {str(PLAYER / 'dist/decogs-decoder.js')!r};"
        f"import {{ readFileSync }} from 'node:fs';"
        f"const source = await createFrameSource(new Uint8Array(readFileSync({str(stream)!r})));"
        "console.log(source.frameCount, (await source.getFrame(0))[0].count > 0);"
    )
    run = ran(program, "--input-type=module", "-e", script, cwd=tmp_path)
    assert run.stdout == "1 true\n", run.stderr


def members_of_the_table() -> tuple[set[str], set[str]]:
    """The members and events that README.md documents."""
    members, events = re.split(r"^\| event ", (PLAYER / "README.md").read_text(), flags=re.MULTILINE)
    rows = [line.split("|")[1] for line in members.splitlines() if line.startswith("| `")]
    sent = [line.split("|")[1] for line in events.splitlines() if line.startswith("| `")]
    return set(re.findall(r"`(\w+)`", " ".join(rows))), set(re.findall(r"`(\w+)`", " ".join(sent)))


def test_the_table_of_members_and_events_is_whole() -> None:
    members, events = members_of_the_table()
    source = (PLAYER / "src/element/player.ts").read_text()
    found = set(re.findall(r"^  (?:get |set |async )?([a-z]\w*)\(", source, re.MULTILINE))
    assert members == {name for name in found if not name.endswith("Callback")} - {"constructor"}
    assert events == set(re.findall(r'\| "(\w+)"', (PLAYER / "src/element/events.ts").read_text()))
