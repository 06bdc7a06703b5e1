"""The layers of a renderer's EXR files: which channels hold color, albedo, normals, depth, positions and motion.

The names are those that Blender (Cycles), Mitsuba 3, pbrt-v4, V-Ray, RenderMan and Arnold give by default, and those of
this package.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.budget import charge, load_budget
from solari_vk.base.errors import SolariError, unknown_name
from solari_vk.base.files import read_regular
from solari_vk.scene.images.exr import IDENTIFIER, is_whole

COLORS = (("r", "g", "b"), ("red", "green", "blue"))
VECTORS = (("x", "y", "z"), *COLORS)
SCALARS = (("z",), ("t",), ("v",), ("y",), ("r",), ("red",), ("",), ("depth",))
PAIRS = (("x", "y"), ("u", "v"), ("r", "g"), ("red", "green"))

_OWN_MOTION = "guides_motion"

# Names of layers in lower case, the best first; "" is the layer of channels without one, such as R, G and B.
NAMES: dict[str, tuple[str, ...]] = {
    # Blender's Combined is denoised already where the render denoises; then the noise is in Noisy Image.
    "color": ("noisy image", "radiance", "combined", "", "rgba", "beauty", "ci", "rgb", "rgb_color", "color"),
    "albedo": (
        *("denoising albedo", "denoise_albedo", "albedo", "guides_diffuse_albedo", "diffuse_albedo", "diffcol"),
        *("vraydiffusefilter", "diffuse_filter", "diffusefilter", "diffuse_color", "vraymtlcolor"),
    ),
    "normal": (
        *("denoising normal", "ns", "sh_normal", "nn", "normal", "normals", "n", "vraynormals", "vraybumpnormals"),
        *("bump_normals", "bumpnormals", "nworld", "__nworld", "nn_world", "shading_normal"),
    ),
    "depth": ("depth", "denoising depth", "z", "zdepth", "vrayzdepth", "z_depth", "dd", "dd.y", "guides_depth"),
    "position": (
        *("position", "p", "pworld", "__pworld", "pos", "worldposition", "world_position", "worldpositions"),
        *("vrayworldposition", "pp"),
    ),
    "motion": (
        "vector",
        "motionvector",
        "motion_vector",
        "motion",
        "backward",
        "velocity",
        "vrayvelocity",
        _OWN_MOTION,
    ),
    "motion_next": ("forward",),
}
SHAPES = {
    "color": COLORS,
    "albedo": COLORS,
    "normal": VECTORS,
    "depth": SCALARS,
    "position": VECTORS,
    "motion": (("x", "y", "z", "w"), *PAIRS),
    "motion_next": PAIRS,
}
WITHOUT = {
    "albedo": "textures are blurred where there is noise, and OIDN has less to go by",
    "normal": "edges between surfaces of one color are blurred",
    "depth": "what comes into view behind an edge may take light of what hid it",
    "motion": "frames that move share little light: only what rests in the picture is averaged over frames",
}
"""What a sequence without a layer loses."""


@dataclass(frozen=True)
class Layers:
    """The channels of each layer that a file has, by the layer's name here: "color", "albedo", ..."""

    channels: Mapping[str, tuple[str, ...]]

    @property
    def is_blender(self) -> bool:
        """Whether motion is Blender's pass Vector: four channels, y up, the next frame's with the other sign."""
        return len(self.channels.get("motion", ())) == 4

    @property
    def is_own(self) -> bool:
        """Whether motion is this package's."""
        return _common(self.channels.get("motion", ("",))).lower().endswith(_OWN_MOTION)

    def described(self) -> str:
        """The layers and where they come from, in a line."""
        return ", ".join(f"{name}: {_common(names)}" for name, names in self.channels.items())


def _common(names: Sequence[str]) -> str:
    """The layer that some channels belong to, or the channels."""
    first = names[0].rpartition(".")[0]
    return first if first else "".join(names)


def find_layers(channels: Sequence[str], chosen: Mapping[str, str], who: str) -> Layers:
    """The layers among a file's channels. chosen: layers that the user names, by the name here.

    Raises SolariError where there is no color, and for a chosen layer that isn't there.
    """
    groups: dict[str, dict[str, str]] = {}
    for channel in channels:
        layer, _, component = channel.rpartition(".")
        groups.setdefault(layer, {})[component.lower()] = channel
        # Channels without a point, such as Z or depth, are layers of their own too.
        if not layer:
            groups.setdefault(channel, {})[""] = channel
    found = {}
    for name, known in NAMES.items():
        wanted = chosen.get(name)
        if wanted is not None and wanted not in groups:
            raise unknown_name(f"{who}: there is no layer", wanted, [group for group in groups if group])
        places = [wanted] if wanted is not None else _places(groups, known)
        names = next((names for place in places if (names := _components(groups[place], name))), None)
        if names is None and wanted is not None:
            raise SolariError(f"{who}: layer {wanted} has the channels {', '.join(groups[wanted].values())}: no {name}")
        if names is not None:
            found[name] = names
    if "color" not in found:
        some = ", ".join(sorted(channels)[:8])
        raise SolariError(f"{who}: has no layer of colors, but {some}: name it by layers={{'color': NAME}} (--layer)")
    layer = found["color"][0].rpartition(".")[0]
    alpha = groups[layer].get("a")
    return Layers(found if alpha is None else found | {"alpha": (alpha,)})


def _places(groups: Mapping[str, Any], known: Sequence[str]) -> list[str]:
    """The layers whose names are known, the best first. Blender puts the view layer's name before a pass's."""
    lower = {group: group.lower() for group in groups}
    exact = [group for name in known for group in groups if lower[group] == name]
    return exact + [group for name in known if name for group in groups if lower[group].endswith(f".{name}")]


def _components(group: Mapping[str, str], name: str) -> tuple[str, ...] | None:
    for components in SHAPES[name]:
        if all(component in group for component in components):
            return tuple(group[component] for component in components)
    return None


def read_channels(path: Path) -> dict[str, NDArray[np.float32]]:
    """All channels of an EXR file by name, (height, width) each, those of further parts too.

    Raises SolariError for what is no EXR file, for one that is damaged, and for one that takes too much memory.
    """
    import OpenEXR

    who = str(path)
    with load_budget():
        data = read_regular(path, who)
        if not data.startswith(IDENTIFIER):
            raise SolariError(f"{who}: is no EXR file: render the sequence as OpenEXR, which keeps radiance and layers")
        if not is_whole(data):
            raise SolariError(f"{who}: is a damaged EXR file, cut off: render this frame again")
        charge(0, who, "its pixels", working=4 * len(data))
        del data
        try:
            with OpenEXR.File(who, separate_channels=True) as file:
                found: dict[str, NDArray[np.float32]] = {}
                for part in file.parts:
                    prefix = part.name() if len(file.parts) > 1 else ""
                    for name, channel in part.channels.items():
                        full = name if not prefix or name.startswith(f"{prefix}.") else f"{prefix}.{name}"
                        found[full] = np.asarray(channel.pixels, np.float32)
                return found
        except (OSError, RuntimeError, ValueError, TypeError) as error:
            raise SolariError(f"{who}: is a damaged EXR file ({str(error)[:100]}): render this frame again") from None


def read_header(path: Path) -> dict[str, Any]:
    """The attributes of an EXR file's header; none where it is no such file."""
    import OpenEXR

    try:
        with OpenEXR.File(str(path), header_only=True) as file:
            return dict(file.header())  # which the library empties when the file is closed
    except (OSError, RuntimeError, ValueError, TypeError):
        return {}
