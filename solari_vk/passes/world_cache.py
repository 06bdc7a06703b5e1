"""The world cache: irradiance of surfaces in a hash map, averaged over frames; glsl/passes/world_cache/."""

from __future__ import annotations

from solari_vk.gpu.frame.frame import Pass, Stage
from solari_vk.passes import brdf_table
from solari_vk.settings import Settings

ROW = 65536  # threads in a row of a dispatch, of passes/world_cache/threads.glsl
BLOCK = 16  # cells that a thread of a pass over the whole map looks after
FRAME_BUFFERS = ("world_cache_dispatch", "world_cache_counters")
CELL_BUFFERS = (
    "world_cache_checksums",
    "world_cache_life",
    "world_cache_irradiance",
    "world_cache_bounds",
    "world_cache_votes",
    "world_cache_points",
    "world_cache_luminance_deltas",
    "world_cache_active_cells",
    "world_cache_samples",
)


def stage(size: tuple[int, int], settings: Settings) -> Stage:
    """A map of settings.world_cache_cells, whatever the picture's size: 80 bytes a cell.

    The buffer world_cache_counters tells of each frame how many cells are active, how many of them were updated, and
    how many queries found no place in the map. One seed gives one picture as long as there are no such failures:
    who comes first is who gets the last place.
    """
    cells = settings.world_cache_cells
    brdf = brdf_table.constants(settings)
    indirect = "world_cache_dispatch"
    return Stage(
        "world_cache",
        buffers={
            **dict.fromkeys(CELL_BUFFERS, cells),
            **dict.fromkeys(FRAME_BUFFERS, 1),
            "world_cache_blocks": cells // BLOCK,
        },
        passes=[
            Pass("world_cache/decay", threads=_rows(cells // BLOCK)),
            Pass("world_cache/scan", threads=1),
            Pass("world_cache/scatter", threads=_rows(cells // BLOCK)),
            Pass("world_cache/sample_direct", indirect=indirect),
            Pass("world_cache/sample_indirect", indirect=indirect, constants=brdf),
            Pass("world_cache/blend", indirect=indirect),
        ],
    )


def _rows(threads: int) -> tuple[int, int]:
    """For a power of two, so that no thread is left over."""
    return min(threads, ROW), max(threads // ROW, 1)
