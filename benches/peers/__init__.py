"""What a researcher could run instead of oitlab, each driven through its own fastest fair path.

An adapter is a module with `setup(arrays, mode)`, which keeps whatever the peer keeps between two frames
of one view (uploads, BVHs, compiled code) and returns a function that renders from scratch. That
function gives an (H, W, 3) or (H, W, 4) array, top row first, uint8 or float; its attribute `decode`, if
there is one, makes that linear RGB and is not timed; its attribute `info` goes into the results.
"""

PEERS = {
    "numba": {"a_buffer": "exact"},
    "mitsuba": {"all_hits": "exact"},
    "embree": {"all_hits": "exact"},
    "ppll": {"linked_lists": "exact"},
    "moderngl": {"wboit_mb7": "wboit", "wboit_mb10": "wboit", "wboit_alpha": "wboit", "painter": "painter"},
    "vtk": {"wboit": "wboit", "depth_peeling": "exact"},
    "pygfx": {"weighted_blend": "wboit", "weighted_solid": "wboit"},
}
"""Every adapter's modes, and what each is a rival of."""
