"""What a bug report needs to know about this machine and this build; plain text."""

from __future__ import annotations

import os
import platform
import sys
from importlib import metadata
from pathlib import Path

import torch

from .. import __version__, machine, native
from ..precision import DEFAULT
from ..study import provenance

# What the builds differ by, as /proc/cpuinfo calls it.
_INSTRUCTION_SETS = ("sse4_2", "avx", "avx2", "fma", "avx512f", "avx512bw", "avx512dq", "avx512vl", "asimd", "sve", "sve2")


def describe() -> str:
    """The versions of everything involved, the processor, and the state of the extension, one "name: value" a line."""
    lines = [
        ("bigtri", f"{__version__} in {Path(__file__).resolve().parent}"),
        ("python", f"{platform.python_version()} ({platform.python_implementation()}, {sys.executable})"),
        *((package, _version(package)) for package in ("torch", "numpy", "scikit-image", "trimesh", "pillow")),
        ("system", platform.platform()),
        ("processor", f"{machine.cpu_name()}, {provenance.usable_cpus()} of {os.cpu_count()} logical processors usable"),
        ("instruction sets", ", ".join(_instruction_sets()) or "unknown"),
        ("torch threads", str(torch.get_num_threads())),
        ("torch CPU capability", torch.backends.cpu.get_cpu_capability()),
        ("torch CUDA", _cuda()),
        *_extension(),
    ]
    width = max(len(name) for name, _ in lines) + 2
    return "\n".join(f"{name + ':':<{width}}{value}" for name, value in lines)


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"


def _instruction_sets() -> list[str]:
    for line in machine.cpuinfo():
        if line.lower().startswith(("flags", "features")):
            flags = set(line.partition(":")[2].split())
            return [name for name in _INSTRUCTION_SETS if name in flags]
    return []


def _cuda() -> str:
    if torch.version.cuda is None:
        return "torch was built without it"
    devices = [torch.cuda.get_device_name(i) for i in range(torch.cuda.device_count())] if torch.cuda.is_available() else []
    return f"{torch.version.cuda}, {', '.join(devices) or 'no device'}"


def _extension() -> list[tuple[str, str]]:
    if not native.available():
        state = "there but does not load" if native.is_broken() else "not loaded"
        return [("extension", f"{state}: {native.load_error()}; build it with `python setup.py build_ext --inplace`")]
    levels = ", ".join(native.isa_levels())
    if "cuda" in native.VARIANTS:
        cuda = f"built, variants: {', '.join(native.VARIANTS['cuda'])}"
    elif native.is_broken("cuda"):
        cuda = f"there but does not load: {native.load_error('cuda')}"
    else:
        cuda = "not built (needs a torch for CUDA and nvcc)"
    return [
        ("extension", "built and loaded"),
        ("extension's levels", f"{levels}; in use: {native.isa()}"),
        ("extension's CUDA", cuda),
        *((f"variant {name}", variant.paper) for name, variant in native.REGISTRY["cpu"][DEFAULT].items()),
    ]
