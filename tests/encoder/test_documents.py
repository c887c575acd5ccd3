"""Documents: links lead somewhere, commands of README and docs/ run as they are shown, and the README stays short."""

from __future__ import annotations

import io
import json
import re
import shlex
import shutil
import sys
import wave
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import cv2
import numpy as np
import pytest

from board_videos import write_board_videos, write_phone_videos
from decogs.decoder.commands import decode_main, export_main, info_main, view_main
from decogs.decoder.editing.commands import edit_main
from decogs.decoder.viewing import notebook
from decogs.decoder.viewing.notebook import View
from decogs.encoder import PRESETS, EncodeSettings
from decogs.encoder.analyze_command import analyze_main
from decogs.encoder.commands import encode_main
from decogs.encoder.packing.commands import pack_main
from decogs.encoder.parts.commands import join_main
from decogs.encoder.settings.frame import SignificanceSettings
from decogs.formats.cameras import project
from decogs.formats.rigs import open_rig
from decogs.formats.stream.container import SIGNATURE
from decogs.rig.calibration.commands import calibrate_main
from decogs.rig.synchronisation.commands import sync_main
from decogs.takes.commands import make_main, report_main, verify_main

ROOT = Path(__file__).parents[2]
DOCS = sorted((ROOT / "docs").glob("*.md"))
LAYERS = ("formats", "codec", "decoder", "encoder", "takes", "bench", "player")
DOCUMENTS = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "report").glob("*.md")),
    *sorted(path for layer in LAYERS for path in (ROOT / layer).rglob("*.md") if "node_modules" not in path.parts),
    ROOT / "tests" / "conformance" / "README.md",
    *DOCS,
]
MAINS: dict[str, Callable[[list[str]], int]] = {
    "decogs-analyze": analyze_main,
    "decogs-calibrate": calibrate_main,
    "decogs-edit": edit_main,
    "decogs-encode": encode_main,
    "decogs-decode": decode_main,
    "decogs-export": export_main,
    "decogs-info": info_main,
    "decogs-join": join_main,
    "decogs-make": make_main,
    "decogs-pack": pack_main,
    "decogs-report": report_main,
    "decogs-sync": sync_main,
    "decogs-verify": verify_main,
    "decogs-view": view_main,
}
LONGEST_README = 110
MOST_WORDS = 24_000
TRADES = ("film.md", "compare.md", "web.md", "shots.md")
MIDDLE = np.zeros((1, 3), np.float32)


def commands_of(document: Path) -> list[str]:
    """The command lines of indented blocks, without their comments."""
    lines = [line.split(" # ")[0].strip() for line in document.read_text().splitlines() if line.startswith("    ")]
    return [line for line in lines if line.split(" ")[0] in MAINS]


def python_of(document: Path) -> list[str]:
    return re.findall(r"```python\n(.*?)```", document.read_text(), re.DOTALL)


@pytest.fixture(scope="module")
def short(tiny_settings: EncodeSettings) -> EncodeSettings:
    return replace(
        tiny_settings,
        keyframe=replace(tiny_settings.keyframe, iterations=20, cap=300, settle_iterations=4),
        frame=replace(tiny_settings.frame, significance=SignificanceSettings(threshold=6.5)),
    )


@pytest.fixture(scope="module")
def shown(tiny_rig: Any, short: EncodeSettings, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a rig, a stream of it and a free camera, under the names of the documents; no test changes it."""
    folder = tmp_path_factory.mktemp("documents") / "shown"
    tiny_rig.write(folder / "rig_dir", frames=[0, 1, 3])
    calibration = json.loads(Path(folder / "rig_dir" / "rig.json").read_text())
    (folder / "rig_dir" / "rig.json").write_text(json.dumps(calibration | {"fps": 30}))
    write_masks(folder)
    live = ['calibration = "rig_dir"', "fps = 30", "late = 0.05", "end = 0.1", "[cameras]"]
    live += [f'{name} = "rig_dir/{name}/{{:04d}}.png"' for name in tiny_rig.names]
    (folder / "sources.toml").write_text("\n".join(live))
    write_board_videos(folder / "videos_dir")
    (folder / "lens_dir").symlink_to("videos_dir")
    write_phone_videos(folder / "phones")
    with wave.open(str(folder / "mix.wav"), "wb") as mix:
        mix.setparams((2, 2, 48_000, 48_000, "NONE", ""))
        mix.writeframes(np.random.default_rng(0).integers(-9000, 9000, 96_000).astype("<i2").tobytes())
    with pytest.MonkeyPatch.context() as patched:
        patch_presets(short, patched)
        patched.chdir(folder)
        assert encode_main(["rig_dir", "-o", "scene.dgs", "--effects", "motion"]) == 0
    for document, names in (("cameras.md", ["pose.json", "bullet.json"]), ("edit.md", ["edits.toml"])):
        texts = re.findall(r"```(?:json|toml)\n(.*?)```", (ROOT / "docs" / document).read_text(), re.DOTALL)
        for name, text in zip(names, texts, strict=True):
            # Pictures of a quarter of the size: a whole turn takes 10 seconds otherwise.
            (folder / name).write_text(text.replace('"width": 640, "height": 360', '"width": 160, "height": 90'))
    return folder


@pytest.fixture
def at_the_rig(shown: Path, short: EncodeSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of that folder, where commands run; presets are short."""
    # Nobody looks: the address is asked for once, and the command goes on as if it had been interrupted.
    monkeypatch.setattr(notebook, "open_browser", lambda url: True)
    monkeypatch.setattr(View, "wait", look_once)
    patch_presets(short, monkeypatch)
    folder = Path(shutil.copytree(shown, tmp_path / "here", symlinks=True))
    monkeypatch.chdir(folder)
    return folder


def patch_presets(short: EncodeSettings, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in PRESETS:
        monkeypatch.setitem(PRESETS, name, short)


def write_masks(folder: Path) -> None:
    """Mattes of a ball in the middle of the rig, and plates that differ from the pictures there."""
    for camera in open_rig(folder / "rig_dir").cameras:
        u, v, depth = (value.item() for value in project(camera, MIDDLE))
        matte = np.zeros((camera.height, camera.width), np.uint8)
        cv2.circle(matte, (round(u), round(v)), round(camera.fx * 0.2 / depth), 255, -1)
        files = sorted((folder / "rig_dir" / camera.name).glob("*.png"))
        shown = cv2.imread(str(files[0]))
        masks = {folder / "masks" / camera.name / file.name: matte for file in files}
        plate = np.where(matte[..., None] > 0, 255 - shown, shown)
        for path, picture in (masks | {folder / "plates" / f"{camera.name}.png": plate}).items():
            path.parent.mkdir(parents=True, exist_ok=True)
            assert cv2.imwrite(str(path), picture)


def look_once(shown: View) -> None:
    with urlopen(shown.url) as page:
        assert b"<decogs-player" in page.read()
    with urlopen(shown.url + shown.name) as stream:
        begun = stream.read()
    assert begun == Path(shown.name).read_bytes() if Path(shown.name).exists() else begun.startswith(SIGNATURE)


def run_line(line: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs a command as it is shown; what one writes into a pipe, the next one reads."""
    piped = b""
    for part in line.split(" | "):
        program, *arguments = shlex.split(part)
        output, given = io.TextIOWrapper(io.BytesIO()), io.TextIOWrapper(io.BytesIO(piped))
        with monkeypatch.context() as streams:
            streams.setattr(sys, "stdout", output)
            streams.setattr(sys, "stdin", given)
            assert MAINS[program](arguments) == 0, part
            output.flush()
            piped = output.buffer.getvalue()  # type: ignore[attr-defined]


LONG = {"calibrate.md", "cameras-and-effects.md", "cameras.md", "film.md", "synchronise.md", "takes.md"}
"""Pages whose commands take a minute and more on a slow machine."""
SHOWN = [pytest.param(page, marks=[pytest.mark.slow] * (page.name in LONG)) for page in (ROOT / "README.md", *DOCS)]


@pytest.mark.parametrize("document", SHOWN, ids=lambda path: path.name)
def test_what_is_shown_runs(document: Path, at_the_rig: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for line in commands_of(document):
        run_line(line, monkeypatch)
    for code in python_of(document):
        exec(compile(code, str(document), "exec"), {})


def test_commands_are_found() -> None:
    """The reader above would pass with none."""
    assert len(commands_of(ROOT / "README.md")) == 10
    assert sum(len(commands_of(document)) for document in DOCS) > 25
    assert sum(len(python_of(document)) for document in DOCS) >= 3


def links_of(document: Path) -> set[str]:
    """The files of the checkout that a page links to, as it names them."""
    targets = re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", document.read_text())
    return {target for target in targets if not target.startswith("http")}


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_lead_somewhere(document: Path) -> None:
    for target in links_of(document):
        assert (document.parent / target).exists(), target


def test_each_room_of_the_encoder_is_in_the_table_of_rooms() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text()
    table = text[text.index("| room | what is in it |") :].split("\n\n")[0]
    listed = [name for row in table.splitlines() for name in re.findall(r"`([^`]+)`", row.split("|")[1])]
    entries = [path for path in (ROOT / "encoder").iterdir() if path.name not in {"__init__.py", "__pycache__"}]
    rooms = [f"{path.name}/" if path.is_dir() else path.name for path in entries if path.suffix in {"", ".py"}]
    assert sorted(listed) == sorted(rooms)


def test_the_report_lists_each_of_its_pages_and_keeps_no_picture_that_none_shows() -> None:
    pages = sorted((ROOT / "report").glob("*.md"))
    linked = {target for page in pages for target in re.findall(r"\]\(([^)#]+)\)", page.read_text())}
    kept = [path for path in (ROOT / "report").rglob("*") if path.is_file() and not is_full_report(path)]
    assert {path.relative_to(ROOT / "report").as_posix() for path in kept} - linked == {"README.md"}


def is_full_report(path: Path) -> bool:
    """What `make report` makes and git does not keep, and the figures that pages cite of it."""
    return bool({"full", "figures"} & {*path.parts}) or path.name == "full.zip"


def test_the_readme_and_the_documents_are_short() -> None:
    assert len((ROOT / "README.md").read_text().splitlines()) <= LONGEST_README
    assert sum(len(document.read_text().split()) for document in DOCS) <= MOST_WORDS


def test_the_readme_leads_to_the_trades_and_these_to_every_page() -> None:
    assert {f"docs/{trade}" for trade in TRADES} <= links_of(ROOT / "README.md")
    ways_in = [ROOT / "README.md", *(ROOT / "docs" / trade for trade in TRADES)]
    linked = {(page.parent / target).resolve() for page in ways_in for target in links_of(page)}
    assert set(DOCS) - linked == set()
