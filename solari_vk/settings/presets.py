"""Presets of the realtime lighting: what differs from the defaults of `Settings`.

`solari` restores the behaviors of Solari in Bevy 0.19 that settings restore. It isn't Solari itself: lights are chosen
by power, paths go on where the world cache has no value, young cells of it converge faster and stand for the point of a
random query, later bounces sample the whole BRDF, and GI's target has no albedo. docs/accuracy.md has the whole list.
"""

from __future__ import annotations

from typing import Any

from solari_vk.settings.solari019 import SOLARI

# Settings for single frames as paths give them. Measurements of the light itself take these.
RAW: dict[str, Any] = {"denoise": False, "antialiasing": False}
QUALITIES: dict[str, dict[str, Any]] = {
    "low": {
        "paths_bounces": 4, "paths_candidates": 4, "paths_later_candidates": 1, "paths_short_history_samples": 1,
        "world_cache_cell_size": 0.3, "world_cache_candidates": 8, "world_cache_update_cap": 10_000,
    },
    "medium": {},
    "high": {
        "paths_candidates": 16, "paths_later_candidates": 4, "world_cache_cell_size": 0.1,
        "world_cache_max_samples": 64,
    },
    "ultra": {
        "paths_candidates": 32, "paths_later_candidates": 8, "paths_short_history_samples": 4,
        "world_cache_cell_size": 0.05, "world_cache_max_samples": 128, "world_cache_update_cap": 200_000,
        "world_cache_updates_per_pixel": 1.0,
    },
    "solari": SOLARI,
}  # fmt: skip
