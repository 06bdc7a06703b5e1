"""The first picture of the documentation: flight helmets in the light of a photograph, by the path tracer, denoised.

    python tools/helmets.py FlightHelmet.gltf map.hdr -o docs/helmets.jpg [--size 1920x800] [--samples 8]

The model is Microsoft's FlightHelmet of the Khronos sample assets, the map Poly Haven's "Spiaggia di Mondello" (both
CC0).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import solari_vk as sv

# position in meters, turn about y in radians
HELMETS = (((0.0, 0.0, 0.0), 0.35), ((-0.95, 0.0, -1.1), 0.9), ((1.05, 0.0, -1.5), -0.5))


def helmets(model: Path, photograph: Path) -> sv.Scene:
    """Three helmets on a smooth floor that reaches to the horizon; the lens is focused on the first."""
    scene = sv.Scene(name="helmets")
    helmet = sv.load(model)
    for position, turn in HELMETS:
        scene.add(helmet, position=position, rotation=turn)
    floor = sv.Material(base_color=(0.2, 0.19, 0.18), roughness=0.22)
    scene.add(sv.shapes.plane(4000), floor, name="floor")
    scene.environment = sv.Environment(photograph, rotation=0.5)
    camera = sv.Camera.look_at((0.1, 0.5, 2.2), (0.06, 0.37, 0), fov=23, auto_exposure=True)
    scene.camera = camera.focus_on((0, 0.45, 0.12), 2.0)
    return scene


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model", type=Path)
    parser.add_argument("map", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--size", default="1920x800")
    parser.add_argument("--samples", type=int, default=8)
    options = parser.parse_args()
    width, height = map(int, options.size.split("x"))
    scene = helmets(options.model, options.map)
    with sv.Device() as device, sv.PathTracer(device, scene, (width, height)) as tracer:
        tracer.render(samples=options.samples, denoise=True).save(options.output)


if __name__ == "__main__":
    main()
