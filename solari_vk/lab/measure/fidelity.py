"""Scenarios of the glTF render fidelity generator: what pictures that many renderers make have in common.

The generator is Khronos' glTF-Render-Fidelity-Generator, which was a part of model-viewer. Its config.json has a list
of scenarios. To renderers with a command line it gives one of them as JSON: {"scenario": {...}, "outputFile": "..."}.
"""

from __future__ import annotations

import json
import math
import os
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError, quoted, unknown_name
from solari_vk.base.files import read_json
from solari_vk.output.tone_mapping import Colors, clip, encode_srgb
from solari_vk.output.transparency import premultiplied, straight
from solari_vk.scene.material import UNLIT_RADIANCE
from solari_vk.scene.model import Camera, Scene

RENDERER = "solari-vk"
"""Our name in a scenario's `exclude`."""
DEFAULTS: dict[str, Any] = {
    "lighting": "../../../environments/lightroom_14b.hdr",
    "dimensions": {"width": 768, "height": 768},
    "target": {"x": 0, "y": 0, "z": 0},
    "orbit": {"theta": 0, "phi": 90, "radius": 1},
    "verticalFoV": 45,
    "renderSkybox": False,
    "clearColor": {"r": 0, "g": 0, "b": 0, "a": 0},
    "exclude": [],
    "pt": {"numSamples": 1},
}
"""What scenarios may leave out; `pt` has no meaning here: --samples has one number for all."""
LIMITS = {
    "dimensions": (1, 2**13),
    "target": (-1e6, 1e6),
    "orbit": (-1e6, 1e6),
    "verticalFoV": (0.01, 179),
    "clearColor": (0, 0),
    "pt": (1, 2**24),
}


@dataclass(frozen=True)
class Scenario:
    """One picture: angles in degrees, lengths in meters, the size in the generator's pixels."""

    name: str
    where: str
    """The JSON file and the name, for messages."""
    folder: Path
    model: str
    lighting: str
    size: tuple[int, int]
    target: tuple[float, float, float]
    theta: float
    phi: float
    radius: float
    vertical_fov: float
    skybox: bool
    excludes_us: bool

    def file(self, key: str) -> Path:
        """The file of "model" or "lighting": beside the JSON file, or where the generator has it, whose paths are seen
        from renderers/NAME/. Raises SolariError if there is none."""
        places = ("", "renderers/x", "test/renderers/x")
        paths = [Path(os.path.normpath(self.folder / place / getattr(self, key))) for place in places]
        for path in paths:
            if os.path.isfile(path):  # False for names that no file can have
                return path
        tried = ", ".join(dict.fromkeys(map(str, paths)))
        raise SolariError(f"{self.where}: '{key}': there is no file {tried}: mend the path, or get the file")

    def camera(self, extent: float) -> Camera:
        """The camera, whose exposure is 1; extent: the radius of the model in meters.

        theta turns from +z to +x, and phi is the angle from +y. With a radius of 0 the camera is at the target and
        looks as it would from outside.
        """
        theta, phi = math.radians(self.theta), math.radians(self.phi)
        outward = np.array((math.sin(phi) * math.sin(theta), math.cos(phi), math.sin(phi) * math.cos(theta)))
        # The derivative of `outward` by -phi, which is defined at the poles too.
        up = (-math.cos(phi) * math.sin(theta), math.sin(phi), -math.cos(phi) * math.cos(theta))
        reach = max(self.radius, extent, 1e-5)
        eye = np.array(self.target) + self.radius * outward
        return Camera.look_at(
            eye, eye - reach * outward, up, fov=self.vertical_fov, near=2 * reach / 1000, ev100=-math.log2(1.2)
        )


def read_scenarios(source: str) -> tuple[list[Scenario], Path | None]:
    """The scenarios of a file or of a JSON text, and the path of `outputFile` if there is one.

    Raises SolariError, which names the file, the scenario and the key, for what the generator wouldn't understand.
    """
    is_text = source.lstrip().startswith("{")
    where, folder = ("the JSON text", Path()) if is_text else (source, Path(source).parent)
    try:
        found = json.loads(source) if is_text else read_json(Path(source), source)
    except (ValueError, RecursionError) as error:
        raise SolariError(f"{where}: not JSON: {error}") from None
    listed = None
    if isinstance(found, dict):
        listed = found.get("scenarios", [found.get("scenario", found)])
    if not isinstance(listed, list) or not listed:
        raise SolariError(f"{where}: 'scenarios' must be a list of scenarios, as in the generator's config.json")
    scenarios = [_scenario(entry, f"{where}: scenario {index}", folder) for index, entry in enumerate(listed)]
    names = Counter(scenario.name for scenario in scenarios)
    for name, count in names.items():
        if count > 1:
            raise SolariError(f"{where}: scenario {quoted(name)}: another has the same 'name': change one")
    output = found.get("outputFile")
    if not isinstance(output, str | None):
        raise SolariError(f"{where}: 'outputFile' must be a path, not {quoted(output)}")
    return scenarios, None if output is None else Path(output)


def _scenario(entry: Any, where: str, folder: Path) -> Scenario:
    if not isinstance(entry, dict):
        raise SolariError(f"{where}: must be an object with 'name' and 'model', not {quoted(entry)}")
    name = entry.get("name")
    if not isinstance(name, str) or name in ("", ".", "..") or set(name) & set("/\\\0"):
        raise SolariError(f"{where}: 'name' must be a name that a file can have, not {quoted(name)}")
    where = f"{where.rpartition(' ')[0]} '{name}'"
    for key in entry:
        if key not in ("name", "model", *DEFAULTS):
            raise unknown_name(f"{where}: there is no key", key, ("name", "model", *DEFAULTS))
    values = {
        key: _merged(entry.get(key, default), default, f"{where}: '{key}'", LIMITS.get(key))
        for key, default in DEFAULTS.items()
    }
    target, orbit, size = (values[key] for key in ("target", "orbit", "dimensions"))
    if orbit["radius"] < 0:
        raise SolariError(f"{where}: 'orbit' has a radius of {orbit['radius']}: give one of at least 0")
    if not isinstance(entry.get("model"), str):
        raise SolariError(f"{where}: 'model' must be the path of a file, not {quoted(entry.get('model'))}")
    return Scenario(
        name,
        where,
        folder,
        entry["model"],
        values["lighting"],
        (round(size["width"]), round(size["height"])),
        (target["x"], target["y"], target["z"]),
        orbit["theta"],
        orbit["phi"],
        orbit["radius"],
        values["verticalFoV"],
        values["renderSkybox"],
        RENDERER in values["exclude"],
    )


def _merged(value: Any, default: Any, where: str, limits: tuple[float, float] | None) -> Any:
    """A value of the default's type, whose missing parts are the default's."""
    if isinstance(default, dict):
        if not isinstance(value, dict) or not default.keys() >= value.keys():
            raise SolariError(f"{where} must be an object of {', '.join(default)}, not {quoted(value)}")
        parts = default.items()
        return {key: _merged(value.get(key, part), part, f"{where}: '{key}'", limits) for key, part in parts}
    if limits is None:
        if not isinstance(value, type(default)):
            raise SolariError(f"{where} must be of the type {type(default).__name__}, not {quoted(value)}")
        return value
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not limits[0] <= value <= limits[1]:
        raise SolariError(f"{where} must be a number from {limits[0]:g} to {limits[1]:g}, not {quoted(value)}")
    return float(value)


def show_unlit_colors(scene: Scene) -> None:
    """Show unlit colors as they are, for a camera with an exposure of 1."""
    for material in scene.materials:
        if material.unlit:
            material.base_color = material.base_color / UNLIT_RADIANCE


# ---- from radiance to a picture ---------------------------------------------------------------------


def aces(color: Colors) -> Colors:
    """The fit of ACES' transforms by Stephen Hill, as three.js has it: a factor of 1 / 0.6 comes first."""
    # Stephen Hill's fit: sRGB to AP1 with its saturation, a rational curve, and back.
    inset = np.array(((0.59719, 0.35458, 0.04823), (0.07600, 0.90834, 0.01566), (0.02840, 0.13383, 0.83777)))
    outset = np.array(((1.60475, -0.53108, -0.07367), (-0.10208, 1.10813, -0.00605), (-0.00327, -0.07276, 1.07602)))
    x = np.minimum(color, 1e6) / 0.6 @ inset.T
    x = (x * (x + 0.0245786) - 0.000090537) / (x * (0.983729 * x + 0.4329510) + 0.238081)
    return np.asarray(np.clip(x @ outset.T, 0, 1), np.float32)


def neutral(color: Colors) -> Colors:
    """Khronos PBR Neutral (2024): colors up to 0.8 stay as they are but for the 4 % of a dielectric's reflection."""
    # Khronos PBR Neutral: compression starts at 0.8, and colors are 0.04 lower by then.
    start = 0.8 - 0.04
    least = color.min(axis=-1, keepdims=True)
    x = color - np.where(least < 0.08, least - 6.25 * least**2, 0.04)
    peak = x.max(axis=-1, keepdims=True)
    top = 1 - (1 - start) ** 2 / (np.maximum(peak, start) + 1 - 2 * start)
    # Desaturation of what is brighter than white, by 0.15.
    share = 1 / (0.15 * (peak - top) + 1)
    compressed = x * (top / np.maximum(peak, start)) * share + top * (1 - share)
    return np.clip(np.where(peak < start, x, compressed), 0, 1).astype(np.float32)


TONEMAPS: dict[str, Callable[[Colors], Colors]] = {"aces": aces, "neutral": neutral, "none": clip}


def codes(
    radiance: Colors, tonemap: str, coverage: NDArray[Any] | None = None, behind: Colors | float = 0.0
) -> NDArray[np.uint8]:
    """sRGB codes (height, width, 3) of radiance (height, width, 3); with `coverage`, the share (height, width) of each
    pixel that surfaces cover, codes (height, width, 4) whose alpha it is, without the radiance of what is behind."""
    if coverage is None:
        return _bytes(encode_srgb(TONEMAPS[tonemap](radiance)))
    share = coverage[..., None].astype(np.float32)
    surfaces = straight(premultiplied(radiance, coverage, behind), coverage)
    colors = np.where(share > 0, encode_srgb(TONEMAPS[tonemap](surfaces)), 0)
    return _bytes(np.concatenate([colors, share], axis=-1))


def _bytes(shares: NDArray[Any]) -> NDArray[np.uint8]:
    return np.round(255 * shares).astype(np.uint8)
