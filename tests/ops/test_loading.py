"""Libraries that lie in the package and do not load: what is said of them, and what draws instead."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import bigtri
from bigtri import fakes, native

PACKAGE = Path(bigtri.__file__).parent

# Prints each step's result and what it warned of.
SCRIPT = """\
import json
import sys
import warnings

# An editable installation has a finder that would find the checkout's libraries where the copy has none.
sys.meta_path[:] = [finder for finder in sys.meta_path if "editable" not in str(finder).lower()]

import numpy as np
import torch
from torch._subclasses import FakeTensorMode

said = []
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")

    def step(name, call):
        try:
            result = call()
        except Exception as error:
            result = f"{type(error).__name__}: {error}"
        said.append([name, result, [(w.category.__name__, w.filename, str(w.message)) for w in caught]])
        caught.clear()

    torch.cuda.is_available = lambda: False
    import bigtri
    from bigtri import native, warn
    from bigtri.app.info import describe

    positions = np.array([(-1, -1, 0, 1), (3, -1, 0, 1), (-1, 3, 0, 1)], np.float32)
    triangles = np.array([(0, 1, 2)], np.int32)

    def draw(backend="auto", place=np.array):
        return int((bigtri.rasterize(place(positions), place(triangles), (8, 9), backend=backend).packed >> 32).max())

    def on_cuda(values):
        return torch.empty(values.shape, dtype=torch.from_numpy(values).dtype, device="cuda")

    step("reference", lambda: draw("reference"))
    step("native", lambda: draw("native"))
    step("auto", draw)
    step("again", draw)
    step("other op", lambda: bigtri.encode_srgb(np.zeros(3, np.float32)).tolist())
    step("state", lambda: [native.available(), native.load_error(), native.is_broken(), native.devices()])
    step("cuda state", lambda: [native.load_error("cuda"), native.is_broken("cuda"), "cuda" in native.VARIANTS])
    with FakeTensorMode(allow_non_fake_inputs=True):
        step("cuda tensors", lambda: draw(place=on_cuda))
    step("info", describe)
    torch.cuda.is_available = lambda: True
    warn._said.clear()
    step("devices", native.devices)
print(json.dumps(said))
"""


def run(folder: Path, **files: bytes) -> dict[str, tuple[object, list]]:
    """Results and warnings of the steps of ``SCRIPT``, on a copy of the package with these libraries."""
    shutil.copytree(PACKAGE, folder / "bigtri", ignore=shutil.ignore_patterns("csrc", "*.so", "__pycache__"))
    for name, content in files.items():
        (folder / "bigtri" / f"{name}.abi3.so").write_bytes(content)
    script = folder / "script.py"
    script.write_text(SCRIPT)
    done = subprocess.run([sys.executable, script], cwd=folder, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return {name: (result, warned) for name, result, warned in json.loads(done.stdout)}


DEPTH = 0x3F000000


def test_a_library_that_does_not_load_is_said_once(tmp_path):
    steps = run(tmp_path, _C=b"no library")
    ((kind, file, text),) = steps["auto"][1]
    assert kind == "RuntimeWarning" and file == str(tmp_path / "script.py")
    assert "the extension's library for cpu is there but does not load" in text
    assert "falls back to the NumPy reference" in text and "_C.abi3.so" in text
    assert steps["auto"][0] == steps["reference"][0] == steps["again"][0] == DEPTH
    available, reason, broken, devices = steps["state"][0]
    assert not available and broken and devices == [] and reason in text
    assert "backend='native' needs the extension: its library is there but does not load" in steps["native"][0]
    assert reason in steps["native"][0]
    assert "there but does not load: " in steps["info"][0]
    assert [name for name, (_, warned) in steps.items() if warned] == ["auto"]


def test_no_library_at_all_is_no_reason_to_warn(tmp_path):
    steps = run(tmp_path)
    assert steps["auto"][0] == DEPTH and steps["state"][0][::2] == [False, False]
    assert "build it with" in steps["native"][0] and "not loaded: " in steps["info"][0]
    assert [name for name, (_, warned) in steps.items() if warned] == []


@pytest.mark.skipif(not native.available(), reason="the extension is not built")
def test_a_library_for_cuda_that_does_not_load_leaves_the_cpu(tmp_path):
    library = next(PACKAGE.glob("_C*.so")).read_bytes()
    steps = run(tmp_path, _C=library, _cuda=b"no library")
    assert steps["native"][0] == steps["auto"][0] == DEPTH
    assert steps["state"][0] == [True, "", False, ["cpu"]]
    reason, broken, drawn_on = steps["cuda state"][0]
    assert "_cuda.abi3.so" in reason and broken and not drawn_on
    ((kind, file, text),) = steps["cuda tensors"][1]
    assert kind == "RuntimeWarning" and file == str(tmp_path / "script.py")
    assert "the extension's library for cuda is there but does not load" in text and reason in text
    refused = f"positions must be on cpu, as the extension's library for cuda does not load here ({reason})"
    assert refused in steps["cuda tensors"][0]
    assert f"there but does not load: {reason}" in steps["info"][0]
    assert [name for name, (_, warned) in steps.items() if warned] == ["cuda tensors", "devices"]
    assert steps["devices"] == (["cpu"], steps["cuda tensors"][1])


@pytest.mark.skipif(not native.available(), reason="the extension is not built")
def test_a_library_of_other_sources_says_to_build_again(monkeypatch):
    for name in ("newer", "newest"):
        monkeypatch.setitem(fakes.OPERATORS, name, fakes.OPERATORS["lambert"])
    with pytest.raises(
        ImportError, match="lacks the operators newer, newest: .*; build it again with `python setup.py build_ext"
    ):
        fakes.register()
