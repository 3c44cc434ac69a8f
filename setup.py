"""Builds the extension `bigtri._C`: one abi3 library on torch's stable ABI, which runs on Python >= 3.10 and torch >= 2.10.

With a torch built for CUDA and a CUDA toolkit (CUDA_HOME, or nvcc on the PATH) the CUDA kernels are built too, as `bigtri._cuda`
beside it; no GPU has to be there. BIGTRI_CUDA=0 leaves them out, BIGTRI_CUDA=1 insists on them. TORCH_CUDA_ARCH_LIST says for
which architectures ("7.5;9.0;12.0+PTX"); by default for the GPUs of this machine, or for all of these where there is none.

BIGTRI_LADDER=1 builds the rungs that are there to show what accuracy costs too (docs/accuracy.md). BIGTRI_CUDA_COUNTING=1
compiles the variants of `exact` on CUDA a second time, with counters of their work (docs/variants.md).
"""

import os
import platform
import re
import subprocess
import sys
from pathlib import Path

import torch
from setuptools import setup
from torch.utils.cpp_extension import CUDA_HOME, BuildExtension, CppExtension, CUDAExtension

CSRC = Path("bigtri/csrc")
TARGET_TORCH = "0x020a000000000000"  # torch 2.10

# Without -ffp-contract=off a compiler may fuse a * b + c, and the bits would differ (docs/numerics.md 1).
FLAGS = [
    "-std=c++17",
    "-O3",
    "-g1",  # lines for profilers and backtraces; Python's own -g would name every variable, which was most of a wheel
    "-ffp-contract=off",
    "-fvisibility=hidden",
    "-pthread",
    "-Wall",
    "-Wextra",
    "-Wno-unused-parameter",
    "-Wno-unused-function",
    "-Wno-psabi",
]
# The same rules for the GPU: no fused multiply-add, true division and square root, no flush to zero.
CUDA_FLAGS = ["-std=c++17", "-O3", "-fmad=false", "-prec-div=true", "-prec-sqrt=true", "-ftz=false", "-lineinfo"]
CUDA_FLAGS += ["-Xcompiler", "-ffp-contract=off,-fvisibility=hidden"]


X86 = platform.machine() in ("x86_64", "AMD64")
PRECISION = (CSRC / "core/precision.h").read_text()
RUNGS, LADDER = (
    re.findall(r"\bX\((\w+)\)", re.search(rf"#define {name}\(X\)((?:.*\\\n)*.*)", PRECISION)[1])
    for name in ("BIGTRI_RUNGS", "BIGTRI_LADDER")
)
DRAWN_AS_EXACT = re.findall(r"struct (\w+) : drawn_as_exact", PRECISION)  # differ from the default in attributes alone


def with_cuda() -> bool:
    """Whether to build the CUDA kernels."""
    wanted = os.environ.get("BIGTRI_CUDA", "auto")
    if wanted not in ("auto", "0", "1"):
        raise SystemExit(f"BIGTRI_CUDA must be 0, 1 or auto, got {wanted!r}")
    possible = torch.version.cuda is not None and CUDA_HOME is not None
    if wanted == "1" and not possible:
        raise SystemExit(f"BIGTRI_CUDA=1 needs a torch built for CUDA (got {torch.__version__}) and CUDA_HOME (got {CUDA_HOME})")
    return possible and wanted != "0"


def known_architectures() -> str:
    """What to build for where there is no GPU to ask: those that CI compiles and their kin, if nvcc knows them, and PTX."""
    listed = subprocess.run([Path(CUDA_HOME) / "bin/nvcc", "--list-gpu-arch"], capture_output=True, text=True, check=True).stdout
    known = [a for a in ("7.5", "8.0", "8.6", "8.9", "9.0", "10.0", "12.0") if f"compute_{a.replace('.', '')}" in listed.split()]
    return ";".join(known) + "+PTX"


def written(path: Path, text: str) -> str:
    """A file with this text; one that has it already is left alone, so that nothing is compiled anew."""
    if not path.exists() or path.read_text() != text:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return str(path)


def per_rung(source: Path, rung: str, counting: bool = False) -> str:
    """A file that compiles ``source`` for a rung; core/precision.h says what that is, core/counters.h what counting is."""
    return per_rung_together([source], source.name, rung, counting)


def per_rung_together(sources: list[Path], name: str, rung: str, counting: bool = False) -> str:
    """The same for several sources, as one file of that name."""
    text = f"#define BIGTRI_RUNG {rung}\n" + "#define BIGTRI_COUNTING\n" * counting
    if rung in DRAWN_AS_EXACT:
        text += f"#define BIGTRI_DRAWN_BY {RUNGS[0]}{'_counting' * counting}\n"
    text += "".join(f'#include "{source.relative_to(CSRC)}"\n' for source in sources)
    return written(Path("build/rungs") / (rung + "_counting" * counting) / name, text)


def with_ladder() -> bool:
    """Whether to build the rungs of the ladder too."""
    wanted = os.environ.get("BIGTRI_LADDER", "0")
    if wanted not in ("0", "1"):
        raise SystemExit(f"BIGTRI_LADDER must be 0 or 1, got {wanted!r}")
    return wanted == "1"


def variants_of(kind: str) -> dict[str, list[str]]:
    """By rung, the variants that are compiled for it; ``kind`` is "cpu" or "cuda"."""
    lists = rf"#define BIGTRI_{kind.upper()}_VARIANTS_(\w+)\(X\)((?:.*\\\n)*.*)"  # a list may be continued
    listed = re.findall(lists, (CSRC / kind / "variants.h").read_text())
    return {rung: re.findall(r"\bX\((\w+)\)", names) for rung, names in listed}


def cpu_sources() -> list[str]:
    once = [
        CSRC / "cpu" / f"{name}.cpp"
        for name in ("dispatch", "index_range", "rungs", "shade", "thread_pool", "transform", "workspace")
    ]
    default = [CSRC / "cpu/shading.cpp"]  # no rung differs in it
    isas = [f for f in sorted(CSRC.glob("cpu/isa_*.cpp")) if X86 or f.stem == "isa_baseline"]
    each = [f for f in sorted(CSRC.glob("cpu/*.cpp")) if f not in once + default and not f.stem.startswith("isa_")]
    counted = [f for f in each if f.stem not in ("attributes", "stages")] + [CSRC / "cpu/isa_baseline.cpp"]
    variants = variants_of("cpu")
    elsewhere = {rung: {name for names in variants.values() for name in names} - {*variants[rung]} for rung in variants}
    files = [str(f) for f in [*once, *sorted(f for f in CSRC.glob("torch/*.cpp") if not f.name.startswith("cuda_"))]]
    files += [per_rung(f, RUNGS[0]) for f in default]
    for rung in RUNGS + with_ladder() * LADDER:
        if rung in DRAWN_AS_EXACT:
            own = [f for f in each if f.stem in ("attributes", "kernels", "variants")]
        else:
            own = [f for f in each if f.stem not in elsewhere[rung]]
        # Of a rung of the ladder, which are many, as one file: that takes half the time.
        files += [per_rung_together(own, "rung.cpp", rung)] if rung in LADDER else [per_rung(f, rung) for f in own]
        files += [per_rung(f, rung) for f in isas]
    files += [
        per_rung(f, rung, counting=True) for rung in RUNGS for f in counted if rung not in DRAWN_AS_EXACT or f.stem == "variants"
    ]
    return files


def with_cuda_counting() -> bool:
    """Whether to compile CUDA variants a second time, with counters of their work."""
    wanted = os.environ.get("BIGTRI_CUDA_COUNTING", "0")
    if wanted not in ("0", "1"):
        raise SystemExit(f"BIGTRI_CUDA_COUNTING must be 0 or 1, got {wanted!r}")
    return wanted == "1"


def cuda_sources() -> list[str]:
    variants = variants_of("cuda")
    files = sorted(CSRC.glob("cuda/*.cu"))
    each = [f for f in files if "BIGTRI_NAMESPACE" in f.read_text()]  # depends on the rung
    found = [str(f) for f in [*(f for f in files if f not in each), *sorted(CSRC.glob("torch/cuda_*.cpp"))]]
    for rung in RUNGS + with_ladder() * LADDER:
        elsewhere = {name for names in variants.values() for name in names} - {*variants[rung]}
        if rung in DRAWN_AS_EXACT:
            own = [f for f in each if f.stem in ("attributes", "shade", "variants")]
        else:
            own = [f for f in each if f.stem not in elsewhere]
        found += [per_rung(f, rung) for f in own]
    if with_cuda_counting():
        counted = (*variants[RUNGS[0]], "clear", "variants")
        found += [per_rung(f, RUNGS[0], counting=True) for f in each if f.stem in counted]
    return found


def extensions() -> list[CppExtension]:
    ladder = ["-DBIGTRI_WITH_LADDER"] * with_ladder()
    flags = [*FLAGS, f"-DTORCH_TARGET_VERSION={TARGET_TORCH}", *ladder]
    link = []
    if "bdist_wheel" in sys.argv and sys.platform == "linux":
        # Nine tenths of the library are debug information, where the flags that Python itself was built with have -g.
        link += ["-Wl,--strip-debug"]
    if sanitize := os.environ.get("BIGTRI_SANITIZE"):  # e.g. address,undefined; CONTRIBUTING.md says how to run it
        # Python's own flags have -fwrapv, under which no signed overflow is undefined, so that none would be reported.
        flags += [f"-fsanitize={sanitize}", "-fno-sanitize-recover=all", "-fno-wrapv", "-fno-omit-frame-pointer", "-g", "-O1"]
        link += [f"-fsanitize={sanitize}"]
    headers = [str(f) for pattern in ("*.h", "*.inl", "*.cuh", "*.cpp", "*.cu") for f in sorted(CSRC.rglob(pattern))]
    common = {"include_dirs": [str(CSRC.resolve())], "extra_link_args": link, "depends": headers, "py_limited_api": True}
    found = [CppExtension("bigtri._C", cpu_sources(), extra_compile_args={"cxx": [*flags]}, **common)]
    if with_cuda():
        if not torch.cuda.is_available():
            os.environ.setdefault("TORCH_CUDA_ARCH_LIST", known_architectures())
        flags += ["-DUSE_CUDA"]  # torch's stable header then declares its CUDA functions
        optional = ladder + ["-DBIGTRI_WITH_CUDA_COUNTING"] * with_cuda_counting()
        each = {"cxx": flags, "nvcc": CUDA_FLAGS + optional}
        found += [CUDAExtension("bigtri._cuda", cuda_sources(), extra_compile_args=each, **common)]
    return found


setup(ext_modules=extensions(), cmdclass={"build_ext": BuildExtension}, options={"bdist_wheel": {"py_limited_api": "cp310"}})
