"""A torch-lit room made of the pieces of a glTF dungeon kit: an example of how to combine scenes in Python.

    python tools/dungeon_room.py KIT_FOLDER -o dungeon_room.png [--size 640x360] [--samples 256]

KIT_FOLDER holds the .glb files of the KayKit Dungeon kit (CC0).
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.builtin import place

FLAME = (60.0, 24.0, 6.0)  # radiance

# piece, position in meters, rotation about y in degrees
PIECES = (
    *(("floor_tile_large", (x, 0, z), 0) for x in (-4, 0, 4) for z in (-4, 0, 4) if (x, z) != (4, -4)),
    ("floor_tile_large_rocks", (4, 0, -4), 0),
    ("wall", (-4, 0, -6), 0),
    ("wall_arched", (0, 0, -6), 0),
    ("wall_shelves", (4, 0, -6), 0),
    ("wall", (-6, 0, -4), 90),
    ("wall_window_open", (-6, 0, 0), 90),
    ("wall", (-6, 0, 4), 90),
    ("wall", (6, 0, -4), -90),
    ("wall_doorway", (6, 0, 0), -90),
    ("wall", (6, 0, 4), -90),
    ("pillar_decorated", (-5.3, 0, -5.3), 0),
    ("pillar", (5.3, 0, -5.3), 0),
    ("banner_patternA_red", (-4, 0, -5.75), 0),
    ("table_long_decorated_A", (-0.3, 0, -0.6), 90),
    ("chair", (-1.2, 0, 0.8), 170),
    ("stool", (0.9, 0, 0.9), 0),
    ("barrel_large", (4.6, 0, -4.0), 20),
    ("barrel_small_stack", (4.4, 0, -1.9), -70),
    ("crates_stacked", (-4.6, 0, -3.9), 15),
    ("keg", (-4.7, 0, -1.4), 90),
    ("chest_gold", (2.6, 0, -4.4), -20),
    ("coin_stack_large", (1.2, 0, -4.2), 0),
    ("bed_decorated", (-4.2, 0, 2.8), 0),
    ("trunk_large_A", (4.6, 0, 3.2), -90),
    ("candle_triple", (3.6, 0, 1.6), 0),
    ("rubble_large", (0, 0, 13), 0),
)
TORCHES = ((-2, 2.3, -5.5, 0), (2, 2.3, -5.5, 0), (-5.5, 2.3, -2.1, 90), (5.5, 2.3, -2.1, -90))


def dungeon_room(kit: Path) -> sv.Scene:
    """The room as a scene with a camera and the warnings of all pieces: 12 x 12 m, open at the front."""
    room = sv.Scene(name="dungeon room")
    loaded: dict[str, sv.Scene] = {}

    def add(piece: str, at: tuple[float, float, float], turn: float) -> None:
        if piece not in loaded:
            loaded[piece] = sv.load_gltf(kit / f"{piece}.glb")
            room.warnings.extend(loaded[piece].warnings)
        moved = place(at=at, turn=math.radians(turn))
        for item in loaded[piece]:
            transform = moved @ item.transform
            room.add(sv.Instance(mesh=item.mesh, material=item.material, transform=transform, name=piece))

    for piece, at, turn in PIECES:
        add(piece, at, turn)
    flame = sv.Material(emissive=np.array(FLAME), name="flame")
    sphere = shapes.sphere(segments=16)
    lit = [(3.55, 1.0, 1.62, 0.05), (3.82, 0.8, 1.55, 0.05)]
    for x, y, z, turn in TORCHES:
        add("torch_mounted", (x, y, z), turn)
        away = 0.35
        inward = (math.sin(math.radians(turn)) * away, math.cos(math.radians(turn)) * away)
        lit.append((x + inward[0], y + 0.75, z + inward[1], 0.13))
    for x, y, z, radius in lit:
        room.add(sv.Instance(mesh=sphere, material=flame, transform=place(scale=radius, at=(x, y, z)), name="flame"))
    eye, target = (0.8, 3.4, 9.5), (-0.1, 1.2, -1.5)
    room.add(sv.Camera.look_at(eye, target, vertical_fov=math.radians(38), ev100=-3.5))
    moon = sv.DirectionalLight(direction=(-0.4, -1.0, -0.5), illuminance=0.15, color=(0.6, 0.75, 1.0), name="moon")
    room.add(moon)
    return room


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kit", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--size", default="640x360")
    parser.add_argument("--samples", type=int, default=256)
    options = parser.parse_args()
    scene = dungeon_room(options.kit)
    width, height = map(int, options.size.split("x"))
    with sv.Device() as device:
        renderer = sv.PathTracer(device, scene, (width, height))
        radiance = renderer.render(scene.camera, samples=options.samples)["radiance"]
    sv.save_image(options.output, radiance, exposure=scene.camera.exposure)


if __name__ == "__main__":
    main()
