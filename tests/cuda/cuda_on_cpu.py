"""The CUDA kernels on the CPU: their own sources, compiled for the host; threads run one after another, from barrier to barrier.

What a GPU does beyond that (overlapping kernels, warps that overtake each other, its instructions) only a GPU can test; but every
formula, index, queue and barrier of the kernels runs, memory is fenced, and it needs no GPU. Linux on x86-64, with the headers of
the CUDA toolkit.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import itertools
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np
from cases import Case
from numpy.typing import NDArray

from bigtri.native import Parameter

HERE = Path(__file__).resolve().parent
CSRC = HERE.parents[1] / "bigtri/csrc"
SOURCES = tuple(sorted(file.stem for file in CSRC.glob("cuda/*.cu") if file.stem != "rungs"))
OF_A_RUNG = tuple(name for name in SOURCES if "BIGTRI_NAMESPACE" in (CSRC / f"cuda/{name}.cu").read_text())
REGISTRY = dict(re.findall(r"#define BIGTRI_CUDA_VARIANTS_(\w+)\(X\)(.*)", (CSRC / "cuda/variants.h").read_text()))
VARIANTS_OF = {rung: tuple(re.findall(r"X\((\w+)\)", listed)) for rung, listed in REGISTRY.items()}
VARIANTS = VARIANTS_OF["exact"]
# Differ from exact in attributes alone, and are drawn by its kernels.
DRAWN_AS_EXACT = re.findall(r"struct (\w+) : drawn_as_exact", (CSRC / "core/precision.h").read_text())
TOGETHER = ("persistent",)  # their blocks wait for each other, but here one runs after the other: so there is only one
CULLS = {"none": 0, "back": 1, "front": 2}
COMPILER = ("c++", "-std=c++17", "-w", "-fPIC", "-ffp-contract=off", "-mpopcnt")

# What a host compiler has no words for, and what there is instead: everything else is in cuda_on_cpu.h.
CHANGES = (
    (r"extern __shared__ __align__\(16\) char memory\[\];", "char* memory = dynamic_shared;"),
    (r"__shared__ ", "static "),
    (r'asm volatile\("mov\.u32 %0, %%tid\.x;".*', "i = threadIdx.x;"),
    (r'asm\("mov\.u32 %0, %%laneid;".*', "lane = threadIdx.x % 32;"),
    (r'asm\("mov\.u32 %0, %%lanemask_lt;".*', "lanes = (1u << threadIdx.x % 32) - 1;"),
    (r'asm volatile\("st\.global\.cs\.v2.*', "if ((uintptr_t)to & 15) abort(); to[0] = a; to[1] = b;"),
    (r'asm\("rcp\.approx\.ftz\.f32.*', "inverse = 1.0f / v;"),
    (r'asm\("rcp\.approx\.ftz\.f64.*', "r = 1.0 / v * (1.0 + 1.0 / (1 << 18));"),
    (r'asm volatile\("prefetch\.global\.L1.*', "(void)*static_cast<const volatile char*>(from);"),
    (r'asm volatile\("red\.relaxed\.gpu\.global\.min\.s64.*', "if (packed < *pixel) *pixel = packed;"),
)
NO_ASSEMBLY = r'asm volatile\("" : "\+[rl]"\(\w\)\);'  # stays: it says something to the compiler only


class Job(NamedTuple):
    """A picture to draw, and what it has to be; or several of one mesh, where the case has positions [B, V, 4]."""

    case: Case
    packed: NDArray[np.int64]  # [H, W] or [B, H, W]
    depth: NDArray[np.float32]  # as packed
    dropped: NDArray[np.int64] | int  # [B], of each view, or of the only one
    variant: str
    settings: Mapping[str, int]  # parameters; those that the variant does not have are left out
    cull: str = "none"
    scissor: tuple[int, int, int, int] | None = None
    ranges: NDArray[np.int32] | None = None  # [B, 2]: what each view draws of positions [V, 4]


def cuda_headers() -> Path | None:
    """Where the CUDA runtime's are."""
    nvcc = shutil.which("nvcc")
    homes = [os.environ.get("CUDA_HOME"), nvcc and Path(nvcc).resolve().parents[1], "/usr/local/cuda"]
    for home in filter(None, homes):
        if (include := Path(home) / "include").joinpath("cuda_runtime.h").exists():
            return include
    return None


def available() -> str:
    """Empty, or what is missing."""
    if sys.platform != "linux" or platform.machine() != "x86_64":
        return "Linux on x86-64 only"
    if not shutil.which("c++"):
        return "no C++ compiler"
    return "" if cuda_headers() else "no headers of the CUDA toolkit"


def included(file: Path) -> set[str]:
    """Names of the file and of all that it includes of its folder."""
    found, waiting = set(), [file.name]
    while waiting:
        if (name := waiting.pop()) not in found:
            found.add(name)
            here = file.with_name(name)
            waiting += re.findall(r'#include "(\w+\.\w+)"', here.read_text()) if here.exists() else []
    return found


def copy_sources(folder: Path, mutation: tuple[str, str, str] | None = None) -> None:
    """Put the kernels' sources into ``folder``, changed for the host and by a mutation, which ``build`` describes."""
    shutil.copytree(CSRC / "core", folder / "core")
    shutil.copytree(CSRC / "cuda", folder / "cuda", ignore=shutil.ignore_patterns("rungs*"))
    for file in (folder / "cuda").iterdir():
        text = file.read_text()
        if mutation and file.name == mutation[0]:
            assert mutation[1] in text, mutation
            text = text.replace(mutation[1], mutation[2])
        for old, new in CHANGES:
            text = re.sub(old, new, text)
        assert "asm" not in re.sub(NO_ASSEMBLY, "", text), f"{file.name}: assembly that has no other form here"
        file.write_text(text)


@functools.cache
def workspace() -> tempfile.TemporaryDirectory[str]:
    """For what is compiled in this process; removed when it ends."""
    return tempfile.TemporaryDirectory(prefix="bigtri_cuda_on_cpu_")


@functools.cache
def compiled_header(optimized: str) -> Path:
    """cuda_on_cpu.h, which includes CUDA's headers: parsed once in a process, for it takes a fifth of a source's time."""
    header = Path(workspace().name) / f"header{optimized}/cuda_on_cpu.h"
    header.parent.mkdir()
    shutil.copy2(HERE / header.name, header)
    flags = [optimized, f"-I{cuda_headers()}", "-x", "c++-header"]
    subprocess.run([*COMPILER, *flags, str(header), "-o", f"{header}.gch"], check=True)
    return header


def compile_and_link(
    folder: Path, sources: Sequence[Path], there: Sequence[Path], rung: str, optimized: str = "-Og", *flags: str
) -> ctypes.CDLL:
    """Compile sources, which lie in ``folder`` or include what does, for a rung, and link them with objects that are there.

    ``optimized``: -Og compiles in half the time of -O2, and what it makes takes a quarter longer.
    """
    folders = (f"-I{path}" for path in (cuda_headers(), folder / "cuda", HERE))
    compiler = [*COMPILER, optimized, *flags, f"-DBIGTRI_RUNG={rung}", *folders]
    compiler += ["-DBIGTRI_DRAWN_BY=exact"] * (rung in DRAWN_AS_EXACT)
    header = ["-include", str(compiled_header(optimized)), "-x", "c++", "-c"]
    objects = [folder / f"{source.stem}.o" for source in sources]
    running = [
        subprocess.Popen([*compiler, *header, str(source), "-o", str(made)])
        for source, made in zip(sources, objects, strict=True)
    ]
    assert not any([process.wait() for process in running]), "the kernels do not compile for the host"
    library = folder / "kernels.so"
    subprocess.run(["c++", "-shared", "-Wl,-Bsymbolic", "-o", str(library), *map(str, [*objects, *there])], check=True)
    return ctypes.CDLL(str(library))


def build(folder: Path, mutation: tuple[str, str, str] | None = None) -> ctypes.CDLL:
    """Compile the kernels of ``exact`` into ``folder``. mutation: a file of csrc/cuda, text that it holds, and what to put in its
    place; only what includes it is compiled then."""
    copy_sources(folder, mutation)
    every = [*(folder / f"cuda/{name}.cu" for name in SOURCES), HERE / "cuda_on_cpu.cpp"]
    changed = [source for source in every if not mutation or mutation[0] in included(source)]
    there = [unchanged("exact") / f"{source.stem}.o" for source in every if source not in changed]
    return compile_and_link(folder, changed, there, "exact", "-Og" if mutation else "-O2")


def build_rung(folder: Path, rung: str) -> ctypes.CDLL:
    """Compile the kernels of another rung into ``folder``: what depends on the rung, as one source, which takes half the time.

    ``shade``, and variants besides the first, are sources of their own: they have names that the others have too.
    """
    copy_sources(folder)
    if rung in DRAWN_AS_EXACT:
        own = ["attributes", "shade", "variants"]
        there = [name for name in SOURCES if name not in own]
    else:
        unlisted = {*VARIANTS} - {*VARIANTS_OF[rung]}
        own = [name for name in OF_A_RUNG if name not in unlisted]
        there = [name for name in SOURCES if name not in OF_A_RUNG]
    apart = {"shade", *VARIANTS_OF[rung][1:]}.intersection(own)
    files = [*(f"{name}.cu" for name in own if name not in apart), str(HERE / "cuda_on_cpu.cpp")]
    source = folder / "cuda/rung.cu"
    source.write_text("".join(f'#include "{file}"\n' for file in files))
    sources = [source, *(folder / f"cuda/{name}.cu" for name in sorted(apart))]
    return compile_and_link(folder, sources, [unchanged("exact") / f"{name}.o" for name in there], rung)


def build_counting(folder: Path) -> ctypes.CDLL:
    """Compile the variants with counters of their work, and what they need of ``exact`` beside them."""
    copy_sources(folder)
    sources = [*(folder / f"cuda/{name}.cu" for name in (*VARIANTS, "clear", "variants")), HERE / "cuda_on_cpu.cpp"]
    there = [unchanged("exact") / f"{name}.o" for name in SOURCES if name != "variants"]
    return compile_and_link(folder, sources, there, "exact", "-Og", "-DBIGTRI_COUNTING")


@functools.cache
def unchanged(rung: str) -> Path:
    """A folder with the kernels as they are, compiled once in a process."""
    folder = Path(tempfile.mkdtemp(dir=workspace().name)) / rung
    if rung == "exact":
        build(folder)
    else:
        build_rung(folder, rung)
    return folder


@functools.cache
def kernels_where_float64_is_slow() -> ctypes.CDLL:
    """Those of ``exact`` with ``bin_owned`` as GPUs have it whose float64 is slow (core/platform.h)."""
    folder = Path(tempfile.mkdtemp(dir=workspace().name)) / "slow_float64"
    copy_sources(folder)
    sources = [folder / f"cuda/{name}.cu" for name in ("bin_owned", "clear")]
    there = [unchanged("exact") / f"{name}.o" for name in (*SOURCES, "cuda_on_cpu") if name not in ("bin_owned", "clear")]
    return compile_and_link(folder, sources, there, "exact", "-Og", "-DBIGTRI_SLOW_FLOAT64")


def kernels(rung: str = "exact") -> ctypes.CDLL:
    return ctypes.CDLL(str(unchanged(rung) / "kernels.so"))


def parameters(library: ctypes.CDLL, variant: str) -> dict[str, Parameter]:
    """A variant's parameters by name, in order; without what they say of themselves."""
    library.parameter_name.restype = ctypes.c_char_p
    library.parameter_range.restype = ctypes.POINTER(ctypes.c_int64)
    library.parameter_only.restype = ctypes.POINTER(ctypes.c_int64)
    found: dict[str, Parameter] = {}
    while name := library.parameter_name(variant.encode(), len(found)):
        place = variant.encode(), len(found)
        standard, low, high = library.parameter_range(*place)[:3]
        only = library.parameter_only(*place)
        values = itertools.takewhile(lambda value: value >= 0, map(only.__getitem__, itertools.count())) if only else ()
        found[name.decode()] = Parameter(name.decode(), "", "", standard, low, high, tuple(values))
    return found


def counted_work(counters: NDArray[np.int64], fragments: NDArray[np.int64], blocks: NDArray[np.int64]) -> NDArray[np.int64]:
    """A CountedWork (csrc/cuda/counted_work.h) with room for so many blocks; the arrays have to live as long."""
    return np.array([counters.ctypes.data, fragments.ctypes.data, blocks.ctypes.data, len(blocks)], np.int64)


Outputs: TypeAlias = tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.int64]]  # packed, depth and dropped [B]


def views_of(job: Job) -> int:
    """How many views a job has."""
    if job.ranges is not None:
        return len(job.ranges)
    return len(job.case.positions) if job.case.positions.ndim == 3 else 1


def outputs_of(job: Job) -> Outputs:
    """Memory for what a job draws."""
    shape = job.packed.shape
    return np.empty(shape, np.int64), np.empty(shape, np.float32), np.empty(views_of(job), np.int64)


def draw(library: ctypes.CDLL, job: Job, counted: NDArray[np.int64] | None = None, outputs: Outputs | None = None) -> Outputs:
    """What the kernels of a job draw, to new memory or ``outputs``; a build that counts adds to what ``counted`` points to."""

    def pointer(array: NDArray) -> ctypes.c_void_p:
        return array.ctypes.data_as(ctypes.c_void_p)

    height, width = job.case.resolution
    x0, y0, x1, y1 = job.scissor or (0, 0, width, height)
    cut = [min(max(value, 0), limit) for value, limit in ((x0, width), (y0, height), (x1, width), (y1, height))]
    view = np.array([width, height, *cut, CULLS[job.cull]], np.int32)
    settings = {name: parameter.standard for name, parameter in parameters(library, job.variant).items()}
    settings |= {name: value for name, value in job.settings.items() if name in settings}
    if job.variant in TOGETHER:
        settings["blocks"] = 1
    values = np.array([*settings.values()], np.int64)
    positions = np.ascontiguousarray(job.case.positions, np.float32)
    triangles = np.ascontiguousarray(job.case.triangles, np.int32)
    packed, depth, dropped = outputs_of(job) if outputs is None else outputs
    refused = library.draw_on_cpu(
        job.variant.encode(),
        len(dropped),
        pointer(positions),
        ctypes.c_int64(positions.shape[-2]),
        pointer(triangles),
        len(triangles),
        None if job.ranges is None else pointer(job.ranges),
        *map(pointer, (view, values, packed, depth, dropped)),
        None if counted is None else pointer(counted),
    )
    assert refused == 0, (refused, job.variant, settings)
    return packed, depth, dropped


def differences(library: ctypes.CDLL, jobs: Iterable[tuple[int, Job]]) -> list[str]:
    """What is not as it has to be, a line for each job of which that can be said; a job's number chooses its two orders."""
    found = []
    for job, order in ((j, o) for n, j in jobs for o in (n % 3, 3 + n % 2)):
        library.set_order(order)  # of threads, and of warps: must not matter
        packed, depth, dropped = draw(library, job)
        depths = int((depth.view(np.int32) != job.depth.view(np.int32)).sum())
        wrong = int((packed != job.packed).sum()), depths, int((dropped != job.dropped).sum())
        if any(wrong):
            how = f"{job.variant}, {dict(job.settings)}, cull {job.cull}, scissor {job.scissor}"
            found.append(f"{how}, order {order}: {wrong} values differ")
    return found


def in_children(bodies: Sequence[Callable[[], list[str]]]) -> str:
    """What the bodies find, a line each; empty if nothing. Each runs in a process of its own, which a kernel may end, at the
    same time as the others."""
    with contextlib.ExitStack() as stack:
        said = [stack.enter_context(tempfile.TemporaryFile("w+")) for _ in bodies]
        children = []
        for body, file in zip(bodies, said, strict=True):
            if (child := os.fork()) == 0:
                os.dup2(file.fileno(), 2)
                try:
                    text = "\n".join(body())
                except BaseException:
                    text = traceback.format_exc()
                os.write(file.fileno(), text.encode())
                os._exit(0)
            children.append(child)
        found = []
        for child, file in zip(children, said, strict=True):
            status = os.waitpid(child, 0)[1]
            file.seek(0)
            found += [file.read(), f"ended with status {status}" if status else ""]
        return "\n".join(filter(None, found))


def differences_in_children(library: ctypes.CDLL, jobs: Sequence[Job], first: int = 0) -> str:
    """The same in a process for each core. first: the number of the first job."""
    numbered = list(enumerate(jobs, first))
    cores = min(len(os.sched_getaffinity(0)), len(numbered))
    return in_children([functools.partial(differences, library, numbered[k::cores]) for k in range(cores)])
