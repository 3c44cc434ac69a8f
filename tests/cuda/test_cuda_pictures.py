"""Pictures and points to clip space on CUDA against the CPU, in bits; CUDA graphs; what the operators refuse."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from cuda_bits import DEVICE, needs_cuda, poison
from picture_cases import (
    Drawn,
    Picture,
    drawn,
    full_screen,
    of_edges_on_centres,
    of_every_effect,
    of_many_clipped,
    of_many_clipped_samples,
    of_many_textures,
    of_parts,
    of_parts_of_samples,
    of_samples,
    of_shared_vertices,
    outputs,
    picture_of,
    to_device,
    with_bad_indices,
)
from test_transform import ASPECT, awkward, cameras

from bigtri.ops.shade import Made, draw, shade
from bigtri.ops.transform import transform
from bigtri.precision import DEFAULT, RUNGS
from bigtri.scene.plan import plan_for
from bigtri.study import courtyard

pytestmark = needs_cuda


def same(wanted: torch.Tensor, got: torch.Tensor) -> bool:
    """In bits, where one NaN is as good as another."""
    a, b = (t.cpu().numpy() for t in (wanted, got))
    if a.dtype == np.float32:
        a, b = (np.where(np.isnan(v), np.float32(np.nan), v).view(np.int32) for v in (a, b))
    return np.array_equal(a, b)


def assert_same(wanted: Drawn, got: Drawn) -> None:
    pairs = zip((wanted.image, *wanted.made, *wanted[2:]), (got.image, *got.made, *got[2:]), strict=True)
    for number, (a, b) in enumerate(pairs):
        assert (a is None) == (b is None)
        assert a is None or same(a, b), number


def shaded(picture: Picture, packed: torch.Tensor) -> Drawn:
    """The picture of a buffer, where its tensors are."""
    to = outputs(picture)
    shade(packed, picture.positions, picture.triangles, picture.surface, to.image, to.made, RUNGS[DEFAULT], "native")
    return to


def pictures() -> list[Picture]:
    lights = [picture_of(42, (20, 30), lights=0), picture_of(43, (20, 30), lights=9)]
    large = [
        full_screen((300, 1001)),
        picture_of(60, (1080, 1920), count=3000),
        picture_of(61, (256, 256), views=40, count=500, made=False),
    ]
    clipped = [of_many_clipped(900), *of_many_clipped_samples(), of_shared_vertices(52, (33, 47), 3)]
    edges = [of_edges_on_centres(False), of_edges_on_centres(True)]
    return [*of_every_effect(), *of_samples(), *of_many_textures(), *lights, *clipped, *edges, *of_parts_of_samples(), *large]


@pytest.mark.parametrize("number", range(len(pictures())))
def test_pictures(number: int) -> None:
    picture = pictures()[number]
    wanted, there = drawn(picture), to_device(picture, DEVICE)
    poison(0xCD, 1 << 24)
    assert_same(wanted, drawn(there))
    poison(0xCD, 1 << 24)
    from_buffer = shaded(there, wanted.packed.to(DEVICE))
    assert same(wanted.image, from_buffer.image)
    for a, b in zip(wanted.made, from_buffer.made, strict=True):
        assert a is None or b is not None and same(a, b)


def test_more_views_than_a_grid_has_layers() -> None:
    picture = picture_of(63, (3, 5), views=70_000, count=2, made=False)
    assert_same(drawn(picture), drawn(to_device(picture, DEVICE)))


@pytest.mark.parametrize("precision", ["exact", "balanced", "fast", "subpixel4"])
@pytest.mark.parametrize("samples", [1, 2])
def test_every_rung_without_a_visibility_buffer(precision: str, samples: int) -> None:
    picture = picture_of(62, (90, 130), views=2, samples=samples, channels=3 + samples % 2)
    images = []
    for one in (picture, to_device(picture, DEVICE)):
        image = outputs(one).image
        given = one.positions, one.triangles, one.cull, one.surface, image, samples
        dropped = draw(*given, Made(), None, RUNGS[precision], "native")
        images.append((image.cpu(), dropped.cpu()))
    assert torch.equal(images[0][0], images[1][0]) and torch.equal(images[0][1], images[1][1])


@pytest.mark.parametrize(
    ("resolution", "channels", "samples"),
    [
        ((1080, 1920), 3, 1),
        ((1237, 1403), 4, 1),
        ((1500, 1001), 3, 1),
        ((540, 960), 3, 2),
        ((617, 701), 4, 2),
        ((411, 467), 3, 3),
    ],
)
def test_pictures_of_a_part_of_a_large_image(resolution: tuple[int, int], channels: int, samples: int) -> None:
    """What no triangle may touch is neither cleared nor read."""
    assert resolution[0] * resolution[1] * samples**2 >= 1_500_000  # kSamplesOfAreas
    for picture in of_parts():
        picture = picture._replace(
            positions=picture.positions[:3].contiguous(), resolution=resolution, channels=channels, samples=samples
        )
        images = []
        there = to_device(picture, DEVICE)
        for one, fills in ((picture, False), (there, False), (there, True)):
            poison(0xCD, 1 << 28)
            image = outputs(one).image
            given = one.positions, one.triangles, one.cull, one.surface, image, samples
            images.append((image, draw(*given, Made(), None, RUNGS[DEFAULT], "native", fills=fills)))
        for image, dropped in images[1:]:
            assert same(images[0][0], image) and same(images[0][1], dropped)


def test_the_courtyard() -> None:
    scene, (height, width) = courtyard.courtyard(), (180, 320)
    clip = torch.from_numpy(courtyard.camera().transform(scene.positions, width / height, scene.origin))[None]
    tensors = scene.on("cpu")
    picture = Picture(clip, tensors.triangles, tensors.surface(plan_for(scene), scene.background), (height, width), samples=2)
    assert_same(drawn(picture), drawn(to_device(picture, DEVICE)))


def test_a_picture_that_is_not_aligned() -> None:
    picture = to_device(picture_of(63, (30, 45)), DEVICE)
    memory = torch.empty(30 * 45 * 3 + 1, dtype=torch.uint8, device=DEVICE)
    image = memory[1:].view(1, 30, 45, 3)
    given = picture.positions, picture.triangles, "none", picture.surface
    draw(*given, image, 1, Made(), None, RUNGS[DEFAULT], "native")
    assert same(drawn(picture).image, image)


@pytest.mark.parametrize(("resolution", "made"), [((70, 90), True), ((1080, 1920), False)])
def test_graphs_draw_what_their_inputs_hold_when_they_run(resolution: tuple[int, int], made: bool) -> None:
    first = second = picture_of(64, resolution, views=2, more=12, made=made)
    second = second._replace(positions=first.positions.flip(0).contiguous())
    there, to = to_device(first, DEVICE), outputs(to_device(first, DEVICE))
    arguments = there.positions, there.triangles, "none", there.surface, to.image, 1, to.made, None, RUNGS[DEFAULT], "native"
    draw(*arguments)
    torch.cuda.synchronize()
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        draw(*arguments)
    for picture in (second, first, second):
        there.positions.copy_(picture.positions)
        to.image.zero_()
        graph.replay()
        assert same(drawn(picture).image, to.image)


def test_bad_indices_end_nothing() -> None:
    picture = picture_of(45, (40, 50), views=2)
    broken, lost = with_bad_indices(picture)
    wanted = drawn(picture)
    named = (wanted.packed & 0xFFFFFFFF).clamp(max=len(lost) - 1)
    kept = (wanted.packed == 2**63 - 1) | ~lost[named]
    got = shaded(to_device(broken, DEVICE), wanted.packed.to(DEVICE)).image.cpu()
    assert torch.equal(got[kept], wanted.image[kept]) and not torch.equal(got, wanted.image)


def test_transform() -> None:
    points = torch.from_numpy(awkward(5000))
    matrices = torch.from_numpy(np.stack([camera.matrix(ASPECT) for camera in cameras()]))
    assert same(transform(points, matrices, "native"), transform(points.to(DEVICE), matrices.to(DEVICE), "native"))


@pytest.mark.parametrize("field", ["uvs", "face_normals", "material", "light_colors"])
def test_tensors_on_another_device_are_refused(field: str) -> None:
    picture = to_device(picture_of(65, (20, 30)), DEVICE)
    surface = picture.surface._replace(**{field: getattr(picture.surface, field).cpu()})
    with pytest.raises(RuntimeError, match=f"bigtri::draw: {field} must be a contiguous tensor on CUDA device 0"):
        drawn(picture._replace(surface=surface))
