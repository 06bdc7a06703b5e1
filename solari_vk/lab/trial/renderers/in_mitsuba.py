"""Mitsuba 3 (`pip install mitsuba`), of the meshes and materials in mitsuba.json: see translation.py."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from glob import glob
from pathlib import Path
from typing import Any

import numpy as np

SAMPLES_AT_ONCE = 2**21  # of all pixels: vectorized variants hold the state of all paths
FROM_MAP = np.array(((0, 0, 1), (0, 1, 0), (-1, 0, 0)))  # of Mitsuba's environment maps, whose middle column is +z


def load(job: dict[str, Any], folder: Path) -> Callable[[int, int], Any]:
    """A function that renders the scene; see child.py."""
    scene = Builder(job, folder).scene()
    width, height = job["size"]

    def render(samples: int, seed: int) -> Any:
        total = np.zeros((height, width, 3))
        done = 0
        while done < samples:
            count = min(samples - done, max(SAMPLES_AT_ONCE // (width * height), 1))
            number = (seed * 65_537 + done) * 65_537 % 2**32  # scalar variants count on from it for a picture's blocks
            total += count * np.array(mi.render(scene, spp=count, seed=number), np.float64)[..., :3]
            done += count
        return total / samples

    return render


def select_variant() -> Any:
    """Mitsuba, vectorized where there is LLVM from 19 on, whose library Dr.Jit doesn't find everywhere by itself."""
    found = sorted(glob("/usr/lib/*/libLLVM.so.*") + glob("/usr/lib/*/libLLVM-1[0-9].so*"))
    usable = [name for name in found if any(f".so.{n}" in name or f"-{n}." in name for n in range(16, 30))]
    if usable:
        os.environ.setdefault("DRJIT_LIBLLVM_PATH", usable[-1])
    import mitsuba

    mitsuba.set_variant("llvm_ad_rgb" if "DRJIT_LIBLLVM_PATH" in os.environ else "scalar_rgb")
    return mitsuba


mi = select_variant()


class Builder:
    """Makes Mitsuba's scene of a job."""

    def __init__(self, job: dict[str, Any], folder: Path) -> None:
        self.job = job
        self.folder = folder
        self.translated = json.loads((folder / "mitsuba.json").read_text(encoding="utf-8"))

    def scene(self) -> Any:
        """The scene, with a box as pixel filter and without roulette."""
        job = self.job
        camera = self.job["camera"]
        width, height = job["size"]
        # Mitsuba looks along +z with +x to the left; orthographic pictures are 2 wide.
        half = camera["orthographic_height"] / 2 * width / height
        to_world = mi.ScalarTransform4f(np.array(camera["transform"]) @ np.diag((-(half or 1), half or 1, -1.0, 1.0)))
        film = {
            "type": "hdrfilm",
            "width": width,
            "height": height,
            "rfilter": {"type": "box"},
            "pixel_format": "rgb",
            "component_format": "float32",
        }
        # An orthographic sensor has no angle.
        angle = {} if half else {"fov": float(np.degrees(camera["vertical_fov"])), "fov_axis": "y"}
        sensor = {
            "type": "orthographic" if half else "perspective",
            **angle,
            "near_clip": camera["near"],
            "far_clip": 1e6,
            "to_world": to_world,
            "film": film,
            "sampler": {"type": "independent"},
        }
        # Mitsuba counts the segments of a path, of which there is one more than bounces. Russian roulette begins where
        # no path is left: the other renderers have none.
        integrator = {"type": "path", "max_depth": job["max_bounces"] + 1, "rr_depth": 1000}
        parts: dict[str, Any] = {"type": "scene", "integrator": integrator, "sensor": sensor}
        for index, light in enumerate(job["lights"]):
            parts[f"light{index}"] = self.light(light)
        if job["environment"] is not None:
            parts["environment"] = self.environment(job["environment"])
        materials = [self.material(material) for material in self.translated["materials"]]
        for index, shape in enumerate(self.translated["shapes"]):
            parts[f"shape{index}"] = self.shape(f"shape{index}", shape, *materials[shape["material"]])
        return mi.load_dict(parts)

    def light(self, light: dict[str, Any]) -> dict[str, Any]:
        """An emitter: suns without a disk, spheres as spheres."""
        if light["kind"] == "directional":
            return {
                "type": "directional",
                "direction": light["direction"],
                "irradiance": rgb(np.array(light["color"]) * light["illuminance"]),
            }
        intensity = np.array(light["color"]) * light["intensity"]
        if light["kind"] == "point" and light["radius"] > 0:
            # A sphere of radiance L has the intensity pi r^2 L in all directions: each sees a disk.
            radiance = intensity / (np.pi * light["radius"] ** 2)
            return {
                "type": "sphere",
                "center": light["position"],
                "radius": light["radius"],
                # Lights of ours reflect nothing.
                "bsdf": {"type": "diffuse", "reflectance": 0.0},
                "emitter": {"type": "area", "radiance": rgb(radiance)},
            }
        if light["kind"] == "point":
            return {"type": "point", "position": light["position"], "intensity": rgb(intensity)}
        at = np.array(light["position"])
        # Any axis that is far from the direction.
        up = np.eye(3)[np.argmin(np.abs(light["direction"]))]
        place = mi.ScalarTransform4f().look_at(origin=at, target=at + light["direction"], up=up)
        outer, inner = (float(np.degrees(light[f"{name}_cone_angle"])) for name in ("outer", "inner"))
        return {
            "type": "spot",
            "to_world": place,
            "intensity": rgb(intensity),
            "cutoff_angle": outer,
            "beam_width": inner,
        }

    def environment(self, environment: dict[str, Any]) -> dict[str, Any]:
        """The map by rows from pole to pole, as Mitsuba has them, with the same values between texels' centers."""
        texels = np.load(self.folder / environment["texels"]) * environment["intensity"]
        height, width = texels.shape[:2]
        # Rows at the centers of texels and at their borders: twice as many and one.
        row = np.clip(np.arange(2 * height + 1) / 2 - 0.5, 0, height - 1)
        low = np.minimum(row.astype(int), max(height - 2, 0))
        share = (row - low)[:, None, None]
        texels = texels[low] * (1 - share) + texels[np.minimum(low + 1, height - 1)] * share
        if width == 1:
            texels = np.repeat(texels, 2, axis=1)
        to_world = np.eye(4)
        to_world[:3, :3] = np.array(environment["rotation"]) @ FROM_MAP
        bitmap = mi.Bitmap(np.ascontiguousarray(texels, np.float32))
        return {"type": "envmap", "bitmap": bitmap, "to_world": mi.ScalarTransform4f(to_world)}

    def texture(self, texture: Any) -> Any:
        """A number or a color as it is; of a dictionary the texture, whose file holds linear values."""
        if not isinstance(texture, dict):
            return rgb(texture) if isinstance(texture, list) else texture
        if "attribute" in texture:
            return {"type": "mesh_attribute", "name": texture["attribute"]}
        bitmap = mi.Bitmap(np.load(self.folder / texture["file"]))
        return {
            "type": "bitmap",
            "bitmap": bitmap,
            "raw": True,
            "wrap_mode": texture["wrap"],
            "filter_type": texture["filter"],
        }

    def material(self, material: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any] | None]:
        """The BSDF and the emitter of a material."""
        bsdf: dict[str, Any] = {"type": material["type"]}
        bsdf |= {name: self.texture(value) for name, value in material["parameters"].items()}
        if "normal" in material:
            bsdf = {"type": "normalmap", "normalmap": self.texture(material["normal"]), "bsdf": bsdf}
        if not material["type"].endswith("dielectric") and not material["parameters"].get("spec_trans"):
            bsdf = {"type": "twosided", "bsdf": bsdf}
        if "opacity" in material:
            bsdf = {"type": "mask", "opacity": self.texture(material["opacity"]), "bsdf": bsdf}
        emitted = material.get("radiance")
        return bsdf, None if emitted is None else {"type": "area", "radiance": self.texture(emitted)}

    def shape(self, name: str, shape: dict[str, Any], bsdf: dict[str, Any], emitter: dict[str, Any] | None) -> Any:
        """A mesh."""
        arrays = np.load(self.folder / shape["file"])
        properties = mi.Properties()
        properties["mesh_bsdf"] = mi.load_dict(bsdf)
        if emitter is not None:
            properties["mesh_emitter"] = mi.load_dict(emitter)
        properties["face_normals"] = "normals" not in arrays
        mesh = mi.Mesh(
            name,
            len(arrays["positions"]),
            len(arrays["triangles"]),
            props=properties,
            has_vertex_normals="normals" in arrays,
            has_vertex_texcoords="uvs" in arrays,
        )
        if "colors" in arrays:
            mesh.add_attribute("vertex_color", 3, arrays["colors"].ravel())
        names = {
            "positions": "vertex_positions",
            "normals": "vertex_normals",
            "uvs": "vertex_texcoords",
            "triangles": "faces",
        }
        parameters = mi.traverse(mesh)
        for key in names.keys() & set(arrays):
            parameters[names[key]] = arrays[key].ravel()
        parameters.update()
        return mesh


def rgb(color: Any) -> dict[str, Any]:
    """A color that may be larger than 1."""
    return {"type": "rgb", "value": [float(value) for value in color]}
