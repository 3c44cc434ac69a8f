"""What to do with a fragment: a packed minimum, a lock for each pixel, or shading at once, behind the same set-up and spans.

Two questions about the variant `scanline`, answered by a bench of its own, which is built from bigtri's headers (fragments.h):
* an atomic minimum of 64 bits that hold depth and triangle, against a lock for each pixel around a comparison and two stores;
* a visibility buffer whose pixels are shaded once, at the end, against shading in the scanline, where an atomic minimum keeps
  depth and colour: of every fragment, or of those that are nearer than what the pixel holds. What is shaded is a smooth normal
  in two lights, encoded as sRGB.

    python bench/fragments.py --csv bench/results/fragments_cpu.csv --docs docs/variants.md
    python bench/fragments.py --device cuda --seconds 0.05 --csv build/gpu/fragments.csv
    python bench/fragments.py --rows bench/results/fragments_cpu.csv --docs docs/variants.md     # tables alone

All ways take turns. Pictures are compared: with a lock the same bits; with colours the pixels that show another colour, where
fragments of the same depth meet. Triangles that need clipping are left out of all.
"""

from __future__ import annotations

import argparse
import ctypes
import dataclasses
import os
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import cuda_clock
import markdown
import numpy as np
import torch
from torch.utils import cpp_extension
from variant_cases import in_turns
from variant_rows import many, text_of

import bigtri
from bigtri.app import arguments as option_types
from bigtri.check import counters
from bigtri.ops.shading import THRESHOLDS
from bigtri.study import benchmark, provenance, scenes

HERE = Path(__file__).resolve().parent
CSRC = Path(bigtri.__file__).parent / "csrc"
# The bits are those of setup.py's flags.
HOST_FLAGS = ["-O3", "-ffp-contract=off", "-pthread"]
CUDA_FLAGS = ["-O3", "-fmad=false", "-prec-div=true", "-prec-sqrt=true", "-ftz=false"]
SOURCES = {
    "cpu": (HERE / "fragments.cpp", CSRC / "cpu/thread_pool.cpp"),
    "cuda": (HERE / "fragments.cu", CSRC / "cuda/kept_graphs.cu"),
}
GUARD = 4  # screens to either side: within the guard band at any size up to 16384 px
SCENES = "R4k,R16k-close,R100k,S2,S3,S4f,S4b"
WAYS = ("packed", "locked", "coloured", "coloured all")  # in the order of fragments.h


class Arguments(ctypes.Structure):
    """FragmentArguments of fragments.h."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("positions", "triangles", "normals", "directions", "colors", "srgb")),
        *((name, ctypes.c_void_p) for name in ("packed", "locks", "image")),
        *((name, ctypes.c_int32) for name in ("count", "lights", "height", "width")),
    )


@dataclasses.dataclass
class Row:
    """A scene drawn by one way; the fields are the CSV's columns."""

    scene: str
    width: int  # px
    height: int  # px
    triangles: int  # that need no clipping
    fragments: int  # that the triangles cover
    covered_px: int
    way: str  # of `WAYS`
    draw_ms: float  # clear included
    image_ms: float  # with the image of colours
    repeats: int
    differing_px: int  # from the image of the packed minimum
    device: str
    how: str
    versions: str
    commit: str
    command: str


def library(device: str) -> ctypes.CDLL:
    """`SOURCES`, built by torch and kept in its folder of extensions."""
    path = cpp_extension.load(
        f"bigtri_fragments_{device}",
        [str(source) for source in SOURCES[device]],
        extra_cflags=HOST_FLAGS,
        extra_cuda_cflags=CUDA_FLAGS,
        extra_include_paths=[str(CSRC)],
        with_cuda=device == "cuda",
        is_python_module=False,
    )
    loaded = ctypes.CDLL(path)
    loaded.fragments_srgb.restype = ctypes.c_int64
    return loaded


class Scene:
    """Triangles that need no clipping, and all that the ways work with."""

    def __init__(self, built: ctypes.CDLL, device: str, name: str, width: int, height: int) -> None:
        made = scenes.make(name, width, height)
        self.name = name
        self.built, self.device, self.size = built, device, (height, width)
        clip = made.positions[made.triangles]
        inside = (np.abs(clip) <= np.array([GUARD, GUARD, 1, 1], np.float32) * clip[..., 3:]) & (clip[..., 3:] > 0)
        faces = made.triangles[inside.all(axis=(1, 2))]
        rng = np.random.default_rng(scenes.SEED)
        normals = rng.normal(size=(len(made.positions), 3)).astype(np.float32)
        directions = np.array([[0.6, 0.0, 0.8], [-0.8, 0.6, 0.0]], np.float32)
        colors = np.array([[0.9, 0.9, 0.8], [0.2, 0.3, 0.4]], np.float32)
        self.given = {
            "positions": made.positions,
            "triangles": faces,
            "normals": normals,
            "directions": directions,
            "colors": colors,
            "srgb": self.srgb(),
        }
        self.tensors = {name: torch.from_numpy(np.ascontiguousarray(array)).to(device) for name, array in self.given.items()}
        for name, kind in (("packed", torch.int64), ("locks", torch.int32), ("image", torch.int32)):
            self.tensors[name] = torch.zeros(self.size, dtype=kind, device=device)
        sizes = {"count": len(faces), "lights": len(directions), "height": height, "width": width}
        self.arguments = Arguments(**{name: tensor.data_ptr() for name, tensor in self.tensors.items()}, **sizes)

    def srgb(self) -> np.ndarray:
        """The table of encode_srgb."""
        thresholds = THRESHOLDS.numpy()
        table = np.empty(self.built.fragments_srgb(None, None), np.uint8)
        self.built.fragments_srgb(ctypes.c_void_p(thresholds.ctypes.data), ctypes.c_void_p(table.ctypes.data))
        return table

    def draw(self, way: str) -> None:
        self._call(self.built.fragments_draw, way)

    def picture(self, way: str) -> None:
        self.draw(way)
        self._call(self.built.fragments_finish, way)

    def _call(self, function: Any, way: str) -> None:
        stream = torch.cuda.current_stream().cuda_stream if self.device == "cuda" else None
        error = function(ctypes.byref(self.arguments), WAYS.index(way), torch.get_num_threads(), ctypes.c_void_p(stream))
        if error:
            raise RuntimeError(f"fragments.cu: CUDA error {error}")

    def check(self) -> None:
        """
        Raises:
            RuntimeError: the packed minimum's bits are not those of bigtri.
        """
        self.draw("packed")
        given = self.tensors["positions"], self.tensors["triangles"]
        expected = bigtri.rasterize(*given, self.size, backend="native", variant="scanline", depth=False).packed
        if not torch.equal(self.tensors["packed"], torch.as_tensor(expected)):
            raise RuntimeError(f"fragments.py: {self.name}: the packed minimum's bits are not those of bigtri's scanline")

    def fragments(self) -> int:
        """Pixels that the triangles cover, hidden ones too."""
        arrays = self.given["positions"], self.given["triangles"]
        return counters.count(*arrays, self.size, variant="scanline").get("fragments", 0)

    def rows(self, seconds: float, where: Mapping[str, str]) -> list[Row]:
        self.check()
        differing = {}
        for way in WAYS:
            self.picture(way)
            image, packed = self.tensors["image"].clone(), self.tensors["packed"].clone()
            if way == "packed":
                first, bits = image, packed
            differing[way] = int(((packed != bits) if way == "locked" else (image != first)).sum())
        calls = {f"draw {way}": partial(self.draw, way) for way in WAYS} | {way: partial(self.picture, way) for way in WAYS}
        times = in_turns(calls, seconds, self.device)
        height, width = self.size
        fragments, covered = self.fragments(), int((first != 0).sum())
        return [
            Row(
                scene=self.name,
                width=width,
                height=height,
                triangles=len(self.given["triangles"]),
                fragments=fragments,
                covered_px=covered,
                way=way,
                draw_ms=times[f"draw {way}"].median,
                image_ms=times[way].median,
                repeats=times[way].repeats,
                differing_px=differing[way],
                device=where["device"],
                how=where["how"],
                versions=where["versions"],
                commit=where["commit"],
                command=where["command"],
            )
            for way in WAYS
        ]


def table(rows: Sequence[Mapping[str, str]]) -> str:
    """A scene a line; times over those of the packed minimum."""
    cases: dict[tuple[str, str], dict[str, Mapping[str, str]]] = {}
    for row in rows:
        cases.setdefault((row["scene"], f"{row['width']}x{row['height']}"), {})[row["way"]] = row
    lines = []
    for (scene, size), ways in cases.items():
        first, locked, nearer, every = (ways[way] for way in WAYS)
        draw, image = float(first["draw_ms"]), float(first["image_ms"])
        lines.append(
            [
                f"{scene}, {size}",
                many(int(first["fragments"])),
                many(int(first["covered_px"])),
                text_of(draw),
                f"{float(locked['draw_ms']) / draw:.2f}",
                text_of(image),
                *(f"{float(way['image_ms']) / image:.2f}" for way in (nearer, every)),
                nearer["differing_px"],
            ]
        )
    head = ["scene", "fragments", "covered px", "packed minimum, ms", "a lock for each pixel, times that"]
    head += ["visibility buffer, then shading, ms", "shading what is nearer, times that", "shading all", "px that differ"]
    whence = ("{device}; {how}; {versions}; commit {commit}: `{command}`.".format(**row) for row in rows)
    return "\n\n".join([*(markdown.wrapped(each) for each in dict.fromkeys(whence)), markdown.table(head, lines)])


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--scenes", default=SCENES, help="names separated by commas, or all (default %(default)s)")
    parser.add_argument("--size", type=option_types.size, default=(1280, 720), help="WIDTHxHEIGHT (default 1280x720)")
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu", help="default %(default)s")
    parser.add_argument("--seconds", type=option_types.seconds, default=0.2, help="each way, each scene (default 0.2)")
    parser.add_argument("--csv", type=option_types.csv_file, metavar="FILE", help="write the rows there")
    parser.add_argument("--rows", type=Path, nargs="+", metavar="FILE", help="take the rows from there and measure nothing")
    parser.add_argument("--docs", type=Path, metavar="PAGE", help="put the table there, between its markers")
    options = parser.parse_args(argv)
    if options.rows:
        found = [row for path in options.rows for row in benchmark.read_csv(path)]
    else:
        try:
            names = option_types.chosen("scene", options.scenes, list(scenes.SCENES))
        except ValueError as error:
            parser.error(str(error))
        if options.device == "cuda" and not torch.cuda.is_available():
            parser.error("--device cuda needs a GPU")
        found = measured(names, options)
    if options.docs:
        markdown.paste(options.docs, f"fragments {options.device}", table(found))
    wrong = [row for row in found if row["way"] == "locked" and int(row["differing_px"])]
    for row in wrong:
        print(f"NOT EQUAL: {row['scene']}: with a lock {row['differing_px']} px have other bits")
    return 1 if wrong else 0


def measured(names: Sequence[str], options: argparse.Namespace) -> list[dict[str, str]]:
    built, where = library(options.device), whence(options.device)
    rows: list[Row] = []
    print(f"{'scene':12} {'fragments':>10} {'covered px':>10}  {'way':14} {'draw ms':>9} {'image ms':>9} {'px differ':>9}")
    for name in names:
        try:
            found = Scene(built, options.device, name, *options.size).rows(options.seconds, where)
        except ValueError as error:  # the image is too small for the scene
            print(f"{name}: {error}")
            continue
        for row in found:
            print(f"{row.scene:12} {row.fragments:10} {row.covered_px:10}  {row.way:14} ", end="")
            print(f"{row.draw_ms:9.3f} {row.image_ms:9.3f} {row.differing_px:9}", flush=True)
        rows += found
        if options.csv:
            benchmark.write_csv(options.csv, rows)
    return [{name: str(value) for name, value in vars(row).items()} for row in rows]


def whence(device: str) -> dict[str, str]:
    return {
        "device": provenance.device(device),
        "how": f"{torch.get_num_threads()} threads" if device == "cpu" else f"graph replay, driver {cuda_clock.driver()}",
        "versions": provenance.versions(),
        "commit": os.environ.get("BIGTRI_COMMIT") or provenance.commit(),  # a copy without .git is told its commit
        "command": provenance.command(),
    }


if __name__ == "__main__":
    sys.exit(main())
