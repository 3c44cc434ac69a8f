"""The floor and the yardsticks of bench/floor.cu: the image with coverage given beforehand, a memset, an empty kernel.

The library is built when it is first asked for, into build/floor, by nvcc for the GPU that is there; `on_host=True` builds it
with the C++ compiler, without kernels, for the tests and for dry runs.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import shutil
import subprocess
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from bigtri.check import stages
from bigtri.reference.records import Records
from bigtri.study import meshes, scenes

SOURCE = Path(__file__).with_name("floor.cu")
FOLDER = Path(__file__).parent.parent / "build" / "floor"
TILE = 8  # px, as in floor.cu
KINDS = ("floor list", "floor shuffle")  # the order is floor_fill's `shuffle`
MAX_ITEMS = 100_000_000  # 1.6 GB of lists

_P, _I, _L = ctypes.c_void_p, ctypes.c_int, ctypes.c_int64
_SIGNATURES = {
    "floor_lists": [_P, _P, _P, _I, _I, _P, _P, _P, _I, _P],
    "floor_fill": [_I, _P, _P, _P, _P, _I, _I, _I, _P],
    "floor_memset": [_P, _L, _P],
    "floor_nothing": [_P],
}


class UnavailableError(RuntimeError):
    """There is no compiler for it, or it does not compile."""


class Lists(NamedTuple):
    """What the fill reads."""

    items: torch.Tensor  # int32 [I, 4]: mask (two words), record, triangle
    first: torch.Tensor  # int32 [tiles + 1]
    planes: torch.Tensor  # float32 [N, 4]: dzdx, dzdy, depth at (0, 0), 0
    width: int
    height: int


def build_command(on_host: bool, capability: tuple[int, int] | None, output: Path) -> list[str]:
    """The command line that makes the library.

    Raises:
        UnavailableError: no compiler.
    """
    if on_host:
        compiler = os.environ.get("CXX") or shutil.which("c++") or shutil.which("g++")
        if not compiler:
            raise UnavailableError("no C++ compiler")
        return [*compiler.split(), "-std=c++17", "-O2", "-shared", "-fPIC", "-o", str(output), "-x", "c++", str(SOURCE)]
    homes = [os.environ.get("CUDA_HOME"), "/usr/local/cuda"]
    nvcc = shutil.which("nvcc") or next((f"{home}/bin/nvcc" for home in homes if home and Path(home, "bin/nvcc").exists()), None)
    if not nvcc:
        raise UnavailableError("no nvcc on the PATH or in CUDA_HOME")
    major, minor = capability or (9, 0)
    flags = ["-std=c++17", "-O3", f"-arch=sm_{major}{minor}", "-shared", "-Xcompiler", "-fPIC"]
    return [nvcc, *flags, "-o", str(output), str(SOURCE)]


def library(on_host: bool = False, folder: Path = FOLDER, capability: tuple[int, int] | None = None) -> ctypes.CDLL:
    """The library, built if it has not been from this source.

    Raises:
        UnavailableError: no compiler, or it failed; the text has what it said.
    """
    if not on_host and capability is None and torch.cuda.is_available():
        capability = torch.cuda.get_device_capability()
    digest = hashlib.sha256(SOURCE.read_bytes()).hexdigest()[:12]
    name = "host" if on_host else "sm_{}{}".format(*(capability or (9, 0)))
    output = folder / f"floor_{name}_{digest}.so"
    if not output.exists():
        folder.mkdir(parents=True, exist_ok=True)
        part = output.with_suffix(f".{os.getpid()}")
        made = subprocess.run(build_command(on_host, capability, part), capture_output=True, text=True, timeout=300)
        if made.returncode:
            raise UnavailableError(f"{SOURCE.name} does not compile:\n{made.stderr[-2000:]}")
        part.replace(output)
    loaded = ctypes.CDLL(str(output))
    for function, arguments in _SIGNATURES.items():
        getattr(loaded, function).argtypes = arguments
    return loaded


def planes(records: Records) -> NDArray[np.float32]:
    """float32 [N, 4]: each record's depth gradient a pixel and its depth at the image's corner (0, 0)."""
    xy, z, area = records.xy.astype(np.float64), records.z.astype(np.float64), records.area.astype(np.float64)
    p, q = np.roll(xy, -1, axis=1), np.roll(xy, -2, axis=1)  # edge k runs from vertex k + 1 to vertex k + 2
    d = q - p
    weight = z / area[:, None]
    dzdx, dzdy = (-d[..., 1] * weight).sum(axis=1), (d[..., 0] * weight).sum(axis=1)  # a subpx
    corner = ((d[..., 1] * p[..., 0] - d[..., 0] * p[..., 1]) * weight).sum(axis=1)
    return np.stack([dzdx * 256, dzdy * 256, corner, np.zeros_like(corner)], axis=1).astype(np.float32)


class Floor:
    """floor.cu on one device."""

    def __init__(self, device: torch.device, folder: Path = FOLDER) -> None:
        self.device = device
        self.on_host = device.type == "cpu"
        self.library = library(self.on_host, folder)

    def stream(self) -> int | None:
        """torch's current stream, which is the one being captured while a graph is made."""
        return None if self.on_host else torch.cuda.current_stream(self.device).cuda_stream

    def check(self, code: int) -> None:
        if code:
            raise RuntimeError(f"floor.cu: CUDA error {code}")

    def lists(self, scene: scenes.Triangles | meshes.Batch, width: int, height: int) -> Lists | None:
        """Every tile's list, or None where they would take too much memory. Not what is timed."""
        records, _ = stages.setup(scene.positions, scene.triangles, height, width, backend="native")
        columns, rows = -(-width // TILE), -(-height // TILE)

        def put(array: NDArray) -> torch.Tensor:
            return torch.from_numpy(np.ascontiguousarray(array)).to(self.device)

        corners, boxes, triangles = put(records.xy.reshape(-1, 6)), put(records.bbox), put(records.triangle)
        count = torch.zeros(columns * rows, dtype=torch.int32, device=self.device)
        first = torch.zeros(columns * rows + 1, dtype=torch.int32, device=self.device)
        given = (corners.data_ptr(), boxes.data_ptr(), triangles.data_ptr(), len(records.triangle), columns)

        def run(items: torch.Tensor | None) -> None:
            at = None if items is None else items.data_ptr()
            code = self.library.floor_lists(*given, count.data_ptr(), first.data_ptr(), at, self.on_host, self.stream())
            self.check(code)

        run(None)
        total = int(count.sum(dtype=torch.int64))
        if total > MAX_ITEMS:
            return None
        first[1:] = count.cumsum(0)
        items = torch.empty((total, 4), dtype=torch.int32, device=self.device)
        count.zero_()
        run(items)
        return Lists(items, first, put(planes(records)), width, height)

    def fill(self, kind: str, lists: Lists, packed: torch.Tensor) -> None:
        """Draws the image into packed int64 [H, W]; kind: one of `KINDS`."""
        pointers = (lists.items.data_ptr(), lists.first.data_ptr(), lists.planes.data_ptr())
        size = (lists.width, lists.height)
        self.check(self.library.floor_fill(KINDS.index(kind), packed.data_ptr(), *pointers, *size, self.on_host, self.stream()))

    def memset(self, packed: torch.Tensor) -> None:
        """cudaMemsetAsync of the image."""
        if self.on_host:
            packed.zero_()
        else:
            self.check(self.library.floor_memset(packed.data_ptr(), packed.numel() * packed.element_size(), self.stream()))

    def nothing(self) -> None:
        """A kernel that does nothing."""
        if not self.on_host:
            self.check(self.library.floor_nothing(self.stream()))
