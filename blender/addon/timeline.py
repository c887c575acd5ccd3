"""Objects that show a stream follow the timeline: their mesh is filled anew whenever the frame changes."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy
import numpy as np
from bpy.app.handlers import persistent

from .splat_nodes import set_camera

if TYPE_CHECKING:
    from .playback import Playback, ShownFrame

_ATTRIBUTES = {
    "scale": ("FLOAT_VECTOR", "vector"),
    "rotation": ("QUATERNION", "value"),
    "opacity": ("FLOAT", "value"),
    "colour": ("FLOAT_COLOR", "color"),
    "rank": ("FLOAT", "value"),
    "id": ("INT", "value"),
    "id_high": ("INT", "value"),
}
"""Of every point: its data type in Blender, and what its values are called there."""

PAINTED = "decogs_colours"
"""Property of an imported USD instancer that has its colours."""

_open: dict[str, Playback] = {}
"""Streams by their path; those of the file that is loaded."""
_reported: set[str] = set()


class DecogsStream(bpy.types.PropertyGroup):  # type: ignore[misc]
    """What an object shows; saved with the .blend file."""

    path: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Stream", subtype="FILE_PATH", description="The .dgs file", update=lambda self, context: self.reload()
    )
    first_frame: bpy.props.IntProperty(  # type: ignore[valid-type]
        name="First frame",
        description="Frame of Blender's timeline that shows the stream's first one",
        update=lambda self, context: self.reload(),
    )
    linear: bpy.props.BoolProperty(name="Linear colours", options={"HIDDEN"})  # type: ignore[valid-type]
    problem: bpy.props.StringProperty(options={"SKIP_SAVE"})  # type: ignore[valid-type]

    def reload(self) -> None:
        """Shows the frame of now, from the file as it is now."""
        if self.id_data.type == "MESH":
            close(self.path)
            show(self.id_data, bpy.context.scene.frame_current)


class DECOGS_PT_stream(bpy.types.Panel):  # type: ignore[misc]
    """Object properties: the stream and its place on the timeline."""

    bl_label = "decogs stream"
    bl_space_type, bl_region_type, bl_context = "PROPERTIES", "WINDOW", "object"

    @classmethod
    def poll(cls, context: Any) -> bool:
        return bool(context.object and context.object.decogs.path)

    def draw(self, context: Any) -> None:
        for name in ("path", "first_frame"):
            self.layout.prop(context.object.decogs, name)
        if context.object.decogs.problem:
            self.layout.label(text=context.object.decogs.problem, icon="ERROR")


def playback(path: str) -> Playback:
    """The open stream at a path of Blender's (// is the .blend file's folder). Raises what opening it raises."""
    from .playback import Playback

    resolved = bpy.path.abspath(path)
    if resolved not in _open:
        _open[resolved] = Playback(Path(resolved), lambda damage: warn(str(damage)))
    return _open[resolved]


def close(path: str | None = None) -> None:
    """Closes the stream of a path, or all."""
    for name in [bpy.path.abspath(path)] if path is not None else list(_open):
        if name in _open:
            _open.pop(name).close()


def show(item: Any, scene_frame: int) -> None:
    """Fills the object's mesh; what is wrong with the stream goes to its panel and the console, once each."""
    settings = item.decogs
    try:
        frame = playback(settings.path).frame(scene_frame - settings.first_frame)
    except Exception as error:  # A handler that raises would stop the whole timeline.
        settings.problem = one_line(error, settings.path)
        warn(settings.problem)
        return
    if settings.problem:
        settings.problem = ""
    fill(item.data, frame, linear=settings.linear)


def fill(mesh: Any, frame: ShownFrame, *, linear: bool) -> None:
    """Points with the attributes that ``splat_nodes`` reads, and each Gaussian's id (low and high 32 bits)."""
    from decogs.formats.colours.srgb import linear_from_srgb

    from .playback import ranks

    count = len(frame.ids)
    if len(mesh.vertices) != count:
        mesh.clear_geometry()
        mesh.vertices.add(count)
    colours = np.ones((count, 4), np.float32)
    colours[:, :3] = linear_from_srgb(frame.colours) if linear else frame.colours
    halves = np.ascontiguousarray(frame.ids, "<i8").view("<i4").reshape(count, 2)
    values = {
        "scale": frame.scales,
        "rotation": frame.rotations,
        "opacity": frame.opacities,
        "colour": colours,
        "rank": ranks(frame.ids),
        "id": halves[:, 0],
        "id_high": halves[:, 1],
    }
    mesh.attributes["position"].data.foreach_set("vector", np.ascontiguousarray(frame.positions).ravel())
    for name, (kind, field) in _ATTRIBUTES.items():
        attribute = mesh.attributes.get(name) or mesh.attributes.new(name, kind, "POINT")
        attribute.data.foreach_set(field, np.ascontiguousarray(values[name]).ravel())
    mesh.update()


def one_line(error: BaseException, path: str) -> str:
    """What is wrong, for Blender's report and console."""
    if isinstance(error, ModuleNotFoundError):
        return f"{path}: this Blender's Python has no module {error.name}, which reading .dgs needs; install it there"
    if isinstance(error, OSError):
        return f"{path}: cannot be read ({error.strerror or error}); choose a .dgs file"
    return " ".join(str(error).split()) or type(error).__name__


def faults() -> list[str]:
    """What was wrong with streams since ``forget``, damage that is concealed included."""
    return sorted(_reported)


def forget() -> None:
    """From now on every fault is reported once more."""
    _reported.clear()


def warn(text: str) -> None:
    """To the console, once in a session."""
    if text not in _reported:
        _reported.add(text)
        print(f"decogs: {text}", file=sys.stderr)


def show_all(scene: Any) -> None:
    """Every stream of a scene, as its frame and its camera want it."""
    for item in streams(scene):
        show(item, scene.frame_current)
    filter_for_camera(scene)


def filter_for_camera(scene: Any) -> None:
    """Sets the low-pass filter and the near plane of streams and painted USD imports for the scene's camera."""
    for item in [*streams(scene), *(item for item in scene.objects if PAINTED in item)]:
        set_camera(item, scene)


def streams(scene: Any) -> list[Any]:
    """The objects that show one."""
    return [item for item in scene.objects if item.type == "MESH" and item.decogs.path]


@persistent  # type: ignore[untyped-decorator]
def _follow(scene: Any, _depsgraph: Any = None) -> None:
    show_all(scene)


@persistent  # type: ignore[untyped-decorator]
def _before_render(scene: Any, _depsgraph: Any = None) -> None:
    # The picture's size or the lens may have changed since the frame did.
    filter_for_camera(scene)


@persistent  # type: ignore[untyped-decorator]
def _another_file(*_: Any) -> None:
    close()
    _reported.clear()


_CLASSES = (DecogsStream, DECOGS_PT_stream)


def register() -> None:
    """Objects get the property ``decogs``; frames that change are followed before they are drawn."""
    for kind in _CLASSES:
        bpy.utils.register_class(kind)
    bpy.types.Object.decogs = bpy.props.PointerProperty(type=DecogsStream)
    bpy.app.handlers.frame_change_pre.append(_follow)
    bpy.app.handlers.render_init.append(_before_render)
    bpy.app.handlers.load_pre.append(_another_file)


def unregister() -> None:
    """Takes back what ``register`` did."""
    close()
    bpy.app.handlers.frame_change_pre.remove(_follow)
    bpy.app.handlers.render_init.remove(_before_render)
    bpy.app.handlers.load_pre.remove(_another_file)
    del bpy.types.Object.decogs
    for kind in reversed(_CLASSES):
        bpy.utils.unregister_class(kind)
