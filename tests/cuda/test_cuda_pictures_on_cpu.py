"""Pictures and points to clip space on a GPU, without one, in bits against the CPU: shade.cu and transform.cu, run by
cuda_on_cpu.py."""

from __future__ import annotations

import ctypes
import functools
import itertools
from collections.abc import Iterable, Sequence
from typing import Any

import cuda_on_cpu
import numpy as np
import pytest
import torch
from exhaustive import exhaustive
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
    with_bad_indices,
)
from test_cuda_attributes_on_cpu import bits, pointer
from test_transform import ASPECT, awkward, cameras

from bigtri import native
from bigtri.ops.shade import shade
from bigtri.ops.transform import transform
from bigtri.precision import DEFAULT, RUNGS
from bigtri.reference.shading import encode_thresholds

pytestmark = [
    pytest.mark.skipif(bool(cuda_on_cpu.available()), reason=cuda_on_cpu.available()),
    pytest.mark.skipif(not native.available(), reason="the extension is not built"),
    pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning"),
]

SIZES = ("views", "height", "width", "samples", "channels", "vertices", "triangles", "materials", "textures", "lights")
ARRAYS = ("positions", "indices", "uvs", "colors", "normals", "face_normals", "material", "looks", "base_colors")
ARRAYS += ("light_directions", "light_colors", "constants", "thresholds")
RESULTS = ("image", "albedo", "normal_image", "linear", "drawn", "depth", "dropped")


class PictureOnCpu(ctypes.Structure):
    """As cuda_on_cpu.cpp has it."""

    _fields_ = [
        *((name, ctypes.c_int64) for name in (*SIZES, "two_sided", "cull")),
        *((name, ctypes.c_void_p) for name in ("packed", *ARRAYS, "texels", "texture_size", *RESULTS)),
    ]


def by_the_kernels(library: ctypes.CDLL, p: Picture, packed: torch.Tensor | None, seen: bool = True) -> Drawn:
    """The picture by the kernels, of a visibility buffer or straight from its triangles; seen: with packed and depth."""
    to, s, (height, width), n = outputs(p), p.surface, p.resolution, p.samples
    thresholds = torch.tensor(encode_thresholds())
    texels = (ctypes.c_void_p * len(s.textures))(*(t.data_ptr() for t in s.textures))
    texture_size = torch.tensor([[*t.shape[:2], t.element_size()] for t in s.textures], dtype=torch.int64)
    given = p.positions, p.triangles, s.uvs, s.colors, s.normals, s.face_normals, s.material, s.looks, s.base_colors
    given = (packed, *given, s.light_directions, s.light_colors, s.constants, thresholds)
    counts = len(p.positions), height * n, width * n, n, p.channels, p.positions.shape[1], len(p.triangles), len(s.looks)
    counts = (*counts, len(s.textures), len(s.light_directions), s.two_sided, ("none", "back", "front").index(p.cull))
    made = pointer(to.image), *map(pointer, to.made), *(pointer(t) if seen else None for t in to[2:4]), pointer(to.dropped)
    call = PictureOnCpu(*counts, *map(pointer, given), ctypes.cast(texels, ctypes.c_void_p), pointer(texture_size), *made)
    assert library.shade_on_cpu(ctypes.byref(call)) == 0
    return to if packed is None else to._replace(packed=packed)


def fields(d: Drawn, of_buffer: bool) -> list[tuple[str, torch.Tensor]]:
    named = [("image", d.image), *((k, v) for k, v in d.made._asdict().items() if v is not None)]
    return named if of_buffer else [*named, ("packed", d.packed), ("depth", d.depth), ("dropped", d.dropped)]


def differences(library: ctypes.CDLL, pictures: Iterable[tuple[Picture, Drawn]]) -> list[str]:
    """Of what the kernels give from what they have to, a line each."""
    found = []
    for number, (picture, wanted) in enumerate(pictures):
        for what, packed, order in (
            ("draw", None, number % 3),
            ("alone", None, number % 4),
            ("shade", wanted.packed, 3 + number % 2),
        ):
            library.set_order(order)  # of threads, and of warps: must not matter
            got = by_the_kernels(library, picture, packed, what != "alone")
            for (name, a), (_, b) in zip(*(fields(d, what != "draw") for d in (wanted, got)), strict=True):
                if count := int((bits(a) != bits(b)).sum()):
                    found.append(f"{what}, picture {number}, order {order}: {count} values of {name} differ")
    return found


def assert_right(pictures: Sequence[Picture]) -> None:
    """The kernels give what the CPU gives."""
    wanted = [(picture, drawn(picture)) for picture in pictures]
    said = cuda_on_cpu.in_children([functools.partial(differences, cuda_on_cpu.kernels(), wanted)])
    assert not said, said


def test_every_effect_and_each_left_out() -> None:
    assert_right(list(of_every_effect()))


def test_several_samples_a_pixel() -> None:
    assert_right(list(of_samples()))


def test_triangles_set_up_before_their_pixels_or_there_and_of_projected_vertices() -> None:
    """kPixelsToPrepare and kPixelsToProject choose the way."""
    assert_right([picture_of(51, (90, 120), 2), of_shared_vertices(52, (33, 47), 3), picture_of(53, (20, 31), 2)])


def test_pixels_on_edges() -> None:
    """Multiplication does not decide their weights, so that they are divided for, by triangles that are set up once more."""
    assert_right([of_edges_on_centres(False), of_edges_on_centres(True)])


def test_pictures_of_a_part_of_the_image() -> None:
    """What no triangle may touch is neither cleared nor read; a buffer that nobody asks for holds rubbish there."""
    assert_right(list(of_parts()))


def test_pictures_of_a_part_of_the_image_of_several_samples_a_pixel() -> None:
    assert_right(list(of_parts_of_samples()))


def test_any_number_of_textures_and_of_lights() -> None:
    assert_right(
        [full_screen((90, 33)), *of_many_textures(), picture_of(42, (20, 30), lights=0), picture_of(43, (20, 30), lights=9)]
    )


def test_more_clipped_triangles_than_are_listed() -> None:
    """Those that find no memory are clipped once more, and with them all samples of a pixel are finished once more."""
    picture = of_many_clipped(900)
    assert len(drawn(picture).packed.unique()) > 600
    assert_right([picture, *of_many_clipped_samples()])


def test_no_triangles_and_no_vertices() -> None:
    picture = picture_of(44, (9, 200))
    s = picture.surface
    none = s._replace(face_normals=s.face_normals[:0], material=s.material[:0])
    empty = picture._replace(triangles=picture.triangles[:0], surface=none)
    assert_right([empty])


def test_bad_indices_read_as_background() -> None:
    picture = picture_of(45, (40, 50), views=2)._replace(cull="back")
    broken, lost = with_bad_indices(picture)
    wanted = drawn(picture)
    named = (wanted.packed & 0xFFFFFFFF).clamp(max=len(lost) - 1)
    where = (wanted.packed != 2**63 - 1) & lost[named]
    empty = drawn(picture._replace(positions=torch.zeros_like(picture.positions)))
    assert where.any() and (~where & (wanted.packed != 2**63 - 1)).any()
    for have, background in ((wanted.image, empty.image), *zip(wanted.made, empty.made, strict=True)):
        have[where] = background[where]

    def body() -> list[str]:
        got = by_the_kernels(cuda_on_cpu.kernels(), broken, wanted.packed)
        pairs = zip(fields(wanted, True), fields(got, True), strict=True)
        return [f"{name} differs" for (name, a), (_, b) in pairs if (bits(a) != bits(b)).any()]

    said = cuda_on_cpu.in_children([body])
    assert not said, said


def test_buffers_that_say_anything() -> None:
    """Nothing ends, and where a buffer names no triangle there is background."""
    picture = picture_of(46, (41, 50), views=2)
    rng, count = np.random.default_rng(0), len(picture.triangles)
    edges = [-1, -(2**63), 2**63 - 1, 2**63 - 2, count, 2**31 - 1, 2**31, 2**32 - 1]
    background = drawn(picture._replace(positions=torch.zeros_like(picture.positions))).image

    def body() -> list[str]:
        for values in (rng.integers(0, count, (2, 41, 50)), rng.choice(edges, (2, 41, 50))):
            got = by_the_kernels(cuda_on_cpu.kernels(), picture, torch.from_numpy(values))
        return [] if np.array_equal(got.image.numpy(), background.numpy()) else ["background"]

    said = cuda_on_cpu.in_children([body])
    assert not said, said


def test_buffers_that_name_triangles_where_they_are_not() -> None:
    """Weights beyond an edge, and none where no record of a clipped triangle covers the pixel, as on edges that do not own it."""
    rng, calls = np.random.default_rng(1), []
    for picture in (of_edges_on_centres(False), of_edges_on_centres(True), picture_of(46, (41, 50), views=2)):
        shape = len(picture.positions), *picture.resolution
        packed, to = torch.from_numpy(rng.integers(0, len(picture.triangles), shape)), outputs(picture)
        shade(packed, picture.positions, picture.triangles, picture.surface, to.image, to.made, RUNGS[DEFAULT], "native")
        calls.append((picture, packed, to))

    def body() -> list[str]:
        found = []
        for number, (picture, packed, wanted) in enumerate(calls):
            got = by_the_kernels(cuda_on_cpu.kernels(), picture, packed)
            pairs = zip(fields(wanted, True), fields(got, True), strict=True)
            found += [f"picture {number}: {name}" for (name, a), (_, b) in pairs if (bits(a) != bits(b)).any()]
        return found

    said = cuda_on_cpu.in_children([body])
    assert not said, said


def test_transform() -> None:
    points = torch.from_numpy(awkward(300))
    matrices = torch.from_numpy(np.stack([camera.matrix(ASPECT) for camera in cameras()]))
    wanted = transform(points, matrices, "native")

    def body() -> list[str]:
        out = torch.empty_like(wanted)
        sizes = (ctypes.c_int64(len(a)) for a in (points, matrices))
        assert cuda_on_cpu.kernels().transform_on_cpu(pointer(points), pointer(matrices), *sizes, pointer(out)) == 0
        return [] if np.array_equal(bits(out), bits(wanted)) else ["differs"]

    said = cuda_on_cpu.in_children([body])
    assert not said, said


def test_more_pixels_than_are_launched_at_once_and_words_that_are_looked_at_together(tmp_path) -> None:
    """With limits of some views of these pictures and of a pixel, as 2^29 pixels, and 2^22, are too many for a test."""
    of_large, at_once = "kPixelsOfLarge = 4 << 20", "kSamplesAtOnce = 1 << 29"
    between = (cuda_on_cpu.CSRC / "cuda/shade.cu").read_text().partition(of_large)[2].partition(at_once)[0]
    change = of_large + between + at_once, f"kPixelsOfLarge = 1{between}kSamplesAtOnce = 5000"
    library = cuda_on_cpu.build(tmp_path / "build", ("shade.cu", *change))
    pictures = [picture_of(48, (33, 47), views=5, channels=4), picture_of(49, (16, 31), 7, samples=2), of_many_clipped(900)]
    pictures += [picture_of(54, (60, 100), views=3), picture_of(55, (70, 97), views=3, made=False, channels=4)]
    pictures.append(of_shared_vertices(56, (33, 47), 3))
    said = cuda_on_cpu.in_children([functools.partial(differences, library, [(p, drawn(p)) for p in pictures])])
    assert not said, said


def also(*row: str) -> Any:
    """A row that every other run leaves out; each takes as long as it takes to compile the kernels."""
    return pytest.param(*row, marks=exhaustive)


@pytest.mark.parametrize(
    ("file", "old", "new", "said"),
    [
        ("shade_work.cuh", "return at.view * work.height + at.y;", "return at.y;", "values of image"),
        ("shade_begin.cuh", "return kNoPlace;", "return 0;", "picture 2"),
        ("shade_pixels.cuh", "work.projected + at.view * job.vertices", "work.projected", "picture 3"),
        ("shade_pixels.cuh", "if (pixels >= kWarp && ((uintptr_t)bytes & 3) == 0) {", "if (true) {", "access beyond memory"),
        also("shade_begin.cuh", "(shift + 8 * k) % 24", "shift % 24", "alone, picture 4"),
        ("clear.cu", "row_of(box.y1 - 1) - top + 1}", "row_of(box.y1 - 1) - top}", "alone, picture 4"),
        also(
            "clear.cu", "PixelBox box = {0, 0, f.view.width, f.view.height};", "PixelBox box = {0, 0, 1, 1};", "alone, picture 6"
        ),
        also("clear.cu", "kAll << (8 * max_of(left, 0))", "kAll << 8 << (8 * max_of(left, 0))", "alone, picture 6"),
        also("clear.cu", "samples.quotient((uint32_t)x) / kAreaWidth", "x / kAreaWidth", "alone, picture 7"),
        ("clear.cu", "kAreaHeight * f.area_samples", "kAreaHeight", "alone, picture 7"),
        ("shade_samples.cuh", "(sample.view * job.height + sample.y)", "sample.y", "shade, picture 7"),
        also("shade_samples.cuh", "finish_behind(work, place.y,", "finish_behind(work, 0,", "shade, picture 7"),
        also("shade_left.cuh", "if (triangle >= 0 && !wanted) sample", "if (false) sample", "shade, picture 8"),
        ("shade_left.cuh", "mine |= is_left", "mine = is_left", "shade, picture 8"),
        ("shade_begin.cuh", "work.flags + view * job.vertices", "work.flags", "picture 3"),
        also("shade_begin.cuh", "(blockIdx.x * work.places + place)", "place", "picture 5"),
        also("skin.cuh", "normal.value[c][0] * skin->look.facing", "normal.value[c][0]", "picture 5"),
        also("weights.cuh", "view, triangle, nullptr, &t,", "0, triangle, nullptr, &t,", "picture 9"),
    ],
)
def test_what_is_broken_shows(file: str, old: str, new: str, said: str, tmp_path) -> None:
    """Rows of the next view, more clipped triangles than there is memory for, its vertices, a picture's end; the background's
    channels, a triangle's last row of areas, those of one to be clipped, and all in a row but the first; areas and clearing as
    if a pixel were one sample, samples of another view, their background; of a pixel that is left, samples that are not, and
    whether any is; which vertices have to be clipped, where a triangle was, a face's light on the wrong side, and weights of
    another view's triangle."""
    library = cuda_on_cpu.build(tmp_path / "build", (file, old, new))
    small = picture_of(47, (90, 33), views=3, made=False, count=2000)
    shared = of_shared_vertices(52, (33, 47), 3)
    pictures = (
        small,
        full_screen((90, 33)),
        of_many_clipped(900),
        shared,
        *itertools.islice(of_parts(), 2),
        list(of_parts())[-1],
        next(of_parts_of_samples()),
        list(of_many_clipped_samples())[1],
        of_edges_on_centres(False),
    )
    wanted = [(p, drawn(p)) for p in pictures]
    assert said in cuda_on_cpu.in_children([functools.partial(differences, library, wanted)])
