"""``bigtri info MODEL``: what a model file holds, what of it is drawn, what is not, and why; plain text."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..scene.load import read_model
from ..scene.readers.assemble import assemble
from ..scene.readers.model import Model, ModelError
from ..scene.scene import Scene


def describe(path: Path) -> str:
    """One "name: value" a line.

    Raises:
        OSError, ValueError: as ``load_scene``, except that a file without triangles is described too.
    """
    model = read_model(path)
    lines = [("file", f"{path}, {path.stat().st_size} bytes"), *_contents(model)]
    try:
        lines += _drawn(assemble(model))
    except ModelError as error:
        lines.append(("drawn", f"nothing: {error}"))
    nothing = [("not drawn", "nothing is left out")]
    lines += [
        (f"not drawn, {found.kind}", f"{found.text} (found: {found.count})") for found in model.findings.values()
    ] or nothing
    width = max(len(name) for name, _ in lines) + 2
    return "\n".join(f"{name + ':':<{width}}{value}" for name, value in lines)


def _contents(model: Model) -> list[tuple[str, str]]:
    meshes = model.meshes
    paints = {id(mesh.paint): mesh.paint for mesh in meshes if mesh.paint is not None}
    images = {id(paint.texture): paint.texture for paint in paints.values() if paint.texture is not None}
    arrays = {id(mesh.positions): len(mesh.positions) for mesh in meshes}
    attributes = [
        name
        for name, key in (("normals", "normals"), ("texture coordinates", "uvs"), ("colours", "colors"))
        if any(getattr(mesh, key) is not None for mesh in meshes)
    ]
    sizes = [f"{texture.shape[1]}x{texture.shape[0]} {texture.dtype}" for texture in images.values()]
    carried = {"points and lines": len(model.strokes), "cameras": len(model.cameras), "lamps": len(model.lamps)}
    return [
        ("meshes", f"{len(meshes)}, placed {sum(len(mesh.transforms) for mesh in meshes)} times"),
        ("triangles", str(sum(len(mesh.triangles) for mesh in meshes))),
        ("vertices", f"{sum(arrays.values())}, with {', '.join(attributes) or 'positions alone'}"),
        ("materials", str(len(paints))),
        ("images", f"{len(images)}{': ' if sizes else ''}{', '.join(sizes)}"),
        *((name, str(count)) for name, count in carried.items() if count),
    ]


def _drawn(scene: Scene) -> list[tuple[str, str]]:
    materials = [scene.materials[i] for i in scene.used_materials]
    textured = sum(material.texture is not None for material in materials)
    two_sided = sum(material.two_sided for material in materials)
    low, high = (" ".join(f"{value:.6g}" for value in corner) for corner in np.asarray(scene.bounds))
    return [
        ("drawn", f"{len(scene.triangles)} triangles, {len(scene.positions)} vertices"),
        ("drawn with", f"{len(materials)} materials, {textured} with a texture, {two_sided} lit from both sides"),
        ("drawn from", f"{low} to {high} (x y z)"),
    ]
