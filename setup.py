"""Builds the extension `bigtri._C`: one abi3 library on torch's stable ABI, which runs on Python >= 3.10 and torch >= 2.10."""

import os
import platform
from pathlib import Path

from setuptools import setup
from torch.utils.cpp_extension import BuildExtension, CppExtension

CSRC = Path("bigtri/csrc")
TARGET_TORCH = "0x020a000000000000"  # torch 2.10

# Without -ffp-contract=off a compiler may fuse a * b + c, and the bits would differ (docs/numerics.md 1).
FLAGS = [
    "-std=c++17",
    "-O3",
    "-ffp-contract=off",
    "-fvisibility=hidden",
    "-pthread",
    "-Wall",
    "-Wextra",
    "-Wno-unused-parameter",
    "-Wno-unused-function",
    "-Wno-psabi",
    "-Wno-maybe-uninitialized",
    "-Wno-uninitialized",
]


def sources() -> list[str]:
    files = sorted([*CSRC.glob("cpu/*.cpp"), *CSRC.glob("torch/*.cpp")])
    if platform.machine() not in ("x86_64", "AMD64"):
        files = [f for f in files if f.name not in ("isa_avx2.cpp", "isa_avx512.cpp")]
    return [str(f) for f in files]


def extension() -> CppExtension:
    flags = [*FLAGS, f"-DTORCH_TARGET_VERSION={TARGET_TORCH}"]
    link = []
    if sanitize := os.environ.get("BIGTRI_SANITIZE"):  # e.g. address,undefined; CONTRIBUTING.md says how to run it
        # Python's own flags have -fwrapv, under which no signed overflow is undefined, so that none would be reported.
        flags += [f"-fsanitize={sanitize}", "-fno-sanitize-recover=all", "-fno-wrapv", "-fno-omit-frame-pointer", "-g", "-O1"]
        link += [f"-fsanitize={sanitize}"]
    headers = [str(f) for pattern in ("*.h", "*.inl") for f in sorted(CSRC.rglob(pattern))]
    return CppExtension(
        "bigtri._C", sources(), extra_compile_args={"cxx": flags}, extra_link_args=link, depends=headers, py_limited_api=True
    )


setup(ext_modules=[extension()], cmdclass={"build_ext": BuildExtension}, options={"bdist_wheel": {"py_limited_api": "cp310"}})
