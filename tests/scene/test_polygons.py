"""Triangulations: of all sorts of polygons, the triangles of one cover it once."""

import numpy as np
import pytest

from bigtri.scene.readers import polygons
from bigtri.scene.readers.model import Model, ModelError
from bigtri.scene.readers.polygons import indices_of, triangulate


def turned(points, seed):
    """Points of a plane, in space."""
    matrix = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return np.column_stack([points, np.zeros(len(points))]) @ (matrix * np.linalg.det(matrix)).T


def side(a, b, c):
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def star(seed):
    """Whole numbers around (0, 0), counter-clockwise, so that areas are exact."""
    random = np.random.default_rng(seed)
    angle = (np.arange(n := int(random.integers(4, 30))) + random.random(n) * 0.5) * (2 * np.pi / n)
    return np.rint(np.stack([np.cos(angle), np.sin(angle)], axis=1) * random.integers(100, 1000, (n, 1)))


def cut(positions, *polygons_of_corners, findings=()):
    model = Model()
    corners = np.array([c for polygon in polygons_of_corners for c in polygon], np.int32)
    corner, polygon = triangulate(model, positions, corners, np.array([len(p) for p in polygons_of_corners]))
    assert tuple(model.findings) == findings
    return corners[corner], polygon


@pytest.mark.parametrize("space", [False, True])
def test_stars(space):
    for seed in range(200):
        points = star(seed)
        n = len(points)
        positions = turned(points, seed) if space else np.column_stack([points, np.zeros(n)])
        triangles, _ = cut(positions, range(n))
        assert triangles.shape == (n - 2, 3)
        areas = [side(*points[t]) for t in triangles]
        assert min(areas) >= 0 and sum(areas) == sum(side((0, 0), points[i - 1], points[i]) for i in range(n)), seed


def test_a_hole_reached_by_an_edge_there_and_back():
    outer, hole = [(0, 0), (9, 0), (9, 9), (0, 9)], [(3, 3), (3, 6), (6, 6), (6, 3)]
    points = np.array([*outer, *hole])
    around = [0, 1, 2, 3, 0, 4, 5, 6, 7, 4]
    positions = np.column_stack([points, np.zeros(8)])
    for i in range(len(around)):
        triangles, _ = cut(positions, around[i:] + around[:i])
        areas = [side(*points[t]) for t in triangles]
        assert len(triangles) == 8 and min(areas) >= 0 and sum(areas) == 2 * (81 - 9)
        centre = np.array((4.5, 4.5))
        assert not any(
            min(side(p, q, centre) for p, q in zip(t, np.roll(t, -1, axis=0), strict=True)) > 0 for t in points[triangles]
        )


def test_corners_on_a_straight_edge_and_in_one_place():
    points = np.array([(0, 0), (1, 0), (2, 0), (2, 2), (1, 1), (1, 1), (0, 2)])
    triangles, _ = cut(np.column_stack([points, np.zeros(7)]), range(7))
    areas = [side(*points[t]) for t in triangles]
    assert len(triangles) == 5 and min(areas) >= 0 and sum(areas) == 6


def test_what_has_no_right_triangulation_gets_some():
    crossed = np.array([(0, 0, 0), (2, 2, 0), (2, 0, 0), (0, 2, 0), (1, 5, 0)], float)
    not_a_number = np.full((5, 3), np.nan)
    for positions in (crossed, not_a_number, np.zeros((5, 3)), np.full((5, 3), 1e300)):
        triangles, _ = cut(positions, range(5))
        assert triangles.shape == (3, 3)


def test_the_order_of_polygons_is_kept():
    """Triangles of convex and concave ones, of several sizes."""
    positions = np.array([(0, 0, 0), (4, 0, 0), (4, 4, 0), (0, 4, 0), (2, 1, 0)], float)
    corners = [[0, 1, 2], [0, 1, 2, 3], [0, 4, 1, 2, 3], [], [0, 1], [0, 4, 1, 2], [3, 0, 1]]
    triangles, polygon = cut(positions, *corners, findings=("faces of one or two corners",))
    assert polygon.tolist() == [0, 1, 1, 2, 2, 2, 5, 5, 6]
    assert triangles[:3].tolist() == [[0, 1, 2], [0, 1, 2], [2, 3, 0]] and triangles[-1].tolist() == [3, 0, 1]
    assert all(side(*positions[t]) > 0 for t in triangles)


def test_many_at_a_time_are_as_each_alone(monkeypatch):
    points = [star(seed) for seed in range(40)]
    positions = np.concatenate([np.column_stack([p, np.zeros(len(p))]) for p in points])
    begin = np.cumsum([0] + [len(p) for p in points])
    ranges = [range(begin[i], begin[i + 1]) for i in range(40)]
    together, polygon = cut(positions, *ranges)
    for i, corners in enumerate(ranges):
        assert np.array_equal(together[polygon == i], cut(positions, corners)[0])
    monkeypatch.setattr(polygons, "_BLOCK", 1)
    assert np.array_equal(together, cut(positions, *ranges)[0])


def test_polygons_that_are_too_large(monkeypatch):
    monkeypatch.setattr(polygons, "MAX_CORNERS", 5)
    points = np.array([(0, 0, 0), (4, 0, 0), (4, 4, 0), (2, 1, 0), (1, 1, 0), (0, 4, 0)], float)
    model = Model()
    triangles, _ = triangulate(model, points, np.arange(6, dtype=np.int32), np.array([6]))
    assert len(triangles) == 4 and list(model.findings) == ["large concave polygons"]


def test_indices():
    assert indices_of("faces", np.array([0.0, 2.0]), 3).dtype == np.int32
    for values, text in (([0, 3], "got indices from 0 to 3"), ([-1, 0], "got indices from -1 to 0"), ([0.5], "got 0.5")):
        with pytest.raises(ModelError, match=f"faces must index the .*vertices.*{text}"):
            indices_of("faces", np.array(values), 3)
