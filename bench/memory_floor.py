"""What writing the image alone costs: the floor under any rasterizer that fills a packed buffer of W*H*8 bytes.

Three ways to fill a buffer that is already mapped, at each thread count: torch's `fill_` and NumPy's `fill` (a store loop), and
libc's `memset`, which need not read a line before it overwrites it (NumPy and memset on disjoint slices, one per thread). In
the last column a buffer of 1 GiB, beyond every cache: the memory's own bandwidth.

    python bench/memory_floor.py --threads 1,2
"""

from __future__ import annotations

import argparse
import ctypes
import statistics
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import torch

from bigtri.app import arguments as option_types
from bigtri.study.clock import clock

SIZES = {"1920x1080": 1920 * 1080 * 8, "3840x2160": 3840 * 2160 * 8, "1 GiB": 1 << 30}  # bytes
libc = ctypes.CDLL(None)
libc.memset.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.c_size_t]


class Floor:
    """Filling an image of 8 bytes a pixel with up to `threads` threads, the fastest way: it can take turns with rasterizers."""

    def __init__(self, threads: int) -> None:
        self.pools = {count: ThreadPoolExecutor(count) for count in {1, threads}}  # small images are faster on one

    def load(self, width: int, height: int) -> None:
        """Allocates an image and finds out what is fastest."""
        buffer = torch.zeros(height * width, dtype=torch.int64)  # zeros: mapped
        ways = [call for count, pool in self.pools.items() for call in fills(buffer, count, pool).values()]
        self.call = min(ways, key=lambda way: statistics.median(clock(way, 0.05)))

    def frames(self, count: int) -> list[float]:
        """Fills it `count` times: milliseconds of each."""
        return clock(self.call, 0, warm=0, at_least=count)

    def close(self) -> None:
        for pool in self.pools.values():
            pool.shutdown()


def fills(buffer: torch.Tensor, threads: int, pool: ThreadPoolExecutor) -> dict[str, Callable[[], object]]:
    """The ways to fill an int64 buffer with `threads` threads. NumPy and ctypes let go of the interpreter lock."""
    parts = np.array_split(buffer.numpy(), threads)

    def numpy_part(part: np.ndarray) -> None:
        part.fill(-1)

    def memset_part(part: np.ndarray) -> None:
        libc.memset(part.ctypes.data, 0xFF, part.nbytes)

    def over(work: Callable[[np.ndarray], None]) -> Callable[[], object]:
        return (lambda: work(parts[0])) if threads == 1 else (lambda: list(pool.map(work, parts)))

    return {"torch fill_": lambda: buffer.fill_(-1), "numpy fill": over(numpy_part), "memset": over(memset_part)}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--threads", type=option_types.listed(option_types.count), default="1,2")
    parser.add_argument("--seconds", type=option_types.seconds, default=0.5, help="time for each figure")
    arguments = parser.parse_args()
    print(f"{'fill':12} {'threads':>7}" + "".join(f" {size + ', ms (GB/s)':>24}" for size in SIZES))
    for threads in arguments.threads:
        torch.set_num_threads(threads)
        with ThreadPoolExecutor(threads) as pool:
            cells: dict[str, list[str]] = {}
            for size in SIZES.values():
                for name, call in fills(torch.empty(size // 8, dtype=torch.int64), threads, pool).items():
                    ms = statistics.median(clock(call, arguments.seconds, warm=1))
                    cells.setdefault(name, []).append(f"{ms:.3f} ({size / ms / 1e6:.1f})")
        for name, row in cells.items():
            print(f"{name:12} {threads:7}" + "".join(f" {cell:>24}" for cell in row), flush=True)


if __name__ == "__main__":
    main()
