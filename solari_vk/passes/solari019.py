"""Solari of Bevy 0.19: separate passes for direct, indirect and specular light (the setting lighting=split).

solari_vk/settings/solari019.py has their settings and the preset, glsl/passes/solari019/ the shaders. Sources: the
posts on Solari in Bevy 0.17, 0.18 and 0.19.
"""

from __future__ import annotations

from solari_vk.gpu.frame.stages import Aliased, Pass, Stage
from solari_vk.passes import world_cache
from solari_vk.settings import Settings
from solari_vk.settings.layering import brdf_constants

OUTPUTS = ("di_diffuse", "di_specular", "gi_diffuse", "specular_gi")  # parts of the radiance


def stages(size: tuple[int, int], settings: Settings) -> list[Stage]:
    """The stages between the guides and the picture, in order."""
    return [
        light_tiles(settings),
        cache(settings),
        restir_di(size, settings),
        restir_gi(size, settings),
        specular_gi(size, settings),
        demodulate(size, settings),
    ]


def light_tiles(settings: Settings) -> Stage:
    """Light samples drawn ahead for all passes that choose among them: all tiles, one after the other, their samples,
    and these resolved and packed. Outputs: `light_tile_samples`, `light_tiles`."""
    # Wyman and Panteleev, "Rearchitecting Spatiotemporal Resampling for Production" (2021), section 5: threads of a
    # workgroup choose among the samples of one tile, which lie side by side in memory.
    count = settings.light_tile_count * settings.light_tile_samples
    constants = {"samples_each": settings.light_tile_samples}
    return Stage(
        "light_tiles",
        buffers={"light_tile_samples": count, "light_tiles": count},
        passes=[Pass("solari019/light_tiles/generate", threads=count, constants=constants)],
    )


def cache(settings: Settings) -> Stage:
    """The world cache with a pass for the direct light of cells and one for their indirect light."""
    indirect = world_cache.DISPATCH
    return world_cache.stage(
        settings.world_cache_cells,
        [
            Pass("solari019/world_cache/sample_direct", indirect=indirect),
            Pass("solari019/world_cache/sample_indirect", indirect=indirect, constants=brdf_constants(settings)),
        ],
    )


def restir_di(size: tuple[int, int], settings: Settings) -> Stage:
    """The light that surfaces reflect straight from lights: the reservoirs after each half, and the radiance by the
    diffuse and the specular lobe.

    Inputs: `camera_media`, `gbuffer*`, `depth`, `motion_vectors`, `previous_*`, `light_tile*`, `*_table`,
    `brdf_averages`.
    Outputs: `di_diffuse`, `di_specular`; for debug views `di_reservoirs`, `di_outcomes`.
    """
    pixels = size[0] * size[1]
    # ReSTIR DI: Bitterli et al., "Spatiotemporal Reservoir Resampling for Real-Time Ray Tracing with Dynamic Direct
    # Lighting" (2020).
    # Two shaders rather than a constant: a shadow ray that is never traced would take time to compile all the same.
    initial = "visible_initial_and_temporal" if settings.di_initial_visibility else "initial_and_temporal"
    names = ("di_reservoirs", "di_temporal_reservoirs", "di_outcomes", "di_diffuse", "di_specular")
    return Stage(
        "restir_di",
        buffers=dict.fromkeys(names, pixels),
        passes=[
            Pass(f"solari019/restir_di/{initial}", threads=size, constants={"lambertian_surfaces": settings.lambert}),
            Pass("solari019/restir_di/spatial_and_shade", threads=size, constants=brdf_constants(settings)),
        ],
    )


def restir_gi(size: tuple[int, int], settings: Settings) -> Stage:
    """Indirect light of diffuse surfaces: the reservoirs before and after spatial reuse, and the radiance.

    Inputs: `camera_media`, `gbuffer*`, `depth`, `motion_vectors`, `previous_*`, `world_cache_*`, `*_table`,
    `brdf_averages`.
    Outputs: `gi_diffuse`, `gi_reservoirs`, and new cells, `world_cache_*`.
    """
    # ReSTIR GI: Ouyang et al., "ReSTIR GI: Path Resampling for Real-Time Path Tracing" (2021). Temporal reuse is a pass
    # of its own, because rays are fast where few values live while they are traced.
    brdf = brdf_constants(settings)
    return Stage(
        "restir_gi",
        buffers=dict.fromkeys(("gi_temporal_reservoirs", "gi_reservoirs", "gi_diffuse"), size[0] * size[1]),
        passes=[
            Pass("solari019/restir_gi/initial", threads=size, constants=brdf),
            Pass("solari019/restir_gi/temporal", threads=size),
            Pass("solari019/restir_gi/spatial_and_shade", threads=size, constants=brdf),
        ],
    )


def specular_gi(size: tuple[int, int], settings: Settings) -> Stage:
    """Mirror and glossy reflections: the radiance specular_gi, light by the specular lobe that DI doesn't shade.

    Inputs: `camera_media`, `gbuffer*`, `depth`, `gi_reservoirs`, `world_cache_*`, `*_table`, `brdf_averages`.
    Outputs: `specular_gi`, `specular_gi_distances`, and new cells, `world_cache_*`.
    """
    return Stage(
        "specular_gi",
        buffers=dict.fromkeys(("specular_gi", "specular_gi_distances"), size[0] * size[1]),
        passes=[Pass("solari019/specular_gi/trace", threads=size, constants=brdf_constants(settings))],
    )


def demodulate(size: tuple[int, int], settings: Settings) -> Stage:
    """The light of the diffuse and of the specular lobe, demodulated, each with a distance in meters, as the denoiser
    takes them.

    Inputs: `gbuffer*`, `depth`, `di_diffuse`, `di_specular`, `gi_diffuse`, `specular_gi*`, `*_table`,
    `brdf_averages`. Outputs: `paths_diffuse`, `paths_specular`.
    """
    pixels = size[0] * size[1]
    return Stage(
        "demodulate",
        # The reservoirs have been read by then.
        buffers={"paths_diffuse": pixels, "paths_specular": Aliased("gi_temporal_reservoirs", pixels)},
        passes=[Pass("solari019/demodulate", threads=size, constants=brdf_constants(settings))],
    )
