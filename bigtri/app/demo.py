"""``bigtri demo``: a courtyard of large textured triangles, drawn, explained and timed. Needs no download."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..check import stages
from ..ops import arguments
from ..ops.rasterize import rasterize
from ..reference.numerics import BACKGROUND, MAX_SIZE
from ..rendering import figure, views
from ..rendering.render import Buffers, render
from ..scene import Scene
from ..scene.camera import Camera
from ..scene.plan import plan_for
from ..study import courtyard

Progress = Callable[[str], None]
Timings = list[tuple[str, float, str]]  # (step, seconds, what came out)


def run(
    out: str | Path, resolution: tuple[int, int] = (1080, 1920), backend: str = "auto", progress: Progress = lambda line: None
) -> list[Path]:
    """Draw the demo and write its pictures.

    Args:
        out: a folder; made if it is not there.
        resolution: (height, width).
        backend: "auto", "reference" or "native".
        progress: gets a line before each longer step.

    Returns:
        The PNG files written.
    """
    chosen = arguments.choose_backend("demo", backend)
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    height, width = resolution
    progress("building the courtyard: meshes, textures, shadows")
    scene, camera = courtyard.courtyard(chosen), courtyard.camera()

    progress(f"{len(scene.triangles)} triangles, {len(scene.materials)} materials, {width}x{height}, backend {chosen}")
    progress(f"effects that the scene calls for: {plan_for(scene)}")
    progress("timing every step")
    image, buffers = render(scene, camera, resolution, backend=chosen, return_buffers=True)
    timings = _stage_timings(scene, buffers.positions, resolution, chosen)
    if chosen != "reference":  # once more, now that all is warm
        image, buffers = render(scene, camera, resolution, backend=chosen, return_buffers=True)
    timings += _render_timings(buffers.seconds)

    progress("drawing the pictures")
    smooth = chosen != "reference" and 2 * max(resolution) <= MAX_SIZE
    shaded = render(scene, camera, resolution, backend=chosen, supersample=2) if smooth else image
    pictures = {"shaded": shaded, **_explained(scene, camera, buffers, image, chosen)}
    paths = [figure.save(folder / f"{name}.png", picture) for name, picture in pictures.items()]
    progress("")
    progress(table(timings))
    return paths


def table(timings: Timings) -> str:
    """Step, milliseconds and result, one a line."""
    width = max(len(step) for step, _, _ in timings)
    return "\n".join(f"{step:<{width}}  {1e3 * seconds:9.2f} ms  {note}" for step, seconds, note in timings)


def largest_sail(scene: Scene, buffers: Buffers) -> int:
    """The sail that most pixels show: unlike the floor's and the walls', it is a whole triangle to look at."""
    sails = [i for i in scene.used_materials if scene.materials[i].name == "sail"]
    seen = buffers.visibility.triangle[buffers.visibility.triangle >= 0]
    pixels = np.bincount(seen, minlength=len(scene.triangles))
    return int(np.argmax(np.where(np.isin(scene.material, sails), pixels, -1)))


def _explained(
    scene: Scene, camera: Camera, buffers: Buffers, image: NDArray[np.uint8], backend: str
) -> dict[str, NDArray[np.uint8]]:
    height, width = image.shape[:2]
    drawn = (buffers.positions, scene.triangles, (height, width))
    assert buffers.normals is not None  # the courtyard has lights
    return {
        "normals": views.normals(buffers.normals, buffers.visibility),
        "depth": views.depth(buffers.visibility, camera),
        "ids": views.triangle_ids(buffers.visibility),
        "overdraw": views.overdraw(*drawn, backend=backend),
        "bins": views.bins(*drawn, backdrop=image, backend=backend),
        "bins_one_triangle": views.bins(*drawn, triangle=largest_sail(scene, buffers), backdrop=image, backend=backend),
    }


def _stage_timings(scene: Scene, positions: NDArray[np.float32], resolution: tuple[int, int], backend: str) -> Timings:
    """Each stage by itself: everything between two of them goes through memory, which the fused call avoids."""
    height, width = resolution
    timings: Timings = []

    def step(name: str, call: Callable[[], Any]) -> Any:
        # Once more where it is fast: the first call pays for memory that the second one finds.
        result, seconds = min((_timed(call) for _ in range(1 if backend == "reference" else 3)), key=lambda pair: pair[1])
        timings.append((name, seconds, ""))
        return result

    def note(text: str) -> None:
        timings[-1] = (*timings[-1][:2], text)

    records, _ = step("setup", lambda: stages.setup(positions, scene.triangles, height, width, backend=backend))
    note(f"{len(records.triangle)} records")
    candidates, kept, small = step("binning", lambda: stages.binning(records, backend=backend))
    queue = candidates[kept]
    note(f"{len(candidates)} candidate bins, {len(queue)} kept; {len(small)} small records")
    touched, full = step("tile mask", lambda: stages.tile_mask(records, queue, backend=backend))
    note(f"{views.count_bits(touched)} tiles touched, {views.count_bits(full)} of them fully covered")
    spans = step("scanline", lambda: stages.scanline(records, queue, touched, small, backend=backend))
    note(f"{len(spans)} spans")
    depth = step("depth", lambda: stages.depth(records, spans, backend=backend))
    note(f"{len(depth)} fragments")
    packed = step("visibility", lambda: stages.visibility(records, spans, depth, height, width, backend=backend))
    note(f"{int((packed != BACKGROUND).sum())} of {height * width} pixels covered")
    fused = step("rasterize, all of these fused", lambda: rasterize(positions, scene.triangles, resolution, backend=backend))
    note("the same bits" if np.array_equal(fused.packed, packed) else "DIFFERENT BITS: please report this")
    return timings


def _render_timings(seconds: dict[str, float]) -> Timings:
    notes = {"transform": "vertices to clip space", "draw": "the whole picture: rasterized, and each pixel finished, in one pass"}
    return [(name, seconds[name], note) for name, note in notes.items()]


def _timed(call: Callable[[], Any]) -> tuple[Any, float]:
    start = time.perf_counter()
    result = call()
    return result, time.perf_counter() - start
