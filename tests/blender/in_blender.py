"""Runs inside Blender (`make blender-test`): installs the extension, imports, checks and renders.

    python in_blender.py EXTENSION.zip STREAM.dgs STREAM.usdc FOLDER

Writes pictures and facts.json into FOLDER; `render.py`, which starts this, compares them.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import bpy
import numpy as np

SAMPLES = 2
FRACTION = 0.25


def empty_scene() -> Any:
    bpy.ops.wm.read_homefile(use_empty=True)
    return bpy.context.scene


def render(name: Path, frame: int) -> float:
    scene = bpy.context.scene
    scene.frame_set(frame)
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.use_adaptive_sampling = SAMPLES, False, False
    scene.render.filepath = str(name)
    start = time.perf_counter()
    bpy.ops.render.render(write_still=True)
    return round(time.perf_counter() - start, 1)


def instances() -> int:
    graph = bpy.context.evaluated_depsgraph_get()
    return sum(1 for item in graph.object_instances if item.is_instance)


def complaint(path: str) -> str:
    """What the import of something that is no stream says, and that it leaves nothing behind."""
    before = len(bpy.data.objects), len(bpy.data.collections), bpy.context.scene.render.fps
    try:
        bpy.ops.import_scene.decogs(filepath=path)
    except RuntimeError as error:
        assert before == (len(bpy.data.objects), len(bpy.data.collections), bpy.context.scene.render.fps)
        return str(error)
    raise SystemExit(f"{path}: was imported")


def main(extension: str, stream: str, usd: str, folder: str) -> None:
    facts: dict[str, Any] = {"version": bpy.app.version_string, "numpy": np.__version__}
    out = Path(folder)
    bpy.ops.extensions.package_install_files(filepath=extension, repo="user_default", enable_on_install=True)
    empty_scene()
    half = out / "half.dgs"
    half.write_bytes(b"no stream at all")
    facts["complaints"] = [complaint(str(half)), complaint(str(out / "missing.dgs"))]

    scene = empty_scene()
    bpy.ops.import_scene.decogs(filepath=stream, first_frame=101, viewport_fraction=FRACTION)
    splats = next(item for item in scene.objects if item.decogs.path)
    facts["range"] = [scene.frame_start, scene.frame_end, scene.render.fps / scene.render.fps_base]
    facts["view"] = [scene.view_settings.view_transform, scene.camera.name]
    facts["transparent"] = [scene.render.film_transparent]
    facts["ups"] = [list(item.matrix_world.col[1][:3]) for item in scene.objects if item.type == "CAMERA"]
    facts["instances"] = instances()
    scene.camera.data.shift_y += 0.03
    bpy.ops.export_scene.decogs_camera(filepath=str(out / "camera.json"))
    scene.camera.data.shift_y -= 0.03
    facts["seconds"] = []
    for frame in range(scene.frame_start, scene.frame_end + 1):
        start = time.perf_counter()
        scene.frame_set(frame)
        facts["seconds"].append(round(time.perf_counter() - start, 3))
    ids = np.zeros(len(splats.data.vertices), np.int32)
    splats.data.attributes["id"].data.foreach_get("value", ids)
    np.save(out / "ids.npy", ids)
    facts["render_seconds"] = [
        render(out / f"stream_{end}.png", frame) for end, frame in enumerate((101, scene.frame_end))
    ]

    size = scene.render.resolution_x, scene.render.resolution_y
    saved = out / "saved.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(saved))
    bpy.ops.wm.open_mainfile(filepath=str(saved))
    splats = next(item for item in bpy.context.scene.objects if item.decogs.path)
    bpy.context.scene.frame_set(101)
    facts["reopened"] = [len(splats.data.vertices), splats.decogs.problem]

    scene = empty_scene()
    bpy.ops.import_scene.decogs(filepath=str(out / "subject.dgs"))
    facts["transparent"].append(scene.render.film_transparent)

    empty_scene()
    bpy.ops.wm.usd_import(filepath=usd, import_cameras=True, set_frame_range=True)
    bpy.ops.object.decogs_usd_colours()
    scene = bpy.context.scene
    scene.camera = next(item for item in scene.objects if item.type == "CAMERA" and item.name == facts["view"][1])
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.render.resolution_percentage = 100
    facts["usd_rate"] = scene.render.fps / scene.render.fps_base
    facts["usd_instances"] = []
    for end, frame in enumerate((scene.frame_start, scene.frame_end)):
        facts["render_seconds"].append(render(out / f"usd_{end}.png", frame))
        facts["usd_instances"].append(instances())

    # In place of the scene's own: two files that a transform has turned, scaled and shifted.
    empty_scene()
    bpy.ops.import_scene.decogs(filepath=str(out / "turned.dgs"), up="none")
    splats = next(item for item in bpy.context.scene.objects if item.decogs.path)
    local = np.zeros(3 * len(splats.data.vertices), np.float32)
    splats.data.vertices.foreach_get("co", local)
    world = np.array(splats.matrix_world)
    np.save(out / "turned_points.npy", local.reshape(-1, 3) @ world[:3, :3].T + world[:3, 3])
    empty_scene()
    bpy.ops.wm.usd_import(filepath=str(out / "turned.usdc"))
    graph = bpy.context.evaluated_depsgraph_get()
    placed = [np.array(item.matrix_world)[:3, 3] for item in graph.object_instances if item.is_instance]
    np.save(out / "turned_instances.npy", np.array(placed))

    whole = Path(stream).read_bytes()
    damaged = out / "damaged.dgs"
    damaged.write_bytes(whole[: len(whole) * 98 // 100])
    empty_scene()
    bpy.ops.import_scene.decogs(filepath=str(damaged))
    facts["damaged"] = bpy.context.scene.frame_end
    sys.modules["zstandard"] = None  # type: ignore[assignment]
    for name in [name for name in sys.modules if name.startswith(("decogs.", "bl_ext.user_default.decogs.playback"))]:
        del sys.modules[name]
    empty_scene()
    facts["complaints"].append(complaint(stream))
    (out / "facts.json").write_text(json.dumps(facts, indent=1))


if __name__ == "__main__":
    main(*sys.argv[1:])
