"""Helpers for building Cycles node graphs, and cheap shaders: diffuse plus a glossy coat.

Renders with Principled BSDF take 10 to 20 % longer.
"""

import hashlib
import os
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from PIL import Image

from synth3dlanes.scene.assets.built_in import assets_dir
from synth3dlanes.scene.settings import SCRATCH
from synth3dlanes.system.files import Folder, encoded

Socket = Any  # an output socket, a number or a tuple: the value of a node input


class ShaderGraph:
    """Builds one node tree; each method adds a node and returns it or its output."""

    def __init__(self, tree: Any) -> None:
        self.tree = tree

    def node(self, kind: str, inputs: dict[str | int, Socket] | None = None, **settings: Any) -> Any:
        """Add a node, set its properties, and connect or set its inputs."""
        node = self.tree.nodes.new(kind)
        for name, value in settings.items():
            setattr(node, name, value)
        for key, value in (inputs or {}).items():
            self.plug(node.inputs[key], value)
        return node

    def plug(self, socket: Any, value: Socket) -> None:
        """Connect an output to an input, or set the input's value."""
        if isinstance(value, bpy.types.NodeSocket):
            self.tree.links.new(value, socket)
        elif isinstance(value, tuple) and socket.type == "RGBA" and len(value) == 3:
            socket.default_value = (*value, 1.0)
        else:
            socket.default_value = value

    def value(self, name: str, default: float = 0.0) -> Any:
        """A named number that `set_materials` changes per scene."""
        node = self.node("ShaderNodeValue", name=name, label=name)
        node.outputs[0].default_value = default
        return node.outputs[0]

    def math(self, operation: str, a: Socket, b: Socket = 0.0, c: Socket = 0.0) -> Any:
        """A scalar operation."""
        return self.node("ShaderNodeMath", {0: a, 1: b, 2: c}, operation=operation).outputs[0]

    def vector(self, operation: str, a: Socket, b: Socket = (0.0, 0.0, 0.0), c: Socket = (0.0, 0.0, 0.0)) -> Any:
        """A vector operation; colours pass as vectors."""
        return self.node("ShaderNodeVectorMath", {0: a, 1: b, 2: c}, operation=operation).outputs[0]

    def vector_dot(self, a: Socket, b: Socket) -> Any:
        """The dot product of two vectors."""
        return self.node("ShaderNodeVectorMath", {0: a, 1: b}, operation="DOT_PRODUCT").outputs["Value"]

    def scale(self, a: Socket, factor: Socket) -> Any:
        """A vector times a number."""
        return self.node("ShaderNodeVectorMath", {0: a, "Scale": factor}, operation="SCALE").outputs[0]

    def clamp(self, a: Socket) -> Any:
        """A number clamped to 0..1."""
        return self.node("ShaderNodeClamp", {0: a}).outputs[0]

    def mix(self, a: Socket, b: Socket, factor: Socket) -> Any:
        """The number `a` where the factor is 0, `b` where it is 1."""
        return self.node("ShaderNodeMix", {0: factor, 2: a, 3: b}, data_type="FLOAT").outputs[0]

    def mix_color(self, a: Socket, b: Socket, factor: Socket) -> Any:
        """`a` where the factor is 0, `b` where it is 1."""
        node = self.tree.nodes.new("ShaderNodeMix")
        node.data_type = "RGBA"
        self.plug(node.inputs[0], factor)
        self.plug(node.inputs[6], a)
        self.plug(node.inputs[7], b)
        return node.outputs[2]

    def surface(self, node: Any) -> None:
        """Make a shader the material's surface."""
        self.node("ShaderNodeOutputMaterial", {"Surface": node.outputs[0]})


def new_material(name: str, semantic_id: int) -> tuple[bpy.types.Material, ShaderGraph]:
    """An empty material whose `pass_index` is its semantic id."""
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    material.node_tree.nodes.clear()
    material.pass_index = semantic_id
    material.use_fake_user = True
    return material, ShaderGraph(material.node_tree)


def set_value(material: bpy.types.Material, name: str, value: float) -> None:
    """Set a number that `ShaderGraph.value` named."""
    socket = material.node_tree.nodes[name].outputs[0]
    if socket.default_value != np.float32(value):  # each change costs Blender an update of the material
        socket.default_value = value


def texture(graph: ShaderGraph, file: Path | str, vector: Socket, is_color: bool) -> Any:
    """The colour output of a repeating texture: a built-in one by name, or any file by its absolute path."""
    image = bpy.data.images.load(str(quick_copy(assets_dir() / "textures" / file)), check_existing=True)
    image.colorspace_settings.name = "sRGB" if is_color else "Non-Color"
    return graph.node("ShaderNodeTexImage", {"Vector": vector}, image=image).outputs["Color"]


def quick_copy(file: Path) -> Path:
    """An uncompressed copy of a JPEG in the scratch folder that a run's workers share, created on first use. Returns
    the file itself if there is no such folder or the copy fails.

    Cycles reads every file again for every render: decoding JPEG costs 2 % of an image at the default settings. Packing
    a file into Blender costs more than it saves.
    """
    scratch = os.environ.get(SCRATCH)
    if scratch is None or file.suffix.lower() not in (".jpg", ".jpeg"):
        return file
    copy = Path(scratch) / f"{file.stem}-{hashlib.sha256(str(file).encode()).hexdigest()[:16]}.tif"
    if not copy.exists():
        with suppress(OSError), Image.open(file) as picture:
            Folder(copy.parent).write(copy.name, encoded(partial(picture.save, format="TIFF")))
    return copy if copy.exists() else file


def coated(
    graph: ShaderGraph,
    color: Socket,
    roughness: Socket,
    amount: Socket,
    ior: float = 1.45,
    normal: Socket | None = None,
) -> None:
    """Diffuse under a glossy coat; the coat's share is `amount` times the Fresnel reflectance."""
    bend: dict[str | int, Socket] = {} if normal is None else {"Normal": normal}
    base = graph.node("ShaderNodeBsdfDiffuse", {"Color": color, **bend})
    coat = graph.node("ShaderNodeBsdfAnisotropic", {"Color": (1.0, 1.0, 1.0), "Roughness": roughness, **bend})
    fresnel = graph.node("ShaderNodeFresnel", {"IOR": ior, **bend})
    share = graph.math("MULTIPLY", fresnel.outputs[0], amount)
    graph.surface(graph.node("ShaderNodeMixShader", {0: share, 1: base.outputs[0], 2: coat.outputs[0]}))


def thing_paint(graph: ShaderGraph, number: int) -> None:
    """Matt cloth, skin or hair, whose colour (a display value, hence the gamma) is the object's property
    `paint{number}`."""
    own = graph.node("ShaderNodeAttribute", {}, attribute_type="OBJECT", attribute_name=f"paint{number}")
    color = graph.node("ShaderNodeGamma", {"Color": own.outputs["Color"], "Gamma": 2.0})
    graph.surface(graph.node("ShaderNodeBsdfDiffuse", {"Color": color.outputs[0]}))


def car_paint(graph: ShaderGraph) -> None:
    """Body paint: the object's colour (a display value, hence the gamma) under a clear coat with the object's gloss.
    Reads `object.color = (r, g, b, gloss)`."""
    info = graph.node("ShaderNodeObjectInfo")
    color = graph.node("ShaderNodeGamma", {"Color": info.outputs["Color"], "Gamma": 2.0})
    dim = graph.mix_color(color.outputs[0], (0.02, 0.02, 0.02), 0.12)
    roughness = graph.math("MULTIPLY_ADD", info.outputs["Alpha"], -0.28, 0.32)
    amount = graph.math("MULTIPLY_ADD", info.outputs["Alpha"], 0.7, 0.3)
    coated(graph, dim, roughness, amount)
