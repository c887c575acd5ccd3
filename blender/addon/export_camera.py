"""File > Export > decogs camera (.json): the scene's camera as a camera path that `decogs-decode --camera` reads."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import bpy
from bpy_extras.io_utils import ExportHelper
from mathutils import Matrix

from . import timeline
from .rig_cameras import OPENCV_TO_BLENDER


class ExportDecogsCamera(bpy.types.Operator, ExportHelper):  # type: ignore[misc]
    """Export the scene's camera, over its frame range, for decogs-decode --camera"""

    bl_idname = "export_scene.decogs_camera"
    bl_label = "Export decogs camera"

    filename_ext = ".json"
    filter_glob: bpy.props.StringProperty(default="*.json", options={"HIDDEN"})  # type: ignore[valid-type]

    def execute(self, context: Any) -> set[str]:
        try:
            path = camera_path(context, _stream(context))
            _write(Path(self.filepath), json.dumps(path, indent=1) + "\n")
        except Exception as error:  # Every error is one line: a traceback helps no artist.
            self.report({"ERROR"}, timeline.one_line(error, self.filepath))
            return {"CANCELLED"}
        self.report({"INFO"}, f"{Path(self.filepath).name}: {len(path)} pictures")
        return {"FINISHED"}


def camera_path(context: Any, splats: Any) -> list[dict[str, Any]]:
    """An entry for every frame of the scene's range, in the units and axes of the stream that ``splats`` shows.

    Each has the frame of the stream that is shown then, the first or the last one outside of it.
    """
    scene, settings = context.scene, splats.decogs
    if scene.camera is None or scene.camera.type != "CAMERA" or scene.camera.data.type != "PERSP":
        raise RuntimeError("the scene has no camera in perspective; make one, or choose it as the scene's camera")
    last, now = timeline.playback(settings.path).frame_count - 1, scene.frame_current
    entries = []
    try:
        for frame in range(scene.frame_start, scene.frame_end + 1):
            scene.frame_set(frame)
            graph = context.evaluated_depsgraph_get()
            camera = scene.camera.evaluated_get(graph)
            world = splats.evaluated_get(graph).matrix_world
            shown = min(max(frame - settings.first_frame, 0), last)
            near = camera.data.clip_start / max(world.to_scale())
            pose = _in_stream(world, camera.matrix_world)
            entries.append({"frame": shown, **_lens(scene, camera, graph), "near": near, "camera_to_world": pose})
    finally:
        scene.frame_set(now)
    return entries


def _stream(context: Any) -> Any:
    """The object that shows a stream: the active one, or else the scene's only one."""
    shown = timeline.streams(context.scene)
    if context.object in shown:
        return context.object
    if len(shown) != 1:
        raise RuntimeError(f"the scene shows {len(shown)} streams; select the Gaussians of the one the camera is for")
    return shown[0]


def _in_stream(world: Any, camera: Any) -> list[list[float]]:
    """The camera's pose (4, 4), OpenCV's axes, in the stream's world: ``world`` may turn and scale it."""
    place, rotation, _ = (world.inverted() @ camera).decompose()
    pose = Matrix.Translation(place) @ rotation.to_matrix().to_4x4() @ OPENCV_TO_BLENDER
    return [list(row) for row in pose]


def _lens(scene: Any, camera: Any, graph: Any) -> dict[str, float]:
    """Picture size, focal lengths and principal point in pixels, from Blender's projection.

    Source: the manual's Cameras; a ray's picture coordinates are (p00 x + p02 z) / -z and (p11 y + p12 z) / -z, from -1
    to 1, y up.
    """
    render = scene.render
    share = render.resolution_percentage / 100
    width, height = int(render.resolution_x * share), int(render.resolution_y * share)
    projection = camera.calc_matrix_camera(
        graph, x=width, y=height, scale_x=render.pixel_aspect_x, scale_y=render.pixel_aspect_y
    )
    return {
        "width": width,
        "height": height,
        "fx": projection[0][0] * width / 2,
        "fy": projection[1][1] * height / 2,
        "cx": (1 - projection[0][2]) * width / 2,
        "cy": (1 + projection[1][2]) * height / 2,
    }


def _write(path: Path, text: str) -> None:
    """An interruption leaves the file that was there, or none."""
    beside = path.with_name(path.name + ".part")
    beside.write_text(text, "utf-8")
    os.replace(beside, path)


def _menu(self: Any, _context: Any) -> None:
    self.layout.operator(ExportDecogsCamera.bl_idname, text="decogs camera (.json)")


def register() -> None:
    """The operator and its menu entry."""
    bpy.utils.register_class(ExportDecogsCamera)
    bpy.types.TOPBAR_MT_file_export.append(_menu)


def unregister() -> None:
    """Takes back what ``register`` did."""
    bpy.types.TOPBAR_MT_file_export.remove(_menu)
    bpy.utils.unregister_class(ExportDecogsCamera)
