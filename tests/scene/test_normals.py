"""Normals and closedness, bit for bit against loops that follow their definition."""

import math
from collections import Counter

import numpy as np
import pytest
import trimesh

from bigtri.scene import normals
from bigtri.scene.normals import face_normals, is_closed, split_normals, weld


def cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def dot(a, b):
    return (a[0] * b[0] + a[1] * b[1]) + a[2] * b[2]


def subtract(a, b):
    return tuple(p - q for p, q in zip(a, b, strict=True))


def unit(v):
    length = math.sqrt(dot(v, v)) if math.isfinite(dot(v, v)) else math.nan
    return tuple(component / length for component in v) if length > 0 else (0.0, 0.0, 0.0)


def area_vector(positions, triangle):
    a, b, c = (positions[v].tolist() for v in triangle)
    return cross(subtract(b, a), subtract(c, a))


def split_by_definition(positions, triangles, crease=50.0):
    area = [area_vector(positions, triangle) for triangle in triangles]
    units = [unit(v) for v in area]
    around = {}
    for t, triangle in enumerate(triangles.tolist()):
        for v in triangle:
            around.setdefault(tuple(positions[v].tolist()), []).append(t)
    corners = {}
    for t, triangle in enumerate(triangles.tolist()):
        for i, v in enumerate(triangle):
            faces = around[tuple(positions[v].tolist())]
            total = (0.0, 0.0, 0.0)
            for other in faces:
                if len(faces) > 64 or dot(units[t], units[other]) >= math.cos(math.radians(crease)):
                    total = tuple(p + q for p, q in zip(total, area[other], strict=True))
            normal = np.array(unit(total)).astype(np.float32) + np.float32(0)
            corners[t, i] = (v, *normal.view(np.int32).tolist())
    unique = sorted(set(corners.values()))
    numbers = {key: n for n, key in enumerate(unique)}
    new = np.array([[numbers[corners[t, i]] for i in range(3)] for t in range(len(triangles))], np.int32).reshape(-1, 3)
    rows = np.array(unique, np.int64).reshape(-1, 4)
    return rows[:, 0], new, rows[:, 1:].astype(np.int32).view(np.float32)


def closed_by_definition(positions, triangles):
    places = [[tuple(positions[v].tolist()) for v in triangle] for triangle in triangles]
    solid = [triangle for triangle in places if len(set(triangle)) == 3]
    edges = Counter((t[i], t[(i + 1) % 3]) for t in solid for i in range(3))
    origin = solid[0][0] if solid else None
    volume = sum(dot(subtract(a, origin), cross(subtract(b, origin), subtract(c, origin))) for a, b, c in solid)
    return all(edges[b, a] == count for (a, b), count in edges.items()) and volume > 0


def grid_points(rng, count):
    """Many in the same place, also as -0."""
    return rng.choice(np.array([-2, -1, -0.5, -0.0, 0, 1, 3], np.float32), (count, 3))


def soup(seed):
    """Triangles at random: without an area, all sorts of creases, more than 64 corners in one place, vertices without a use."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 60))
    positions = grid_points(rng, count) if seed % 2 else rng.normal(size=(count, 3)).astype(np.float32)
    return positions, rng.integers(0, count, (int(rng.integers(0, 120)), 3)).astype(np.int32)


def rough(seed):
    """Closed bodies, of which some have creases in some places."""
    make = (trimesh.creation.box, trimesh.creation.icosphere, trimesh.creation.torus, trimesh.creation.cylinder)[seed % 4]
    sizes = ({}, {"subdivisions": 2}, {"major_radius": 2, "minor_radius": 1, "major_sections": 9}, {"radius": 1, "height": 2})
    mesh = make(**sizes[seed % 4])
    noise = np.random.default_rng(seed).normal(size=mesh.vertices.shape) * (0, 0.05, 0.2)[seed % 3]
    positions, triangles = (mesh.vertices + noise).astype(np.float32), mesh.faces.astype(np.int32)
    if seed % 5 == 1:  # every triangle with vertices of its own
        return positions[triangles.reshape(-1)], np.arange(triangles.size, dtype=np.int32).reshape(-1, 3)
    return positions, triangles


def fan(_):
    """One place with more corners than are compared in pairs, beside creases."""
    angle = np.arange(100) * (2 * np.pi / 100)
    rim = np.stack([np.cos(angle), np.sin(angle), np.where(np.arange(100) % 2, 2, 0)], axis=1)
    triangles = np.stack([np.zeros(100), 1 + np.arange(100), 1 + (np.arange(100) + 1) % 100], axis=1)
    return np.concatenate([np.zeros((1, 3)), rim]).astype(np.float32), triangles.astype(np.int32)


def huge(seed):
    """Areas whose squares are near the end of float64."""
    positions, triangles = soup(seed)
    return positions * np.float32(3e37), triangles


MESHES = [(make, seed) for make, seeds in ((soup, 24), (rough, 12), (fan, 1), (huge, 2)) for seed in range(seeds)]


# The sizes at which work is cut into parts change no bit.
@pytest.mark.parametrize("part", [None, 7])
def test_the_definition_bit_for_bit(monkeypatch, part):
    if part:
        monkeypatch.setattr(normals, "_CHUNK", part)
        monkeypatch.setattr(normals, "_BLOCK", part)
    for make, seed in MESHES:
        positions, triangles = make(seed)
        got, expected = split_normals(positions, triangles), split_by_definition(positions, triangles)
        for name, ours, theirs in zip(("source", "triangles", "normals"), got, expected, strict=True):
            assert ours.dtype == theirs.dtype and ours.shape == theirs.shape, (make, seed, name)
            assert ours.tobytes() == theirs.tobytes(), (make, seed, name)
        assert is_closed(positions, triangles) == closed_by_definition(positions, triangles), (make, seed)
        flat = np.array([unit(area_vector(positions, triangle)) for triangle in triangles]).reshape(-1, 3).astype(np.float32)
        assert np.array_equal(face_normals(positions, triangles), flat), (make, seed)


def test_other_creases():
    for crease in (0.0, 20.0, 90.0, 180.0):
        positions, triangles = rough(5)
        for ours, theirs in zip(
            split_normals(positions, triangles, crease), split_by_definition(positions, triangles, crease), strict=True
        ):
            assert ours.tobytes() == theirs.tobytes(), crease


def test_the_same_place():
    positions = grid_points(np.random.default_rng(1), 200)
    place = weld(positions)
    assert place.dtype == np.int32 and place.min() >= 0 and place.max() < len(positions)
    assert np.array_equal(place[:, None] == place, (positions[:, None] == positions).all(axis=2))
    assert len(weld(positions[:0])) == 0
