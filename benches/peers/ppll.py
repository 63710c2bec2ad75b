"""Exact per-pixel linked lists in OpenGL 4.5 (moderngl), 8 bits per channel.

The image is cut into as many bands of rows as it takes for the nodes of one band to fit their buffers. A
pixel has at most 512 nodes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import moderngl as gl
import numpy as np

from peers.moderngl import Context

CAPACITY = 1 << 24
MAX_LAYERS = 512

STORAGE = """#version 450
layout(r32ui, binding = 0) uniform uimage2D first;
layout(std430, binding = 0) buffer Used { uint used; };
layout(std430, binding = 1) buffer Links { uint link[]; };
layout(std430, binding = 2) buffer Nodes { uvec2 node[]; };  // depth bits, RGBA8
"""
BUILD = f"""{STORAGE}
flat in vec4 surface;
in float depth;
void main() {{
    uint mine = 1u + atomicAdd(used, 1u);
    if (mine < {CAPACITY}u) {{
        node[mine] = uvec2(floatBitsToUint(depth), packUnorm4x8(surface));
        link[mine] = imageAtomicExchange(first, ivec2(gl_FragCoord.xy), mine);
    }}
}}"""
# The sort leaves its loop by a break: Mesa 22.3 miscompiles the test "at > 0 && ..." in the loop's head.
RESOLVE = f"""{STORAGE}
uniform vec3 behind;
out vec4 color;
void main() {{
    ivec2 here = ivec2(gl_FragCoord.xy);
    uvec2 nodes[{MAX_LAYERS}];
    int count = 0;
    for (uint n = imageLoad(first, here).x; n != 0u && count < {MAX_LAYERS}; n = link[n]) {{
        uvec2 next = node[n];
        int at = count++;
        while (at > 0) {{
            if (nodes[at - 1].x >= next.x) break;  // positive floats order as their bits
            nodes[at] = nodes[at - 1];
            at--;
        }}
        nodes[at] = next;
    }}
    imageStore(first, here, uvec4(0u));
    vec3 light = behind;
    for (int k = 0; k < count; k++) {{
        vec4 layer = unpackUnorm4x8(nodes[k].y);
        light += layer.a * (layer.rgb - light);
    }}
    color = vec4(light, 1.0);
}}"""


def setup(arrays: Any, mode: str) -> Callable[[], Any]:
    context = Context(arrays, BUILD, 450)
    screen = context.screen(RESOLVE, 450)
    screen.program["behind"] = tuple(arrays.background.tolist())
    first = context.gl.texture(context.size, 1, dtype="u4", data=bytes(4 * arrays.width * arrays.height))
    first.bind_to_image(0)
    used, links, nodes = (context.gl.buffer(reserve=size) for size in (4, 4 * CAPACITY, 8 * CAPACITY))
    for binding, buffer in enumerate((used, links, nodes)):
        buffer.bind_to_storage_buffer(binding)
    # Blending that keeps the target: without it Mesa 22.3 discards fragments that later ones cover.
    context.gl.blend_func = gl.ZERO, gl.ONE

    def band(y: int, rows: int) -> bool:
        """Draw some rows; false when their fragments did not fit."""
        context.target.scissor = 0, y, arrays.width, rows
        used.write(bytes(4))
        context.gl.enable_only(gl.BLEND)
        context.mesh.render()
        context.gl.memory_barrier()
        fragments = int(np.frombuffer(used.read(), np.uint32)[0])
        context.gl.enable_only(gl.NOTHING)
        screen.render(vertices=3)
        context.gl.memory_barrier()
        return fragments < CAPACITY - 1

    def frame() -> Any:
        context.target.use()
        rows = -(-arrays.height // frame.info["bands"])  # type: ignore[attr-defined]
        if not all([band(y, min(rows, arrays.height - y)) for y in range(0, arrays.height, rows)]):
            frame.info["bands"] *= 2  # type: ignore[attr-defined]
            return frame()
        return context.read()

    frame.info = {**context.info, "bands": 1}  # type: ignore[attr-defined]
    return frame
