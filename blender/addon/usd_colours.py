"""Object > decogs: colours for USD imports: USD files of decogs-export look like the stream that they were made of.

Blender imports point instancers without their colours. The file has them on a points object beside each, in the same
order (`formats/usd/writing.py`); they are read by index in the instancer's geometry nodes.
"""

from __future__ import annotations

from typing import Any

import bpy

from .import_stream import set_rate, show_faithfully
from .splat_nodes import add_camera, ellipsoid, low_pass, product, set_camera, splat_material
from .timeline import PAINTED


class AttachUsdColours(bpy.types.Operator):  # type: ignore[misc]
    """Give the Gaussians of imported USD files of decogs-export their colours and opacities"""

    bl_idname = "object.decogs_usd_colours"
    bl_label = "decogs: colours for USD imports"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 (Blender reads it)

    colours: bpy.props.EnumProperty(  # type: ignore[valid-type]
        name="Colours",
        items=[
            ("DISPLAY", "As decoded", "Blended sRGB-coded. Right in view transform Raw, which has no lighting"),
            ("LINEAR", "Linear", "In linear light, beside other objects. Softer than decoded pictures are"),
        ],
    )
    set_rate: bpy.props.BoolProperty(  # type: ignore[valid-type]
        name="Set frame rate", default=True, description="The scene gets the rate of the file"
    )
    set_view: bpy.props.BoolProperty(  # type: ignore[valid-type]
        name="Set view and render",
        default=True,
        description="The scene gets the view transform that the colours need, and Cycles with enough bounces",
    )

    def execute(self, context: Any) -> set[str]:
        pairs = unpainted(context.scene)
        if not pairs:
            self.report({"ERROR"}, "no Gaussians without colours are here; import a USD file of decogs-export first")
            return {"CANCELLED"}
        material = splat_material(
            "decogs USD splat", "displayColor", "displayOpacity", to_display=self.colours == "DISPLAY"
        )
        for instancer, points in pairs:
            attach(instancer, points, material)
            set_camera(instancer, context.scene)
        if self.set_view:
            show_faithfully(context.scene, self.colours)
        rate = _rate(pairs[0][1]) if self.set_rate else None
        if rate:
            set_rate(context.scene, rate)
        self.report({"INFO"}, f"{len(pairs)} groups of Gaussians have their colours")
        return {"FINISHED"}


def unpainted(scene: Any) -> list[tuple[Any, Any]]:
    """Instancers <name> with their <name>Points, of one import each, that have no colours yet."""
    clouds = {item.name: item for item in scene.objects if item.type == "POINTCLOUD"}
    pairs = []
    for name, item in clouds.items():
        base, dot, number = name.partition(".")
        points = clouds.get(f"{base}Points{dot}{number}")
        if points is not None and PAINTED not in item and _place(item) is not None:
            pairs.append((item, points))
    return pairs


def attach(instancer: Any, points: Any, material: Any) -> None:
    """Copies displayColor and displayOpacity of ``points`` to the instances of ``instancer``, row by row.

    Scales are standard deviations there, too: an ellipsoid large enough for the falloff replaces the file's sphere, and
    the low-pass filter is that of an imported stream. The points are no longer drawn.
    """
    place = _place(instancer)
    tree = place.id_data
    add_camera(tree)
    given = next(node for node in tree.nodes if node.bl_idname == "NodeGroupInput")
    scale, rotation = (place.inputs[name].links[0].from_socket for name in ("Scale", "Rotation"))
    scales, kept = low_pass(tree, given, scale, rotation)
    tree.links.new(scales, place.inputs["Scale"])
    source = tree.nodes.new("GeometryNodeObjectInfo")
    source.inputs["Object"].default_value = points
    index = tree.nodes.new("GeometryNodeInputIndex")
    geometry = place.inputs["Points"].links[0].from_socket
    for name, kind, factor in (("displayColor", "FLOAT_COLOR", None), ("displayOpacity", "FLOAT", kept)):
        geometry = _stored(tree, geometry, source, index, name, kind, factor)
    tree.links.new(geometry, place.inputs["Points"])
    tree.links.new(ellipsoid(tree, material), place.inputs["Instance"])
    place.inputs["Pick Instance"].default_value = False
    for link in place.inputs["Pick Instance"].links:
        tree.links.remove(link)
    instancer[PAINTED] = True
    points.hide_render = True
    points.hide_set(True)


def _stored(tree: Any, geometry: Any, source: Any, index: Any, name: str, kind: str, factor: Any) -> Any:
    """The points with an attribute of another object, by index, times a ``factor`` if there is one."""
    read = tree.nodes.new("GeometryNodeInputNamedAttribute")
    read.data_type = kind
    read.inputs["Name"].default_value = name
    sample = tree.nodes.new("GeometryNodeSampleIndex")
    sample.data_type, sample.domain = kind, "POINT"
    store = tree.nodes.new("GeometryNodeStoreNamedAttribute")
    store.data_type, store.domain = kind, "POINT"
    store.inputs["Name"].default_value = name
    tree.links.new(source.outputs["Geometry"], sample.inputs["Geometry"])
    tree.links.new(read.outputs["Attribute"], sample.inputs["Value"])
    tree.links.new(index.outputs["Index"], sample.inputs["Index"])
    tree.links.new(geometry, store.inputs["Geometry"])
    value = sample.outputs["Value"] if factor is None else product(tree, sample.outputs["Value"], factor)
    tree.links.new(value, store.inputs["Value"])
    return store.outputs["Geometry"]


def _place(item: Any) -> Any:
    """The node that puts the instances on an imported instancer's points; None where there is none."""
    groups = [modifier.node_group for modifier in item.modifiers if modifier.type == "NODES" and modifier.node_group]
    return next((n for tree in groups for n in tree.nodes if n.bl_idname == "GeometryNodeInstanceOnPoints"), None)


def _rate(points: Any) -> float | None:
    """Time codes per second of the file that the points came from; None if unknown."""
    files = [m.cache_file for m in points.modifiers if m.type == "MESH_SEQUENCE_CACHE" and m.cache_file]
    if not files:
        return None
    if hasattr(bpy.utils, "expose_bundled_modules"):
        bpy.utils.expose_bundled_modules()
    try:
        from pxr import Usd
    except ImportError:
        return None
    return float(Usd.Stage.Open(bpy.path.abspath(files[0].filepath)).GetTimeCodesPerSecond())


def _menu(self: Any, _context: Any) -> None:
    self.layout.operator(AttachUsdColours.bl_idname)


def register() -> None:
    """The operator and its menu entry."""
    bpy.utils.register_class(AttachUsdColours)
    bpy.types.VIEW3D_MT_object.append(_menu)


def unregister() -> None:
    """Takes back what ``register`` did."""
    bpy.types.VIEW3D_MT_object.remove(_menu)
    bpy.utils.unregister_class(AttachUsdColours)
