"""The player's exact picture, the kernel as WebAssembly, has the bits of the native one; needs Node."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest

from decogs.decoder import open_stream
from decogs.decoder.output.pictures import to_8bit
from decogs.decoder.rasterise import Rendering
from decogs.decoder.rasterise.native import render_planes
from decogs.decoder.rasterise.straight_alpha import straight_picture
from decogs.formats.cameras import Camera, as_pinhole, scale_camera
from decogs.formats.splats import Splats
from node import run_player_tests
from random_splats import random_splats
from rasterise_cases import CASES, pinhole

ROOT = Path(__file__).parents[2]
BACKGROUND = (0.2, 0.5, 0.7)


def write_case(path: Path, splats: Splats, camera: Camera) -> None:
    """The scene, and what the native kernel makes of it."""
    rgb, alpha, depth = render_planes(splats, camera, BACKGROUND, threads=1)
    assert alpha.max() > 0.1, "nothing is seen"
    fields = ("width", "height", "fx", "fy", "cx", "cy", "near")
    seen = {name: getattr(camera, name) for name in fields} | {"worldToCamera": camera.world_to_camera[:3].tolist()}
    case = {"count": len(splats), "shDegree": splats.sh_degree, "camera": seen, "background": BACKGROUND}
    path.with_suffix(".json").write_text(json.dumps(case))
    stored = (splats.means, splats.log_scales, splats.quaternions, splats.opacity_logits, splats.sh)
    path.with_suffix(".scene").write_bytes(b"".join(array.tobytes() for array in stored))
    path.with_suffix(".planes").write_bytes(rgb.tobytes() + alpha.tobytes() + depth.tobytes())
    over_black = Rendering(render_planes(splats, camera, (0, 0, 0), threads=1)[0].transpose(1, 2, 0), alpha, depth)
    path.with_suffix(".straight").write_bytes(to_8bit(straight_picture(over_black)).tobytes())
    opaque = np.full((camera.height, camera.width, 1), 255, np.uint8)
    path.with_suffix(".pixels").write_bytes(np.dstack([to_8bit(rgb.transpose(1, 2, 0)), opaque]).tobytes())


def test_every_float_is_the_native_one(tmp_path: Path) -> None:
    for name in ("arc", "light"):
        with open_stream(ROOT / "tests" / "canary" / f"{name}.dgs") as stream:
            camera, scene = as_pinhole(stream.header.cameras[0]), next(stream.frames()).splats
        for scale in (1.0, 2.37):
            write_case(tmp_path / f"{name}-{scale:g}".replace(".", "_"), scene, scale_camera(camera, scale))
    for degree in range(4):
        camera = pinhole(203, 117, 150.0, turn=0.2, nod=-0.3, offset=(0.1, -0.2, 3.5))
        write_case(tmp_path / f"degree{degree}", random_splats(5000, (degree + 1) ** 2, seed=degree), camera)
    for name, make in CASES.items():
        case = make()
        write_case(tmp_path / name, case.splats, case.camera)
    run_player_tests("exact", DECOGS_EXACT_CASES=str(tmp_path))


@pytest.mark.parametrize("name", ["exact", "kernel"])
def test_the_compiled_kernels_are_those_of_the_sources(name: str) -> None:
    """Compiling needs Zig, which few have; what it was compiled of is stated beside its source."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "player" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    assert made.STATED.read_text().strip() == made.digest(), "the kernel changed: make player-wasm"
