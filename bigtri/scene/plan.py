"""Effects: what a scene calls for, decided once, so that what it does not need is never run; docs/effects.md."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..reference.clip import clip_planes
from ..reference.numerics import LARGE_THRESHOLD
from .camera import Camera

if TYPE_CHECKING:
    from .scene import Material, Scene


@dataclass(frozen=True)
class RenderPlan:
    """Which effects ``render`` runs. One that is False costs nothing: its attributes are not even interpolated.

    A scene says per material which effects apply, so running one that no material calls for changes no bit: ``EVERYTHING`` and
    ``plan_for(scene)`` give the same picture. Leaving out one that a material does call for leaves it out of the picture, which
    ``render`` says in a warning.

    Culling is not here. It decides what is drawn, not how: at the silhouette of a closed surface a back face may win a pixel over
    the front face that it meets there, so that culling can change a bit. ``Scene.cull`` asks for it.

    Attributes:
        textures: textures are looked up.
        vertex_colors: vertex colours are interpolated.
        smooth_normals: vertex normals are interpolated.
        flat_normals: triangles' own normals are used.
        two_sided: normals of back faces are turned round.
        lights: there are lights beyond the ambient one. Without them no normal is needed.
    """

    textures: bool = True
    vertex_colors: bool = True
    smooth_normals: bool = True
    flat_normals: bool = True
    two_sided: bool = True
    lights: bool = True

    def __str__(self) -> str:
        names = [name.replace("_", " ") for name, on in vars(self).items() if on]
        return ", ".join(names) or "no effects"

    def checked(self, scene: Scene) -> RenderPlan:
        """This plan; warns of the effects that it leaves out though the scene calls for them."""
        needed = _switches(scene)
        missing = [f"{name} ({effect.why})" for name, effect in needed.items() if effect.on and not getattr(self, name)]
        if missing:
            text = f"bigtri.render: plan leaves out what the scene calls for, so the picture is another: {'; '.join(missing)}"
            warnings.warn(text, UserWarning, stacklevel=4)  # the line that called render
        return self


EVERYTHING = RenderPlan()


class Effect(NamedTuple):
    """One row of a ``Plan``."""

    name: str
    on: bool
    why: str  # the fact that calls for it, or rules it out
    cost: str  # what it costs where it is on


@dataclass(frozen=True)
class Plan:
    """What ``Scene.plan`` found: every effect, whether it runs, why, and what it costs. As text, a table.

    Attributes:
        effects: all of them.
        switches: those that a plan decides; ``render`` takes it as its ``plan``. The others follow from the data, triangle by
            triangle.
    """

    effects: tuple[Effect, ...]
    switches: RenderPlan

    def __str__(self) -> str:
        rows = [("effect", "", "why", "costs"), *((e.name, "on" if e.on else "off", e.why, e.cost) for e in self.effects)]
        widths = [max(len(row[i]) for row in rows) for i in range(3)]
        return "\n".join("  ".join([*map(str.ljust, row, widths), row[3]]).rstrip() for row in rows)


# What an effect costs where it is on, in work a pixel; docs/effects.md has what that is in time.
_COSTS = {
    "textures": "a covered pixel: 4 texels, 12 values decoded, 9 blends (nearest: 1 texel)",
    "vertex_colors": "a covered pixel: 3 values interpolated, 3 products",
    "smooth_normals": "a covered pixel: 3 values interpolated",
    "flat_normals": "a triangle: its normal, computed when the scene is uploaded",
    "two_sided": "a visible triangle: a determinant of three corners",
    "lights": "a covered pixel: a square root and 3 divisions; for each light 5 products, 3 sums and 3 products",
    "perspective": "a covered pixel: 6 divisions in float64",
    "clipping": "a triangle that crosses a plane: a polygon of up to 9 corners; its pixels find their part of it",
    "large_triangles": "a triangle: an entry in the list of each bin (64x64 px) that it meets; masks of the bins' tiles",
    "small_triangles": "a triangle: each row of its bounding box is cut to a span",
    "culling": "a triangle: the sign of its area, which is there anyway",
}


def plan_for(scene: Scene) -> RenderPlan:
    """The effects that materials in use and lights call for, and no other."""
    return RenderPlan(**{name: effect.on for name, effect in _switches(scene).items()})


def explain(
    scene: Scene,
    camera: Camera | None = None,
    resolution: tuple[int, int] | None = None,
    *,
    on: Iterable[str] = (),
    off: Iterable[str] = (),
    approximate: bool = False,
) -> Plan:
    """What ``Scene.plan`` returns; arguments as there."""
    forced_on, forced_off = set(on), set(off)
    switches = _switches(scene)
    allowed = ", ".join(map(repr, switches))
    for name, names in (("on", forced_on), ("off", forced_off)):
        if unknown := sorted(names - set(switches)):
            raise ValueError(f"bigtri.Scene.plan: {name} must hold some of {allowed}, got {unknown[0]!r}")
    if both := sorted(forced_on & forced_off):
        raise ValueError(f"bigtri.Scene.plan: on and off must not share an effect, got {both[0]!r} in both")
    effects = {}
    for name, effect in switches.items():
        if name in forced_on and not effect.on:
            effect = effect._replace(on=True, why=f"forced on; changes no bit: {effect.why}")
        if name in forced_off and effect.on:
            if not approximate:
                raise ValueError(
                    f"bigtri.Scene.plan: off must not hold {name!r}, which the scene calls for ({effect.why}); "
                    "pass approximate=True for the picture without it"
                )
            effect = effect._replace(on=False, why=f"forced off, so the picture is another: {effect.why}")
        effects[name] = effect
    rows = [*effects.values(), _culling(scene)]
    if camera is not None:
        height, width = resolution or (720, 1280)
        rows += _of_triangles(scene, camera, height, width)
    return Plan(tuple(rows), RenderPlan(**{name: effect.on for name, effect in effects.items()}))


def _switches(scene: Scene) -> dict[str, Effect]:
    """What a ``RenderPlan`` decides, by its attribute, as the materials in use and the lights call for it."""
    used = [scene.materials[m] for m in scene.used_materials]
    textured = [m for m in used if m.texture is not None]
    colored = [m for m in used if m.vertex_colors]
    smooth = [m for m in used if m.smooth and scene.normals is not None]
    flat = [m for m in used if not (m.smooth and scene.normals is not None)]
    turned = [m for m in used if m.two_sided]
    lit = len(scene.lights) > 0
    dark = "there are no lights, so no normal matters"
    facts = {
        "textures": _fact(
            [(scene.uvs is not None, "no texture coordinates"), (textured, "no material in use has a texture")],
            lambda: f"{_named(textured)}: {', '.join(sorted({_texture_kind(m) for m in textured}))}",
        ),
        "vertex_colors": _fact(
            [(scene.colors is not None, "no vertex colours"), (colored, "no material in use asks for vertex colours")],
            lambda: f"{_named(colored)} asked for",
        ),
        "smooth_normals": _fact(
            [(lit, dark), (scene.normals is not None, "no vertex normals"), (smooth, "no material in use is smooth")],
            lambda: f"{_named(smooth)} smooth",
        ),
        "flat_normals": _fact(
            [(lit, dark), (used, "nothing is drawn"), (flat, "all materials in use are smooth, and there are vertex normals")],
            lambda: f"{_named(flat)} flat" if scene.normals is not None else "no vertex normals",
        ),
        "two_sided": _fact([(lit, dark), (turned, "no material in use is two-sided")], lambda: f"{_named(turned)} two-sided"),
        "lights": _fact([(lit, "no light but the ambient one")], lambda: _counted(len(scene.lights), "light")),
    }
    return {name: Effect(name.replace("_", " "), on, why, _COSTS[name]) for name, (on, why) in facts.items()}


def _fact(conditions: list[tuple[object, str]], why: Callable[[], str]) -> tuple[bool, str]:
    """(True, why) where all conditions hold, else (False, the text of the first that does not)."""
    for holds, otherwise in conditions:
        if not holds:
            return False, otherwise
    return True, why()


def _culling(scene: Scene) -> Effect:
    on = scene.cull != "none"
    return Effect("culling", on, f"Scene.cull is {scene.cull!r}", _COSTS["culling"])


def _of_triangles(scene: Scene, camera: Camera, height: int, width: int) -> list[Effect]:
    """What each triangle decides for itself, as this camera sees it."""
    clip = camera.transform(scene.positions, width / height, scene.origin)
    corners = scene.triangles
    w = clip[:, 3][corners]
    tilted = int((w != w[:, :1]).any(axis=1).sum())
    planes = [plane.distance(clip.astype(np.float64)) >= 0 for plane in clip_planes(height, width)]
    inside: NDArray[np.bool_] = np.stack(planes, axis=-1)[corners]  # [T, 3, 6]
    some, whole = np.all(np.any(inside, axis=1), axis=1), np.all(inside, axis=(1, 2))
    cut = int((some & ~whole).sum())
    count, large, small = len(corners), *_by_size(clip[corners[whole]], height, width)
    sizes = f"in sight and not clipped have %s {LARGE_THRESHOLD} px in their bounding box"
    return [
        Effect(
            "perspective", tilted > 0, f"w differs between the corners of {tilted} of {count} triangles", _COSTS["perspective"]
        ),
        Effect("clipping", cut > 0, f"{cut} of {count} triangles cross a plane", _COSTS["clipping"]),
        Effect("large triangles", large > 0, f"{large} of {count} {sizes % 'more than'}", _COSTS["large_triangles"]),
        Effect("small triangles", small > 0, f"{small} of {count} {sizes % 'at most'}", _COSTS["small_triangles"]),
    ]


def _by_size(corners: NDArray[np.float32], height: int, width: int) -> tuple[int, int]:
    """Of triangles in clip space [T, 3, 4], how many are drawn by tiles and how many directly; those beyond the picture are
    neither. Not snapped, which moves a border by less than a pixel."""
    across = (corners[..., :2] / corners[..., 3:] * (1, -1) + 1) * (width / 2, height / 2)
    low, high = (np.clip(end, 0, (width, height)) for end in (np.floor(across.min(axis=1)), np.ceil(across.max(axis=1))))
    pixels = np.prod(high - low, axis=-1)
    return int((pixels > LARGE_THRESHOLD).sum()), int(((pixels > 0) & (pixels <= LARGE_THRESHOLD)).sum())


def _named(materials: list[Material]) -> str:
    names = list(dict.fromkeys(repr(m.name) for m in materials))
    more = len(names) - 3
    listed = ", ".join(names[:3]) + (f" and {more} more" if more > 0 else "")
    return f"{_counted(len(materials), 'material')} ({listed})"


def _texture_kind(material: Material) -> str:
    assert material.texture is not None
    height, width = material.texture.shape[:2]
    return f"{width}x{height} {material.texture.dtype}, {material.filter}, {material.wrap}"


def _counted(count: int, what: str) -> str:
    return f"{count} {what}{'s' * (count != 1)}"
