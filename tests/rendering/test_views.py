"""The explaining pictures: what they claim is what the stages say."""

import numpy as np
import pytest
from backends import BACKENDS

from bigtri import Camera, Visibility, rasterize
from bigtri.rendering import views
from bigtri.scene import from_trimesh


def flat(*triangles) -> tuple[np.ndarray, np.ndarray]:
    """Clip-space triangles from (x, y, z) corners in normalized device coordinates."""
    positions = np.array(triangles, np.float32).reshape(-1, 3)
    positions = np.column_stack([positions, np.ones(len(positions), np.float32)])
    return positions, np.arange(len(positions), dtype=np.int32).reshape(-1, 3)


WHOLE = [(-1, -1, 0.5), (3, -1, 0.5), (-1, 3, 0.5)]  # covers the screen
LEFT = [(-1, -1, 0), (0, -1, 0), (-1, 1, 0)]


def seen(triangle, depth=None) -> Visibility:
    triangle = np.asarray(triangle, np.int32)
    depth = np.where(triangle >= 0, 0.5, np.inf) if depth is None else depth
    return Visibility(triangle.astype(np.int64), np.asarray(depth, np.float32), np.zeros((), np.int64))


@pytest.mark.parametrize("backend", BACKENDS)
def test_fragment_counts_are_coverage_added_up(backend):
    positions, triangles = flat(WHOLE, LEFT, WHOLE)
    size = (130, 200)
    count = views.fragment_counts(positions, triangles, size, backend=backend)
    expected = sum((rasterize(positions, triangles[t : t + 1], size).triangle == 0).astype(int) for t in range(3))
    assert np.array_equal(count, expected) and count.max() == 3 and count.min() == 2
    image = views.overdraw(positions, triangles, size, backend=backend)
    assert image.shape == (*size, 3) and image.dtype == np.uint8
    assert len(np.unique(image[:60].reshape(-1, 3), axis=0)) == 2  # above the colour bar: two counts, two colours


def test_ids_differ_and_do_not_depend_on_the_picture():
    image = views.triangle_ids(seen([[-1, *range(2000)]]))
    assert len(np.unique(image[0, 1:], axis=0)) > 1900
    assert np.array_equal(views.triangle_ids(seen([[1234, -1]]))[0], image[0, [1235, 0]])
    assert image[0, 1:].max(axis=1).min() > 120  # none is as dark as the background


def test_depth_is_lighter_nearer_and_blue_where_nothing_is():
    camera = Camera((0, 0, 0), (0, 0, -1), near=1, far=100)
    distance = np.array([1, 2, 4, 8, 16, np.inf])
    window = np.where(np.isfinite(distance), 100 / 99 * (1 - 1 / distance), np.inf)
    image = views.depth(seen([[0, 0, 0, 0, 0, -1]], [window]), camera).astype(int)
    assert (image[0, :5] == image[0, :5, :1]).all()
    steps = -np.diff(image[0, :5, 0])
    assert (steps > 20).all() and steps.max() - steps.min() < 20
    assert image[0, 5, 2] > image[0, 5, 0]
    assert views.depth(seen([[-1]]), camera).shape == (1, 1, 3)


def test_normals():
    directions = np.array([[(0, 0, 2), (-5, 0, 0), (0, 0, 0)]], np.float32)
    image = views.normals(directions, seen([[0, 1, 2]]))
    assert image[0].tolist() == [[128, 128, 255], [0, 128, 128], [128, 128, 128]]


@pytest.mark.parametrize("backend", BACKENDS)
def test_bins_of_one_triangle(backend):
    positions, triangles = flat(WHOLE, [(-0.95, -0.9, 0), (0.9, -0.95, 0), (-0.9, 0.95, 0)])
    image = views.bins(positions, triangles, (512, 512), triangle=1, backend=backend).astype(int)

    def is_mostly(x, y, channel):
        return image[y, x, channel] > 1.3 * np.delete(image[y, x], channel).max()

    assert is_mostly(100, 300, 1)  # deep inside: a full tile, green
    assert is_mostly(476, 36, 0)  # the bin at the upper right: rejected, red
    assert image[3, 3].tolist() != image[30, 30].tolist()  # outside the bounding box, inside its first bin: border and fill
    whole = views.bins(positions, triangles, (512, 512), backdrop=np.full((512, 512, 3), 200, np.uint8), backend=backend)
    assert whole.shape == (512, 512, 3) and whole.dtype == np.uint8


def test_pictures_of_a_scene():
    import trimesh

    scene = from_trimesh(trimesh.creation.box())
    camera = Camera.framing(scene.bounds)
    pictures = [views.picture(view, scene, camera, (150, 200)) for view in views.VIEWS]
    assert all(picture.shape == (150, 200, 3) and picture.dtype == np.uint8 for picture in pictures)
    assert len({picture.tobytes() for picture in pictures}) == len(views.VIEWS)
    with pytest.raises(ValueError, match="view must be one of 'shaded'.*got 'wireframe'"):
        views.picture("wireframe", scene, camera, (150, 200))


@pytest.mark.parametrize("size", [(1, 1), (3, 2), (40, 18), (9, 40)])
def test_views_of_few_pixels(size):
    positions, triangles = flat(*[WHOLE] * 40)  # more counts than the colour bar has pixels
    assert views.overdraw(positions, triangles, size).shape == (*size, 3)
    assert views.overdraw(*flat(WHOLE, LEFT), size).shape == (*size, 3)
    assert views.bins(positions, triangles, size).shape == (*size, 3)


def test_count_bits():
    masks = np.array([[0, -1], [1, 0], [5, 0], [-(2**63), 0]], np.int64)
    assert views.count_bits(masks[:, 0]) == 4 and views.count_bits(masks[:1, 1]) == 64


def test_views_of_nothing():
    positions, triangles = np.zeros((0, 4), np.float32), np.zeros((0, 3), np.int32)
    assert views.overdraw(positions, triangles, (100, 120)).shape == (100, 120, 3)
    assert views.bins(positions, triangles, (100, 120)).shape == (100, 120, 3)
