"""How evenly threads are loaded, also more of them than this machine has cores: the busiest one's work over the mean.

Batches are views from a circle around a body (R4k, R16k, ...); one view of any scene is the benchmark's. Every piece of work is
timed on one thread, and counts for the thread that would have taken it (`bigtri.study.clock.thread_load`). The images drawn that
way are compared with those of two threads.

    python bench/thread_load.py
    python bench/thread_load.py --threads 4,64 --scenes R100k --batches 64x256x256,1x1080x1920
"""

from __future__ import annotations

import argparse
from functools import partial

import torch

from bigtri import rasterize
from bigtri.app import arguments as option_types
from bigtri.study import meshes, scenes
from bigtri.study.clock import setting, thread_load

BATCHES = "64x256x256,64x512x512,8x1024x1024,1024x64x64,1x480x640,1x1080x1920,1x2160x3840"  # views x height x width


def batch(text: str) -> tuple[int, int, int]:
    """ "8x256x256" to (8, 256, 256)."""
    parts = text.split("x")
    if len(parts) != 3 or not all(part.isdigit() and int(part) for part in parts):
        raise argparse.ArgumentTypeError(f"must be VIEWSxHEIGHTxWIDTH, got {text!r}")
    return int(parts[0]), int(parts[1]), int(parts[2])


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--threads", type=option_types.listed(option_types.count), default="16")
    parser.add_argument("--scenes", default="R4k,R16k", help="scenes with a body seen whole, for batches; default R4k,R16k")
    parser.add_argument(
        "--batches", type=option_types.listed(batch), default=BATCHES, help=f"views x height x width; default {BATCHES}"
    )
    parser.add_argument("--calls", type=option_types.count, default=9, help="the median of so many is shown; default 9")
    arguments = parser.parse_args()
    print(f"{'scene':14} {'views':>5} {'size':>10} {'threads':>7} {'longest ms':>10} {'mean ms':>8} {'load':>5}")
    for name in arguments.scenes.split(","):
        for views, height, width in arguments.batches:
            given: meshes.Batch | scenes.Triangles
            if views > 1:
                given = meshes.batch([meshes.of(scenes.REAL[name], scenes.SEED)], views, width / height)
            else:
                given = scenes.make(name, width, height)
            positions, triangles = torch.from_numpy(given.positions), torch.from_numpy(given.triangles)
            out = torch.empty((*positions.shape[:-2], height, width), dtype=torch.int64)
            with setting(2):
                expected = rasterize(positions, triangles, (height, width), depth=False).packed
            draw = partial(rasterize, positions, triangles, (height, width), out=out, depth=False)
            for threads in arguments.threads:
                load = thread_load(draw, threads, arguments.calls)
                if not torch.equal(out, torch.as_tensor(expected)):
                    raise SystemExit(f"{name}: {threads} threads draw another image than two")
                print(
                    f"{name:14} {views:5} {f'{width}x{height}':>10} {threads:7} {load.longest:10.3f} {load.mean:8.3f} "
                    f"{load.longest / load.mean:5.2f}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
