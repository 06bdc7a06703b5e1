"""LuxCore (`pip install pyluxcore numpy`), of the meshes and materials in mitsuba.json: see translation.py."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np  # before pyluxcore, which replaces the functions that allocate memory
import pyluxcore

WRAPS = {"repeat": "repeat", "mirror": "repeat", "clamp": "clamp"}
DISNEY = {"base_color": "basecolor", "clearcoat_gloss": "clearcoatgloss"}
FROM_MAP = np.array(((-1, 0, 0), (0, 0, 1), (0, 1, 0)))  # of LuxCore's maps, which have z up and run the other way
GLASS = {"dielectric": "glass", "roughdielectric": "roughglass", "thindielectric": "archglass"}


def load(job: dict[str, Any], folder: Path) -> Callable[[int, int], Any]:
    """A function that renders the scene; see child.py."""
    pyluxcore.Init()
    scene = Builder(job, folder).scene()
    width, height = job["size"]
    depth = job["max_bounces"] + 1
    settings = {
        "renderengine.type": "PATHCPU",
        "sampler.type": "RANDOM",
        # Russian roulette begins where no path is left: the other renderers have none.
        "path.russianroulette.depth": 1000,
        **{f"path.pathdepth.{kind}": depth for kind in ("total", "diffuse", "glossy", "specular")},
        "film.width": width,
        "film.height": height,
        "film.filter.type": "BOX",
        "film.filter.width": 0.5,
        "film.imagepipelines.0.0.type": "NOP",
    }

    def render(samples: int, seed: int) -> Any:
        chosen = properties(settings | {"renderengine.seed": seed + 1, "batch.haltspp": samples})
        session = pyluxcore.RenderSession(pyluxcore.RenderConfig(chosen, scene))
        session.Start()
        # LuxCore checks its halt conditions only when its statistics are asked for.
        while not session.HasDone():
            time.sleep(0.005)
            session.UpdateStats()
        session.Stop()
        picture = np.zeros((height, width, 3), np.float32)
        session.GetFilm().GetOutputFloat(pyluxcore.FilmOutputType.RGB, picture)
        # Its first row is the lowest one.
        return picture[::-1]

    return render


def properties(values: dict[str, Any]) -> Any:
    """Names and values as LuxCore takes them."""
    made = pyluxcore.Properties()
    for name, value in values.items():
        made.Set(pyluxcore.Property(name, np.asarray(value).tolist()))
    return made


class Builder:
    """Makes LuxCore's scene of a job."""

    def __init__(self, job: dict[str, Any], folder: Path) -> None:
        self.job = job
        self.folder = folder
        self.translated = json.loads((folder / "mitsuba.json").read_text(encoding="utf-8"))
        self.made = pyluxcore.Scene()
        self.count = 0  # of textures

    def parse(self, prefix: str, values: dict[str, Any]) -> None:
        self.made.Parse(properties({f"scene.{prefix}.{name}": value for name, value in values.items()}))

    def scene(self) -> Any:
        """The scene."""
        self.camera()
        for index, light in enumerate(self.job["lights"]):
            self.parse(f"lights.light{index}", self.light(light))
        if self.job["environment"] is not None:
            self.environment(self.job["environment"])
        for index, material in enumerate(self.translated["materials"]):
            self.parse(f"materials.material{index}", self.material(material))
        for index, shape in enumerate(self.translated["shapes"]):
            arrays = np.load(self.folder / shape["file"])
            names = ("positions", "triangles", "normals", "uvs", "colors")
            lists = [list(map(tuple, arrays[name].tolist())) if name in arrays else None for name in names]
            self.made.DefineMesh(f"mesh{index}", *lists, None)
            self.parse(f"objects.object{index}", {"shape": f"mesh{index}", "material": f"material{shape['material']}"})
        return self.made

    def camera(self) -> None:
        """It looks along -z with y up; the angle is that between top and bottom. LuxCore shows all a pixel too low.
        An orthographic window is in meters."""
        camera = self.job["camera"]
        (width, height) = self.job["size"]
        place = np.array(camera["transform"])
        half = camera["orthographic_height"] / 2
        # Shifted by one pixel, so that pictures lie where ours do.
        window = (half or 1) * np.array([-width / height, width / height, -1 - 2 / height, 1 - 2 / height])
        self.parse(
            "camera",
            {
                "type": "orthographic" if half else "perspective",
                "lookat.orig": place[:3, 3],
                "lookat.target": place[:3, 3] - place[:3, 2],
                "up": place[:3, 1],
                "fieldofview": float(np.degrees(camera["vertical_fov"])),
                "screenwindow": window,
                "cliphither": camera["near"],
                "clipyon": 1e6,
                "autovolume.enable": 0,
                "shutteropen": 0.0,
                "shutterclose": 0.0,
            },
        )

    def light(self, light: dict[str, Any]) -> dict[str, Any]:
        """Suns with a disk, and points and spheres, whose gain is over all directions."""
        if light["kind"] == "directional":
            half = light["angular_diameter"] / 2
            cosine = float(np.cos(np.float32(half)))  # rounded as LuxCore rounds it
            # A disk of radiance L and half angle a gives pi L sin^2(a) lux to a surface that faces it.
            radiance = light["illuminance"] / (np.pi * (1 - cosine**2))
            return {
                "type": "distant",
                "direction": light["direction"],
                "theta": float(np.degrees(half)),
                "color": light["color"],
                "gain": [radiance] * 3,
            }
        found = {"position": light["position"], "color": light["color"]}
        if light["kind"] == "spot":
            inner, outer = (float(np.degrees(light[f"{name}_cone_angle"])) for name in ("inner", "outer"))
            target = np.array(light["position"]) + light["direction"]
            return found | {
                "type": "spot",
                "target": target,
                "coneangle": outer,
                "conedeltaangle": outer - inner,
                "gain": [light["intensity"]] * 3,
            }
        kind = {"type": "sphere", "radius": light["radius"]} if light["radius"] > 0 else {"type": "point"}
        return found | kind | {"gain": [4 * np.pi * light["intensity"]] * 3}

    def environment(self, environment: dict[str, Any]) -> None:
        # LuxCore's maps run the other way around.
        texels = np.load(self.folder / environment["texels"])[:, ::-1]
        self.image("environment", np.repeat(texels, 2, axis=1) if texels.shape[1] == 1 else texels)
        to_world = np.eye(4)
        to_world[:3, :3] = np.array(environment["rotation"]) @ FROM_MAP
        self.parse(
            "lights.environment",
            {
                "type": "infinite",
                "file": "environment",
                "gamma": 1.0,
                "transformation": to_world.T.ravel(),
                "gain": [environment["intensity"]] * 3,
            },
        )

    def image(self, name: str, texels: Any) -> None:
        height, width, channels = texels.shape
        self.made.DefineImageMap(name, np.ascontiguousarray(texels, np.float32).ravel(), 1.0, channels, width, height)

    def texture(self, texture: Any) -> Any:
        """A number or a color as it is; of a dictionary the name of a texture, whose file holds linear values."""
        if not isinstance(texture, dict):
            return texture
        self.count += 1
        name = f"texture{self.count}"
        if "attribute" in texture:
            self.parse(f"textures.{name}", {"type": "hitpointcolor"})
            return name
        self.image(texture["file"], np.load(self.folder / texture["file"]))
        self.parse(
            f"textures.{name}",
            {"type": "imagemap", "file": texture["file"], "gamma": 1.0, "wrap": WRAPS[texture["wrap"]]},
        )
        return name

    def material(self, material: dict[str, Any]) -> dict[str, Any]:
        """A material, with what it emits."""
        parameters = {name: self.texture(value) for name, value in material["parameters"].items()}
        if material["type"] == "diffuse":
            made = {"type": "matte", "kd": parameters.get("reflectance", [0.0] * 3)}
        elif material["type"] in GLASS:
            made = {
                "type": GLASS[material["type"]],
                "kr": [1.0] * 3,
                "kt": parameters["specular_transmittance"],
                "interiorior": parameters["int_ior"],
            }
            if material["cauchy"] and material["type"] == "dielectric":
                made["cauchyb"] = material["cauchy"]  # its index of refraction is that of endless waves
                made["interiorior"] -= material["cauchy"] / 0.58756**2
            if "alpha" in parameters:
                made |= dict.fromkeys(("uroughness", "vroughness"), parameters["alpha"])
        else:
            # Disney's "specular" is the reflection straight on over 0.08.
            eta = parameters.pop("eta")
            # LuxCore's model cannot transmit light: see differences.py.
            parameters.pop("spec_trans", None)
            made = {"type": "disney", "specular": ((eta - 1) / (eta + 1)) ** 2 / 0.08}
            made |= {DISNEY.get(name, name): value for name, value in parameters.items()}
        if "normal" in material:
            self.count += 1
            name = f"normal{self.count}"
            self.parse(f"textures.{name}", {"type": "normalmap", "texture": self.texture(material["normal"])})
            made["bumptex"] = name
        if "opacity" in material:
            made["transparency"] = self.texture(material["opacity"])
        if "radiance" in material:
            made |= {"emission": self.texture(material["radiance"]), "emission.gain": [1.0] * 3, "emission.power": 0.0}
        return made
