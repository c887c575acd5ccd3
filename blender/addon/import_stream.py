"""File > Import > decogs (.dgs)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
from bpy_extras.io_utils import ImportHelper
from mathutils import Matrix

from . import timeline

TRANSPARENT_BOUNCES = 256
"""Of Cycles: each Gaussian that a ray passes takes two. Too few turn dense places black; more showed no gain."""

_UPS = ("auto", "Z", "-Z", "Y", "-Y", "X", "-X", "none")


class ImportDecogs(bpy.types.Operator, ImportHelper):  # type: ignore[misc]
    """Import a stream of 3D Gaussians that follows the timeline"""

    bl_idname = "import_scene.decogs"
    bl_label = "Import decogs"
    bl_options = {"UNDO"}  # noqa: RUF012 (Blender reads it)

    filename_ext = ".dgs"
    filter_glob: bpy.props.StringProperty(default="*.dgs", options={"HIDDEN"})  # type: ignore[valid-type]
    first_frame: bpy.props.IntProperty(  # type: ignore[valid-type]
        name="First frame", default=1, description="Frame of Blender's timeline that shows the stream's first one"
    )
    viewport_fraction: bpy.props.FloatProperty(  # type: ignore[valid-type]
        name="Viewport fraction",
        default=1.0,
        min=0.0,
        max=1.0,
        subtype="FACTOR",
        description="How many of the Gaussians the viewport shows; renders have all. It can be changed in the modifier",
    )
    up: bpy.props.EnumProperty(  # type: ignore[valid-type]
        name="Up",
        items=[(up, up, "") for up in _UPS],
        description="Which way is up in the stream; it becomes Z. auto: from the cameras; none: nothing is turned",
    )
    metres: bpy.props.FloatProperty(  # type: ignore[valid-type]
        name="Metres per unit", default=1.0, min=1e-6, soft_max=1e3, description="How long one unit of the stream is"
    )
    cameras: bpy.props.BoolProperty(  # type: ignore[valid-type]
        name="Cameras", default=True, description="Make the cameras of the rig"
    )
    colours: bpy.props.EnumProperty(  # type: ignore[valid-type]
        name="Colours",
        items=[
            ("DISPLAY", "As decoded", "Blended as they are stored. Right in view transform Raw, which has no lighting"),
            ("LINEAR", "Linear", "In linear light, beside other objects. Softer than decoded pictures are"),
        ],
    )
    set_timeline: bpy.props.BoolProperty(  # type: ignore[valid-type]
        name="Set frame rate and range", default=True, description="The scene gets those of the stream"
    )
    set_view: bpy.props.BoolProperty(  # type: ignore[valid-type]
        name="Set view and render",
        default=True,
        description="The scene gets the view transform that the colours need, the stream's background, "
        "Cycles with enough transparent bounces, and the first camera with its size",
    )

    def execute(self, context: Any) -> set[str]:
        timeline.forget()
        # The file may be another one by now.
        timeline.close(self.filepath)
        try:
            playback = timeline.playback(self.filepath)
            first = playback.frame(0)
        except Exception as error:  # Every error is one line: a traceback helps no artist.
            timeline.close(self.filepath)
            self.report({"ERROR"}, timeline.one_line(error, self.filepath))
            return {"CANCELLED"}
        cameras = self._scene(context, playback)
        if self.set_timeline:
            _set_timeline(context.scene, playback, self.first_frame)
        if self.set_view:
            _set_view(context.scene, playback.header, cameras, self.colours)
        # Cycles reads a mesh while the timeline may already fill the next frame's.
        context.scene.render.use_lock_interface = True
        timeline.show_all(context.scene)
        for damage in timeline.faults():
            self.report({"WARNING"}, damage)
        self.report({"INFO"}, f"{Path(self.filepath).name}: {playback.frame_count} frames, {len(first.ids)} Gaussians")
        return {"FINISHED"}

    def _scene(self, context: Any, playback: Any) -> list[Any]:
        """The collection with root, Gaussians and cameras; returns the cameras."""
        from .rig_cameras import add_cameras
        from .splat_nodes import FRACTION, set_input, splat_group, splat_material

        name = Path(self.filepath).stem
        collection = bpy.data.collections.new(name)
        context.scene.collection.children.link(collection)
        root = bpy.data.objects.new(name, None)
        root.matrix_world = _upright(self.up, self.metres, playback.header)
        splats = bpy.data.objects.new(f"{name} splats", bpy.data.meshes.new(f"{name} splats"))
        for item in (root, splats):
            collection.objects.link(item)
        splats.parent = root
        modifier = splats.modifiers.new("decogs splats", "NODES")
        modifier.node_group = splat_group(splat_material("decogs splat", "colour", "opacity"))
        set_input(splats, FRACTION, self.viewport_fraction)
        settings = splats.decogs
        settings["first_frame"], settings["linear"] = self.first_frame, self.colours == "LINEAR"
        settings["path"] = self.filepath
        return add_cameras(playback.header, root, collection, self.metres) if self.cameras else []


def _upright(up: str, metres: float, header: Any) -> Matrix:
    """Brings the stream's up to Blender's Z, and its units to metres."""
    from decogs.formats.geometry.up_direction import AXES, turn_between, up_vector

    direction = up_vector(up, header.cameras)  # type: ignore[arg-type]
    if direction is None:
        return Matrix.Scale(metres, 4)
    return Matrix(turn_between(direction, AXES["Z"]).tolist()).to_4x4() @ Matrix.Scale(metres, 4)


def _set_timeline(scene: Any, playback: Any, first_frame: int) -> None:
    scene.frame_start, scene.frame_end = first_frame, first_frame + playback.frame_count - 1
    if playback.header.fps:
        set_rate(scene, playback.header.fps)


def set_rate(scene: Any, rate: float) -> None:
    """Frames per second, also those that are no whole number (24000/1001)."""
    scene.render.fps = max(1, round(rate))
    scene.render.fps_base = scene.render.fps / rate


def _set_view(scene: Any, header: Any, cameras: list[Any], colours: str) -> None:
    import numpy as np

    from decogs.formats.colours.srgb import linear_from_srgb

    from .rig_cameras import show_through

    background = np.array(header.background, np.float32)
    show_faithfully(scene, colours)
    scene.world = scene.world or bpy.data.worlds.new("World")
    _set_background(scene.world, background if colours == "DISPLAY" else linear_from_srgb(background))
    scene.render.film_transparent = header.subject
    if cameras:
        show_through(scene, cameras[0])


def show_faithfully(scene: Any, colours: str) -> None:
    """The view transform that leaves ``colours`` as they are, and Cycles with enough transparent bounces."""
    scene.view_settings.view_transform = "Raw" if colours == "DISPLAY" else "Standard"
    scene.view_settings.look = "None"
    scene.view_settings.exposure, scene.view_settings.gamma = 0.0, 1.0
    scene.render.engine = "CYCLES"
    # Below that number Cycles ends rays by chance: noise of 4 dB more at 16 samples than without at 4.
    scene.cycles.transparent_max_bounces = scene.cycles.min_transparent_bounces = TRANSPARENT_BOUNCES


def _set_background(world: Any, colour: Any) -> None:
    if bpy.app.version < (5, 0, 0):
        world.use_nodes = True
    for node in world.node_tree.nodes:
        if node.bl_idname == "ShaderNodeBackground":
            node.inputs["Color"].default_value = (*colour.tolist(), 1.0)
            node.inputs["Strength"].default_value = 1.0


def _menu(self: Any, _context: Any) -> None:
    self.layout.operator(ImportDecogs.bl_idname, text="decogs (.dgs)")


def register() -> None:
    """The operator and its menu entry."""
    bpy.utils.register_class(ImportDecogs)
    bpy.types.TOPBAR_MT_file_import.append(_menu)


def unregister() -> None:
    """Takes back what ``register`` did."""
    bpy.types.TOPBAR_MT_file_import.remove(_menu)
    bpy.utils.unregister_class(ImportDecogs)
