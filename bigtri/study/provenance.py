"""Where a measurement comes from: processor, versions, commit, command line."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from pathlib import Path

import numpy as np
import torch

from .. import __version__
from ..machine import cpu_name


def usable_cpus() -> int:
    """How many logical processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def device(kind: str = "cpu") -> str:
    """The CPU's name and how many of its cores this process may use; of "cuda" the current device's name."""
    if kind == "cuda":
        return torch.cuda.get_device_name()
    return f"{cpu_name()}, {usable_cpus()} cores"


def versions() -> str:
    return f"bigtri {__version__}; torch {torch.__version__}; numpy {np.__version__}; python {platform.python_version()}"


def commit() -> str:
    """The checkout's commit, with -dirty where files differ from it; empty outside a checkout."""
    describe = ["git", "describe", "--always", "--dirty", "--exclude=*"]
    try:
        return subprocess.run(describe, cwd=Path(__file__).parent, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return ""


def command() -> str:
    """This process's command line, without the folder of the program."""
    program = Path(sys.argv[0]).name
    return " ".join(["python -m bigtri" if program == "__main__.py" else program, *sys.argv[1:]])
