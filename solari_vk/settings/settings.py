"""The settings of the realtime lighting, each with its default, its meaning and its range."""

from __future__ import annotations

import dataclasses
import functools
from functools import partial
from typing import Any

from solari_vk.base.errors import Hints, SolariError, is_name, quoted, unknown_name
from solari_vk.settings.field import Field, setting
from solari_vk.settings.layering import LAYERINGS
from solari_vk.settings.presets import QUALITIES as QUALITIES
from solari_vk.settings.solari019 import SeparatePasses

_frame, _taa, _paths, _denoise, _restir, _reuse, _cache = (
    partial(setting, name) for name in ("frame", "taa", "paths", "denoise", "restir", "reuse", "world_cache")
)


@dataclasses.dataclass
class Settings(SeparatePasses, Hints):
    """The constants of the realtime passes. Assigning one checks it and takes effect with the next frame.

    Defaults are those of Solari in Bevy 0.19 unless the meaning names Solari's value; `preset("solari")` takes Solari's
    values. Constants of materials, which the path tracer shares, are not settings. Raises SolariError for values out of
    range.
    """

    # ---- what is computed
    lighting: str = _frame(
        "paths",
        "How light is computed: by one path a pixel; or by separate passes for direct, indirect and specular "
        "light (Solari in Bevy 0.19).",
        choices=("paths", "split"),
        rebuilds=True,
    )
    world_cache: bool = _frame(
        True,
        "The radiance cache. Without it paths end after their last bounce, and with lighting=split indirect "
        "light is one bounce of direct.",
    )
    jitter: bool = _frame(True, "Move samples within the pixel from frame to frame, for antialiasing.")
    frame_ms: float = _frame(
        0.0,
        "Milliseconds that a frame is to take on the GPU, as the 95th percentile (0: no such aim), with "
        "lighting=paths, denoise=on and restir=off: pixels take no, one or several paths, by chance. More: less noise.",
        low=0,
        high=1e4,
        rebuilds=True,
    )
    gbuffer: str = _frame(
        "auto",
        "How the surface of a pixel is found: by rasterization or by rays. auto: by what is faster, which is "
        "rays on GPUs and rasterization on software devices; by rasterization where instances have a ray_mesh.",
        choices=("auto", "raster", "traced"),
        rebuilds=True,
    )
    frustum_culling: bool = _frame(True, "Skip instances outside the view when rasterizing.", rebuilds=True)
    occlusion_culling: bool = _frame(True, "Skip instances that others hide when rasterizing.", rebuilds=True)
    layering: str = _frame(
        "conserving",
        "How the specular layer dims the diffuse one below it: so that all energy is kept, or by a "
        "product of Fresnel terms, which loses some (Solari).",
        choices=LAYERINGS,
        rebuilds=True,
    )
    pure_metal: float = _frame(
        0.9999,
        "Metallic above which a surface counts as having no diffuse lobe: guides show what it mirrors, and "
        "paths don't end there in the world cache. Less: faster, less exact.",
        low=0,
        high=1,
    )
    lambert: bool = _frame(False, "Every surface is Lambertian, to compare with closed forms.", rebuilds=True)
    primary_surface_replacement: bool = _frame(True, "Guides describe the surface that a mirror or clear glass shows.")

    # ---- the picture, from jittered samples
    antialiasing: bool = _taa(True, "Average samples at different positions in each pixel over frames (Solari: off).")
    upscale: float = _taa(
        1.0,
        "One of so many pixels squared takes a path in a frame, with lighting=paths, denoise=on, restir=off and "
        "frame_ms=0; else the width of the picture over that of what is rendered. More: faster, more noise.",
        low=1,
        high=3,
        rebuilds=True,
    )

    # ---- paths (lighting=paths)
    paths_bounces: int = _paths(
        16, "Rays of a path, those from mirrors not counted. More: truer in halls of shiny surfaces.", low=1, high=64
    )
    paths_candidates: int = _paths(
        8,
        "Light samples from which a pixel's surface chooses one, at most one for each triangle of the lights. More: "
        "less noise.",
        low=1,
        high=1024,
    )
    paths_later_candidates: int = _paths(
        2, "The same for each further surface of a path. More: less noise.", low=1, high=1024
    )
    paths_short_history_samples: int = _paths(
        2,
        "Paths of a pixel with less than 8 frames of history, with denoise=on and restir=off. More: less noise "
        "after cuts and where surfaces or light are new, slower there.",
        low=1,
        high=16,
        rebuilds=True,
    )
    paths_cache_roughness: float = _paths(
        0.35,
        "Roughness (alpha, of GGX) from which the world cache stands for the specular lobe of a surface too. "
        "More: sharper reflections of reflections, slower.",
        low=0,
        high=1,
    )
    paths_regularization: float = _paths(
        0.15,
        "Least roughness (alpha) of surfaces that a path meets after it left a diffuse one (0: off). More: less "
        "noise, wider caustics.",
        low=0,
        high=1,
    )

    denoise: bool = _denoise(
        True, "Average light over frames and pixels, as far as differences are noise. Less noise, slower."
    )
    denoise_max_history: int = _denoise(
        128, "Most frames in a pixel's mean. More: less noise, more lag.", low=1, high=4096
    )

    # ---- ReSTIR of paths (lighting=paths)
    restir: bool = _restir(
        False,
        "Pixels reuse light that others found (ReSTIR). Less noise in some scenes, "
        "more in others, which the measured pages name; slower.",
        rebuilds=True,
    )
    restir_confidence_cap: float = _restir(
        8.0, "Largest confidence of history, in frames. More: noise that lasts.", low=1, high=1e4
    )
    restir_roughness: float = _restir(
        0.6, "Perceptual roughness from which specular light is reused too. Less: more outliers.", low=0.05, high=2
    )
    restir_radius: float = _restir(30.0, "Pixels to the farthest neighbor. More: fewer blotches.", low=1, high=1e4)

    # ---- reuse between pixels, in DI and GI (lighting=split), and with restir=on
    similarity_plane_distance: float = _reuse(
        0.003,
        "Largest distance of a pixel from the tangent plane of another that reuses its samples, over the view "
        "depth. More: less noise at small features, more blur of contact shadows.",
        low=1e-6,
        high=1.0,
    )
    similarity_normal_cosine: float = _reuse(
        0.0, "Cosine of the largest angle between two normals. More: less blur, more noise.", low=-1, high=1
    )
    permutation_sampling: bool = _reuse(True, "Permute pixels in temporal reuse: less correlation.")
    spatial_tries: int = _reuse(5, "Attempts to find a similar neighbor. More: less noise, slower.", low=1, high=32)
    spatial_radius_halving: bool = _reuse(True, "Halve the search radius after each failed attempt.")

    # ---- world cache
    world_cache_cells: int = _cache(
        1 << 20,
        "Cells of the hash map, a power of two. Less: less memory; light is lost when full.",
        low=1 << 10,
        high=1 << 26,
        rebuilds=True,
    )
    world_cache_cell_size: float = _cache(
        0.15, "Size of the finest cells in meters. Less: sharper, slower, noisier.", low=1e-6, high=1e6
    )
    world_cache_lod_distance: float = _cache(
        15.0, "Distance in meters at which cells have twice the finest size. More: finer cells.", low=1e-6, high=1e9
    )
    world_cache_lod_sharpness: float = _cache(
        3.0,
        "Exponent of the probability of the coarser level. More: finer cells, harder edges between levels.",
        low=0.01,
        high=100,
    )
    world_cache_lifetime: int = _cache(
        10, "Frames for which a cell lives without queries. More: steadier, more cells.", low=1, high=1000
    )
    world_cache_search_steps: int = _cache(
        8, "Entries of the map that a key may take (Solari: 3). Less: faster, full sooner.", low=1, high=64
    )
    world_cache_max_samples: int = _cache(32, "Frames in a cell's mean. More: less noise, more lag.", low=1, high=4096)
    world_cache_change_exponent: float = _cache(
        0.125,
        "Exponent of a cell's relative change in the adaptive blend. Less: forgets at smaller changes.",
        low=0.01,
        high=10,
    )
    world_cache_change_smoothing: float = _cache(
        0.125, "Weight of the newest frame in a cell's change. More: quicker, noisier.", low=0.001, high=1
    )
    world_cache_relight: bool = _cache(
        True,
        "Forget as large a share of the past as the share of the lights' power that changed, and all where most of "
        "the light may have changed (Solari: off).",
    )
    world_cache_candidates: int = _cache(
        32, "Light samples from which a cell chooses. More: less noise, slower.", low=1, high=1024
    )
    world_cache_ray_length: float = _cache(
        50.0, "Length of a cell's rays in meters, with lighting=split. Less: faster, darker.", low=1e-3, high=1e9
    )
    world_cache_update_cap: int = _cache(
        40_000,
        "Cells that are updated in a frame, at random and on average; in a batch for each world. Less: "
        "faster, more lag.",
        low=1,
        high=1 << 26,
    )
    world_cache_updates_per_pixel: float = _cache(
        0.25,
        "Cells that are updated for each pixel of the picture while lights don't change, at most as many as "
        "world_cache_update_cap (Solari: no such bound). Less: faster, more noise.",
        low=1e-6,
        high=1e9,
    )
    world_cache_updates: str = _cache(
        "asked",
        "Which cells are updated: those that the previous frame asked for, or all that live (Solari).",
        choices=("asked", "all"),
    )
    world_cache_jitter: float = _cache(
        0.5, "Random offset of a query, in cells. More: hides the grid, blurs.", low=0, high=2
    )
    world_cache_leak_prevention: str = _cache(
        "divided",
        "How light is kept from leaking through walls. finest: with lighting=split, rays shorter than a "
        "cell ask the finest cells (Solari); divided: cells that a wall divides aren't used either; none: in no way.",
        choices=("divided", "finest", "none"),
    )
    world_cache_surfaces: str = _cache(
        "whole",
        "What surfaces are to the cache: their whole material, so that paths go on from mirrors and from what "
        "transmits light; or all diffuse, so that paths end at any of them (Solari).",
        choices=("whole", "diffuse"),
    )

    revision = 0
    """A number that grows with each change."""

    def __new__(cls, *_: Any, **fields: Any) -> Settings:
        # Before the dataclass's __init__, which would raise a TypeError without a suggestion.
        for name in fields:
            if name not in FIELDS:
                raise _unknown(name)
        return super().__new__(cls)

    def __setattr__(self, name: str, value: Any) -> None:
        checked = _check(name, value)
        # Renderers compare this number to see whether anything has changed since their latest frame.
        object.__setattr__(self, "revision", self.revision + 1)
        object.__setattr__(self, name, checked)

    @classmethod
    def preset(cls, quality: str) -> Settings:
        """The settings of one of QUALITIES. Raises SolariError for another name."""
        if not is_name(quality, QUALITIES):
            raise SolariError(f"Settings: quality is one of {', '.join(QUALITIES)}, not {quoted(quality)}")
        return cls(**QUALITIES[quality])

    def reset(self, *names: str) -> None:
        """Set the named fields, or all without names, to their defaults."""
        for name in names or FIELDS:
            if name not in FIELDS:
                raise _unknown(name)
            setattr(self, name, DEFAULTS[name])

    def update(self, text: str) -> None:
        """Set a field from a text "name=value"."""
        name, equals, value = text.partition("=")
        name = name.strip().replace("-", "_")
        if not equals:
            raise SolariError(f"Settings: {quoted(text)} is not of the form name=value")
        if name not in FIELDS:
            raise _unknown(name)
        text = value.strip()
        if isinstance(DEFAULTS[name], bool):
            if text.lower() not in _SWITCH:
                raise SolariError(f"Settings: {name} must be on or off, not {quoted(text)}")
            setattr(self, name, _SWITCH[text.lower()])
        else:
            setattr(self, name, text)

    def __repr__(self) -> str:
        """The settings that aren't as by default."""
        values = {name: getattr(self, name) for name in FIELDS}
        changed = (f"{name}={value!r}" for name, value in values.items() if value != DEFAULTS[name])
        return f"Settings({', '.join(changed)})"

    @property
    def rebuild_key(self) -> tuple[Any, ...]:
        """The values of the fields that are built into pipelines or sizes."""
        values = {name: getattr(self, name) for name, field in FIELDS.items() if field.rebuilds}
        # Pipelines depend on whether frames have a time limit; its value is live.
        return tuple((values | {"frame_ms": self.frame_ms > 0}).values())


_SWITCH = dict.fromkeys(("1", "true", "on", "yes"), True) | dict.fromkeys(("0", "false", "off", "no"), False)
_fields = sorted(dataclasses.fields(Settings), key=lambda field: field.name not in Settings.__annotations__)
FIELDS: dict[str, Field] = {field.name: field.metadata["field"] for field in _fields}
DEFAULTS: dict[str, Any] = {field.name: field.default for field in _fields}

_init = Settings.__init__


@functools.wraps(_init)
def _init_by_name(self: Settings, *values: Any, **fields: Any) -> None:
    if values and isinstance(values[0], str):
        raise SolariError(
            f"Settings: takes name=value, not {quoted(values[0])}: Settings.preset({quoted(values[0])}) "
            f"has the settings of a quality, {', '.join(QUALITIES)}"
        )
    _init(self, *values, **fields)


Settings.__init__ = _init_by_name  # type: ignore[method-assign]


def _unknown(name: str) -> SolariError:
    if name in ("quality", "preset", *QUALITIES):
        hint = "Settings.preset('solari') gives the settings of a quality"
        return SolariError(f"Settings: there is no setting '{name}'; {hint}")
    error = unknown_name("Settings: there is no setting", name, FIELDS)
    return SolariError(f"{error}; `solari-vk settings` lists all")


def allowed(name: str) -> str:
    """The allowed values of a field, in words."""
    field, default = FIELDS[name], DEFAULTS[name]
    if field.choices:
        return f"one of {', '.join(field.choices)}"
    if isinstance(default, bool):
        return "True or False"
    kind = "a whole number" if isinstance(default, int) else "a number"
    power = ", a power of two" if name == "world_cache_cells" else ""
    return f"{kind} from {field.low:.10g} to {field.high:.10g}{power}"


def _check(name: str, value: Any) -> Any:
    """The value in its field's type. Raises SolariError for an unknown field or a value out of range."""
    if name not in FIELDS:
        raise _unknown(name)
    checked = FIELDS[name].checked(value, DEFAULTS[name])
    if checked is None or (name == "world_cache_cells" and checked & (checked - 1)):
        raise SolariError(f"Settings: {name} must be {allowed(name)}, not {quoted(value)}")
    return checked
