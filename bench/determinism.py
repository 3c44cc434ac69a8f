"""What a race costs: the same scene drawn many times with a packed 64-bit atomic minimum, as bigtri keeps the nearest fragment,
and with an atomic minimum of the depth alone after which the winner stores its triangle, as many software rasterizers do.

    python bench/determinism.py                       # on the GPU, or on the threads of the CPU where there is none
    python bench/determinism.py --device cpu --threads 8 --scenes S4b --size 640x360

The rasterizer, determinism.cu, is a bare one of its own, and the same for both but for these lines; torch builds it. A row says
how many pixels show different triangles in different runs, how many show another triangle than the nearest, in the worst run, and
the median time of a frame. A pixel of the packed minimum can do neither.
"""

from __future__ import annotations

import argparse
import ctypes
import time
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch.utils import cpp_extension

from bigtri.app import arguments
from bigtri.study import provenance, scenes
from bigtri.study.clock import summary

HERE = Path(__file__).resolve().parent
METHODS = {"packed minimum": True, "depth, then triangle": False}


def library(device: str) -> ctypes.CDLL:
    """determinism.cu, built by torch and kept in its folder of extensions."""
    source = HERE / ("determinism.cu" if device == "cuda" else "determinism.cpp")
    flags = ["-O2", "-pthread"]
    name = f"bigtri_determinism_{device}"
    return ctypes.CDLL(
        cpp_extension.load(name, [str(source)], extra_cflags=flags, with_cuda=device == "cuda", is_python_module=False)
    )


def corners(scene: scenes.Triangles, width: int, height: int) -> NDArray[np.float32]:
    """float32 [T, 3, 3]: x and y in px, and window depth; of triangles that need no clipping."""
    clip = scene.positions[scene.triangles].astype(np.float64)
    w = clip[..., 3]
    whole = ((w > 0) & (np.abs(clip[..., 2]) <= w)).all(axis=1)
    x, y, z = (clip[whole][..., k] / w[whole] * 0.5 + 0.5 for k in range(3))
    return np.stack([x * width, (1 - y) * height, z], axis=-1).astype(np.float32)


class Image:
    """Memory that frames are drawn into."""

    def __init__(self, device: str, found: NDArray[np.float32], width: int, height: int, threads: int) -> None:
        self.device, self.size, self.threads, self.library = device, (width, height), threads, library(device)
        self.corners = torch.from_numpy(found).to(device)
        self.words = torch.empty(height, width, dtype=torch.int64, device=device)
        self.depths, self.ids = (torch.empty(height, width, dtype=torch.int32, device=device) for _ in range(2))

    def draw(self, packed: bool) -> None:
        stream = torch.cuda.current_stream().cuda_stream if self.device == "cuda" else 0
        memory = [ctypes.c_void_p(t.data_ptr()) for t in (self.words, self.depths, self.ids)]
        count = ctypes.c_int64(len(self.corners))
        error = self.library.draw_frame(
            ctypes.c_void_p(self.corners.data_ptr()),
            count,
            *self.size,
            int(packed),
            *memory,
            self.threads,
            ctypes.c_void_p(stream),
        )
        if error:
            raise RuntimeError(f"determinism.cu: CUDA error {error}")

    def shown(self, packed: bool) -> torch.Tensor:
        """int32 [H, W]: the triangle of each pixel of the last frame, -1 where there is none."""
        return self.words.to(torch.int32) if packed else self.ids.clone()

    def ms(self, packed: bool) -> float:
        """Of one frame."""
        start = time.perf_counter()
        if self.device == "cpu":
            self.draw(packed)
            return (time.perf_counter() - start) * 1e3
        begin, end = (torch.cuda.Event(enable_timing=True) for _ in range(2))
        begin.record()
        self.draw(packed)
        end.record()
        torch.cuda.synchronize()
        return begin.elapsed_time(end)


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--scenes", default="S4b,S4f,S3,R100k,Rcourtyard", help="of bigtri bench (default %(default)s)")
    options.add_argument("--size", type=arguments.size, default=(1280, 720), help="WIDTHxHEIGHT (default 1280x720)")
    options.add_argument("--device", choices=("cpu", "cuda"), default="cuda" if torch.cuda.is_available() else "cpu")
    options.add_argument("--threads", type=arguments.count, default=2 * provenance.usable_cpus(), help="of the CPU")
    options.add_argument("--runs", type=arguments.count, default=100)
    given = options.parse_args()
    width, height = given.size
    print(f"{provenance.device(given.device)}; {given.runs} runs, {width}x{height} px", end="")
    print(f", {given.threads} threads" if given.device == "cpu" else "")
    print(f"{'scene':12} {'triangles':>9}  {'method':22} {'px that change':>14} {'px not nearest':>14} {'ms':>8}")
    for name in arguments.chosen("scene", given.scenes, list(scenes.SCENES)):
        found = corners(scenes.make(name, width, height, scenes.SEED), width, height)
        image = Image(given.device, found, width, height, given.threads)
        image.draw(packed=True)
        nearest = image.shown(packed=True)
        for method, packed in METHODS.items():
            image.draw(packed)
            first, changed, wrong, ms = image.shown(packed), torch.zeros_like(nearest, dtype=torch.bool), 0, []
            for _ in range(given.runs):
                ms.append(image.ms(packed))
                shown = image.shown(packed)
                changed |= shown != first
                wrong = max(wrong, int((shown != nearest).sum()))
            print(
                f"{name:12} {len(found):9}  {method:22} {int(changed.sum()):14} {wrong:14} {summary(ms).median:8.3f}", flush=True
            )


if __name__ == "__main__":
    main()
