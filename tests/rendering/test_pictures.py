"""The shading pass: every way to a picture gives the same bits, and they are those of docs/numerics.md section 18."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from backends import needs_native
from hypothesis import given, settings
from hypothesis import strategies as st
from operators import call

import bigtri
from bigtri import Camera, Light, Material, Scene, native, render
from bigtri.ops import shade as ops
from bigtri.ops.shade import Made
from bigtri.ops.shading import THRESHOLDS
from bigtri.precision import EXACT
from bigtri.reference import shade as reference
from bigtri.reference.shading import encode_srgb
from bigtri.scene.plan import EVERYTHING, RenderPlan, plan_for

ISAS = [isa for isa in ("baseline", "avx2", "avx512") if native.available() and torch.ops.bigtri.has_isa(isa)]


def random_scene(rng: np.random.Generator, triangles: int = 30) -> Scene:
    """Some triangles around the origin: large and small, behind each other, across the near plane, of every material."""
    size = rng.choice([0.05, 0.3, 3.0], (triangles, 1, 1))
    corners = rng.normal(0, 1, (triangles, 1, 3)) + size * rng.normal(0, 1, (triangles, 3, 3))
    vertices = 3 * triangles
    kinds = [rng.random((3, 5, 3)).astype(np.float32), rng.integers(0, 256, (*rng.integers(1, 6, 2), 3)).astype(np.uint8)]
    kinds.append(rng.integers(0, 65536, (2, 7, 3)).astype(np.uint16))
    materials = [
        Material(
            base_color=tuple(rng.random(3)),
            texture=None if i % 4 == 3 else kinds[i % 3],
            wrap=str(rng.choice(["repeat", "clamp"])),
            filter=str(rng.choice(["bilinear", "nearest"])),
            vertex_colors=bool(rng.integers(2)),
            smooth=bool(rng.integers(2)),
            two_sided=bool(rng.integers(2)),
        )
        for i in range(6)
    ]
    lights = tuple(Light(tuple(rng.normal(0, 1, 3)), tuple(rng.random(3))) for _ in range(rng.integers(0, 4)))
    return Scene(
        corners.reshape(-1, 3).astype(np.float32),
        np.arange(vertices, dtype=np.int32).reshape(-1, 3),
        normals=rng.normal(0, 1, (vertices, 3)).astype(np.float32),
        uvs=rng.normal(0, 2, (vertices, 2)).astype(np.float32),
        colors=rng.random((vertices, 3)).astype(np.float32),
        material=rng.integers(0, len(materials), triangles).astype(np.int32),
        materials=tuple(materials),
        lights=lights,
        ambient=tuple(rng.random(3)),
        background=(tuple(rng.random(3)), tuple(rng.random(3))),
        cull=str(rng.choice(["none", "back", "front"])),
    )


def random_camera(rng: np.random.Generator) -> Camera:
    return Camera.orbit((0, 0, 0), float(rng.uniform(0.5, 4)), float(rng.uniform(0, 360)), float(rng.uniform(-80, 80)), fov_y=70)


def buffers_of(scene: Scene, camera: object, size: tuple[int, int], **options: object) -> list[np.ndarray]:
    image, buffers = render(scene, camera, size, return_buffers=True, **options)
    arrays = [image, buffers.albedo, buffers.normals, buffers.linear, buffers.visibility.packed, buffers.visibility.depth]
    return [a for a in arrays if a is not None]


@needs_native
@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_reference_and_native_agree_in_bits(seed):
    """On random scenes, with random sets of effects, samples, alpha and cameras, by a random instruction set."""
    rng = np.random.default_rng(seed)
    scene, cameras = random_scene(rng), [random_camera(rng) for _ in range(rng.integers(1, 4))]
    size = (int(rng.integers(1, 90)), int(rng.integers(1, 90)))
    plan = RenderPlan(*(bool(on) for on in rng.integers(0, 2, 6)))
    options = {"supersample": int(rng.choice([1, 1, 2, 3])), "transparent": bool(rng.integers(2))}
    tensors = scene.on("cpu")
    surface = tensors.surface(plan, scene.background)
    used = torch.ops.bigtri.isa()
    torch.ops.bigtri.set_isa(str(rng.choice(ISAS)))
    try:
        drawn = [drawing(scene, cameras, size, surface, backend, **options) for backend in ("reference", "native")]
        for one, two in zip(*drawn, strict=True):
            assert one.tobytes() == two.tobytes()
        alone = drawing(scene, cameras, size, surface, "native", **options, alone=True)
        assert alone[0].tobytes() == drawn[0][0].tobytes()  # nothing but the picture: no visibility buffer
    finally:
        torch.ops.bigtri.set_isa(used)


def drawing(
    scene: Scene,
    cameras: list[Camera],
    size: tuple[int, int],
    surface: object,
    backend: str,
    supersample: int = 1,
    transparent: bool = False,
    alone: bool = False,
    parameters: tuple[int, ...] = (),
) -> list[np.ndarray]:
    """The picture and all that it is made from, by the operators; or the picture ``alone``."""
    height, width = size
    clip = torch.from_numpy(np.stack([c.transform(scene.positions, width / height) for c in cameras]))
    triangles = torch.from_numpy(scene.triangles)
    shape = (len(cameras), height * supersample, width * supersample)
    image = torch.zeros(len(cameras), height, width, 3 + transparent, dtype=torch.uint8)
    made = Made() if alone else Made(*(torch.full((*shape, 3), 7.0) for _ in Made._fields))
    seen = None if alone else (torch.zeros(shape, dtype=torch.int64), torch.zeros(shape))
    if parameters:
        dropped = torch.zeros(len(cameras), dtype=torch.int64)
        packed, depth = seen or (None, None)
        given = (clip, triangles, *shape[1:], scene.cull, *surface[:10], *surface[10:], THRESHOLDS, "exact", list(parameters))
        call("draw", (*given, image, made.albedo, made.normals, made.linear, packed, depth, dropped, False))
    else:
        ops.draw(clip, triangles, scene.cull, surface, image, supersample, made, seen, EXACT, backend)
    return [t.numpy() for t in (image, *(made if not alone else ()), *(seen or ()))]


@needs_native
@pytest.mark.parametrize("samples", [1, 2, 3])
@pytest.mark.parametrize(("records", "candidates"), [(26, 1), (64, 3), (200, 40)])
def test_a_view_that_takes_several_passes(samples, records, candidates):
    """The memory of a pass is bounded; views that it does not finish are held, and shaded when they are."""
    for seed in range(6):
        rng = np.random.default_rng(seed)
        scene, cameras = random_scene(rng, 60), [random_camera(rng) for _ in range(4)]
        # A view whose last triangles reach no bin, and one that has none at all.
        cameras[seed % 4] = Camera((0, 0, 50), (0, 0, 90))
        surface = scene.on("cpu").surface(EVERYTHING, scene.background)
        size = (70, 133)
        at_once = drawing(scene, cameras, size, surface, "native", samples)
        for alone in (False, True):
            drawn = drawing(scene, cameras, size, surface, "native", samples, alone=alone, parameters=(records, candidates))
            for one, two in zip(at_once, drawn, strict=False):
                assert one.tobytes() == two.tobytes()


@needs_native
def test_weights_in_the_middle_of_two_floats():
    """Edge values over an area of 2^40: some quotients lie exactly between two float32, where only the law of bits decides."""
    side = 64
    x0, y0 = -50 * 256, -50 * 256  # 1/256 px
    corners = np.array([(x0, y0), (x0 + 2**20 - 1, y0 + 1), (x0 - 1, y0 + 2**20 + 1)])
    centre = 256 * np.arange(side) + 128
    # The edge from corner 0 to corner 1, whose value is the weight of corner 2.
    quotient = ((2**20 - 1) * (centre[:, None] - y0) - (centre[None] - x0)) / 2**40
    nearest = quotient.astype(np.float32)
    assert (2 * np.abs(quotient - nearest) == np.spacing(nearest)).any()
    x, y = (corners / 256 - side / 2).T / (side / 2)
    positions = np.stack([x, -y, np.zeros(3)], axis=1).astype(np.float32)
    colors = np.random.default_rng(0).random((3, 3)).astype(np.float32)
    scene = Scene(positions, np.array([[0, 1, 2]], np.int32), colors=colors, materials=(Material(vertex_colors=True),))
    cameras, size = [Camera.from_matrix(np.eye(4))], (side, side)
    surface = scene.on("cpu").surface(EVERYTHING, scene.background)
    expected = drawing(scene, cameras, size, surface, "reference")
    assert np.isfinite(expected[-1]).all()
    for isa in ISAS:
        with native.using_isa(isa):
            for one, two in zip(expected, drawing(scene, cameras, size, surface, "native"), strict=True):
                assert one.tobytes() == two.tobytes()


@needs_native
def test_a_texture_whose_values_32_bits_do_not_number():
    """It is looked up as a small one is: everything is at the last texel, and the others take no memory."""
    texture = np.zeros((2**14 + 1, 2**16, 3), np.uint8)
    texture[-1, -1] = 50, 100, 150
    small = np.ascontiguousarray(texture[-1:, -1:])
    positions = np.array([(-1, -1, 0), (1, -1, 0), (0, 1, 0)], np.float32)
    look = Material(texture=small, wrap="clamp")
    scene = Scene(positions, np.array([[0, 1, 2]], np.int32), uvs=np.tile(np.float32([1, 0]), (3, 1)), materials=(look,))
    surface = scene.on("cpu").surface(EVERYTHING, scene.background)
    huge = surface._replace(textures=(torch.from_numpy(texture),))
    expected, drawn = (drawing(scene, [Camera.from_matrix(np.eye(4))], (20, 30), s, "native") for s in (surface, huge))
    assert len(np.unique(expected[0].reshape(-1, 3), axis=0)) > 1
    for one, two in zip(expected, drawn, strict=True):
        assert one.tobytes() == two.tobytes()


@pytest.mark.parametrize("backend", ["reference", pytest.param("native", marks=needs_native)])
def test_every_effect_compiled_in_changes_nothing(backend):
    for seed in range(8):
        rng = np.random.default_rng(seed)
        scene, camera = random_scene(rng), random_camera(rng)
        if not scene.lights:  # then no normal is needed, and none is returned
            images = [render(scene, camera, (40, 50), backend=backend, plan=plan) for plan in (None, EVERYTHING)]
            assert np.array_equal(*images)
            continue
        for one, two in zip(
            buffers_of(scene, camera, (40, 50), backend=backend),
            buffers_of(scene, camera, (40, 50), backend=backend, plan=EVERYTHING),
            strict=True,
        ):
            assert np.array_equal(one, two)


@pytest.mark.parametrize("backend", ["reference", pytest.param("native", marks=needs_native)])
def test_a_batch_is_its_views(backend):
    rng = np.random.default_rng(5)
    scene, cameras = random_scene(rng), [random_camera(rng) for _ in range(3)]
    together = render(scene, cameras, (33, 47), backend=backend, supersample=2)
    for camera, image in zip(cameras, together, strict=True):
        assert np.array_equal(render(scene, camera, (33, 47), backend=backend, supersample=2), image)


@needs_native
def test_many_views_are_drawn_by_a_thread_each():
    rng = np.random.default_rng(6)
    scene, cameras = random_scene(rng), [random_camera(rng) for _ in range(17)]
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(2)
        together = buffers_of(scene, cameras, (33, 47), plan=EVERYTHING, backend="native")
        torch.set_num_threads(1)
        for k, camera in enumerate(cameras):
            alone = buffers_of(scene, camera, (33, 47), plan=EVERYTHING, backend="native")
            assert all(np.array_equal(a[k], b) for a, b in zip(together, alone, strict=True)), k
    finally:
        torch.set_num_threads(before)


def half_covered() -> tuple[Scene, Camera]:
    """A white wall over the left half of a picture 9 px wide, so that it ends in the middle of a pixel."""
    corners = np.float32([(-9, -9, 0), (0, -9, 0), (0, 9, 0), (-9, 9, 0)])
    scene = Scene(corners, np.int32([(0, 1, 2), (0, 2, 3)]), lights=(), ambient=(1, 1, 1), background=((0, 0, 0), (0, 0, 0)))
    return scene, Camera((0, 0, 1), (0, 0, 0), fov_y=90)


@pytest.mark.parametrize("backend", ["reference", pytest.param("native", marks=needs_native)])
def test_alpha(backend):
    scene, camera = half_covered()
    image = render(scene, camera, (9, 9), backend=backend, supersample=2, transparent=True)
    assert image[4, :, 3].tolist() == [255] * 4 + [128] + [0] * 4
    # Of the samples that are covered: no dark seam at the silhouette. Where nothing is, black.
    assert image[4, :, 0].tolist() == [255] * 5 + [0] * 4
    opaque = render(scene, camera, (9, 9), backend=backend, supersample=2)
    assert opaque[4, :, 0].tolist() == [255] * 4 + [int(encode_srgb(np.float32(0.5)))] + [0] * 4


@pytest.mark.parametrize("backend", ["reference", pytest.param("native", marks=needs_native)])
@pytest.mark.parametrize("samples", [1, 2, 3, 5])
def test_backgrounds(backend, samples):
    scene, camera = half_covered()
    plain = render(scene, camera, (8, 9), backend=backend, supersample=samples, background=(0.25, 0.5, 1))
    assert (plain[:, 8] == encode_srgb(np.float32((0.25, 0.5, 1)))).all()
    graded = render(scene, camera, (8, 9), backend=backend, background=((0, 0, 0), (1, 1, 1)))
    expected = encode_srgb((np.arange(8, dtype=np.float32) + np.float32(0.5)) / np.float32(8))
    assert np.array_equal(graded[:, 8], np.repeat(expected[:, None], 3, axis=1))
    empty = scene.with_(triangles=scene.triangles[:0], material=scene.material[:0])
    assert np.array_equal(render(empty, camera, (8, 9), backend=backend, supersample=samples)[..., 0], np.zeros((8, 9)))


def test_what_can_be_drawn(tmp_path: Path):
    ball = trimesh.creation.icosphere(subdivisions=1)
    ball.export(tmp_path / "ball.ply")
    scene = bigtri.from_trimesh(ball)
    camera, size = Camera.framing(scene.bounds), (24, 24)
    image = render(scene, camera, size)
    assert image.std() > 20
    assert np.array_equal(render(ball, camera, size), image)
    assert np.array_equal(render(str(tmp_path / "ball.ply"), camera, size), render(tmp_path / "ball.ply", camera, size))
    tensors = scene.on("cpu")
    drawn, buffers = render(tensors, camera, size, return_buffers=True)
    assert isinstance(drawn, torch.Tensor) and isinstance(buffers.visibility.depth, torch.Tensor)
    assert np.array_equal(drawn.numpy(), image)
    # Without a camera all of it is in the picture, and without a size it is one of 720 x 1280.
    framed = render(scene)
    assert framed.shape == (720, 1280, 3)
    assert np.array_equal(framed, render(scene, Camera.framing(scene.bounds, aspect=1280 / 720), (720, 1280)))


@needs_native
def test_a_picture_alone_takes_no_memory_for_a_visibility_buffer():
    """Of a picture of 16 Mpx, whose visibility buffer would take 128 MiB."""
    scene, camera = half_covered()
    program = f"""
import resource, numpy as np, bigtri
from bigtri.scene import Scene
scene = Scene(np.array({scene.positions.tolist()}, np.float32), np.array({scene.triangles.tolist()}, np.int32))
camera = bigtri.Camera((0, 0, 1), (0, 0, 0), fov_y=90)
bigtri.render(scene, camera, (8, 8))
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
image = bigtri.render(scene, camera, (4096, 4096))
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""
    import subprocess
    import sys

    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert int(done.stdout) < (4096 * 4096 * 3 >> 10) + 40_000  # KiB


@needs_native
def test_precisions():
    """A picture of each rung that is built, by its own weights and its own visibility."""
    rng = np.random.default_rng(8)
    scene, camera = random_scene(rng), random_camera(rng)
    for name in native.REGISTRY["cpu"]:
        if not bigtri.precision.RUNGS[name].reversed:
            pictures = [buffers_of(scene, camera, (40, 50), precision=name, backend=b) for b in ("reference", "native")]
            for one, two in zip(*pictures, strict=True):
                assert one.tobytes() == two.tobytes(), name


@needs_native
def test_what_the_operator_refuses():
    rng = np.random.default_rng(2)
    scene, camera = random_scene(rng).with_(lights=(Light((0, 0, 1), (1, 1, 1)),)), random_camera(rng)
    surface = scene.on("cpu").surface(EVERYTHING, scene.background)
    faces = surface.material.clone()
    faces[3] = 6
    looks = surface.looks.clone()
    looks[1, 1] = 9
    for wrong, text in (
        (surface._replace(uvs=surface.uvs[1:]), r"uvs must be .*float32 \[V, 2\], got Float \[89, 2\]"),
        (surface._replace(material=faces), "material must index the 6 rows of looks, got indices from 0 to 6"),
        (surface._replace(looks=looks), "looks must name one of the 5 textures or -1, got 9 in row 1"),
        (surface._replace(textures=(*surface.textures[:4], torch.zeros(0, 3, 3))), "textures must be 1 to 65536 px a side each"),
        (
            surface._replace(textures=(*surface.textures[:4], torch.zeros(2, 3))),
            "textures must be .*each float32, uint8 or uint16",
        ),
        (surface._replace(light_colors=surface.light_colors[:0]), r"light_colors must be .*float32 \[L, 3\]"),
        (surface._replace(constants=torch.zeros(2, 3)), r"constants must be .*float32 \[3, 3\]"),
    ):
        with pytest.raises(RuntimeError, match=f"bigtri::draw: {text}"):
            drawing(scene, [camera], (8, 8), wrong, "native")


def test_the_plan_says_why():
    rng = np.random.default_rng(3)
    scene = random_scene(rng).with_(lights=(Light((0, 0, 1)),), cull="back")
    plan = scene.plan(random_camera(rng), (48, 64))
    found = {effect.name: effect for effect in plan.effects}
    assert plan.switches == plan_for(scene) == EVERYTHING
    assert "float32, " in found["textures"].why and found["lights"].why == "1 light"
    assert found["culling"].on and found["clipping"].on and "of 30 triangles cross a plane" in found["clipping"].why
    assert str(plan).count("\n") == len(plan.effects)
    large, small = (found[f"{size} triangles"] for size in ("large", "small"))
    assert not large.on and small.on and "at most 4000 px" in small.why
    assert [e.on for e in scene.plan(Camera.framing(scene.bounds), (2000, 2000)).effects[-2:]] == [True, True]
    dark = scene.with_(lights=(), uvs=None)
    assert {e.name: (e.on, e.why) for e in dark.plan().effects}["smooth normals"] == (
        False,
        "there are no lights, so no normal matters",
    )
    assert dark.plan().switches == RenderPlan(False, True, False, False, False, False)


def test_effects_can_be_forced():
    rng = np.random.default_rng(4)
    scene, camera = random_scene(rng).with_(lights=()), random_camera(rng)
    forced = scene.plan(on=("two_sided", "lights"))
    assert forced.switches == replace(plan_for(scene), two_sided=True, lights=True)
    assert np.array_equal(render(scene, camera, (30, 40), plan=forced), render(scene, camera, (30, 40)))
    with pytest.raises(ValueError, match="off must not hold 'textures', which the scene calls for .*approximate=True"):
        scene.plan(off=("textures",))
    without = scene.plan(off=("textures",), approximate=True)
    assert "the picture is another" in str(without) and not without.switches.textures
    bare = scene.with_(materials=tuple(replace(m, texture=None) for m in scene.materials))
    assert np.array_equal(render(scene, camera, (30, 40), plan=without), render(bare, camera, (30, 40)))
    with pytest.raises(ValueError, match="on must hold some of 'textures', .*, got 'fog'"):
        scene.plan(on=("fog",))
    with pytest.raises(ValueError, match="on and off must not share an effect, got 'lights' in both"):
        scene.plan(on=("lights",), off=("lights",))


@pytest.mark.parametrize("seed", range(3))
def test_the_reference_by_its_parts(seed):
    """The pass is what the operators for each of its parts say, put together."""
    rng = np.random.default_rng(seed)
    scene = random_scene(rng).with_(cull="none", lights=(Light((1, 2, 3)), Light((-1, 0, 1), (0.2, 0.3, 0.4))))
    clip = random_camera(rng).transform(scene.positions, 1.0)
    packed = bigtri.rasterize(clip, scene.triangles, (32, 32), backend="reference").packed
    surface = scene.on("cpu").surface(EVERYTHING, scene.background)
    plain = reference.Surface(*(ops._numpy(field) for field in surface))
    shaded = reference.shade(packed, clip, scene.triangles, plain)
    uvs, colors, smooth = (
        bigtri.interpolate(a, packed, clip, scene.triangles, backend="reference")
        for a in (scene.uvs, scene.colors, scene.normals)
    )
    back = reference.is_back(clip, scene.triangles)
    flat = bigtri.scene.normals.face_normals(scene.positions, scene.triangles)
    for y, x in np.argwhere((packed & 0xFFFFFFFF) < len(scene.triangles))[::7]:
        triangle = int(packed[y, x] & 0xFFFFFFFF)
        material = scene.materials[scene.material[triangle]]
        albedo = np.float32(material.base_color)
        if material.texture is not None:
            how = {"filter": material.filter, "wrap": material.wrap, "backend": "reference"}
            albedo = albedo * bigtri.sample_texture(material.texture, uvs[y, x][None], **how)[0]
        if material.vertex_colors:
            albedo = albedo * colors[y, x]
        normal = smooth[y, x] if material.smooth else flat[triangle]
        normal = -normal if material.two_sided and back[triangle] else normal
        directions, lights = (np.float32([getattr(light, name) for light in scene.lights]) for name in ("direction", "color"))
        lit = bigtri.lambert(normal[None], albedo[None], np.float32(scene.ambient), directions, lights, backend="reference")[0]
        assert np.array_equal(shaded.albedo[y, x], albedo) and np.array_equal(shaded.normals[y, x], normal)
        assert np.array_equal(shaded.linear[y, x], lit) and np.array_equal(shaded.image[y, x], encode_srgb(lit))
