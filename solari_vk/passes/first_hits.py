"""Outputs at pixels' centers: what they mean, and the GLSL that computes each one from the surface that a ray hits.

To add an output, add a row to FIRST_HITS. Both renderers, batches, data sets, the command line and the documentation
have it then. A value that takes more than an expression is a function in glsl/passes/reference/aov.glsl.
"""

from __future__ import annotations

from dataclasses import dataclass

GEOMETRIC_NORMAL = "front_face ? point.geometric_world_normal : -point.geometric_world_normal"


@dataclass(frozen=True)
class FirstHit:
    """An output that describes the surface at each pixel's center.

    type: of GLSL. value: a GLSL expression of that type. It knows `CameraRay ray`, `Hit hit`, `Mesh mesh`, which is the
    one that was hit, and `SurfaceInteraction surface`. geometric: the same without the surface's material, which takes
    time of its own, from `TrianglePoint point` and `bool front_face` in place of `surface`; "" if the output needs the
    material. nothing: the value where the ray hits nothing.
    """

    type: str
    value: str
    meaning: str
    nothing: str
    geometric: str = ""

    @property
    def has_mean(self) -> bool:
        """Whether values can be averaged over a pixel's area: numbers of objects can't."""
        return self.type != "uint"


FIRST_HITS = {
    "depth": FirstHit(
        "float",
        "hit.t * ray.depth_per_t",
        "distance along the view axis, in meters; inf in the background; of [wide lenses](cameras.md) along the ray",
        "INFINITY",
        "hit.t * ray.depth_per_t",
    ),
    "distance": FirstHit(
        "float", "hit.t", "along the ray, from the camera, in meters; inf in the background", "INFINITY", "hit.t"
    ),
    "position": FirstHit(
        "vec3",
        "surface.world_position + scene_info.origin",
        "in the world, in meters",
        "vec3(0.0)",
        "point.world_position + scene_info.origin",
    ),
    "geometric_normal": FirstHit(
        "vec3",
        "surface.geometric_world_normal",
        "the triangle's own normal, a unit vector in the world, towards the camera",
        "vec3(0.0)",
        GEOMETRIC_NORMAL,
    ),
    "shading_normal": FirstHit(
        "vec3", "surface.world_normal", "the normal that light sees, a unit vector in the world", "vec3(0.0)"
    ),
    "camera_normal": FirstHit(
        "vec3",
        "surface.world_normal * mat3(camera.world_from_view) * Y_UP",
        "`shading_normal` in the camera's axes as OpenCV has them: x right, y down, z forward",
        "vec3(0.0)",
    ),
    "uv": FirstHit(
        "vec2",
        "texture_point(mesh, mesh.triangles.at[hit.triangle], hit.barycentrics).uv",
        "the first set, 0 without one",
        "vec2(0.0)",
    ),
    "albedo": FirstHit("vec3", "surface.material.base.color", "the material's base color, linear", "vec3(0.0)"),
    "roughness_metallic": FirstHit(
        "vec2",
        "vec2(surface.material.base.perceptual_roughness, surface.material.base.metallic)",
        "the material's perceptual roughness and metallic",
        "vec2(0.0)",
    ),
    "emissive": FirstHit("vec3", "shown_emission(surface)", "the radiance that the material emits", "vec3(0.0)"),
    "instance_id": FirstHit(
        "uint",
        "instance_number(hit.instance)",
        "a number from 0 on, 4294967295 in the background; `frame.instances[number]` is the instance. Each primitive "
        "of a glTF mesh is one, [a part](outputs.md#labels) of the node's object",
        "NO_INDEX",
        "instance_number(hit.instance)",
    ),
    "material_id": FirstHit(
        "uint", "instances.at[hit.instance].material", "a number; `frame.materials[number]` is the material", "NO_INDEX"
    ),
}
"""The outputs by name, in the order in which frames list them."""
GEOMETRY = tuple(name for name, output in FIRST_HITS.items() if output.geometric)
"""The outputs that need no material."""


def glsl_header() -> str:
    """The buffers `aov_NAME`, and macros that store all outputs of a pixel where what their values know is defined."""
    # Macros rather than functions, because this header is included before the structs that the values are made of.
    outputs = FIRST_HITS.items()
    blocks = [f"layout(set = 1, scalar) buffer Aov_{name} {{ {row.type} at[]; }} aov_{name};" for name, row in outputs]
    macros = {
        "STORE_FIRST_HITS": {name: row.value for name, row in outputs},
        "STORE_NO_FIRST_HITS": {name: row.nothing for name, row in outputs},
        "STORE_GEOMETRY": {name: row.geometric for name, row in outputs if row.geometric},
        "STORE_NO_GEOMETRY": {name: row.nothing for name, row in outputs if row.geometric},
    }
    return "\n".join([*blocks, *(_macro(name, values) for name, values in macros.items())])


def _macro(name: str, values: dict[str, str]) -> str:
    """A macro of one line, as GLSL's preprocessor takes it, that stores values at an index of their buffers."""
    stores = (f"aov_{output}.at[index] = {value};" for output, value in values.items())
    return f"#define {name}(index) " + " ".join(stores)
