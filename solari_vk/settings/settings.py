"""What can be set about the realtime lighting, with the meaning of each: more of it, less of it."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from solari_vk.errors import SolariError
from solari_vk.settings.field import Field, setting
from solari_vk.settings.layering import LAYERINGS
from solari_vk.settings.presets import QUALITIES as QUALITIES


@dataclass
class Settings:
    """The constants of the realtime passes; assigning checks the value and takes effect with the next frame.

    What a material is, such as the roughness of a mirror, is none: the path tracer shares it.
    Defaults are Solari 0.19's unless said otherwise. Choices other than the first of a field are older or other
    behaviours, kept for comparison. Raises SolariError for values out of range.
    """

    # ---- what is computed
    di: bool = setting(True, "frame", "Direct light (ReSTIR DI).")
    gi: bool = setting(True, "frame", "Indirect light of diffuse surfaces (ReSTIR GI).")
    specular: bool = setting(True, "frame", "What specular lobes reflect: indirect light, and in smooth ones lights.")
    world_cache: bool = setting(True, "frame", "The radiance cache; without it indirect light is one bounce of direct.")
    jitter: bool = setting(True, "frame", "Move samples within the pixel from frame to frame, for antialiasing.")
    gbuffer: str = setting(
        "raster", "frame", "How pixels find their surface.", choices=("raster", "traced"), rebuilds=True
    )
    frustum_culling: bool = setting(True, "frame", "Raster draws only what may be in view.", rebuilds=True)
    occlusion_culling: bool = setting(
        True, "frame", "Raster draws only what isn't behind what was visible last frame.", rebuilds=True
    )
    layering: str = setting(
        "conserving", "frame", "How the specular layer dims the diffuse one below it: so that all energy is kept, or "
        "by a product of Fresnel terms, which loses some (Solari).", choices=LAYERINGS, rebuilds=True
    )  # fmt: skip
    pure_metal: float = setting(
        0.9999, "frame", "Metallic above which smooth surfaces take no GI, or are mirrors alone. Less: faster, untrue.",
        low=0, high=1
    )  # fmt: skip
    lambert: bool = setting(False, "frame", "Every surface is plain Lambert, for closed forms.", rebuilds=True)

    # ---- reuse, of DI and GI
    similarity_plane_distance: float = setting(
        0.003, "reuse", "Share of the view depth that two pixels' planes may lie apart to share samples. More: less "
        "noise at small features, more blur of contact shadows.", low=1e-6, high=1.0
    )  # fmt: skip
    similarity_normal_cosine: float = setting(
        0.0, "reuse", "Cosine of the widest angle between two normals. More: less blur, more noise.", low=-1, high=1
    )
    permutation_sampling: bool = setting(True, "reuse", "Shuffle pixels among neighbours over time: less correlation.")
    spatial_tries: int = setting(
        5, "reuse", "Attempts to find a similar neighbour. More: less noise, slower.", low=1, high=32
    )
    spatial_radius_halving: bool = setting(True, "reuse", "Halve the radius after each failed attempt (0.19).")

    # ---- light tiles
    light_tile_count: int = setting(
        128, "light_tiles", "Tiles a frame. More: less correlation.", low=1, high=4096, rebuilds=True
    )
    light_tile_samples: int = setting(
        1024, "light_tiles", "Light samples a tile. More: less correlation.", low=1, high=65536, rebuilds=True
    )

    # ---- world cache
    world_cache_cells: int = setting(
        1 << 20, "world_cache", "Cells of the hash map, a power of two. Less: less memory; light is lost when full.",
        low=1 << 10, high=1 << 26, rebuilds=True
    )  # fmt: skip
    world_cache_cell_size: float = setting(
        0.15, "world_cache", "Metres of the finest cell. Less: sharper, slower, noisier.", low=1e-6, high=1e6
    )
    world_cache_lod_distance: float = setting(
        15.0, "world_cache", "Metres at which cells have doubled. More: finer cells.", low=1e-6, high=1e9
    )
    world_cache_lod_sharpness: float = setting(
        3.0, "world_cache", "How late in a level chance takes the next. More: finer cells, harder edges of levels.",
        low=0.01, high=100
    )  # fmt: skip
    world_cache_lifetime: int = setting(
        10, "world_cache", "Frames a cell lives unseen. More: steadier, more cells.", low=1, high=1000
    )
    world_cache_search_steps: int = setting(
        8, "world_cache", "Places tried for a cell (Solari: 3). Less: faster, fuller sooner.", low=1, high=64
    )
    world_cache_max_samples: int = setting(
        32, "world_cache", "Frames averaged. More: less noise, more lag.", low=1, high=4096
    )
    world_cache_change_exponent: float = setting(
        0.125, "world_cache", "Of a cell's relative change, in the adaptive blend. Less: forgets at smaller changes.",
        low=0.01, high=10
    )  # fmt: skip
    world_cache_change_smoothing: float = setting(
        0.125, "world_cache", "Share of the newest frame in a cell's change. More: quicker, noisier.", low=0.001, high=1
    )
    world_cache_relight: bool = setting(
        True, "world_cache", "Forget as much of the past as came, went or moved of the lights' power. Not in Solari."
    )
    world_cache_candidates: int = setting(
        32, "world_cache", "Light samples a cell chooses from. More: less noise, slower.", low=1, high=1024
    )
    world_cache_ray_length: float = setting(
        50.0, "world_cache", "Metres that a cell's ray sees. Less: faster, darker.", low=1e-3, high=1e9
    )
    world_cache_update_cap: int = setting(
        40_000, "world_cache", "Cells updated a frame, about; others wait by chance. Less: faster, more lag.", low=1,
        high=1 << 26
    )  # fmt: skip
    world_cache_jitter: float = setting(
        0.5, "world_cache", "Cells by which a query is moved at random. More: hides the grid, blurs.", low=0, high=2
    )
    world_cache_leak_prevention: str = setting(
        "landmarks", "world_cache", "How light is kept from leaking through walls: rays shorter than a cell ask the "
        "finest cells (Solari); with landmarks, walls also divide cells.", choices=("landmarks", "finest")
    )  # fmt: skip
    world_cache_surfaces: str = setting(
        "whole", "world_cache", "What a surface reflects of the light in the cache: what its whole material reflects, "
        "mirrors included; or its base colour, as if everything were diffuse (Solari).", choices=("whole", "diffuse")
    )  # fmt: skip

    # ---- ReSTIR DI
    di_candidates: int = setting(
        8, "restir_di", "Light samples a pixel chooses from (0.17: 32). More: less noise.", low=1, high=1024
    )
    di_temporal: bool = setting(True, "restir_di", "Reuse the last frame's samples.")
    di_spatial: bool = setting(True, "restir_di", "Reuse a neighbour's sample.")
    di_initial_visibility: bool = setting(
        False, "restir_di", "Drop occluded candidates before reuse, as Solari: less noise, but shadows grow halos."
    )
    di_target: str = setting(
        "brdf", "restir_di", "Chooses lights by highlights too, or as if all were diffuse (Solari: diffuse only).",
        choices=("brdf", "matte")
    )  # fmt: skip
    di_confidence_cap: float = setting(
        20.0, "restir_di", "Frames of history that count. More: less noise, more lag.", low=1, high=1e4
    )
    di_spatial_radius: float = setting(
        30.0, "restir_di", "Pixels in which a neighbour is looked for. More: fewer blotches.", low=1, high=1e4
    )

    # ---- ReSTIR GI
    gi_temporal: bool = setting(True, "restir_gi", "Reuse the last frame's samples.")
    gi_spatial: bool = setting(True, "restir_gi", "Reuse a neighbour's sample.")
    gi_confidence_cap: float = setting(
        8.0, "restir_gi", "Frames of history that count. More: less noise, more lag.", low=1, high=1e4
    )
    gi_spatial_radius: float = setting(
        30.0, "restir_gi", "Pixels in which a neighbour is looked for. More: fewer blotches.", low=1, high=1e4
    )
    gi_jacobian_limit: float = setting(
        10.0, "restir_gi", "A shift that stretches more than so is no merge. Less: more noise.", low=1, high=1e6
    )
    gi_skip_smooth_metals: bool = setting(True, "restir_gi", "Nothing is sampled where nothing diffuse is (0.19).")
    gi_visibility: str = setting(
        "both", "restir_gi", "Which visibility a merge tests: that of each sample from both pixels; or only that of a "
        "neighbour's sample from this pixel, which loses light at the edges of indirect shadows (Solari).",
        choices=("both", "neighbor")
    )  # fmt: skip
    gi_refresh: bool = setting(
        True, "restir_gi", "Ask the world cache anew what the last frame's samples reflect: light that is switched "
        "off goes at the cache's pace. Solari doesn't."
    )  # fmt: skip

    # ---- specular GI
    specular_bounces: int = setting(
        3, "specular_gi", "Surfaces a path visits before it ends in the cache. More: truer, slower.", low=1, high=64
    )
    specular_reuse_roughness: float = setting(
        0.4, "specular_gi", "Above this roughness the GI reservoir serves; smooth metals that GI skips are up to it. "
        "More: sharper reflections, slower.", low=0, high=1
    )  # fmt: skip
    specular_di_roughness: float = setting(
        0.0225, "specular_gi", "Up to this roughness lights are met by specular rays, above it DI shades them. More: "
        "noisier where lights are small.", low=0, high=1
    )  # fmt: skip
    specular_termination: str = setting(
        "spread", "specular_gi", "A path ends in the cache when its cone is wider than a cell. The cone begins at the "
        "surface that the pixel shows; or at the camera, with rays longer than sqrt(3) cells (Solari).",
        choices=("spread", "camera_spread")
    )  # fmt: skip
    primary_surface_replacement: bool = setting(True, "specular_gi", "Guides describe what mirrors show.")

    revision = 0
    """Grows with every change."""

    def __setattr__(self, name: str, value: Any) -> None:
        checked = _check(name, value)
        object.__setattr__(self, "revision", self.revision + 1)
        object.__setattr__(self, name, checked)

    @classmethod
    def preset(cls, quality: str) -> Settings:
        """Settings of a quality, one of QUALITIES."""
        if quality not in QUALITIES:
            raise SolariError(f"Settings: quality is one of {', '.join(QUALITIES)}, not {quality!r}")
        return cls(**QUALITIES[quality])

    def reset(self, *names: str) -> None:
        """Back to the default: the named fields, or all."""
        for name in names or FIELDS:
            if name not in FIELDS:
                raise SolariError(_unknown(name))
            setattr(self, name, DEFAULTS[name])

    def update(self, text: str) -> None:
        """Set a field from "name=value", as on the command line."""
        name, equals, value = text.partition("=")
        name = name.strip().replace("-", "_")
        if not equals:
            raise SolariError(f"Settings: {text!r} is no name=value")
        if name not in FIELDS:
            raise SolariError(_unknown(name))
        text = value.strip()
        if isinstance(DEFAULTS[name], bool):
            if text.lower() not in _SWITCH:
                raise SolariError(f"Settings: {name} must be on or off, not {text!r}")
            setattr(self, name, _SWITCH[text.lower()])
        else:
            setattr(self, name, text)

    @property
    def built_in(self) -> tuple[Any, ...]:
        """The values that need a rebuild when they change."""
        return tuple(getattr(self, name) for name, field in FIELDS.items() if field.rebuilds)


_SWITCH = dict.fromkeys(("1", "true", "on", "yes"), True) | dict.fromkeys(("0", "false", "off", "no"), False)
FIELDS: dict[str, Field] = {field.name: field.metadata["field"] for field in dataclasses.fields(Settings)}
DEFAULTS: dict[str, Any] = {field.name: field.default for field in dataclasses.fields(Settings)}


def _unknown(name: str) -> str:
    return f"Settings: there is no setting '{name}'; there are {', '.join(FIELDS)}"


def allowed(name: str) -> str:
    """What a field may be, in words."""
    field, default = FIELDS[name], DEFAULTS[name]
    if field.choices:
        return f"one of {', '.join(field.choices)}"
    if isinstance(default, bool):
        return "True or False"
    kind = "a whole number" if isinstance(default, int) else "a number"
    power = ", a power of two" if name == "world_cache_cells" else ""
    return f"{kind} from {field.low:.10g} to {field.high:.10g}{power}"


def _check(name: str, value: Any) -> Any:
    """The value as its field keeps it."""
    if name not in FIELDS:
        raise SolariError(_unknown(name))
    field, default = FIELDS[name], DEFAULTS[name]
    wrong = SolariError(f"Settings: {name} must be {allowed(name)}, not {value!r}")
    if field.choices or isinstance(default, bool):
        if value not in (field.choices or (True, False)):
            raise wrong
        return value if field.choices else bool(value)
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        raise wrong from None
    whole = isinstance(default, int)
    if not (field.low <= number <= field.high) or (whole and number != int(number)):
        raise wrong
    if name == "world_cache_cells" and int(number) & (int(number) - 1):
        raise wrong
    return int(number) if whole else number
