"""OpenGL through moderngl without a window (Mesa's llvmpipe where there is no GPU), 8 bits per channel.

wboit_mb7 and wboit_mb10 are weighted blended transparency with the paper's equations 7 and 10;
wboit_alpha has no depth weight. Their sums are half floats, as in the paper. painter sorts the triangles
by centroid depth in NumPy for every frame and blends them in that order.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import moderngl as gl
import numpy as np

GEOMETRY = """#version 330
uniform mat4 to_eye, to_clip;
in vec3 corner;
in vec4 rgba;
flat out vec4 surface;
out float depth;
void main() {
    vec4 eye = to_eye * vec4(corner, 1.0);
    surface = rgba;
    depth = -eye.z;
    gl_Position = to_clip * eye;
}"""
SCREEN = """#version 330
void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0); }"""
OVER = """#version 330
flat in vec4 surface;
out vec4 color;
void main() { color = surface; }"""
SUMS = """#version 330
flat in vec4 surface;
in float depth;
layout(location = 0) out vec4 color_and_revealage;
layout(location = 1) out float normalization;
void main() {
    float w = surface.a * (WEIGHT);
    color_and_revealage = vec4(w * surface.rgb, surface.a);
    normalization = w;
}"""
COMPOSITE = """#version 330
uniform sampler2D color_and_revealage, normalization;
uniform vec3 behind;
out vec4 color;
void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec4 sums = texelFetch(color_and_revealage, at, 0);
    float w = texelFetch(normalization, at, 0).x;
    color = vec4(sums.rgb / max(w, 1e-5) * (1.0 - sums.a) + behind * sums.a, 1.0);
}"""
WEIGHTS = {
    "wboit_mb7": "clamp(10.0 / (1e-5 + pow(depth / 5.0, 2.0) + pow(depth / 200.0, 6.0)), 1e-2, 3e3)",
    "wboit_mb10": "max(1e-2, 3e3 * pow(1.0 - gl_FragCoord.z, 3.0))",
    "wboit_alpha": "1.0",
}


class Context:
    """What all OpenGL peers share: the uploaded mesh, the 8-bit target and its way back to NumPy."""

    def __init__(self, arrays: Any, fragment_shader: str, version: int = 330) -> None:
        self.gl = gl.create_standalone_context(backend="egl", require=version)
        self.size = arrays.width, arrays.height
        self.vertices, self.faces, colors = arrays.for_gpu()
        program = self.gl.program(GEOMETRY.replace("330", str(version)), fragment_shader)
        program["to_eye"].write(arrays.view().T.astype("f4").tobytes())
        program["to_clip"].write(arrays.projection().T.astype("f4").tobytes())
        self.indices = self.gl.buffer(np.ascontiguousarray(self.faces, np.int32))
        buffers = [(self.gl.buffer(np.ascontiguousarray(self.vertices)), "3f", "corner"),
                   (self.gl.buffer(np.ascontiguousarray(colors)), "4f", "rgba")]  # fmt: skip
        self.mesh = self.gl.vertex_array(program, buffers, index_buffer=self.indices)
        self.target = self.gl.framebuffer([self.gl.texture(self.size, 4)])
        self.info = {"version": gl.__version__, "renderer": self.gl.info["GL_RENDERER"]}

    def screen(self, fragment_shader: str, version: int = 330) -> Any:
        """A triangle over the whole screen."""
        return self.gl.vertex_array(self.gl.program(SCREEN.replace("330", str(version)), fragment_shader), [])

    def read(self) -> Any:
        """The target as an (H, W, 4) array, top row first."""
        pixels = np.frombuffer(self.target.read(components=4), np.uint8)
        return pixels.reshape(self.size[1], self.size[0], 4)[::-1]


def setup(arrays: Any, mode: str) -> Callable[[], Any]:
    return _painter(arrays) if mode == "painter" else _wboit(arrays, WEIGHTS[mode])


def _painter(arrays: Any) -> Callable[[], Any]:
    context = Context(arrays, OVER)
    background = arrays.background.tolist()
    toward_eye = arrays.view()[2, :3].astype(np.float32)

    def frame() -> Any:
        rank = (context.vertices @ toward_eye)[context.faces].sum(axis=1)
        context.indices.write(np.ascontiguousarray(context.faces[np.argsort(rank)], np.int32))
        context.target.use()
        context.target.clear(*background, 1.0)
        context.gl.enable_only(gl.BLEND)
        context.gl.blend_func = gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA
        context.mesh.render()
        return context.read()

    frame.info = context.info  # type: ignore[attr-defined]
    return frame


def _wboit(arrays: Any, weight: str) -> Callable[[], Any]:
    context = Context(arrays, SUMS.replace("WEIGHT", weight))
    textures = [context.gl.texture(context.size, channels, dtype="f2") for channels in (4, 1)]
    sums = context.gl.framebuffer(textures)
    screen = context.screen(COMPOSITE)
    screen.program["behind"] = tuple(arrays.background.tolist())
    for unit, name in enumerate(("color_and_revealage", "normalization")):
        screen.program[name] = unit
        textures[unit].use(unit)

    def frame() -> Any:
        sums.use()
        sums.clear(0.0, 0.0, 0.0, 1.0)
        context.gl.enable_only(gl.BLEND)
        # One blend function serves both targets: everything adds up, only the alpha channel multiplies.
        context.gl.blend_func = gl.ONE, gl.ONE, gl.ZERO, gl.ONE_MINUS_SRC_ALPHA
        context.mesh.render()
        context.target.use()
        context.gl.enable_only(gl.NOTHING)
        screen.render(vertices=3)
        return context.read()

    frame.info = context.info  # type: ignore[attr-defined]
    return frame
