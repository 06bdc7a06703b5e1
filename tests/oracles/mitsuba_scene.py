"""A solari_vk Scene (no textures, no suns) as a Mitsuba 3 scene, with Lambert, our own BRDF, or one of Mitsuba's; and
stored pictures of Mitsuba, which `python -m oracles.mitsuba_scene` in tests/ renders again.

Our BRDF is the NumPy oracle's, written as a Mitsuba BSDF: evaluation as in oracles.brdf with its albedo
tables, sampling by Mitsuba's own visible-normal and cosine sampling. Its vectorized form needs the variant
llvm_ad_rgb, and so LLVM 19 (Debian: libllvm19); scalar_rgb renders the Lambert scenes.
"""

import hashlib
import os
import sys
from functools import lru_cache
from glob import glob
from pathlib import Path

import numpy as np
from oracles.brdf import Surface

from solari_vk.scene.builtin import cornell_box
from solari_vk.scene.matrices import transform_points
from solari_vk.scene.model import Material


def select_variant(vectorized):
    """Import Mitsuba in a variant; None when the vectorized one is asked for and LLVM 19 is missing."""
    if vectorized and "DRJIT_LIBLLVM_PATH" not in os.environ:
        found = glob("/usr/lib/*/libLLVM.so.19*") + glob("/usr/lib/*/libLLVM-19.so*")
        if not found:
            return None
        os.environ["DRJIT_LIBLLVM_PATH"] = found[0]
    import mitsuba

    mitsuba.set_variant("llvm_ad_rgb" if vectorized else "scalar_rgb")
    return mitsuba


def scene_of(mi, scene, width, height, *, bounces, lambert=False, bsdf=None, camera=None, emitters=None):
    """The Mitsuba scene; pixels are averaged by a box, paths go up to `bounces` bounces without roulette.

    bsdf: Mitsuba's dictionary of one for all surfaces. emitters: lights that have no counterpart in ours, as its
    dictionaries by name.
    """
    camera = camera or scene.camera
    # Mitsuba looks along +z with +x to the left; ours looks along -z with +x to the right.
    to_world = camera.transform @ np.diag((-1.0, 1.0, -1.0, 1.0))
    film = {
        "type": "hdrfilm",
        "width": width,
        "height": height,
        "rfilter": {"type": "box"},
        "pixel_format": "rgb",
        "component_format": "float32",
    }
    sensor = {
        "type": "perspective",
        "fov": float(np.degrees(camera.vertical_fov)),
        "fov_axis": "y",
        "near_clip": 1e-3,
        "far_clip": 1e6,
        "to_world": mi.ScalarTransform4f(to_world),
        "film": film,
        "sampler": {"type": "independent"},
    }
    if camera.aperture:
        sensor |= {"type": "thinlens", "aperture_radius": camera.aperture / 2, "focus_distance": camera.focus_distance}
    integrator = {"type": "path", "max_depth": bounces + 1, "rr_depth": 1000}
    parts = {"type": "scene", "integrator": integrator, "sensor": sensor, **(emitters or {})}
    for index, instance in enumerate(scene):
        if instance.visible:
            parts[f"shape{index}"] = _mesh(mi, instance, f"shape{index}", lambert, bsdf)
    return mi.load_dict(parts)


def environment_of(mi, environment, pixels):
    """Mitsuba's emitter for an environment, of its radiance in rows from pole to pole."""
    # In Mitsuba a map's middle column is +z and longitude runs towards -x; ours is +x and runs towards +z.
    to_world = np.eye(4)
    to_world[:3, :3] = environment.rotation @ np.array(((0, 0, 1), (0, 1, 0), (-1, 0, 0)))
    return {"type": "envmap", "bitmap": mi.Bitmap(pixels), "to_world": mi.ScalarTransform4f(to_world)}


def _mesh(mi, instance, name, lambert, given):
    mesh = instance.ray_mesh or instance.mesh
    material = instance.material
    properties = mi.Properties()
    if given:
        bsdf = mi.load_dict(given)
    elif lambert:
        plain = {"type": "diffuse", "reflectance": {"type": "rgb", "value": material.base_color.tolist()}}
        bsdf = mi.load_dict({"type": "twosided", "bsdf": plain})
    else:
        bsdf = mi.load_dict({"type": "solari", "surface": _key(material)})
    properties["mesh_bsdf"] = bsdf
    if material.emits:
        emission = {"type": "area", "radiance": {"type": "rgb", "value": material.emissive.tolist()}}
        properties["mesh_emitter"] = mi.load_dict(emission)
    properties["face_normals"] = mesh.normals is None
    triangles = mesh.triangles
    # Mitsuba takes the front of a triangle from the order of its corners in the world, ours from that in the mesh.
    if np.linalg.det(instance.transform[:3, :3]) < 0:
        triangles = triangles[:, ::-1]
    smooth = mesh.normals is not None
    made = mi.Mesh(name, len(mesh.positions), len(triangles), has_vertex_normals=smooth, props=properties)
    parameters = mi.traverse(made)
    world = transform_points(instance.transform, mesh.positions)
    parameters["vertex_positions"] = np.ascontiguousarray(world, np.float32).ravel()
    parameters["faces"] = np.ascontiguousarray(triangles, np.uint32).ravel()
    if mesh.normals is not None:
        normals = mesh.normals @ np.linalg.inv(instance.transform[:3, :3])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        parameters["vertex_normals"] = np.ascontiguousarray(normals, np.float32).ravel()
    parameters.update()
    return made


_surfaces: list[tuple] = []


def _key(material):
    """An id for a material's BRDF, because a plugin's properties can't hold Python objects."""
    colors = (tuple(map(float, color)) for color in (material.base_color, material.reflectance))
    key = (*colors, material.metallic, material.perceptual_roughness)
    if key not in _surfaces:
        _surfaces.append(key)
    return _surfaces.index(key)


@lru_cache
def _surface(key):
    color, reflectance, metallic, roughness = _surfaces[key]
    return Surface(color, metallic, roughness, reflectance)


def register_bsdf(mi):
    """Make the BSDF 'solari' known to the chosen variant; call once per variant."""
    import drjit as dr

    class SolariBsdf(mi.BSDF):
        def __init__(self, properties):
            mi.BSDF.__init__(self, properties)
            self.surface = _surface(int(properties["surface"]))
            flags = mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
            self.m_components = [mi.BSDFFlags.GlossyReflection | flags, mi.BSDFFlags.DiffuseReflection | flags]
            self.m_flags = self.m_components[0] | self.m_components[1]
            surface = self.surface
            self.alpha = max(surface.alpha, 2e-3)
            self.microfacets = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, self.alpha, True)
            # 1 - E of the dielectric and A + B over the square root of the cosine, evenly spaced.
            roots = np.linspace(0.05, 1, 1024)
            through = 1 - surface.layer.albedo(roots**2, surface.dielectric_f0)
            self.through = mi.Float(through.astype(np.float32).ravel())
            a, b = surface.layer.terms(roots**2)
            self.single = mi.Float((a + b).astype(np.float32))
            lost = 1 - surface.layer.average_albedo(surface.dielectric_f0)
            self.diffuse_color = mi.Color3f((surface.base_color / np.pi / lost).tolist())
            self.dielectric_f0 = mi.Color3f(surface.dielectric_f0.tolist())
            self.metal_f0 = mi.Color3f(surface.base_color.tolist())

        def lookup(self, table, cosine, channels):
            place = (dr.sqrt(dr.clip(cosine, 0.0025, 1.0)) - 0.05) / 0.95 * 1023
            low = mi.UInt32(dr.clip(place, 0, 1022))
            part = place - low
            values = []
            for channel in range(channels):
                first = dr.gather(mi.Float, table, low * channels + channel)
                second = dr.gather(mi.Float, table, (low + 1) * channels + channel)
                values.append(dr.lerp(first, second, part))
            return values

        def value_and_pdf(self, wo_in, wi_in):
            """The BRDF times cosine, and the pdf. Mitsuba's wi is the direction to the viewer, which is wo_in here."""
            sign = dr.sign(wo_in.z)
            wo, wi = wo_in * sign, wi_in * sign
            above = (wo.z > 0) & (wi.z > 0)
            half = dr.normalize(wo + wi)
            density = self.microfacets.eval(half)
            shadow = 1 / (1 + self.smith_lambda(wo.z) + self.smith_lambda(wi.z))
            shape = density * shadow / (4 * wo.z)
            weight = dr.power(dr.clip(1 - dr.dot(wo, half), 0, 1), 5)
            (single,) = self.lookup(self.single, wo.z, 1)

            def specular(f0):
                return (f0 + (1 - f0) * weight) * (1 + f0 * (1 / single - 1)) * shape

            through = mi.Color3f(*self.lookup(self.through, wo.z, 3)) * mi.Color3f(*self.lookup(self.through, wi.z, 3))
            dielectric = self.diffuse_color * through * wi.z + specular(self.dielectric_f0)
            metallic = self.surface.metallic
            value = (1 - metallic) * dielectric + metallic * specular(self.metal_f0)
            visible = density / (4 * wo.z * (1 + self.smith_lambda(wo.z)))
            pdf = 0.5 * visible + 0.5 * wi.z / dr.pi
            return dr.select(above, value, 0), dr.select(above, pdf, 0)

        def smith_lambda(self, cosine):
            tangent_squared = (1 - cosine * cosine) / (cosine * cosine)
            return (dr.sqrt(1 + self.alpha * self.alpha * tangent_squared) - 1) / 2

        def sample(self, ctx, si, sample1, sample2, active=True):
            sign = dr.sign(si.wi.z)
            wo = si.wi * sign
            normal, _ = self.microfacets.sample(wo, sample2)
            reflected = 2 * dr.dot(wo, normal) * normal - wo
            wi = dr.select(sample1 < 0.5, reflected, mi.warp.square_to_cosine_hemisphere(sample2))
            value, pdf = self.value_and_pdf(wo, wi)
            active &= (wo.z > 0) & (wi.z > 0) & (pdf > 0)
            result = mi.BSDFSample3f()
            result.wo = wi * sign
            result.pdf = pdf
            result.eta = 1.0
            result.sampled_type = mi.UInt32(+mi.BSDFFlags.GlossyReflection)
            result.sampled_component = 0
            return dr.select(active, result, dr.zeros(mi.BSDFSample3f)), dr.select(active, value / pdf, 0)

        def eval(self, ctx, si, wo, active=True):
            return dr.select(active, self.value_and_pdf(si.wi, wo)[0], 0)

        def pdf(self, ctx, si, wo, active=True):
            return dr.select(active, self.value_and_pdf(si.wi, wo)[1], 0)

        def eval_pdf(self, ctx, si, wo, active=True):
            value, pdf = self.value_and_pdf(si.wi, wo)
            return dr.select(active, value, 0), dr.select(active, pdf, 0)

        def to_string(self):
            return "SolariBsdf[]"

    mi.register_bsdf("solari", SolariBsdf)


def render(mi, mitsuba_scene, batches, samples, seed=0):
    """Mean (h, w, 3) of independent batches of samples and the variance of that mean.

    The variance is per pixel over the batches; use at least 8.
    """
    images = []
    for batch in range(batches):
        # Seeds are far apart, because scalar variants seed a picture's blocks with successive numbers.
        image = mi.render(mitsuba_scene, spp=samples, seed=(seed * 1000 + batch) * 65_537 % 2**32)
        images.append(np.array(image, np.float64))
    stack = np.stack(images)
    return stack.mean(axis=0), stack.var(axis=0, ddof=1) / batches


# ---- stored pictures ----


REFERENCES = Path(__file__).parent / "references"
REFERENCE_SIZE = 64
REFERENCE_BOUNCES = 4


def lambert_box():
    return cornell_box(), True


def glossy_box():
    """The Cornell box with a rough gold block, a glossy plastic one, and half-metallic walls."""
    scene = cornell_box()
    gold = Material(base_color=(1.0, 0.77, 0.34), metallic=1.0, perceptual_roughness=0.45)
    plastic = Material(base_color=(0.2, 0.35, 0.7), perceptual_roughness=0.35, reflectance=(0.5, 0.7, 0.9))
    for instance in scene:
        if instance.name == "tall block":
            instance.material = gold
        elif instance.name == "short block":
            instance.material = plastic
        elif instance.name == "room":
            instance.material.update(perceptual_roughness=0.6, metallic=0.3, reflectance=0.5)
    return scene, False


REFERENCE_SCENES = {"lambert": lambert_box, "glossy": glossy_box}


def fingerprint(scene):
    """A hash of the scene's geometry, materials and camera, rounded so that all platforms agree."""
    digest = hashlib.sha256()
    for instance in scene:
        material = instance.material
        numbers = [instance.transform, instance.mesh.positions[instance.mesh.triangles], material.base_color]
        numbers += [material.emissive, material.metallic, material.perceptual_roughness, material.reflectance]
        for value in numbers:
            digest.update(np.round(np.asarray(value, np.float64) * 1e4).astype(np.int64).tobytes())
    camera = scene.camera
    digest.update(np.round(np.append(camera.transform, camera.vertical_fov) * 1e4).astype(np.int64).tobytes())
    return digest.hexdigest()


def load_reference(name):
    """The stored picture's mean and variance (height, width, 3), and its scene's fingerprint."""
    with np.load(REFERENCES / f"{name}.npz") as stored:
        return {"mean": stored["mean"], "variance": stored["variance"], "fingerprint": str(stored["fingerprint"])}


def main():
    """Render the stored pictures again, which needs LLVM 19."""
    mitsuba = select_variant(vectorized=True)
    if mitsuba is None:
        return "the vectorized Mitsuba needs LLVM 19 (Debian: libllvm19)"
    register_bsdf(mitsuba)
    REFERENCES.mkdir(exist_ok=True)
    for name, case in REFERENCE_SCENES.items():
        scene, lambert = case()
        made = scene_of(mitsuba, scene, REFERENCE_SIZE, REFERENCE_SIZE, bounces=REFERENCE_BOUNCES, lambert=lambert)
        mean, variance = render(mitsuba, made, batches=32, samples=1024)
        np.savez_compressed(
            REFERENCES / f"{name}.npz",
            mean=mean.astype(np.float32),
            variance=variance.astype(np.float32),
            fingerprint=fingerprint(scene),
        )
        error = np.sqrt(variance.mean()) / mean.mean() / REFERENCE_SIZE
        print(f"{name}: mean {mean.mean():.6f}, relative error {error:.5%}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
