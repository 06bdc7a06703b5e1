"""Scene features: what some scenes hold and others don't, so that the shaders of the others are compiled without it.

Each row of FEATURES is a boolean constant SCENE_NAME, which `generated/bound/features.glsl` declares and
scene/bindings.glsl includes. In the modules for scenes without any feature it is plainly false: these modules hold no
code below `if (SCENE_NAME)`, and compiling them takes a third of the time. For other scenes it is a specialization
constant, so that one module serves each set of features, and drivers remove the code of features that are false; one
that many scenes have is such a constant in all modules. To add a feature, write its row, and use the constant in GLSL;
frames over a scene do the rest.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from types import NoneType
from typing import Any

import numpy as np

from solari_vk.bound.lights.light_tree import LightChoice
from solari_vk.gpu.shaders.compiler import COMMON_FEATURES
from solari_vk.scene.camera import Camera
from solari_vk.scene.lights.environment import EnvironmentLight
from solari_vk.scene.lights.portal import Portal
from solari_vk.scene.lights.punctual import PointLight, PunctualLight
from solari_vk.scene.material import Material, Texture
from solari_vk.scene.objects import Instance, Mesh


@dataclass(frozen=True)
class Feature:
    """A row of `FEATURES`: the class of what may have the feature in a scene, and whether one has it. Without a class,
    the feature is added by its constant."""

    name: str
    source: type[Any] = NoneType
    is_in: Callable[[Any], bool] = bool
    is_lobe: bool = False
    """Whether the feature adds a lobe, or several, to those that nearly all materials have."""
    transmits: bool = False
    """Whether light passes below surfaces by that lobe."""

    @property
    def constant(self) -> str:
        """The name of the constant."""
        return f"SCENE_{self.name}"


FEATURES = (
    Feature("ENVIRONMENT", EnvironmentLight, lambda light: True),
    Feature("LIGHT_TREE", LightChoice, lambda choice: choice.by_tree),
    Feature("LIGHT_STRATA", LightChoice, lambda choice: choice.by_strata),
    Feature("PORTAL", Portal, lambda light: True),
    Feature("POINT", PunctualLight, lambda light: light.radius == 0),
    Feature("SPHERE", PunctualLight, lambda light: light.radius > 0),
    Feature("PROFILES", PointLight, lambda light: light.profile is not None),
    Feature("POSES", Instance, lambda instance: instance.posed),
    Feature("PROXIES", Instance, lambda instance: instance.ray_mesh is not None),
    Feature("ALPHA", Instance, lambda instance: instance.alpha_mode != "opaque"),
    Feature("BLEND", Instance, lambda instance: instance.alpha_mode == "blend"),
    Feature("LARGE"),  # instances of LARGE_SIZE and more, which SceneRecords finds as it writes them
    Feature("VAST"),  # those of VAST_SIZE and more, likewise; shaders don't ask
    Feature("VERTEX_COLORS", Mesh, lambda mesh: mesh.colors is not None),
    Feature("SMOOTH_NORMALS"),  # as Geometry finds when it packs a mesh
    Feature("SECOND_UVS", Texture, lambda texture: texture.uv_set > 0),
    Feature("GLASS", Material, lambda material: material.transmission > 0, is_lobe=True, transmits=True),
    Feature(
        "DIFFUSE_TRANSMISSION",
        Material,
        lambda material: material.diffuse_transmission > 0,
        is_lobe=True,
        transmits=True,
    ),
    Feature("LAYERS", Material, lambda material: material.has_layers, is_lobe=True),
    Feature("IRIDESCENCE", Material, lambda material: material.iridescence > 0, is_lobe=True),
    Feature("DISPERSION", Material, lambda material: material.disperses),
    Feature("ABSORPTION", Material, lambda material: material.bounds_solid and bool(np.any(material.absorption))),
    Feature("UNLIT", Material, lambda material: material.unlit),
    Feature("LENSES", Camera, lambda camera: camera.has_lens),
)
LENSES = "SCENE_LENSES"
LARGE = "SCENE_LARGE"
SMOOTH_NORMALS = "SCENE_SMOOTH_NORMALS"
LARGE_SIZE = 100.0
"""In meters: the bits of barycentrics say where a point is on a triangle of that size to .01 mm."""
VAST = "SCENE_VAST"
VAST_SIZE = 1e5
"""In meters: rasterizers clip triangles of that size too coarsely for what is seen from less than a meter away."""
ABSORPTION = "SCENE_ABSORPTION"
LOBES = frozenset(feature.constant for feature in FEATURES if feature.is_lobe)


class Features:
    """The features that a scene has, or has had: objects that come and go then cost one compilation of pipelines."""

    def __init__(self) -> None:
        self.constants: frozenset[str] = frozenset()
        """The constants that are true."""

    def add(self, constant: str) -> None:
        """Add a feature by its constant."""
        self.constants |= {constant}

    def add_of(self, item: Any) -> None:
        """Add the features of an object that was added to a scene, or edited in it."""
        self.constants |= {row.constant for row in FEATURES if isinstance(item, row.source) and row.is_in(item)}


def _any_of(name: str, features: Iterable[Feature]) -> str:
    # A macro, because a constant with the value of a specialization constant would keep its default.
    return f"#define SCENE_{name} ({' || '.join(feature.constant for feature in features)})"


def glsl_header() -> str:
    """The declarations of the constants; SCENE_LOBES and SCENE_TRANSMISSION are true if one of these features is."""
    plain = {feature.constant: f"const bool {feature.constant} = false;" for feature in FEATURES}
    lobes = _any_of("LOBES", (feature for feature in FEATURES if feature.is_lobe))
    transmission = _any_of("TRANSMISSION", (feature for feature in FEATURES if feature.transmits))
    specialized = {name: f"layout(constant_id = {name}_id) {line}" for name, line in plain.items()}
    few = plain | {name: specialized[name] for name in COMMON_FEATURES}
    declared = ("#ifdef WITHOUT_FEATURES", *few.values(), "#else", *specialized.values(), "#endif")
    return "\n".join((*declared, lobes, transmission))
