"""Differences between renderers whose reasons are known: the page names those that apply to a file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from solari_vk.lab.trial.translation import USED
from solari_vk.scene.lights.directional import DirectionalLight
from solari_vk.scene.lights.punctual import PunctualLight, SpotLight
from solari_vk.scene.material import TEXTURES, Material
from solari_vk.scene.meshes.tangents import components, neighbors, weld
from solari_vk.scene.model import Instance, Mesh, Scene


@dataclass(frozen=True)
class Difference:
    """Whose pictures differ from ours, why, and whether that is so in a scene. docs/reference/trial.md shows all."""

    renderer: str
    what: str
    why: str
    applies: Callable[[Scene], bool]


def _with(test: Callable[[Material], Any]) -> Callable[[Scene], bool]:
    return lambda scene: any(test(material) for material in scene.materials)


def _light(test: Callable[[Any], Any]) -> Callable[[Scene], bool]:
    return lambda scene: any(test(light) for light in scene.lights)


def _textures(material: Material) -> dict[str, Any]:
    found = {name: getattr(material, name) for name in TEXTURES}
    return {name: texture for name, texture in found.items() if texture is not None}


def _moves_uvs_apart(material: Material) -> bool:
    # Textures that are left out cannot need uvs of their own.
    used = [texture for name, texture in _textures(material).items() if name in USED]
    ways = {(texture.uv_set, texture.uv_transform.tobytes()) for texture in used}
    return len(ways) > 1 or any(texture.wrap_u != texture.wrap_v for texture in used)


def _is_layered(material: Material) -> bool:
    """Whether it becomes Mitsuba's `principled`."""
    # As in translation.py: what becomes glass, or plain diffuse, is not layered.
    glass = material.transmission == 1 and material.transmission_texture is None and material.metallic == 0
    return not glass and not material.unlit and (material.specular > 0 or material.metallic > 0)


def _has_parts_inside_out(mesh: Mesh) -> bool:
    """Whether some closed parts of a mesh face inwards where others face outwards."""
    # Closed parts of a mesh have a volume, which is negative where they face inwards.
    corners = weld(mesh.positions)[mesh.triangles.astype(np.int64)]
    is_open = (neighbors(corners, np.ones(len(corners), bool)) < 0).reshape(-1, 3).any(axis=1)
    ends = corners[:, 1:].T.reshape(-1)
    part = components(int(corners.max()) + 1, np.tile(corners[:, 0], 2), ends)[corners[:, 0]]
    # The signed volume of each part, six times, by the divergence theorem.
    volumes = np.bincount(part, np.linalg.det(mesh.positions[mesh.triangles].astype(np.float64)))
    closed = volumes[np.bincount(part, is_open) == 0]
    return bool(closed.min(initial=0) < 0 < closed.max(initial=0))


def _shows_backs(item: Instance) -> bool:
    """Whether other renderers show backs of an instance that cameras of ours don't see."""
    if not item.material.hides_back:
        return False
    return item.material.alpha_mode != "opaque" or _has_parts_inside_out(item.mesh)


def _is_spot(light: Any) -> bool:
    return isinstance(light, SpotLight)


TRANSLATED: tuple[tuple[str, str, Callable[[Scene], bool]], ...] = (  # of translation.py
    (
        "attenuation",
        "left out: the solid is clear there",
        _with(lambda m: m.solid and m.transmission > 0 and m.absorption.any()),
    ),
    ("sheen", "left out", _with(lambda m: m.sheen_color.max() > 0)),
    ("anisotropy", "left out", _with(lambda m: m.anisotropy > 0)),
    (
        "clearcoat",
        "Disney's coat: a quarter as strong, with another roughness, and without its normal texture",
        _with(lambda m: m.clearcoat > 0),
    ),
    (
        "reflectance",
        "colors and textures of a dielectric's reflections are left out",
        _with(lambda m: m.specular_texture or m.specular_color_texture or m.reflectance.std() > 0),
    ),
    ("iridescence", "left out", _with(lambda m: m.iridescence > 0)),
    ("diffuse transmission", "left out", _with(lambda m: m.diffuse_transmission > 0)),
    ("unlit", "left out: black there", _with(lambda m: m.unlit)),
    ("uvs", "all textures of a material take the uvs, and one way to wrap, of the first", _with(_moves_uvs_apart)),
    (
        "vertex colors",
        "with a base color texture they are left out, as is their alpha",
        lambda scene: any(instance.mesh.colors is not None for instance in scene),
    ),
)
DIFFERENCES = (
    Difference(
        "cycles",
        "colored glass",
        "glTF tints light at each surface of a solid, so twice; Blender takes the root of "
        "the color, so solids are lighter there: with squared colors TransmissionRoughnessTest agrees within 0.5 %",
        _with(lambda m: m.transmission > 0 and m.solid),
    ),
    Difference(
        "cycles",
        "thin glass",
        "Blender has no thin glass: shadows of panes have no light through them",
        _with(lambda m: m.transmission > 0 and not m.solid),
    ),
    Difference(
        "cycles",
        "diffuse transmission",
        "Blender's importer leaves it out",
        _with(lambda m: m.diffuse_transmission > 0),
    ),
    Difference("cycles", "unlit", "mirrors and glass show them black", _with(lambda m: m.unlit)),
    Difference(
        "cycles",
        "sheen",
        "Blender's sheen is another model, of Zeltner et al.; ours equals that of KHR_materials_sheen",
        _with(lambda m: m.sheen_color.max() > 0),
    ),
    Difference(
        "cycles",
        "anisotropy",
        "Blender makes another pair of roughnesses of an anisotropy",
        _with(lambda m: m.anisotropy > 0),
    ),
    Difference("cycles", "dispersion", "Cycles bends all colors alike", _with(lambda m: m.disperses)),
    Difference("mitsuba", "dispersion", "left out", _with(lambda m: m.disperses)),
    Difference(
        "luxcore",
        "dispersion",
        "its colors are bands of other wavelengths, chosen anew at each surface; rough glass has none",
        _with(lambda m: m.disperses),
    ),
    Difference("cycles", "iridescence", "Blender's importer leaves it out", _with(lambda m: m.iridescence > 0)),
    Difference(
        "cycles",
        "layering",
        "Cycles weakens the diffuse lobe by what the view's direction reflects, ours by both "
        "directions, which is reciprocal: at a roughness of 0.5 ours is 1 to 3 % brighter under steep light and 9 to "
        "13 % darker under light 5 to 10 degrees above the surface",
        _with(lambda m: _is_layered(m) and (m.metallic < 1 or m.metallic_roughness_texture)),
    ),
    *(
        Difference(
            renderer,
            "Fresnel",
            "a dielectric reflects by Fresnel's equations; ours by Schlick's approximation, as in glTF: "
            "7 % less of uniform light at an index of 1.5, a quarter less at 55 degrees, 6 % more at 85",
            _with(lambda m: _is_layered(m) and (m.metallic < 1 or m.metallic_roughness_texture)),
        )
        for renderer in ("cycles", "mitsuba")
    ),
    Difference(
        "cycles",
        "specular",
        "Blender's importer makes the weight of reflections one at normal incidence: rims "
        "reflect fully there; glTF weights them too",
        _with(lambda m: 0 < m.specular < 1 or m.specular_texture),
    ),
    Difference(
        "mitsuba",
        "principled",
        "Mitsuba's `principled` stands for the material: Disney's diffuse lobe "
        "is brighter at grazing angles, and rough metals lose what they reflect more than once",
        _with(_is_layered),
    ),
    Difference(
        "mitsuba",
        "rough glass",
        "its roughdielectric loses light that a rough surface scatters more than "
        "once: solids darken with their roughness",
        _with(lambda m: m.transmission > 0 and m.solid and m.perceptual_roughness > 0),
    ),
    *(Difference(renderer, *row) for renderer in ("mitsuba", "luxcore") for row in TRANSLATED),
    Difference(
        "mitsuba",
        "suns",
        "a sun has no disk: its shadows are sharp",
        _light(lambda light: isinstance(light, DirectionalLight)),
    ),
    Difference(
        "mitsuba",
        "spotlights",
        "their light falls off linearly with the angle, and they have no size",
        _light(_is_spot),
    ),
    Difference(
        "luxcore",
        "disney",
        "LuxCore's `disney` stands for the material: its diffuse lobe is brighter at "
        "grazing angles, and rough metals lose what they reflect more than once",
        _with(_is_layered),
    ),
    Difference(
        "luxcore",
        "partial glass",
        "left out: a material that transmits a part of its light is opaque there",
        _with(lambda m: 0 < m.transmission < 1 or m.transmission_texture or m.metallic > 0 < m.transmission),
    ),
    Difference(
        "luxcore",
        "thin glass",
        "its archglass lets all light pass and reflects a part besides: panes are up to 4 % brighter",
        _with(lambda m: m.transmission > 0 and not m.solid),
    ),
    Difference(
        "luxcore",
        "rough glass",
        "its roughglass has another distribution of normals, and loses light that a "
        "rough surface scatters more than once",
        _with(lambda m: m.transmission > 0 and m.solid and m.perceptual_roughness > 0),
    ),
    Difference(
        "luxcore",
        "texels",
        "textures are interpolated where the file says nearest, and repeated where it says mirrored",
        _with(
            lambda m: any(t.magnification == "nearest" or t.wrap_u == "mirrored_repeat" for t in _textures(m).values())
        ),
    ),
    Difference(
        "luxcore",
        "spotlights",
        "between its cones a spotlight falls off by another curve, and has no size",
        _light(_is_spot),
    ),
    Difference(
        "all",
        "range of lights",
        "light without an end, as real light",
        _light(lambda light: isinstance(light, PunctualLight) and light.range is not None),
    ),
    Difference(
        "all",
        "normal maps",
        "ours bends normals until the mirror direction is above the surface; steep normals "
        "seen at grazing angles are brighter or darker, also where the surface is matte",
        _with(lambda m: m.normal_texture),
    ),
    Difference(
        "all",
        "back sides",
        "cameras of ours don't see the back of single-sided surfaces, as glTF has it; "
        "others do: through blended and cut out surfaces, and of parts of meshes that face inwards",
        lambda scene: any(_shows_backs(item) for item in scene),
    ),
)


def that_apply(scene: Scene) -> list[Difference]:
    """The differences that a scene has reasons for."""
    return [difference for difference in DIFFERENCES if difference.applies(scene)]
