"""The world cache: irradiance of surfaces in a hash map, averaged over frames; glsl/passes/world_cache/."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from solari_vk.gpu.frame.stages import IfUsed, Pass, Stage
from solari_vk.gpu.shaders.headers import constants
from solari_vk.passes.paths import HIT_QUADS, RAYS_QUADS, STATE_QUADS
from solari_vk.passes.rows import rows
from solari_vk.settings import Settings
from solari_vk.settings.layering import brdf_constants

FILL_ROUNDS = 3  # in which a cold cache is filled
FILL_SQUARE = 3  # width in pixels of the squares of which one pixel asks for cells in each of these rounds
BLOCK_SIZE = 16  # consecutive cells that one thread of a pass over the whole map handles
CELLS_OF_PIXEL = 16
FEWEST_CELLS = 1 << 16
FEWEST_CELLS_OF_WORLD = 1 << 12
LARGEST_CELL_BYTES = 16  # of a cell in one buffer
WAVES_APART = 5  # with traces_apart; the last one traces paths to their ends
PATHS_APART = 1 << 16  # room for paths of cells where a pass of its own traces their rays
PATH_BYTES = 16 * (STATE_QUADS + RAYS_QUADS + HIT_QUADS + 1)  # glsl/passes/world_cache/bindings.glsl
DISPATCH = "world_cache_dispatch"  # the workgroup counts of passes over active cells
FRAME_BUFFERS = (DISPATCH, "world_cache_counters")
CELL_BUFFERS = (
    "world_cache_checksums",
    "world_cache_life",
    "world_cache_irradiance",
    "world_cache_bounds",
    "world_cache_votes",
    "world_cache_points",
    "world_cache_first_points",
    "world_cache_luminance_deltas",
    "world_cache_active_cells",
    "world_cache_samples",
)


def parts(worlds: int) -> int:
    """The number of parts of the map, of which each world of a batch has one."""
    # A power of two, as the number of cells is, so that the parts are equally large.
    return 1 << (worlds - 1).bit_length()


def most_worlds(largest_buffer: int) -> int:
    """The number of worlds for which buffers of this many bytes have cells."""
    cells = largest_buffer // LARGEST_CELL_BYTES
    return 1 << (cells // FEWEST_CELLS_OF_WORLD).bit_length() - 1


def paths_stage(
    size: tuple[int, int], settings: Settings, worlds: int = 1, apart_bytes: int = 0, fills: bool = True
) -> Stage:
    """The cache with cells that are sampled by paths; fewer cells for small pictures, more for many worlds.

    apart_bytes: what `paths.apart_bytes` has returned. fills: whether a cold cache is filled before paths ask it, for
    the surfaces that pixels without a history show.
    """
    # Paths of a small picture ask for few cells, and passes over the whole map take time with its size.
    cells = max(1 << (CELLS_OF_PIXEL * size[0] * size[1] - 1).bit_length(), FEWEST_CELLS)
    brdf: dict[str, Any] = brdf_constants(settings)

    def sampled(waves: int) -> list[Pass]:
        found = [Pass("world_cache/sample", indirect=DISPATCH, constants=brdf | {"traces_apart": apart_bytes > 0})]
        for wave in range(waves if apart_bytes else 0):
            last = {"is_last_wave": wave == waves - 1}
            found += [
                Pass("world_cache/trace", indirect=DISPATCH, constants={"is_first_wave": wave == 0}),
                Pass("world_cache/arrive", indirect=DISPATCH, constants=brdf | last),
            ]
        return found

    fewest = FEWEST_CELLS_OF_WORLD * parts(worlds) if worlds > 1 else 0
    cells = max(min(settings.world_cache_cells, cells), fewest)
    # In rounds of the fill one wave traces paths to their ends, since each pass takes time in frames that skip them.
    made = stage(cells, sampled(WAVES_APART), _fill(size, sampled(1)) if fills else [])
    # Worlds have few cells each, which are nearly all updated while lights stay: as many as their pixels allow.
    updates = 1.1 * settings.world_cache_updates_per_pixel * size[0] * size[1] if worlds > 1 else 0
    room = max(PATHS_APART, int(updates))
    paths = {"world_cache_paths": max(min(cells, room, apart_bytes // PATH_BYTES), 1)}
    return replace(made, buffers={**made.buffers, **paths})


def _fill(size: tuple[int, int], samples: Sequence[Pass]) -> list[Pass]:
    """The rounds that fill a cold cache, and the begin of the last round, which is that of all frames. samples: the
    passes that sample the light of cells."""
    rounds = {"fill_rounds": FILL_ROUNDS}
    squares = tuple(-(-side // FILL_SQUARE) for side in size)
    begin = Pass("world_cache/begin_round", threads=1, constants=rounds)
    request = Pass("world_cache/request", threads=squares, constants=rounds)
    take_points, blend = (Pass(f"world_cache/{name}", indirect=DISPATCH) for name in ("take_points", "blend"))
    return [*FILL_ROUNDS * [request, begin, take_points, *samples, blend], begin]


def stage(cells: int, samples: Sequence[Pass], fill: Sequence[Pass] = ()) -> Stage:
    """A map of `cells` cells with 88 bytes each. samples: the passes that sample the light of cells. fill: what `_fill`
    returns.

    The buffer world_cache_counters holds the numbers of active cells, of updated cells (after a fill those of its last
    round), and of queries that found no free entry in the map. As long as the last is 0, one seed gives one picture;
    otherwise the entries go to the queries that happen to be first.
    Inputs: `*_table`, `brdf_averages`; to fill the cache `camera_media`, `depth`, `gbuffer*`, `denoise_guides` and
    `denoise_diffuse`; for the separate passes `light_tile*`. Outputs: `world_cache_*`.
    """
    return Stage(
        "world_cache",
        buffers={
            **dict.fromkeys(CELL_BUFFERS, cells),
            **dict.fromkeys(FRAME_BUFFERS, 1),
            "world_cache_blocks": cells // BLOCK_SIZE,
            "world_cache_worlds": IfUsed(cells),
        },
        passes=[
            # The cells that live, then where the active ones of each block begin in their list, then the list.
            Pass("world_cache/decay", threads=rows(cells // BLOCK_SIZE)),
            Pass("world_cache/scan", threads=1, constants={"fill_rounds": FILL_ROUNDS if fill else 0}),
            Pass("world_cache/scatter", threads=rows(cells // BLOCK_SIZE)),
            # A cold cache is filled first; all other frames skip these rounds, which have no cells then.
            *fill,
            *samples,
            Pass("world_cache/blend", indirect=DISPATCH),
        ],
    )


def glsl_header() -> str:
    """The sizes of a block and of a square, by the same names."""
    return constants(BLOCK_SIZE=BLOCK_SIZE, FILL_SQUARE=FILL_SQUARE)
