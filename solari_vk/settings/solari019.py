"""The settings of the separate passes of Solari (lighting=split), and the preset that restores Solari's behaviors."""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Any

from solari_vk.settings.field import setting

_solari019, _tiles, _di, _gi, _specular = (
    partial(setting, name) for name in ("solari019", "light_tiles", "restir_di", "restir_gi", "specular_gi")
)

# What differs from the defaults.
SOLARI: dict[str, Any] = {
    "lighting": "split", "layering": "fresnel_product", "world_cache_search_steps": 3,
    "world_cache_updates": "all", "world_cache_updates_per_pixel": 1e9, "world_cache_relight": False,
    "world_cache_leak_prevention": "finest", "world_cache_surfaces": "diffuse", "di_initial_visibility": True,
    "di_target": "matte", "gi_jacobian_limit": 1.2, "gi_visibility": "neighbor", "gi_refresh": False,
    "specular_termination": "camera_spread",
}  # fmt: skip


@dataclasses.dataclass
class SeparatePasses:
    """The fields of `Settings` that need lighting=split."""

    di: bool = _solari019(True, "Direct light (ReSTIR DI), with lighting=split.")
    gi: bool = _solari019(True, "Indirect light of diffuse surfaces (ReSTIR GI), with lighting=split.")
    specular: bool = _solari019(
        True, "Light by the specular lobe, with lighting=split: indirect light, and on smooth surfaces lights."
    )

    # ---- light tiles
    light_tile_count: int = _tiles(
        128, "Tiles per frame, with lighting=split. More: less correlation.", low=1, high=4096, rebuilds=True
    )
    light_tile_samples: int = _tiles(
        1024, "Light samples per tile. More: less correlation.", low=1, high=65536, rebuilds=True
    )

    # ---- ReSTIR DI (lighting=split)
    di_candidates: int = _di(8, "Light samples from which a pixel chooses. More: less noise.", low=1, high=1024)
    di_temporal: bool = _di(True, "Reuse samples of the previous frame.")
    di_spatial: bool = _di(True, "Reuse a sample of a neighbor.")
    di_initial_visibility: bool = _di(
        False, "Drop an occluded sample before reuse (Solari: on): less noise, but shadows grow halos.", rebuilds=True
    )
    di_target: str = _di(
        "brdf",
        "Choose lights by the whole BRDF, or as if all surfaces were diffuse (Solari).",
        choices=("brdf", "matte"),
    )
    di_confidence_cap: float = _di(
        20.0, "Largest confidence of history, in frames. More: less noise, more lag.", low=1, high=1e4
    )
    di_spatial_radius: float = _di(
        30.0, "Radius in pixels within which a neighbor is searched. More: fewer blotches.", low=1, high=1e4
    )

    # ---- ReSTIR GI
    gi_temporal: bool = _gi(True, "Reuse samples of the previous frame.")
    gi_spatial: bool = _gi(True, "Reuse a sample of a neighbor.")
    gi_confidence_cap: float = _gi(
        8.0, "Largest confidence of history, in frames. More: less noise, more lag.", low=1, high=1e4
    )
    gi_spatial_radius: float = _gi(
        30.0, "Radius in pixels within which a neighbor is searched. More: fewer blotches.", low=1, high=1e4
    )
    gi_jacobian_limit: float = _gi(
        10.0,
        "Largest Jacobian, or inverse of it, of a sample that is merged (Solari: 1.2). Less: more noise.",
        low=1,
        high=1e6,
    )
    gi_skip_smooth_metals: bool = _gi(True, "Trace no diffuse ray for smooth metals, which have no diffuse lobe.")
    gi_visibility: str = _gi(
        "both",
        "Which visibility a merge tests: that of each sample from both pixels; or only that of a neighbor's "
        "sample from this pixel, which loses light at the edges of indirect shadows (Solari).",
        choices=("both", "neighbor"),
    )
    gi_refresh: bool = _gi(
        True,
        "Read the light of the previous frame's samples from their cells again, so that GI follows changes of "
        "light as fast as the cache (Solari: off).",
    )

    # ---- specular GI
    specular_bounces: int = _specular(
        3, "Surfaces that a path may visit before it ends in the cache. More: truer, slower.", low=1, high=64
    )
    specular_reuse_roughness: float = _specular(
        0.4,
        "Roughness above which surfaces reuse the sample of ReSTIR GI, and up to which GI skips metals. More: "
        "sharper reflections, slower.",
        low=0,
        high=1,
    )
    specular_di_roughness: float = _specular(
        0.0225,
        "Roughness up to which specular rays find the lights; above it DI shades them. More: noisier where "
        "lights are small.",
        low=0,
        high=1,
    )
    specular_termination: str = _specular(
        "spread",
        "A path ends in the cache when its cone is wider than a cell. The cone begins at the surface that "
        "the pixel shows; or at the camera, with rays longer than sqrt(3) cells (Solari).",
        choices=("spread", "camera_spread"),
    )
