"""The cameras of a rig in Blender: where they stand, and their lenses."""

from __future__ import annotations

from typing import Any

import bpy
from mathutils import Matrix

from decogs.codec.header.header import StreamHeader

_SENSOR = 36.0
OPENCV_TO_BLENDER = Matrix.Diagonal((1.0, -1.0, -1.0, 1.0))
_FAR = 10_000.0


def add_cameras(header: StreamHeader, root: Any, collection: Any, metres: float) -> list[Any]:
    """A camera object for each of the rig's, under ``root``.

    As pinholes: Blender bends no rays as OpenCV's lenses do. ``metres``: of a world unit, for the near plane. Picture
    size, name and lens distortion stay on it as custom properties.
    """
    return [_add_camera(camera, root, collection, metres) for camera in header.cameras]


def show_through(scene: Any, camera: Any) -> None:
    """Renders look through a camera of ours, at its size and with its pixels' shape."""
    scene.camera = camera
    scene.render.resolution_x, scene.render.resolution_y = camera.data["decogs_size"]
    scene.render.resolution_percentage = 100
    wide = camera.data["decogs_pixel_aspect"]
    # Blender has no aspect below 1.
    scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = max(wide, 1.0), max(1 / wide, 1.0)


def _add_camera(camera: Any, root: Any, collection: Any, metres: float) -> Any:
    """Source: Blender's manual, Cameras; shifts are in widths of the picture, as the sensor is fitted to its width.

    A pixel's width over its height is fy / fx: the sensor's height, from which Blender has the vertical field, is
    fitted by the scene's pixel aspect.
    """
    lens = bpy.data.cameras.new(camera.name)
    lens.sensor_fit = "HORIZONTAL"
    lens.sensor_width = _SENSOR
    lens.lens = _SENSOR * camera.fx / camera.width
    lens.shift_x = 0.5 - camera.cx / camera.width
    aspect = camera.fy / camera.fx
    lens.shift_y = (camera.cy - camera.height / 2) / camera.width / aspect
    lens.clip_start = max(camera.near * metres, 1e-3)
    lens.clip_end = _FAR
    lens["decogs_name"], lens["decogs_size"] = camera.name, (camera.width, camera.height)
    lens["decogs_pixel_aspect"] = aspect
    if camera.distortion_model != "none":
        lens["decogs_distortion_model"] = camera.distortion_model
        lens["decogs_distortion"] = list(camera.distortion)
    item = bpy.data.objects.new(camera.name, lens)
    collection.objects.link(item)
    item.parent = root
    item.matrix_local = Matrix(camera.world_to_camera.tolist()).inverted() @ OPENCV_TO_BLENDER
    return item
