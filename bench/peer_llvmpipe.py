"""llvmpipe, Mesa's software rasterizer, as a peer: the same clip-space positions through OpenGL, on the same cores.

A frame clears both targets, draws, and ends with glFinish; the vertex buffer is uploaded once, nothing is read back while the
clock runs. Targets: an R32I image for the triangle's index and a 32-bit float depth buffer, that is 8 bytes a pixel, as many as
bigtri writes. Others were no faster on S1 and S3: RGBA8 or R32F for the index, 24-bit depth, vectors of 128 or 512 bits, huge
pages.

`ids` says how a fragment learns its triangle, since which one is faster depends on the scene:
* `primitive`: gl_PrimitiveID, indexed triangles (shared vertices are transformed once);
* `attribute`: a flat vertex attribute, no index buffer;
* `none`: depth only, half the bytes and no fragment shader. Not the same work; a lower bound.

The number of threads is fixed when a context is made, so each count lives in a process of its own (`Llvmpipe`), which takes
orders as JSON lines. The processes sleep between orders, so a driver can alternate between peers. Mesa's count 0 rasterizes in
the calling thread, 1 adds a worker to it.

Mesa's rows grow upward. The vertex shader mirrors y, so that row 0 is the top and ties on an edge go to the top and left, as in
bigtri.

    python bench/peer_llvmpipe.py --scenes S1,S3 --size 1920x1080 --threads 1,2 --check
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:  # the worker needs neither bigtri nor torch
    from typing_extensions import Self

    from bigtri.study.scenes import Triangles

WAYS = ("primitive", "attribute", "none")

# OpenGL names that moderngl does not cover
TEXTURE_2D, DEPTH_COMPONENT32F, DEPTH_COMPONENT, FLOAT = 0x0DE1, 0x8CAC, 0x1902, 0x1406
COLOR, DEPTH = 0x1800, 0x1801


# --- the driver's side


class Process:
    """A process with an llvmpipe context of `threads` rasterizer threads (0: none besides the caller), which runs `program`."""

    def __init__(self, program: str, threads: int) -> None:
        environment = os.environ | {"LIBGL_ALWAYS_SOFTWARE": "1", "GALLIUM_DRIVER": "llvmpipe", "LP_NUM_THREADS": str(threads)}
        self.process = subprocess.Popen(
            [sys.executable, program, "--worker"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
        )
        self.folder = tempfile.TemporaryDirectory()
        self.renderer: str = self._receive()["renderer"]

    def load_arrays(self, arrays: dict[str, NDArray[Any]], **about: Any) -> None:
        """Hands over arrays by name, and what else the worker's `make` wants to know."""
        path = Path(self.folder.name) / "scene.npz"
        np.savez(path, **arrays)  # type: ignore[arg-type]  # the stub takes them for the option allow_pickle
        self._order(order="load", path=str(path), **about)

    def frames(self, count: int) -> list[float]:
        """Draws `count` frames: milliseconds of each."""
        return self._order(order="frames", count=count)["ms"]

    def result(self) -> NDArray[Any]:
        """The last frame."""
        path = Path(self.folder.name) / "result.npy"
        self._order(order="result", path=str(path))
        return np.load(path)

    def close(self) -> None:
        assert self.process.stdin
        self.process.stdin.close()
        self.process.wait(timeout=30)
        self.folder.cleanup()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def _order(self, **order: Any) -> dict[str, Any]:
        assert self.process.stdin
        self.process.stdin.write(json.dumps(order) + "\n")
        self.process.stdin.flush()
        return self._receive()

    def _receive(self) -> dict[str, Any]:
        assert self.process.stdout
        line = self.process.stdout.readline()
        if not line:
            raise RuntimeError("llvmpipe: no OpenGL context through EGL (bench/README.md says what to install)")
        return json.loads(line)


class Llvmpipe(Process):
    """What draws a visibility buffer."""

    def __init__(self, threads: int) -> None:
        super().__init__(__file__, threads)

    def load(self, scene: Triangles, width: int, height: int, ids: str) -> None:
        """Uploads a scene in clip space; ids is one of `WAYS`."""
        self.load_arrays({"positions": scene.positions, "triangles": scene.triangles}, width=width, height=height, ids=ids)

    def ids(self) -> NDArray[np.int32]:
        """The last frame's triangle indices, int32 [H, W], row 0 on top, -1 where there is none."""
        return self.result()


# --- the worker's side


def opengl(name: str, *arguments: Any) -> Any:
    """An OpenGL function of the current context by name."""
    egl = ctypes.CDLL("libEGL.so.1")
    egl.eglGetProcAddress.restype = ctypes.c_void_p
    egl.eglGetProcAddress.argtypes = [ctypes.c_char_p]
    return ctypes.CFUNCTYPE(None, *arguments)(egl.eglGetProcAddress(name.encode()))


def float_depth(context: Any, size: tuple[int, int]) -> Any:
    """A depth texture of 32-bit floats, which moderngl does not make."""
    depth = context.depth_texture(size)
    i, u, p = ctypes.c_int, ctypes.c_uint, ctypes.c_void_p
    opengl("glBindTexture", u, u)(TEXTURE_2D, depth.glo)
    opengl("glTexImage2D", u, i, i, i, i, i, u, u, p)(TEXTURE_2D, 0, DEPTH_COMPONENT32F, *size, 0, DEPTH_COMPONENT, FLOAT, None)
    return depth


VERTEX = """#version 330
in vec4 position; {declare}
void main() {{ gl_Position = vec4(position.x, -position.y, position.zw); {assign} }}"""


class Frame:
    """One scene on one pair of targets; `draw` is a whole frame."""

    def __init__(self, context: Any, scene: dict[str, NDArray[Any]], width: int, height: int, ids: str) -> None:
        flat, written = ids == "attribute", ids != "none"
        source = "triangle" if flat else "gl_PrimitiveID"
        program = context.program(
            vertex_shader=VERTEX.format(
                declare="in int index; flat out int triangle;" if flat else "", assign="triangle = index;" if flat else ""
            ),
            fragment_shader="#version 330\n"
            + ("flat in int triangle; " if flat else "")
            + (f"out int color; void main() {{ color = {source}; }}" if written else "void main() {}"),
        )
        positions, triangles = scene["positions"], scene["triangles"]
        if flat:
            index = np.repeat(np.arange(len(triangles), dtype=np.int32), 3)
            corners = context.buffer(positions[triangles].tobytes())
            content = [(corners, "4f", "position"), (context.buffer(index.tobytes()), "1i", "index")]
            self.vertices = context.vertex_array(program, content)
        else:
            content = [(context.buffer(positions.tobytes()), "4f", "position")]
            self.vertices = context.vertex_array(program, content, index_buffer=context.buffer(triangles.tobytes()))
        self.size = (width, height)
        self.color = context.texture(self.size, 1, dtype="i4") if written else None
        i, u, p = ctypes.c_int, ctypes.c_uint, ctypes.c_void_p
        self.target = context.framebuffer([self.color] if self.color else [], float_depth(context, self.size))
        self.target.use()
        context.viewport = (0, 0, width, height)
        context.enable_only(context.DEPTH_TEST)
        context.depth_func = "<"
        self.clear_ids, self.clear_depth = opengl("glClearBufferiv", u, i, p), opengl("glClearBufferfv", u, i, p)
        self.finish = opengl("glFinish")
        self.background, self.far = (i * 4)(-1, -1, -1, -1), (ctypes.c_float * 1)(1.0)

    def draw(self) -> float:
        """A frame: its milliseconds."""
        start = time.perf_counter()
        if self.color:
            self.clear_ids(COLOR, 0, self.background)
        self.clear_depth(DEPTH, 0, self.far)
        self.vertices.render()
        self.finish()
        return (time.perf_counter() - start) * 1e3

    def result(self) -> NDArray[np.int32]:
        assert self.color, "WAYS none draws no ids"
        return np.frombuffer(self.color.read(), np.int32).reshape(self.size[1], self.size[0])


class Drawn(Protocol):
    """What a worker draws."""

    def draw(self) -> float:
        """A whole frame: its milliseconds."""

    def result(self) -> NDArray[Any]:
        """The last frame."""


def worker(make: Callable[[Any, dict[str, NDArray[Any]], dict[str, Any]], Drawn]) -> None:
    """Answers orders from stdin until it closes. make: of a context, arrays, and what else came with the order to load."""
    import moderngl

    try:
        context = moderngl.create_context(standalone=True, backend="egl")  # type: ignore[arg-type]  # as its documentation has it
    except Exception as error:  # whatever EGL lacks, the driver only needs to know that there is no context
        sys.exit(f"llvmpipe: {error}")
    context.gc_mode = "auto"  # a new scene frees the last one's buffers
    print(json.dumps({"renderer": f"{context.info['GL_RENDERER']}, {context.info['GL_VERSION']}"}), flush=True)
    frame: Drawn | None = None
    for line in sys.stdin:
        order = json.loads(line)
        answer: dict[str, Any] = {}
        if order["order"] == "load":
            frame = None  # gives its memory back first
            frame = make(context, dict(np.load(order["path"])), order)
        elif frame is None:
            raise RuntimeError("an order to draw before one to load")
        elif order["order"] == "frames":
            answer["ms"] = [frame.draw() for _ in range(order["count"])]
        elif order["order"] == "result":
            np.save(order["path"], frame.result())
        print(json.dumps(answer), flush=True)


# --- by itself: a table of all ways, to see which one is the fastest


def budgeted(peer: Process, seconds: float) -> list[float]:
    """Frames for about `seconds`, at least 3, after one or two to warm up."""
    first = peer.frames(2)[1]
    return peer.frames(max(3, min(200, int(seconds * 1e3 / first))))


def main() -> None:
    if "--worker" in sys.argv[1:]:
        return worker(lambda context, arrays, about: Frame(context, arrays, about["width"], about["height"], about["ids"]))

    from bigtri.app import arguments as option_types
    from bigtri.study import scenes

    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--scenes", default=scenes.DEFAULT)
    parser.add_argument(
        "--size", type=option_types.listed(option_types.size), default="1080p", help="WxH, several separated by commas"
    )
    parser.add_argument("--threads", default="0,1,2", help="values of LP_NUM_THREADS")
    parser.add_argument("--ways", default=",".join(WAYS))
    parser.add_argument("--seconds", type=option_types.seconds, default=1.0, help="time for each figure")
    parser.add_argument("--check", action="store_true", help="compare each image with bigtri's")
    arguments = parser.parse_args()
    print(f"{'scene':8} {'size':>10} {'LP_NUM_THREADS':>14} {'ids':>10} {'median ms':>10} {'min ms':>9} {'frames':>7}")
    for threads in map(int, arguments.threads.split(",")):
        with Llvmpipe(threads) as peer:
            print(f"# {peer.renderer}", flush=True)
            for width, height in arguments.size:
                for name in arguments.scenes.split(","):
                    scene = scenes.make(name, width, height)
                    for way in arguments.ways.split(","):
                        peer.load(scene, width, height, way)
                        ms = budgeted(peer, arguments.seconds)
                        line = f"{name:8} {f'{width}x{height}':>10} {threads:14} {way:>10} "
                        line += f"{statistics.median(ms):10.2f} {min(ms):9.2f} {len(ms):7}"
                        if arguments.check and way != "none":
                            line += f"  {different(peer.ids(), scene, width, height)}"
                        print(line, flush=True)


def different(ids: NDArray[np.int32], scene: Triangles, width: int, height: int) -> str:
    """How an image compares with bigtri's: pixels with another coverage, and with another triangle."""
    import bigtri

    mine = np.asarray(bigtri.rasterize(scene.positions, scene.triangles, (height, width), depth=False).triangle)
    coverage = int(((ids >= 0) != (mine >= 0)).sum())
    return f"{coverage} px covered differently, {int((ids != mine).sum()) - coverage} px with another triangle"


if __name__ == "__main__":
    main()
