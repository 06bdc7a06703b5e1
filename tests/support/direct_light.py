"""Renderers that compute only direct light, by ReSTIR DI."""

from support.realtime import DIRECT, SPLIT, add_up, make_renderer

# Passes and settings for frames that contain only direct light.
ALONE = {"passes": DIRECT, **SPLIT, "gi": False, "specular": False, "world_cache": False}
QUICK = {**SPLIT, "gbuffer": "traced", "jitter": False, "light_tile_count": 32, "light_tile_samples": 256}


def direct_light(frame):
    """The reflected direct light of a frame, (h, w, 3)."""
    return add_up(frame, "di_diffuse", "di_specular")


def direct_renderer(device, scene, size, **settings):
    """A renderer with few light tiles whose samples lie at pixel centers."""
    return make_renderer(device, scene, size, passes=DIRECT, **(QUICK | settings))
