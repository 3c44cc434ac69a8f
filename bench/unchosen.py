"""Cases that nobody chose: a mesh, a camera, a size and a number of views at random, by number. For best.py.

Scenes and cameras of a benchmark are what a program is tuned for. These are meshes that people have, from where they may stand:
a body or a model from far away, from close by or from within; a terrain or a room from anywhere in it; many copies of one mesh;
triangles without shared vertices or in random order; pictures of any shape; batches whose views have nothing in common.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
from cuda_cases import Maker
from cuda_clock import Job
from numpy.random import Generator

from bigtri.scene import Camera
from bigtri.study import meshes
from bigtri.study.meshes import Batch, Mesh

KINDS = ("body", "body", "body", "terrain", "room", "courtyard", "copies", "soup")
SIDES = (64, 4096)  # px
LONGEST = 3  # times the other side
MOST_VIEWS, MOST_PIXELS, MOST_TRIANGLES = 512, 20_000_000, 8_000_000  # of a batch, all its views together


def between(rng: Generator, low: float, high: float) -> float:
    """As likely between 1 and 2 as between 10 and 20."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def copies(mesh: Mesh, number: int, rng: Generator) -> Mesh:
    """So many of it in a cube, about as close to each other as they can be without touching."""
    low, high = mesh.bounds()
    places = rng.uniform(-0.6, 0.6, (number, 3)) * (high - low).max() * number ** (1 / 3)
    vertices = (mesh.vertices + places[:, None]).reshape(-1, 3)
    triangles = mesh.triangles + len(mesh.vertices) * np.arange(number, dtype=np.int32)[:, None, None]
    return Mesh(vertices, triangles.reshape(-1, 3))


def soup(mesh: Mesh) -> Mesh:
    """Each triangle with vertices of its own."""
    return Mesh(
        mesh.vertices[mesh.triangles].reshape(-1, 3), np.arange(mesh.triangles.size, dtype=np.int32).reshape(mesh.triangles.shape)
    )


def some_body(rng: Generator, seed: int, models: dict[str, Mesh], most: float) -> tuple[str, Mesh]:
    """One of the models, or a bumpy body of marching cubes with at most so many cells a side."""
    if models and rng.random() < 0.7:
        name = str(rng.choice(sorted(models)))
        return name, models[name]
    cells = int(between(rng, 8, most))
    return f"body{cells}", meshes.body(cells, seed)


def some_mesh(rng: Generator, kind: str, seed: int, models: dict[str, Mesh]) -> tuple[str, Mesh]:
    """A mesh of one of KINDS, and a name for it."""
    if kind == "terrain":
        side = int(between(rng, 10, 700))
        return f"terrain{side}", meshes.terrain(side, seed)
    if kind == "room":
        pieces = int(between(rng, 2, 300))
        return f"room{pieces}", meshes.room(pieces, seed)
    if kind == "courtyard":
        return kind, meshes.demo()
    name, mesh = some_body(rng, seed, models, 60 if kind == "copies" else 450)
    if kind == "copies":
        number = int(between(rng, 2, 40))
        return f"{name}*{number}", copies(mesh, number, rng)
    if kind == "soup":
        return f"{name} soup", soup(mesh)
    return (f"{name} shuffled", meshes.shuffled(mesh, seed)) if rng.random() < 0.15 else (name, mesh)


def some_camera(rng: Generator, kind: str, mesh: Mesh, aspect: float) -> Camera:
    """From anywhere within what is seen from within, else on a sphere around it; aspect: width / height."""
    low, high = mesh.bounds()
    size, radius = high - low, float(np.linalg.norm(high - low)) / 2
    within = kind == "room" or (kind in ("terrain", "courtyard") and rng.random() < 0.7)
    if not within:
        distance, field = between(rng, 0.15, 6), float(rng.uniform(25, 80))
        azimuth, elevation = float(rng.uniform(0, 360)), float(rng.uniform(-80, 80))
        return Camera.framing(mesh.bounds(), azimuth, elevation, distance, aspect, field)
    eye = (low + high) / 2 + size * rng.uniform(-0.45, 0.45, 3)
    if kind != "room":
        eye[1] = high[1] * rng.uniform(0.3, 1.5)
    forward = rng.normal(size=3) * (1, 0.3, 1)
    field = float(rng.uniform(35, 90))
    return Camera(tuple(eye), tuple(eye + forward), fov_y=field, near=radius / 2000, far=4 * radius)


def case(number: int, seed: int, models: dict[str, Mesh]) -> tuple[Job, Batch]:
    """The same one for the same number, seed and models."""
    rng = np.random.default_rng((seed, number))
    kind = str(rng.choice(KINDS))
    name, mesh = some_mesh(rng, kind, seed + number, models)
    width, height = (int(between(rng, *SIDES)) for _ in range(2))
    width, height = min(width, LONGEST * height), min(height, LONGEST * width)
    views = int(between(rng, 2, MOST_VIEWS)) if rng.random() < 0.3 else 1
    while views > 1 and (views * width * height > MOST_PIXELS or views * len(mesh.triangles) > MOST_TRIANGLES):
        views, width, height = views * 2 // 3, max(width * 4 // 5, SIDES[0]), max(height * 4 // 5, SIDES[0])
    aspect = width / height
    seen = [some_camera(rng, kind, mesh, aspect).transform(mesh.vertices, aspect) for _ in range(views)]
    return Job(f"{number} {name}", width, height, seed, views), Batch(
        np.stack(seen) if views > 1 else seen[0], mesh.triangles, None
    )


def made(count: int, seeds: list[int], maker: Maker, end: float) -> Iterator[tuple[Job, Batch]]:
    """So many cases of each seed, until ``time.perf_counter()`` is past ``end``; what is left out is said."""
    numbers = [(number, seed) for seed in seeds for number in range(count)]
    for done, (number, seed) in enumerate(numbers):
        if time.perf_counter() > end:
            print(f"--total is over: {len(numbers) - done} left out")
            return
        yield case(number, seed, maker.models)
