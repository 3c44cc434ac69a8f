"""Pictures on the GPU: from clip-space triangles to a finished picture in sRGB, and the shading pass alone.

Scenes are bodies and the courtyard of bigtri.study, and models from files; single pictures of several sizes, and batches of
views of 256x256. Each is drawn into memory that is there already, from positions in clip space that are on the GPU, as a CUDA
graph that is replayed (cuda_clock.py). Every picture is compared with the CPU's, byte for byte.

* `picture`: the operator `draw`: triangles, textures, lights, sRGB.
* `pass`: the operator `shade` alone, of a visibility buffer that was drawn before.
* `drawing`: `rasterize` alone, into a visibility buffer.

With several samples a pixel along each axis these say so: `picture supersample=2`. Sizes are always those of the picture.

With --kernels, also what each kernel of a picture takes by torch's profiler. GB/s is that of the pass: 8 bytes a sample read
and a picture written, the least that it has to move.

    python bench/cuda_pictures.py --csv build/gpu/pictures.csv --kernels
    python bench/cuda_pictures.py --scenes courtyard --model duck.glb spot.obj --sizes 1920x1080 --supersample 1,2
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Callable
from functools import partial
from pathlib import Path

import cuda_clock
import numpy as np
import torch
from cuda_cases import batch, device_for
from cuda_clock import Clock, Job, Machine, Row, text_of
from picture_scenes import target

import bigtri
from bigtri import Camera, Scene
from bigtri.precision import RUNGS
from bigtri.scene.normals import smooth_normals, weld
from bigtri.scene.plan import plan_for
from bigtri.study import benchmark, courtyard, meshes

SIZES = "256x256,640x480,1920x1080,3840x2160"
BATCHES = "64x256x256"
BODIES = {"R4k": 30, "R16k": 60, "R100k": 148}  # cells of marching cubes a side


def body(cells: int) -> Scene:
    """A smooth body with a texture and two lights."""
    mesh = meshes.body(cells, 1)
    vertices = mesh.vertices.astype(np.float32)
    uvs = np.column_stack([np.arctan2(mesh.vertices[:, 0], mesh.vertices[:, 2]) / 3, mesh.vertices[:, 1]]).astype(np.float32)
    texture = np.random.default_rng(2).integers(0, 256, (512, 512, 3)).astype(np.uint8)
    material = bigtri.Material(texture=texture, smooth=True)
    lights = bigtri.Light((0.4, 0.8, 0.5), (0.9, 0.85, 0.8)), bigtri.Light((-0.7, 0.2, 0.3), (0.2, 0.25, 0.3))
    normals = smooth_normals(vertices, mesh.triangles, weld(vertices))
    return Scene(vertices, mesh.triangles, uvs=uvs, normals=normals, materials=(material,), lights=lights)


def cameras_of(name: str, scene: Scene, job: Job) -> list[Camera]:
    """The courtyard's own camera; or cameras around a body or a model, which fills the picture."""
    if name == "courtyard":
        return [courtyard.camera()] * job.views
    around = 30 + 360 * np.arange(job.views) / job.views
    return [Camera.framing(scene.bounds, azimuth=float(turn), aspect=job.width / job.height) for turn in around]


class Bench:
    """Measures pictures and keeps the rows."""

    def __init__(self, clock: Clock, where: Machine, arguments: argparse.Namespace, device: torch.device) -> None:
        self.clock, self.where, self.options, self.device = clock, where, arguments, device
        self.rows: list[Row] = []

    def picture(self, name: str, scene: Scene, job: Job, samples: int) -> None:
        cameras, named = cameras_of(name, scene, job), f" supersample={samples}" if samples > 1 else ""
        given = scene, cameras, (job.height, job.width), plan_for(scene), samples, self.options.precision
        on_cpu = target(*given, torch.device("cpu"))
        on_cpu.draw()
        one = target(*given, self.device)
        one.rasterize()
        calls: dict[str, Callable[[], None]] = {"drawing": one.rasterize, "pass": one.shade, "picture": one.draw}
        medians = {}
        for what, call in calls.items():
            us, again = self.clock.measure(call, "graph", self.options.seconds)
            wrong = None
            if what != "drawing":
                one.image.fill_(77)
                again()
                wrong = int((one.image.cpu() != on_cpu.image).any(-1).sum())
            row = cuda_clock.row_of(job, what + named, len(one.triangles), "graph", us, wrong, self.where)
            self.rows.append(row)
            medians[what] = row.us_median
        moved = 8 * one.packed.numel() + one.image.numel()
        rate = f"{moved / medians['pass'] / 1e3:.0f} GB/s"
        times = "  ".join(f"{what} {text_of(median)}" for what, median in medians.items())
        bad = sum(row.wrong_pixels or 0 for row in self.rows[-2:])
        wrong_too = f"  WRONG: {bad} pixels" if bad else ""
        print(f"{name:12} {job.size:12} x{samples * samples} {times}  {rate}{wrong_too}", flush=True)
        if self.options.kernels and self.device.type == "cuda":
            for kernel, spent in cuda_clock.kernels(one.draw).items():
                print(f"    {text_of(spent):>6}  {kernel}")


def parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", default=",".join((*BODIES, "courtyard")), help="of bigtri.study, or none")
    parser.add_argument("--model", nargs="*", type=Path, default=[], help="files to draw too")
    parser.add_argument("--sizes", default=SIZES, help="WIDTHxHEIGHT,..., or none")
    parser.add_argument("--batches", default=BATCHES, help="VIEWSxHEIGHTxWIDTH,..., or none; not of the courtyard")
    parser.add_argument("--supersample", default="1", metavar="N,...", help="samples of a pixel along each axis")
    parser.add_argument("--precision", default="exact", choices=list(RUNGS))
    parser.add_argument("--seconds", type=float, default=0.02, help="to measure for")
    parser.add_argument("--kernels", action="store_true", help="say what each kernel takes")
    parser.add_argument("--dry-run", action="store_true", help="on the CPU, by the host's clock")
    parser.add_argument("--csv", type=Path, help="file to write")
    return parser.parse_args()


def main() -> None:
    arguments = parsed()
    device = device_for(arguments.dry_run)
    where = cuda_clock.machine()
    print(cuda_clock.headline(where))
    bench = Bench(cuda_clock.clock_for(device), where, arguments, device)
    scenes: dict[str, Callable[[], Scene]] = {name: partial(body, cells) for name, cells in BODIES.items()}
    scenes["courtyard"] = courtyard.courtyard
    names = [] if arguments.scenes == "none" else cuda_clock.listed(arguments.scenes, "--scenes", scenes)
    chosen = {name: scenes[name] for name in names}
    chosen |= {path.stem: partial(bigtri.load_scene, path) for path in arguments.model}
    sizes = [] if arguments.sizes == "none" else [tuple(map(int, size.split("x"))) for size in arguments.sizes.split(",")]
    batches = [] if arguments.batches == "none" else [batch(text) for text in arguments.batches.split(",")]
    for name, make in chosen.items():
        scene = make()
        jobs = [Job(name, width, height, 1) for width, height in sizes]
        if name != "courtyard":
            jobs += [Job(name, width, height, 1, views) for views, height, width in batches]
        for job, samples in itertools.product(jobs, map(int, arguments.supersample.split(","))):
            bench.picture(name, scene, job, samples)
    if arguments.csv:
        benchmark.write_csv(arguments.csv, bench.rows, cuda_clock.DIGITS)
    if wrong := sum(row.wrong_pixels or 0 for row in bench.rows):
        raise SystemExit(f"{wrong} pixels differ from the CPU's")


if __name__ == "__main__":
    main()
