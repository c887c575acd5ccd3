"""Run inside Blender (4.5 or 5.x): imports a USD file of decogs-export with every splat's own colour and opacity.

    blender --python blender_attach_colours.py -- scene.usdc
    blender --background --python blender_attach_colours.py -- scene.usdc --render out.png --frame 5 --camera cam00

Blender imports point instancers without their colours; the file carries them on a points object beside each, in the
same order. For every pair this script reads them by index in the instancer's geometry nodes, gives the splats
a material that shows them, hides the points, and sets the frame rate.
It is a script of Blender's, not a module of the toolkit.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

TRANSPARENT_BOUNCES = 64
"""How many splats a ray may pass through; fewer is faster, too few turns dense places black."""


def import_scene(bpy: Any, path: Path) -> list[Any]:
    """Imports the file, with its frame range and rate; returns the new objects."""
    before = set(bpy.data.objects)
    bpy.ops.wm.usd_import(filepath=str(path), import_cameras=True, set_frame_range=True)
    bpy.utils.expose_bundled_modules()
    from pxr import Usd

    rate = Usd.Stage.Open(str(path)).GetTimeCodesPerSecond()
    bpy.context.scene.render.fps = max(1, round(rate))
    bpy.context.scene.render.fps_base = bpy.context.scene.render.fps / rate
    return [item for item in bpy.data.objects if item not in before]


def splat_material(bpy: Any) -> Any:
    """Emits the instance's displayColor, transparent by its displayOpacity."""
    material = bpy.data.materials.new("Splat")
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    colour, opacity = (tree.nodes.new("ShaderNodeAttribute") for _ in range(2))
    for node, name in ((colour, "displayColor"), (opacity, "displayOpacity")):
        node.attribute_type = "INSTANCER"
        node.attribute_name = name
    emission = tree.nodes.new("ShaderNodeEmission")
    clear = tree.nodes.new("ShaderNodeBsdfTransparent")
    mix = tree.nodes.new("ShaderNodeMixShader")
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(colour.outputs["Color"], emission.inputs["Color"])
    tree.links.new(opacity.outputs["Fac"], mix.inputs[0])
    tree.links.new(clear.outputs[0], mix.inputs[1])
    tree.links.new(emission.outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], output.inputs["Surface"])
    return material


def attach(bpy: Any, instancer: Any, points: Any, material: Any) -> None:
    """Copies displayColor and displayOpacity of ``points`` to the instances of ``instancer``, row by row."""
    tree = next(modifier.node_group for modifier in instancer.modifiers if modifier.type == "NODES")
    place = next(node for node in tree.nodes if node.bl_idname == "GeometryNodeInstanceOnPoints")
    source = tree.nodes.new("GeometryNodeObjectInfo")
    source.inputs["Object"].default_value = points
    index = tree.nodes.new("GeometryNodeInputIndex")
    geometry = place.inputs["Points"].links[0].from_socket
    for name, kind in (("displayColor", "FLOAT_COLOR"), ("displayOpacity", "FLOAT")):
        read = tree.nodes.new("GeometryNodeInputNamedAttribute")
        read.data_type = kind
        read.inputs["Name"].default_value = name
        sample = tree.nodes.new("GeometryNodeSampleIndex")
        sample.data_type = kind
        sample.domain = "POINT"
        store = tree.nodes.new("GeometryNodeStoreNamedAttribute")
        store.data_type = kind
        store.domain = "POINT"
        store.inputs["Name"].default_value = name
        tree.links.new(source.outputs["Geometry"], sample.inputs["Geometry"])
        tree.links.new(read.outputs["Attribute"], sample.inputs["Value"])
        tree.links.new(index.outputs["Index"], sample.inputs["Index"])
        tree.links.new(geometry, store.inputs["Geometry"])
        tree.links.new(sample.outputs["Value"], store.inputs["Value"])
        geometry = store.outputs["Geometry"]
    tree.links.new(geometry, place.inputs["Points"])
    paint = tree.nodes.new("GeometryNodeSetMaterial")
    paint.inputs["Material"].default_value = material
    prototype = place.inputs["Instance"].links[0].from_socket
    tree.links.new(prototype, paint.inputs["Geometry"])
    tree.links.new(paint.outputs["Geometry"], place.inputs["Instance"])
    points.hide_render = True
    points.hide_set(True)


def attach_all(bpy: Any, objects: list[Any]) -> int:
    """Pairs each instancer <name> with its <name>Points; returns how many pairs there were."""
    clouds = {item.name.partition(".")[0]: item for item in objects if item.type == "POINTCLOUD"}
    material = splat_material(bpy)
    pairs = [(item, clouds[f"{name}Points"]) for name, item in clouds.items() if f"{name}Points" in clouds]
    for instancer, points in pairs:
        attach(bpy, instancer, points, material)
    return len(pairs)


def show_faithfully(bpy: Any) -> None:
    """Display colours as stored (no film-like view transform) and enough transparent bounces."""
    scene = bpy.context.scene
    scene.view_settings.view_transform = "Standard"
    scene.cycles.transparent_max_bounces = TRANSPARENT_BOUNCES


def render(bpy: Any, arguments: argparse.Namespace, objects: list[Any]) -> None:
    """One picture of these objects alone, through the first camera whose name begins as asked."""
    scene = bpy.context.scene
    cameras = [item for item in objects if item.type == "CAMERA" and item.name.startswith(arguments.camera)]
    if not cameras:
        raise SystemExit(f"{arguments.usd}: has no camera whose name begins with {arguments.camera!r}")
    scene.camera = cameras[0]
    for other in set(bpy.data.objects) - set(objects):
        other.hide_render = True
    scene.render.engine = "CYCLES"
    scene.cycles.samples = arguments.samples
    scene.render.resolution_x, scene.render.resolution_y = arguments.size
    scene.render.resolution_percentage = 100
    scene.frame_set(arguments.frame)
    scene.render.filepath = str(arguments.render.resolve())
    bpy.ops.render.render(write_still=True)


def parse(words: list[str]) -> argparse.Namespace:
    """The words after ``--`` on Blender's command line."""
    parser = argparse.ArgumentParser(prog="blender --python blender_attach_colours.py --")
    parser.add_argument("usd", type=Path)
    parser.add_argument("--render", type=Path, metavar="PNG", help="render one picture and stop")
    parser.add_argument("--camera", default="", help="camera to render through (default: the first)")
    parser.add_argument("--frame", type=int, default=0)
    parser.add_argument("--size", type=int, nargs=2, default=(640, 480), metavar=("W", "H"))
    parser.add_argument("--samples", type=int, default=16)
    return parser.parse_args(words)


def main(words: list[str]) -> None:
    """Imports, attaches, and renders if asked."""
    import bpy  # type: ignore[import-not-found]

    arguments = parse(words)
    objects = import_scene(bpy, arguments.usd)
    show_faithfully(bpy)
    print(f"{attach_all(bpy, objects)} groups of splats coloured")
    if arguments.render is not None:
        render(bpy, arguments, objects)


if __name__ == "__main__":
    main(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:])
