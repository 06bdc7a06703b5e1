"""Presets of the realtime lighting: what differs from the defaults of `Settings`."""

from __future__ import annotations

from typing import Any

QUALITIES: dict[str, dict[str, Any]] = {
    "low": {
        "di_candidates": 4,
        "world_cache_cell_size": 0.3,
        "world_cache_candidates": 8,
        "world_cache_update_cap": 10_000,
        "specular_bounces": 2,
    },
    "medium": {},
    "high": {"di_candidates": 16, "world_cache_cell_size": 0.1, "world_cache_max_samples": 64, "specular_bounces": 4},
    "ultra": {
        "di_candidates": 32,
        "world_cache_cell_size": 0.05,
        "world_cache_max_samples": 128,
        "world_cache_update_cap": 200_000,
        "specular_bounces": 8,
        "gi_confidence_cap": 16.0,
    },
}
