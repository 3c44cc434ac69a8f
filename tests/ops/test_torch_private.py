"""bigtri on a torch that has renamed what is private in it."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import bigtri

PACKAGE = Path(bigtri.__file__).parent


def test_one_file_has_all_private_names_of_torch():
    private = re.compile(r"\btorch(\.\w+)*\._[a-zA-Z]|\b(from|import) torch(\.\w+)*\._|\._is_")
    files = [path for path in PACKAGE.rglob("*.py") if private.search(path.read_text(encoding="utf-8"))]
    assert [path.name for path in files] == ["torch_private.py"]


# In a process of its own for each name, forked from one that has imported torch and not bigtri.
WITHOUT = """
import os
import sys

import numpy as np
import torch
import torch._subclasses


class Gone:
    def __get__(self, tensor, kind):
        raise AttributeError("gone")


def import_without(name):
    owner, _, last = ("torch." + name).rpartition(".")
    owner = eval(owner)
    kept = getattr(owner, last)
    if owner is torch.Tensor:  # the name is inherited from a class that cannot be changed
        setattr(owner, last, Gone())
    else:
        delattr(owner, last)
    import bigtri.torch_private

    setattr(owner, last, kept)  # torch needs them itself


def fails(call, *errors):
    try:
        call()
    except errors:
        return
    raise AssertionError("no error")


def use():
    import bigtri

    positions = np.array([(-1, -1, 0, 1), (3, -1, 0, 1), (-1, 3, 0, 1)], np.float32)
    triangles = np.array([(0, 1, 2)], np.int32)
    for backend in ("reference", "auto"):
        seen = bigtri.rasterize(positions, triangles, (8, 9), backend=backend)
        assert (seen.packed == 0x3F000000 << 32).all()
        clip, faces = torch.from_numpy(positions), torch.from_numpy(triangles)
        image = torch.empty((8, 9), dtype=torch.int64)
        bigtri.rasterize(clip, faces, (8, 9), backend=backend, out=image)
        assert np.array_equal(image.numpy(), seen.packed)
        weights = [bigtri.barycentrics(seen, positions, triangles, backend=one) for one in ("reference", backend)]
        assert np.array_equal(*weights)
        assert not bigtri.encode_srgb(torch.zeros(2, 3), backend=backend).any()

        # What cannot be drawn, or only from a copy: no crash, and no other values.
        zeros = torch._efficientzerotensor((3, 4))
        assert (bigtri.rasterize(zeros, faces, (8, 9), backend=backend).triangle == -1).all()
        nowhere = torch._efficientzerotensor((8, 9), dtype=torch.int64)
        fails(lambda: bigtri.rasterize(clip, faces, (8, 9), backend=backend, out=nowhere), ValueError)
        batch = torch.zeros(2, 3, 4)
        fails(
            lambda: torch.vmap(lambda p: bigtri.rasterize(p, faces, (8, 9), backend=backend).packed)(batch),
            *(ValueError, RuntimeError, NotImplementedError, AttributeError),
        )
        freed = torch.zeros(3, 4)
        freed.untyped_storage().resize_(0)
        fails(lambda: bigtri.rasterize(freed, faces, (8, 9), backend=backend), ValueError)

    mode = torch._subclasses.fake_tensor.FakeTensorMode()
    fake = mode.from_tensor(torch.zeros(2, 3))
    if bigtri.native.available():
        assert bigtri.encode_srgb(fake).shape == (2, 3)
    assert bigtri.decode_srgb(mode.from_tensor(torch.zeros(2, dtype=torch.uint8))).shape == (2,)
    fails(lambda: bigtri.encode_srgb(fake, backend="reference"), ValueError)


# What torch imports on first use, once for all children.
torch.vmap(torch.neg)(torch.zeros(2, 3))
torch._subclasses.fake_tensor.FakeTensorMode().from_tensor(torch.zeros(2, 3))
for name in sys.argv[1:]:
    child = os.fork()
    if child == 0:
        import_without(name)
        use()
        os._exit(0)
    assert os.waitpid(child, 0)[1] == 0, f"without {name}"
    print(name)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_without_any_of_them():
    names = [
        "_is_functional_tensor",
        "_C._functorch.is_batchedtensor",
        "_C._has_storage",
        "_C._dispatch_keys",
        "_C.DispatchKey",
        "Tensor._is_zerotensor",
        "_subclasses.FakeTensor",
    ]
    command = [sys.executable, "-c", WITHOUT, *names]
    done = subprocess.run(command, cwd=PACKAGE.parent, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == names
