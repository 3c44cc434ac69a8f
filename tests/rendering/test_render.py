"""Pictures against what they must show, plans against each other, and backend against backend."""

import itertools
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh
from backends import BACKENDS, needs_native
from skimage import data

import bigtri
from bigtri import Camera, Scene, decode_srgb, encode_srgb, render
from bigtri.reference.shading import decode_table
from bigtri.scene import Light, Material, from_trimesh, merge
from bigtri.scene.plan import EVERYTHING, RenderPlan, plan_for

WHITE = (1.0, 1.0, 1.0)
NOTHING = RenderPlan(**dict.fromkeys(vars(EVERYTHING), False))


def quad(half_width=1.0, half_height=1.0, z=0.0, **settings) -> Scene:
    """In the x-y plane, facing +z, the texture upright on it."""
    uv = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], np.float32)
    corners = (uv * 2 - 1) * np.array([half_width, half_height], np.float32)
    return Scene(
        np.column_stack([corners, np.full(4, z)]).astype(np.float32),
        np.array([(0, 1, 2), (0, 2, 3)], np.int32),
        uvs=uv,
        **settings,
    )


# Sees the square from -1 to 1 at z = 0, and no more.
FRONT = Camera((0, 0, 1), (0, 0, 0), fov_y=90)


def varied() -> Scene:
    """Something of everything: textured, coloured, smooth, flat, open and closed, shared vertices and not."""
    ball = from_trimesh(trimesh.creation.icosphere(subdivisions=2))
    rng = np.random.default_rng(0)
    colored = ball.with_(
        positions=ball.positions * np.float32(0.7) + np.float32((1.2, 0.2, 0)),
        colors=rng.random((len(ball.positions), 3)).astype(np.float32),
        materials=(Material("colored", vertex_colors=True, two_sided=False),),
    )
    flat = ball.with_(
        positions=ball.positions - np.float32((0.9, 0, 0)), materials=(Material("flat", (0.2, 0.5, 0.9), smooth=False),)
    )
    picture = decode_table()[data.astronaut()[::16, ::16]]
    wall = quad(2, 2, -0.5, materials=(Material("wall", (1, 0.9, 0.8), texture=picture, wrap="clamp"),))
    floor = quad(3, 3, 0, materials=(Material("floor", texture=picture[:5, :3], filter="nearest"),))
    floor = floor.with_(positions=np.ascontiguousarray(floor.positions[:, [0, 2, 1]]) - np.float32((0, 0.8, 0)))
    return merge([colored, flat, wall, floor])


VARIED_CAMERAS = [
    Camera.orbit((0, 0, 0), 2.2, azimuth, elevation, fov_y=70) for azimuth, elevation in ((20, 15), (170, -20), (90, 60))
]


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("kind", ["linear", "8 bits", "16 bits"])
def test_a_texture_that_fills_the_picture_is_the_picture(kind, backend):
    codes = np.random.default_rng(1).integers(0, 256, (8, 12, 3)).astype(np.uint8)
    texture = {"linear": decode_table()[codes], "8 bits": codes, "16 bits": codes.astype(np.uint16) * 257}[kind]
    material = Material(texture=texture, filter="nearest", wrap="clamp")
    assert material.texture is texture  # as it came, in as many bytes
    scene = quad(1.5, 1, materials=(material,), lights=(), ambient=WHITE)
    assert np.array_equal(render(scene, FRONT, (8, 12), backend=backend), codes)
    # From behind it is mirrored.
    behind = Camera((0, 0, -1), (0, 0, 0), fov_y=90)
    assert np.array_equal(render(scene, behind, (8, 12), backend=backend), codes[:, ::-1])


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_codes_draw_what_their_linear_values_draw(dtype, backend):
    scene, rng = varied(), np.random.default_rng(2)
    codes = rng.integers(0, np.iinfo(dtype).max + 1, (7, 9, 3)).astype(dtype)
    pictures = []
    for texture in (codes, decode_srgb(codes)):
        materials = tuple(m if m.texture is None else replace(m, texture=texture) for m in scene.materials)
        _, buffers = render(scene.with_(materials=materials), VARIED_CAMERAS, (31, 43), backend=backend, return_buffers=True)
        pictures.append(buffers.linear)
    assert pictures[0].tobytes() == pictures[1].tobytes()


def test_lambert_by_hand():
    scene = quad(
        lights=(Light((0, 0, 5), (0.5, 0.25, 0)),), ambient=(0.25, 0.25, 0.25), materials=(Material(base_color=(1, 0.5, 1)),)
    )
    _, buffers = render(scene, FRONT, (4, 4), return_buffers=True)
    assert buffers.linear.tolist() == [[[0.75, 0.25, 0.25]] * 4] * 4
    assert buffers.normals.tolist() == [[[0, 0, 1]] * 4] * 4
    assert buffers.albedo.tolist() == [[[1, 0.5, 1]] * 4] * 4


def test_two_sided_surfaces_look_the_same_from_behind():
    lights = (Light((0, 0, 1)), Light((0, 0, -1)))
    behind = Camera((0, 0, -1), (0, 0, 0), fov_y=90)
    for two_sided, z in ((True, -1), (False, 1)):
        scene = quad(lights=lights, materials=(Material(two_sided=two_sided),))
        normals = render(scene, behind, (4, 4), return_buffers=True)[1].normals
        assert normals.tolist() == [[[0, 0, z]] * 4] * 4
    assert render(scene.with_(cull="back"), behind, (4, 4), return_buffers=True)[1].visibility.triangle.max() == -1


def test_facing_is_right_for_triangles_that_reach_behind_the_camera():
    floor = quad(50, 50).with_(lights=(Light((0, 1, 0)),))
    floor = floor.with_(positions=np.ascontiguousarray(floor.positions[:, [0, 2, 1]]))  # its front is below
    for height, up in ((1, 1), (-1, -1)):
        camera = Camera((0, height, 3), (0, 0.9 * height, 0))
        _, buffers = render(floor, camera, (20, 20), return_buffers=True)
        seen = buffers.visibility.triangle >= 0
        assert seen.sum() > 150 and (buffers.normals[seen] == (0, up, 0)).all()


def test_background_is_a_gradient():
    scene = quad(0.15, 0.15, background=((1, 0, 0), (0, 1, 0)))
    _, buffers = render(scene, FRONT, (10, 10), return_buffers=True)
    assert buffers.linear[0, 0].tolist() == pytest.approx([0.95, 0.05, 0])
    assert buffers.linear[9, 3].tolist() == pytest.approx([0.05, 0.95, 0])
    assert not buffers.albedo[0, 0].any() and buffers.albedo[5, 5].all()


@pytest.mark.parametrize("backend", BACKENDS)
def test_every_plan_that_covers_the_scene_gives_the_same_bits(backend):
    ball = from_trimesh(trimesh.creation.icosphere(subdivisions=1))
    scenes = [varied(), ball, ball.with_(normals=None), quad(), varied().with_(lights=()), varied().with_(uvs=None, colors=None)]
    for scene in scenes:
        derived = render(scene, VARIED_CAMERAS, (45, 60), backend=backend)
        assert np.array_equal(derived, render(scene, VARIED_CAMERAS, (45, 60), backend=backend, plan=EVERYTHING))


def test_plans_name_what_the_scene_calls_for():
    assert plan_for(varied()) == EVERYTHING
    assert str(replace(NOTHING, vertex_colors=True, lights=True)) == "vertex colors, lights"
    assert plan_for(quad(lights=())) == NOTHING and str(NOTHING) == "no effects"
    ball = from_trimesh(trimesh.creation.icosphere(subdivisions=1))
    assert plan_for(ball) == replace(NOTHING, smooth_normals=True, lights=True)
    unused = ball.with_(materials=(*ball.materials, Material(vertex_colors=True)), colors=ball.positions)
    assert plan_for(unused) == plan_for(ball)


def test_what_the_plan_does_not_name_is_not_read():
    """Its arrays do not even reach the shading pass."""
    surface = varied().on("cpu").surface(NOTHING, ((0, 0, 0), (1, 1, 1)))
    assert [surface.uvs, surface.colors, surface.normals, surface.face_normals] == [None] * 4
    assert len(surface.light_directions) == 0 and not surface.two_sided
    with pytest.warns(UserWarning, match="plan leaves out what the scene calls for.*textures .*lights .2 lights"):
        image = render(varied(), VARIED_CAMERAS[0], (30, 40), plan=NOTHING)
    assert image.shape == (30, 40, 3)


@needs_native
def test_backends_agree_in_bits():
    for scene in (varied(), varied().with_(cull="back"), varied().with_(lights=())):
        pictures = [render(scene, VARIED_CAMERAS, (54, 72), backend=b, return_buffers=True) for b in ("reference", "native")]
        assert np.array_equal(pictures[0][0], pictures[1][0])
        for name in ("albedo", "normals", "linear"):
            one, two = (getattr(buffers, name) for _, buffers in pictures)
            assert one is two is None or one.tobytes() == two.tobytes()


def test_precision_reaches_coverage_and_attributes():
    """Each picture is what the reference draws; a coarser grid moves edges, and weights without perspective move textures."""
    scene = varied()
    pictures = {
        name: render(scene, VARIED_CAMERAS[0], (30, 40), precision=name, backend="reference", return_buffers=True)
        for name in ("exact", "subpixel4", "attributes_affine")
    }
    seen = {name: buffers.visibility.packed for name, (_, buffers) in pictures.items()}
    assert np.array_equal(pictures["exact"][0], render(scene, VARIED_CAMERAS[0], (30, 40)))
    assert not np.array_equal(seen["subpixel4"], seen["exact"])
    assert np.array_equal(seen["attributes_affine"], seen["exact"])
    assert not np.array_equal(pictures["attributes_affine"][1].albedo, pictures["exact"][1].albedo)


def test_batches_are_single_views():
    scene = varied()
    image, buffers = render(scene, VARIED_CAMERAS, (45, 60), return_buffers=True)
    assert image.shape == (3, 45, 60, 3) and image.dtype == np.uint8
    for b, camera in enumerate(VARIED_CAMERAS):
        single, alone = render(scene, camera, (45, 60), return_buffers=True)
        assert np.array_equal(single, image[b])
        assert np.array_equal(alone.visibility.packed, buffers.visibility.packed[b])
        assert np.array_equal(alone.normals, buffers.normals[b]) and np.array_equal(alone.positions, buffers.positions[b])


def test_supersampling_averages_linear_light():
    scene = varied()
    fine = render(scene, VARIED_CAMERAS[0], (60, 80), return_buffers=True)[1].linear.astype(np.float64)
    expected = fine.reshape(30, 2, 40, 2, 3).mean(axis=(1, 3))
    coarse = render(scene, VARIED_CAMERAS[0], (30, 40), supersample=2)
    assert np.abs(coarse.astype(int) - encode_srgb(expected.astype(np.float32)).astype(int)).max() <= 1


@needs_native
def test_all_operations_compile_into_one_graph():
    generator = torch.Generator().manual_seed(0)
    positions, attributes = torch.randn(30, 4, generator=generator), torch.rand(30, 5, generator=generator)
    positions[:, 3] = 1.5
    triangles, texture = torch.arange(30, dtype=torch.int32).reshape(-1, 3), torch.rand(8, 8, 3, generator=generator)

    def shade(positions, attributes):
        seen = bigtri.rasterize(positions, triangles, (24, 32))
        values = bigtri.interpolate(attributes, seen, positions, triangles)
        albedo = bigtri.sample_texture(texture, values[..., :2])
        lit = bigtri.lambert(values[..., 2:], albedo, torch.ones(3), torch.eye(3), torch.eye(3))
        codes = bigtri.encode_srgb(lit)
        return codes, bigtri.decode_srgb(codes), bigtri.barycentrics(seen, positions, triangles)

    compiled = torch.compile(shade, fullgraph=True, backend="aot_eager")
    for eager, traced in zip(shade(positions, attributes), compiled(positions, attributes), strict=True):
        assert torch.equal(eager, traced)


def test_scenes_without_triangles():
    empty = Scene(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32))
    for plan in (None, EVERYTHING):
        assert render(empty, FRONT, (3, 4), plan=plan).shape == (3, 4, 3)


def test_the_default_device_and_type_of_torch_do_not_matter():
    """In a process of its own: tables are made when bigtri is imported."""
    script = """
import numpy as np, torch
torch.set_default_device("meta")
torch.set_default_dtype(torch.float64)
import bigtri
from bigtri.scene.plan import RenderPlan
linear = torch.tensor([0.1, 0.5, 0.9], dtype=torch.float32, device="cpu")
assert bigtri.encode_srgb(linear).tolist() == [89, 188, 243]
assert bigtri.decode_srgb(torch.tensor([0, 255], dtype=torch.uint8, device="cpu")).tolist() == [0, 1]
corners = np.array([(-1, -1, 0), (1, -1, 0), (0, 1, 0)], np.float32)
scene = bigtri.Scene(corners, np.array([(0, 1, 2)], np.int32))
camera = bigtri.Camera((0, 0, 1), (0, 0, 0), fov_y=90)
flat = RenderPlan(smooth_normals=False, flat_normals=False)
pictures = [bigtri.render(scene, camera, (8, 8), plan=plan) for plan in (None, flat)]
print(*(int(p.sum()) for p in pictures))
"""
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120)
    assert result.returncode == 0, result.stderr
    corners = np.array([(-1, -1, 0), (1, -1, 0), (0, 1, 0)], np.float32)
    scene = Scene(corners, np.array([(0, 1, 2)], np.int32))
    plans = (None, RenderPlan(smooth_normals=False, flat_normals=False))
    assert result.stdout.split() == [str(render(scene, FRONT, (8, 8), plan=plan).sum()) for plan in plans]


@pytest.mark.parametrize(
    ("arguments", "options", "error", "text"),
    [
        ((None, FRONT, (4, 4)), {}, TypeError, "scene must be a Scene, .*, got None"),
        ((quad(), 3, (4, 4)), {}, TypeError, "camera must be a Camera or a sequence of them, got 3"),
        ((quad(), [FRONT, 3], (4, 4)), {}, TypeError, "camera must be a Camera or a sequence of them, got 3"),
        ((quad(), itertools.repeat(FRONT), (4, 4)), {}, TypeError, "camera must be .*, got repeat"),
        ((quad(), FRONT, (8, 9, 7, 5)), {}, ValueError, "resolution must be"),
        ((quad(), FRONT, 4), {}, TypeError, "resolution must be .*, got 4"),
        ((quad(), FRONT, (4.0, 4)), {}, TypeError, "resolution must be"),
        ((quad(), FRONT, (4, 8193)), {"supersample": 2}, ValueError, "supersample must be such that .* at most 16384, got 2"),
        ((quad(), FRONT, (4, 4)), {"plan": "all"}, TypeError, "plan must be a RenderPlan, .*, got 'all'"),
        ((quad(), FRONT, (4, 4)), {"precision": "vague"}, ValueError, "precision must be one of 'exact', .*, got 'vague'"),
        ((quad(), FRONT, (4, 4)), {"precision": "depth_reversed"}, ValueError, "precision must be one that takes window depth"),
        ((quad(), FRONT, (4, 4)), {"return_buffers": np.ones(2)}, TypeError, "return_buffers must be True or False, got float64"),
        ((quad(), FRONT, (4, 4)), {"transparent": 1}, TypeError, "transparent must be True or False, got 1"),
        (
            (quad(), FRONT, (4, 4)),
            {"transparent": True, "background": WHITE},
            ValueError,
            "background must be None where transparent is True",
        ),
        ((quad(), FRONT, (4, 4)), {"background": (1, 2)}, TypeError, "background must be three finite numbers"),
    ],
)
def test_errors_name_the_argument(arguments, options, error, text):
    with pytest.raises(error, match=f"bigtri.render: {text}"):
        render(*arguments, **options)


def test_errors():
    with pytest.raises(ValueError, match="bigtri.render: camera must be"):
        render(quad(), [], (4, 4))
    with pytest.raises(ValueError, match="bigtri.render: supersample must be"):
        render(quad(), FRONT, (4, 4), supersample=0)
    with pytest.raises(ValueError, match="resolution must be"):
        render(quad(), FRONT, (0, 4))
