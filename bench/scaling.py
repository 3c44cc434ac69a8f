"""How time grows: with the resolution, with the number of triangles, with their area. One CSV, one row per point.

* `resolution`: 32 very large triangles (as S3) on squares of 256 to 16384 px, and one triangle over all of it, the cheapest
image.
* `count`: 1 to 16384 triangles of 500 to 5000 px at 1920x1080, and a mesh of 10 px triangles of 1000 to 1,000,000.
* `area`: a mesh of triangles of 2 to 100,000 px at 1920x1080, four layers deep whatever the area: the number of fragments stays
the same, what is left is the cost of a triangle.

The column `scene` names the curve and the parameter: `resolution S3 4096`, `area mesh 20`.

    python bench/scaling.py --csv bench/results/scaling.csv
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Iterator

import peer_llvmpipe

from bigtri import native
from bigtri.app import arguments as option_types
from bigtri.reference.numerics import MAX_SIZE
from bigtri.study import benchmark, provenance, scenes
from bigtri.study.clock import summary

WIDTH, HEIGHT = 1920, 1080  # px, of `count` and `area`
LAYERS = 4

Point = tuple[str, int, int, scenes.Triangles]  # "curve parameter", width, height, triangles


def resolution_points(largest: int) -> Iterator[Point]:
    side = 256
    while side <= largest:
        many = scenes.very_large(32, side, side, scenes.SEED)
        yield f"resolution S3 {side}", side, side, scenes.to_clip(many, side, side)
        one = scenes.full_screen(1, side, side, scenes.SEED, back_to_front=False)
        yield f"resolution one {side}", side, side, scenes.to_clip(one, side, side)
        side *= 2


def count_points() -> Iterator[Point]:
    for power in range(0, 15, 2):
        mesh = scenes.large(2**power, WIDTH, HEIGHT, scenes.SEED, area=(500, 5000))
        yield f"count large {2**power}", WIDTH, HEIGHT, scenes.to_clip(mesh, WIDTH, HEIGHT)
    for count in (1000, 10_000, 100_000, 1_000_000):
        mesh = scenes.small_mesh(count, WIDTH, HEIGHT, scenes.SEED)
        yield f"count mesh {count}", WIDTH, HEIGHT, scenes.to_clip(mesh, WIDTH, HEIGHT)


def area_points() -> Iterator[Point]:
    for area in (2, 5, 10, 20, 50, 100, 500, 2000, 10_000, 100_000):
        mesh = scenes.layers_of(area, WIDTH, HEIGHT, LAYERS)
        yield f"area mesh {area}", WIDTH, HEIGHT, scenes.to_clip(mesh, WIDTH, HEIGHT)


def llvmpipe_row(base: benchmark.Row, peer: peer_llvmpipe.Llvmpipe, scene: scenes.Triangles, seconds: float) -> benchmark.Row:
    """The same point on llvmpipe, with the faster of its two ways to learn the index; base: bigtri's row."""
    found = []
    for way in ("primitive", "attribute"):
        peer.load(scene, base.width, base.height, way)
        found.append((summary(peer_llvmpipe.budgeted(peer, seconds / 2)), way))
    timing, way = min(found, key=lambda pair: pair[0].median)
    return dataclasses.replace(base, renderer="llvmpipe", variant=f"ids {way}", precision="", isa="", peak_mib=None).timed(timing)


def show(row: benchmark.Row) -> None:
    print(f"{row.scene:20} {row.renderer:8} {row.variant:13} {row.threads} threads {row.ms_median:10.3f} ms", end="  ")
    print(f"{row.triangles} triangles, {row.fragments} fragments", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--curves", default="resolution,count,area", help="which of them (default all)")
    parser.add_argument(
        "--largest",
        type=option_types.whole(1, MAX_SIZE),
        default=MAX_SIZE,
        help="side of the largest square, px (default 16384: 2 GiB)",
    )
    parser.add_argument("--threads", type=option_types.listed(option_types.count), default="1,2", help="default 1,2")
    parser.add_argument("--variant", default="auto", help="bigtri's variants, separated by commas (default auto)")
    parser.add_argument("--llvmpipe", action="store_true", help="also llvmpipe, up to 8192 px a side")
    parser.add_argument("--seconds", type=option_types.seconds, default=0.5, help="time for each figure (default 0.5)")
    parser.add_argument("--csv", metavar="FILE", type=option_types.csv_file, help="write the rows there")
    arguments = parser.parse_args()
    curves = {"resolution": lambda: resolution_points(arguments.largest), "count": count_points, "area": area_points}
    if unknown := [curve for curve in arguments.curves.split(",") if curve not in curves]:
        parser.error(f"--curves must be of {', '.join(curves)}, got {', '.join(unknown)}")

    print(f"{provenance.device()}; {provenance.versions()}; {provenance.commit()}")
    peers = {threads: peer_llvmpipe.Llvmpipe(threads) for threads in arguments.threads} if arguments.llvmpipe else {}
    rows: list[benchmark.Row] = []
    for curve in arguments.curves.split(","):
        for name, width, height, scene in curves[curve]():
            fragments = None
            for variant in arguments.variant.split(","):
                job = benchmark.Job(name, width, height, scene, variant)
                for threads in arguments.threads:
                    fragments = job.fragments() if fragments is None else fragments
                    rows.append(benchmark.measure(job, threads, native.isa(), arguments.seconds, fragments))
                    show(rows[-1])
            if width <= 8192:
                for threads, peer in peers.items():
                    base = next(row for row in reversed(rows) if row.threads == threads and row.renderer == "bigtri")
                    rows.append(llvmpipe_row(base, peer, scene, arguments.seconds))
                    show(rows[-1])
            if arguments.csv:
                benchmark.write_csv(arguments.csv, rows)
    for peer in peers.values():
        peer.close()


if __name__ == "__main__":
    main()
