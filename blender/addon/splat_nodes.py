"""What draws Gaussians in Blender: instances of an icosahedron, and a material that falls off as a Gaussian does."""

from __future__ import annotations

from typing import Any

import bpy

FRACTION, PIXEL, NEAR = "Viewport fraction", "Pixel", "Near"
"""Inputs of the geometry nodes."""
CUT = 3.0
"""Standard deviations at which a Gaussian ends; its opacity is 1.1 % of its peak's there."""
_BLUR = 0.3
"""Variance of the renderer's low-pass filter, square pixels."""
_NOWHERE_NEAR = -1e9
"""A near plane that everything lies beyond."""
_INRADIUS = 0.93
"""Of an icosphere of two subdivisions with corners at 1 (0.934): the ellipsoid at ``CUT`` lies within. One of
one has a quarter of the faces for a surface a third larger, and took half as long again to render."""


def splat_material(name: str, colour: str, opacity: str, *, to_display: bool = False) -> Any:
    """A material that emits the instance's ``colour`` through its ``opacity``, less by exp(-d^2 / 2).

    d: the distance, in standard deviations, at which the ray passes the centre; for that an instance's own space has
    these as its unit. The far side counts, the near one is clear: Blender blends along a ray by where it meets them,
    our renderer by centres. Ordered by near sides, large Gaussians hide small ones that lie before their centre.
    ``to_display``: colours are linear and shall be emitted sRGB-coded.
    """
    material = bpy.data.materials.new(name)
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    if hasattr(material, "surface_render_method"):
        # EEVEE: right in the mean whatever the order of the instances, which it does not sort.
        material.surface_render_method = "DITHERED"
    tree = material.node_tree
    tree.nodes.clear()
    link, node = tree.links.new, tree.nodes.new
    geometry = node("ShaderNodeNewGeometry")
    place = _transform(tree, "POINT", geometry.outputs["Position"])
    ray = _vector(tree, "NORMALIZE", _transform(tree, "VECTOR", geometry.outputs["Incoming"]))
    offset = _vector(tree, "CROSS_PRODUCT", place, ray)
    squared = _vector(tree, "DOT_PRODUCT", offset, offset, output="Value")
    falloff = _math(tree, "EXPONENT", _math(tree, "MULTIPLY", squared, -0.5))
    peak = _attribute(tree, opacity).outputs["Fac"]
    alpha = _math(tree, "MULTIPLY", _math(tree, "MULTIPLY", falloff, peak), geometry.outputs["Backfacing"])
    emission, clear = node("ShaderNodeEmission"), node("ShaderNodeBsdfTransparent")
    mix, output = node("ShaderNodeMixShader"), node("ShaderNodeOutputMaterial")
    shade = _attribute(tree, colour).outputs["Color"]
    link(_display(tree, shade) if to_display else shade, emission.inputs["Color"])
    link(alpha, mix.inputs[0])
    link(clear.outputs[0], mix.inputs[1])
    link(emission.outputs[0], mix.inputs[2])
    link(mix.outputs[0], output.inputs["Surface"])
    _in_columns(tree)
    return material


def splat_group(material: Any) -> Any:
    """Geometry nodes that put an ellipsoid on every point by its attributes rotation and scale.

    The input "Viewport fraction" thins them out in the viewport, by the attribute rank; renders have all. The input
    "Pixel" is the width of one, seen from the scene's camera, as the tangent of its angle: Gaussians are not smaller.
    "Near" is that camera's near plane: a Gaussian whose centre lies before it is not drawn, as in the decoder.
    """
    tree = bpy.data.node_groups.new("decogs splats", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    fraction = tree.interface.new_socket(FRACTION, in_out="INPUT", socket_type="NodeSocketFloat")
    fraction.default_value, fraction.min_value, fraction.max_value = 1.0, 0.0, 1.0
    add_camera(tree)
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    link, node = tree.links.new, tree.nodes.new
    given, made = node("NodeGroupInput"), node("NodeGroupOutput")
    beyond = _math(tree, "GREATER_THAN", _named(tree, "rank", "FLOAT"), given.outputs[FRACTION])
    viewport = node("GeometryNodeIsViewport").outputs[0]
    thinned = node("GeometryNodeDeleteGeometry")
    link(given.outputs["Geometry"], thinned.inputs["Geometry"])
    link(_math(tree, "MULTIPLY", beyond, viewport), thinned.inputs["Selection"])
    scale, rotation = _named(tree, "scale", "FLOAT_VECTOR"), _named(tree, "rotation", "QUATERNION")
    scales, kept = low_pass(tree, given, scale, rotation)
    dimmed = node("GeometryNodeStoreNamedAttribute")
    dimmed.data_type, dimmed.domain = "FLOAT", "POINT"
    dimmed.inputs["Name"].default_value = "opacity"
    link(thinned.outputs["Geometry"], dimmed.inputs["Geometry"])
    link(_math(tree, "MULTIPLY", _named(tree, "opacity", "FLOAT"), kept), _enabled(dimmed.inputs, "Value"))
    instances = node("GeometryNodeInstanceOnPoints")
    link(dimmed.outputs["Geometry"], instances.inputs["Points"])
    link(ellipsoid(tree, material), instances.inputs["Instance"])
    link(rotation, instances.inputs["Rotation"])
    link(scales, instances.inputs["Scale"])
    link(instances.outputs["Instances"], made.inputs["Geometry"])
    _in_columns(tree)
    return tree


def add_camera(tree: Any) -> None:
    """Gives geometry nodes the inputs "Pixel" and "Near", without a camera at first."""
    pixel = tree.interface.new_socket(PIXEL, in_out="INPUT", socket_type="NodeSocketFloat")
    pixel.default_value, pixel.min_value = 0.0, 0.0
    near = tree.interface.new_socket(NEAR, in_out="INPUT", socket_type="NodeSocketFloat")
    near.default_value = _NOWHERE_NEAR


def set_input(item: Any, name: str, value: float) -> None:
    """Sets an input of the geometry nodes of an object that shows a stream, where it differs."""
    for modifier in item.modifiers:
        if modifier.type == "NODES" and modifier.node_group:
            for socket in modifier.node_group.interface.items_tree:
                if socket.name == name:
                    _set(modifier, socket.identifier, value)
                    item.update_tag()


def _set(modifier: Any, identifier: str, value: float) -> None:
    # Blender 5.2 has a place of their own for inputs; before, they are custom properties of the modifier.
    inputs = getattr(getattr(modifier, "properties", None), "inputs", None)
    if inputs is not None:
        getattr(inputs, identifier).value = value
    else:
        modifier[identifier] = value


def set_camera(item: Any, scene: Any) -> None:
    """Sets both of an object that shows Gaussians for the scene's camera."""
    pixel = pixel_of(scene)
    set_input(item, PIXEL, pixel)
    # In the object's own units, as depths are there.
    unit = max(item.matrix_world.to_scale())
    set_input(item, NEAR, scene.camera.data.clip_start / unit if pixel and unit > 0 else _NOWHERE_NEAR)


def pixel_of(scene: Any) -> float:
    """The width of a pixel of the scene's camera, at a distance of 1; 0 without a camera in perspective."""
    if scene.camera is None or scene.camera.type != "CAMERA" or scene.camera.data.type != "PERSP":
        return 0.0
    corners = scene.camera.data.view_frame(scene=scene)
    width = max(corner.x for corner in corners) - min(corner.x for corner in corners)
    pixels = scene.render.resolution_x * scene.render.resolution_percentage / 100
    return float(width / -corners[0].z / pixels)


def ellipsoid(tree: Any, material: Any) -> Any:
    """The surface around a Gaussian up to ``CUT``, in its own space, with its material: a socket of geometry."""
    ball = tree.nodes.new("GeometryNodeMeshIcoSphere")
    ball.inputs["Radius"].default_value = CUT / _INRADIUS
    ball.inputs["Subdivisions"].default_value = 2
    painted = tree.nodes.new("GeometryNodeSetMaterial")
    painted.inputs["Material"].default_value = material
    tree.links.new(ball.outputs["Mesh"], painted.inputs["Geometry"])
    return painted.outputs["Geometry"]


def low_pass(tree: Any, given: Any, scale: Any, rotation: Any) -> tuple[Any, Any]:
    """Scales with the renderer's low-pass filter, and the part of the opacity that this leaves: sockets from sockets.

    ``given``: the node of the group's inputs. Before the near plane nothing is left.

    The filter adds 0.3 square pixels to the variance in the picture (decoder/rasterise/kernel/project.h); here it adds
    as much in all directions at the Gaussian's depth. Opacity is kept so that what a Gaussian covers stays (Yu 2024,
    Mip-Splatting, equation 9): the root of the ratio of the variances' determinants in the picture, which are
    det(S) d^T S^-1 d, seen along d.
    """
    link, node = tree.links.new, tree.nodes.new
    active, camera = node("GeometryNodeInputActiveCamera"), node("GeometryNodeObjectInfo")
    camera.transform_space = "RELATIVE"
    link(active.outputs[0], camera.inputs["Object"])
    offset = _vector(tree, "SUBTRACT", node("GeometryNodeInputPosition").outputs[0], camera.outputs["Location"])
    forward = _rotate(tree, (0.0, 0.0, -1.0), camera.outputs["Rotation"])
    depth = _vector(tree, "DOT_PRODUCT", offset, forward, output="Value")
    sigma = _math(tree, "MULTIPLY", _math(tree, "MULTIPLY", depth, given.outputs[PIXEL]), _BLUR**0.5)
    added = _math(tree, "MULTIPLY", sigma, sigma)
    before = _vector(tree, "MULTIPLY", scale, scale)
    after = _vector(tree, "ADD", before, added)
    back = node("FunctionNodeInvertRotation")
    link(rotation, back.inputs[0])
    along = _rotate(tree, offset, back.outputs[0])
    squared = _vector(tree, "MULTIPLY", along, along)
    seen = [
        _vector(tree, "DOT_PRODUCT", _vector(tree, "DIVIDE", squared, variance), (1.0,) * 3, output="Value")
        for variance in (before, after)
    ]
    ratios, roots = node("ShaderNodeSeparateXYZ"), node("ShaderNodeSeparateXYZ")
    link(_vector(tree, "DIVIDE", before, after), ratios.inputs[0])
    link(after, roots.inputs[0])
    x, y, z = ratios.outputs
    volume = _math(tree, "MULTIPLY", _math(tree, "MULTIPLY", x, y), z)
    kept = _math(tree, "SQRT", _math(tree, "MULTIPLY", volume, _math(tree, "DIVIDE", *seen)))
    kept = _math(tree, "MULTIPLY", kept, _math(tree, "GREATER_THAN", depth, given.outputs[NEAR]))
    scales = node("ShaderNodeCombineXYZ")
    for root, into in zip(roots.outputs, scales.inputs, strict=True):
        link(_math(tree, "SQRT", root), into)
    return scales.outputs[0], kept


def _rotate(tree: Any, vector: Any, rotation: Any) -> Any:
    turn = tree.nodes.new("FunctionNodeRotateVector")
    _operate(tree, turn, (vector, rotation))
    return turn.outputs[0]


def _named(tree: Any, name: str, kind: str) -> Any:
    read = tree.nodes.new("GeometryNodeInputNamedAttribute")
    read.data_type = kind
    read.inputs["Name"].default_value = name
    return _enabled(read.outputs, "Attribute")


def _enabled(sockets: Any, name: str) -> Any:
    """Of the sockets of that name, one for every data type in Blender 4.2, the one in use."""
    return next(socket for socket in sockets if socket.enabled and socket.name == name)


def _attribute(tree: Any, name: str) -> Any:
    read = tree.nodes.new("ShaderNodeAttribute")
    read.attribute_type, read.attribute_name = "INSTANCER", name
    return read


def _transform(tree: Any, kind: str, source: Any) -> Any:
    """World to the instance's own space."""
    turn = tree.nodes.new("ShaderNodeVectorTransform")
    turn.vector_type, turn.convert_from, turn.convert_to = kind, "WORLD", "OBJECT"
    tree.links.new(source, turn.inputs[0])
    return turn.outputs[0]


def _operate(tree: Any, node: Any, sources: tuple[Any, ...]) -> None:
    for socket, source in zip(node.inputs, sources, strict=False):
        if isinstance(source, (float, tuple)):
            socket.default_value = source
        else:
            tree.links.new(source, socket)


def product(tree: Any, left: Any, right: Any) -> Any:
    """A socket of the product of two numbers."""
    return _math(tree, "MULTIPLY", left, right)


def _math(tree: Any, operation: str, *sources: Any) -> Any:
    node = tree.nodes.new("ShaderNodeMath")
    node.operation = operation
    _operate(tree, node, sources)
    return node.outputs[0]


def _vector(tree: Any, operation: str, *sources: Any, output: str = "Vector") -> Any:
    node = tree.nodes.new("ShaderNodeVectorMath")
    node.operation = operation
    _operate(tree, node, sources)
    return node.outputs[output]


def _display(tree: Any, colour: Any) -> Any:
    """sRGB's upper branch, 1.055 c^(1/2.4) - 0.055, not below 0; its toe, two levels, is left out."""
    power = tree.nodes.new("ShaderNodeGamma")
    power.inputs["Gamma"].default_value = 1 / 2.4
    tree.links.new(colour, power.inputs["Color"])
    coded = _vector(tree, "MULTIPLY_ADD", power.outputs[0], (1.055,) * 3, (-0.055,) * 3)
    return _vector(tree, "MAXIMUM", coded, (0.0,) * 3)


def _in_columns(tree: Any) -> None:
    """Lays the nodes out, so that who opens the editor sees more than a heap."""
    for number, node in enumerate(tree.nodes):
        node.location = (number // 4 * 220, -(number % 4) * 220)
