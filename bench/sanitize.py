"""Draws a small image in every way there is, for compute-sanitizer: every CUDA variant, every path of it, small queues, depth.
Then interpolates, samples, lights and encodes over it.

compute-sanitizer --tool memcheck python bench/sanitize.py
compute-sanitizer --tool racecheck python bench/sanitize.py --quick

Each image is compared with the CPU's, so it is also a test by itself. With --device cpu it draws the CPU's variants, which says
whether the script runs.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import sys
import time
from typing import Any

import numpy as np
import torch

import bigtri
from bigtri import native
from bigtri.app import arguments as option_types
from bigtri.ops.texture import FILTERS, WRAPS
from bigtri.study import scenes

PATHS: dict[str, dict[str, int]] = {
    "as it is": {},
    "few": {"few": 65536},
    "rows": {"few": 0},
    "rows, queue 1": {"few": 0, "widest": 8, "queue": 1},
    "rows, two bands, short lists": {"few": 0, "widest": 8, "cache": 200_000, "queue": 600},
    "none by rows": {"few": 0, "widest": 1},
    "in teams": {"few": 0, "share": 16, "team": 4},
    "in groups": {"few": 0, "share": 124},
    "even": {"few": 0, "share": 256},
    "even, fewer": {"few": 0, "share": 192},
    "apart": {"few": 0, "share": 128},
    "tested": {"few": 0, "share": 1024},
    "entries 1": {"few": 65536, "entries": 1},
    "rows, entries 1": {"few": 0, "widest": 8, "entries": 1},
    "8 warps, 4 px": {"few": 65536, "warps": 8, "region": 4},
    "8 warps, 8 px": {"few": 65536, "warps": 8, "region": 8},
    "16 warps, 8 px": {"few": 65536, "warps": 16, "region": 8},
    "16 warps, 16 px": {"few": 65536, "warps": 16, "region": 16},
    "one block": {"few": 65536, "blocks": 1},
}
QUICK = (
    "few",
    "16 warps, 16 px",
    "rows",
    "rows, queue 1",
    "in teams",
    "in groups",
    "even",
    "even, fewer",
    "apart",
    "tested",
    "entries 1",
)
CULLS = ("none", "back")


def clip_space(seed: int, count: int, w: tuple[float, float]) -> scenes.Triangles:
    """Triangles anywhere in clip space, w uniform over the interval: with one below 0, most of them are clipped."""
    rng = np.random.default_rng(seed)
    positions = rng.uniform(-2, 2, (3 * count, 4))
    positions[:, 3] = rng.uniform(*w, 3 * count)
    return scenes.Triangles(positions.astype(np.float32), np.arange(3 * count, dtype=np.int32).reshape(-1, 3))


def bad_values(scene: scenes.Triangles) -> scenes.Triangles:
    """The same triangles, some of them with a NaN, an infinity or no area."""
    positions, triangles = scene.positions.copy(), scene.triangles.copy()
    positions[0, 0], positions[4, 3], positions[7] = np.nan, np.inf, positions[8]
    triangles[3] = triangles[3, 0]
    return scenes.Triangles(positions, triangles)


def pictures(width: int, height: int) -> dict[str, scenes.Triangles]:
    def in_pixels(mesh: scenes.Mesh) -> scenes.Triangles:
        return scenes.to_clip(mesh, width, height)

    rng = np.random.default_rng(5)
    ends = rng.uniform([0, 0], [width, height], (40, 2, 2))
    thin = np.concatenate([ends, ends[:, 1:] + rng.uniform(-1.5, 1.5, (40, 1, 2))], axis=1)
    slivers, mesh = scenes.soup(thin, scenes.tilted(rng, 40, 0.02)), scenes.small_mesh(3000, width, height, 4)
    return {
        "large": in_pixels(scenes.large(20, width, height, 1, area=(300, 4000))),
        "very large": in_pixels(scenes.very_large(12, width, height, 2)),
        "full screens": in_pixels(scenes.full_screen(9, width, height, 3, back_to_front=True)),
        "mesh": in_pixels(mesh),
        "slivers": in_pixels(slivers),
        "slivers and mesh": in_pixels(scenes.joined(slivers, mesh)),
        "clipped": clip_space(6, 60, (-1, 1.5)),
        "clipped by far planes": clip_space(7, 300, (0.2, 0.6)),
        "bad values": bad_values(clip_space(8, 30, (0.5, 2))),
        "one": in_pixels(scenes.full_screen(1, width, height, 9, back_to_front=False)),
        "none": scenes.Triangles(np.zeros((0, 4), np.float32), np.zeros((0, 3), np.int32)),
    }


def tensor(value: object) -> torch.Tensor:
    """What bigtri returns for tensors, said to the type checker."""
    assert isinstance(value, torch.Tensor)
    return value


def shaded(positions: torch.Tensor, triangles: torch.Tensor, packed: torch.Tensor) -> dict[str, torch.Tensor]:
    """What reads a visibility buffer, each operator with each of its settings."""

    def given(*shape: int) -> torch.Tensor:
        return torch.from_numpy(np.random.default_rng(shape).uniform(-0.2, 1.4, shape).astype(np.float32)).to(packed.device)

    found = {"barycentrics": tensor(bigtri.barycentrics(packed, positions, triangles))}
    for channels in (1, 2, 3, 5):
        attributes = given(len(positions), channels)
        found[f"interpolate {channels}"] = tensor(bigtri.interpolate(attributes, packed, positions, triangles))
    uv = found["interpolate 2"]
    for how, wrap in itertools.product(FILTERS, WRAPS):
        found[f"sample_texture {how} {wrap}"] = bigtri.sample_texture(given(13, 7, 3), uv, filter=how, wrap=wrap)
    normals = found["interpolate 3"]
    found["lambert"] = bigtri.lambert(normals, given(*normals.shape), given(3), given(2, 3), given(2, 3))
    found["encode_srgb"] = bigtri.encode_srgb(found["lambert"])
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--size", type=option_types.size, default="200x150", help="WIDTHxHEIGHT (default 200x150)")
    parser.add_argument("--only", metavar="PICTURE", help="one of the pictures, such as 'slivers and mesh'")
    parser.add_argument("--quick", action="store_true", help="only the main paths, without culling and scissor")
    parser.add_argument("--total", type=float, default=1e9, help="s: skip the rest after that, and say so")
    parser.add_argument("--device", default="cuda", choices=("cuda", "cpu"))
    arguments = parser.parse_args()
    width, height = arguments.size
    if arguments.device not in native.devices():
        raise SystemExit(f"no {arguments.device} here")
    paths = {name: PATHS[name] for name in (QUICK if arguments.quick else PATHS)}
    scissors: list[tuple[int, int, int, int] | None] = [None]
    if not arguments.quick:
        scissors.append((3, 70, width - 9, height - 1))
    end = time.perf_counter() + arguments.total
    drawn = wrong = skipped = 0
    drawings = pictures(width, height)
    if arguments.only is not None:
        if arguments.only not in drawings:
            parser.error(f"--only must be one of {', '.join(drawings)}, got {arguments.only!r}")
        drawings = {arguments.only: drawings[arguments.only]}
    for title, scene in drawings.items():
        on_cpu = torch.from_numpy(scene.positions), torch.from_numpy(scene.triangles)
        here = on_cpu[0].to(arguments.device), on_cpu[1].to(arguments.device)
        for cull, scissor in ((c, s) for c in (CULLS[:1] if arguments.quick else CULLS) for s in scissors):
            how: dict[str, Any] = {"cull": cull, "scissor": scissor}
            expected = bigtri.rasterize(*on_cpu, (height, width), backend="native", **how)
            for variant, (path, tuning) in ((v, p) for v in native.VARIANTS[arguments.device] for p in paths.items()):
                for depth in (False, True):
                    if time.perf_counter() > end:
                        skipped += 1
                        continue
                    with native.using_parameters(**tuning) if arguments.device == "cuda" else contextlib.nullcontext():
                        seen = bigtri.rasterize(*here, (height, width), variant=variant, depth=depth, **how)
                    bits = int((tensor(seen.packed).cpu() != tensor(expected.packed)).sum())
                    bits += int(seen.dropped != expected.dropped)
                    if depth:
                        depths = [tensor(image.depth).cpu().view(torch.int32) for image in (seen, expected)]
                        bits += int((depths[0] != depths[1]).sum())
                    drawn, wrong = drawn + 1, wrong + bits
                    if bits:
                        print(f"{title}; {how}; {variant}, {path}, depth={depth}: {bits} values differ", flush=True)
        colors, wanted = (shaded(*at, tensor(bigtri.rasterize(*at, (height, width)).packed)) for at in (here, on_cpu))
        for name, values in wanted.items():
            bits = int((colors[name].cpu().view(torch.uint8) != values.view(torch.uint8)).sum())
            drawn, wrong = drawn + 1, wrong + bits
            if bits:
                print(f"{title}; {name}: {bits} bytes differ", flush=True)
        print(f"{title}: done after {drawn} images", flush=True)
    print(f"{drawn} images, {wrong} values differ from the CPU's" + (f", {skipped} skipped: --total" if skipped else ""))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
