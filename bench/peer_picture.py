"""llvmpipe as a peer of `render`: the same meshes, textures, lights and camera by shaders, on the same cores.

A frame clears, draws the triangles of each material with a shader that holds what the material asks for and nothing else, and
ends with glFinish. Vertices and textures are uploaded once, nothing is read back while the clock runs. Targets: sRGB codes of 8
bits (SRGB8_ALPHA8, written through GL_FRAMEBUFFER_SRGB) and a 32-bit float depth buffer. sRGB textures are decoded by OpenGL.

The vertex shader multiplies by the camera's matrix, in float32, where bigtri rounds once; so a vertex may land on the
neighbouring sub-pixel. Its rows are mirrored as in peer_llvmpipe.py.
"""

from __future__ import annotations

import json
import sys
import time
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from peer_llvmpipe import Process, float_depth, opengl, worker

if TYPE_CHECKING:  # the worker needs neither bigtri nor torch
    from bigtri import Camera, Scene

FRAMEBUFFER_SRGB, SRGB8_ALPHA8 = 0x8DB9, 0x8C43


# --- the driver's side


class LlvmpipePictures(Process):
    """What draws pictures."""

    def __init__(self, threads: int) -> None:
        super().__init__(__file__, threads)

    def load(self, scene: Scene, camera: Camera, width: int, height: int) -> None:
        """Uploads a scene and where it is seen from."""
        from bigtri.scene.normals import face_normals

        arrays: dict[str, NDArray[Any]] = {
            "positions": scene.positions,
            "triangles": scene.triangles,
            "material": scene.material,
            "face_normals": face_normals(scene.positions, scene.triangles),
            "matrix": camera.matrix(width / height, scene.origin).astype(np.float32),
        }
        arrays |= {name: a for name in ("normals", "uvs", "colors") if (a := getattr(scene, name)) is not None}
        arrays |= {f"texture{i}": m.texture for i, m in enumerate(scene.materials) if m.texture is not None}
        materials = [
            {
                "base": [float(c) for c in m.base_color],
                "colored": bool(m.vertex_colors),
                "smooth": bool(m.smooth),
                "two_sided": bool(m.two_sided),
                "nearest": m.filter == "nearest",
                "repeat": m.wrap == "repeat",
            }
            for m in scene.materials
        ]
        about = {
            "materials": materials,
            "directions": [[float(c) for c in light.direction] for light in scene.lights],
            "colors": [[float(c) for c in light.color] for light in scene.lights],
            "ambient": [float(c) for c in scene.ambient],
            "background": [float(c) for c in scene.background[0]],
        }
        self.load_arrays(arrays, width=width, height=height, about=json.dumps(about))

    def picture(self) -> NDArray[np.uint8]:
        """The last frame, uint8 [H, W, 3], row 0 on top."""
        return self.result()


# --- the worker's side

VERTEX = """#version 330
uniform mat4 matrix;
in vec3 position;
#ifdef TEXTURED
in vec2 uv; out vec2 at;
#endif
#ifdef COLORED
in vec3 color; out vec3 tint;
#endif
#ifdef LIGHTS
in vec3 normal; NORMAL out vec3 across;
#endif
void main() {
  vec4 p = matrix * vec4(position, 1.0);
  gl_Position = vec4(p.x, -p.y, p.z, p.w);
#ifdef TEXTURED
  at = uv;
#endif
#ifdef COLORED
  tint = color;
#endif
#ifdef LIGHTS
  across = normal;
#endif
}"""

FRAGMENT = """#version 330
uniform vec3 base, ambient;
#ifdef TEXTURED
uniform sampler2D image; in vec2 at;
#endif
#ifdef COLORED
in vec3 tint;
#endif
#ifdef LIGHTS
uniform vec3 directions[LIGHTS], colors[LIGHTS]; NORMAL in vec3 across;
#endif
out vec4 picture;
void main() {
  vec3 albedo = base, light = ambient;
#ifdef TEXTURED
  albedo *= texture(image, at).rgb;
#endif
#ifdef COLORED
  albedo *= tint;
#endif
#ifdef LIGHTS
  vec3 n = normalize(across);
#ifdef TWO_SIDED
  if (!gl_FrontFacing) n = -n;
#endif
  for (int i = 0; i < LIGHTS; ++i) light += colors[i] * max(dot(n, directions[i]), 0.0);
#endif
  picture = vec4(albedo * light, 1.0);
}"""


class Picture:
    """One scene on one pair of targets; `draw` is a whole frame."""

    def __init__(self, context: Any, arrays: dict[str, NDArray[Any]], width: int, height: int, about: dict[str, Any]) -> None:
        self.context, self.size, self.about = context, (width, height), about
        self.draws = [
            self._draw_of(arrays, number) for number in range(len(about["materials"])) if (arrays["material"] == number).any()
        ]
        self.color = context.texture(self.size, 4, internal_format=SRGB8_ALPHA8)
        self.target = context.framebuffer([self.color], float_depth(context, self.size))
        self.target.use()
        context.viewport = (0, 0, width, height)
        context.enable_only(context.DEPTH_TEST)
        context.enable_direct(FRAMEBUFFER_SRGB)
        context.depth_func, context.front_face = "<", "cw"  # as the mirrored rows have it
        self.finish = opengl("glFinish")

    def draw(self) -> float:
        """A frame: its milliseconds."""
        start = time.perf_counter()
        self.target.clear(*self.about["background"], depth=1.0)
        for vertices, texture in self.draws:
            if texture:
                texture.use(0)
            vertices.render()
        self.finish()
        return (time.perf_counter() - start) * 1e3

    def result(self) -> NDArray[np.uint8]:
        return np.frombuffer(self.color.read(), np.uint8).reshape(self.size[1], self.size[0], 4)[..., :3]

    def _draw_of(self, arrays: dict[str, NDArray[Any]], number: int) -> tuple[Any, Any]:
        """Vertices with their shader, and the texture, of a material."""
        material, lights = self.about["materials"][number], len(self.about["directions"])
        textured = "uvs" in arrays and f"texture{number}" in arrays
        smooth = "normals" in arrays and material["smooth"]
        colored = "colors" in arrays and material["colored"]
        defines = {"TEXTURED": textured, "COLORED": colored, "TWO_SIDED": material["two_sided"]}
        head = "".join(f"\n#define {name}" for name, on in defines.items() if on) + f"\n#define NORMAL {'' if smooth else 'flat'}"
        head += f"\n#define LIGHTS {lights}" if lights else ""
        vertex, fragment = (source.replace("#version 330", "#version 330" + head) for source in (VERTEX, FRAGMENT))
        program = self.context.program(vertex_shader=vertex, fragment_shader=fragment)
        values = {"matrix": arrays["matrix"].T, "base": material["base"], "ambient": self.about["ambient"]}
        if lights:
            values |= {"directions": self.about["directions"], "colors": self.about["colors"]}
        for name, value in values.items():
            program[name].write(np.ascontiguousarray(value, np.float32).tobytes())

        mine = arrays["material"] == number
        triangles = arrays["triangles"][mine]
        # A flat surface shares no vertices, as each has the normal of one triangle.
        index = np.arange(triangles.size, dtype=np.int32) if not smooth else None
        used = triangles.reshape(-1) if not smooth else slice(None)
        normals = np.repeat(arrays["face_normals"][mine], 3, axis=0) if not smooth else arrays["normals"]
        streams = [("3f", "position", arrays["positions"][used])]
        streams += [("2f", "uv", arrays["uvs"][used])] if textured else []
        streams += [("3f", "color", arrays["colors"][used])] if colored else []
        streams += [("3f", "normal", normals)] if lights else []
        content = [(self.context.buffer(np.ascontiguousarray(a, np.float32).tobytes()), form, name) for form, name, a in streams]
        order = self.context.buffer((triangles if index is None else index).astype(np.int32).tobytes())
        texture = self._texture(arrays[f"texture{number}"], material) if textured else None
        return self.context.vertex_array(program, content, index_buffer=order), texture

    def _texture(self, texels: NDArray[Any], material: dict[str, Any]) -> Any:
        """Four channels, which are faster than three; row 0 at the bottom."""
        height, width = texels.shape[:2]
        if texels.dtype == np.uint16:
            raise ValueError("no textures of 16-bit sRGB codes in OpenGL")
        coded = texels.dtype == np.uint8
        padded = np.full((height, width, 4), 255 if coded else 1, texels.dtype)
        padded[..., :3] = texels[::-1]
        options = {"dtype": "f1", "internal_format": SRGB8_ALPHA8} if coded else {"dtype": "f4"}
        texture = self.context.texture((width, height), 4, padded.tobytes(), **options)
        texture.filter = 2 * (self.context.NEAREST if material["nearest"] else self.context.LINEAR,)
        texture.repeat_x = texture.repeat_y = material["repeat"]
        return texture


if __name__ == "__main__" and "--worker" in sys.argv[1:]:
    worker(lambda context, arrays, order: Picture(context, arrays, order["width"], order["height"], json.loads(order["about"])))
