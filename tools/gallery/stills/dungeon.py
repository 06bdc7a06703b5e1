"""A dungeon by torchlight.

Pieces of the KayKit Dungeon kit (CC0), which `tools/dungeon_room.py` puts together, seen from just above the floor. The
flames of torches and candles are meshes with an emissive material. Blue evening light comes from behind the camera.
"""

from __future__ import annotations

import math
import runpy
from pathlib import Path

import solari_vk as sv

SAMPLES = 64
ROOM = runpy.run_path(str(Path(__file__).parents[2] / "dungeon_room.py"))
CHEST = (1.75, 0, 1.3)
COINS = (0.55, 0, 2.1)
CANDLE = (-1.15, 0, 2.9)


def scene(assets: Path) -> sv.Scene:
    """The room with a stone ceiling, a chest, gold and a candle near the camera."""
    kit = assets / "kaykit_dungeon"
    made = ROOM["dungeon_room"](kit)
    for x in (-4, 0, 4):
        for z in (-4, 0, 4):
            made.add(kit / "floor_tile_large.glb", position=(x, 4.05, z), rotation=(1, 0, 0, 0))
    for z in (-2, 2):
        made.add(sv.shapes.box((-6, 3.6, z - 0.2), (6, 4, z + 0.2)), sv.Material(base_color=(0.09, 0.05, 0.03)))
    made.add(kit / "chest_gold.glb", position=CHEST, rotation=math.radians(-30))
    made.add(kit / "coin_stack_large.glb", position=COINS, rotation=0.6, scale=0.45)
    made.add(kit / "candle_lit.glb", position=CANDLE)
    flame = made.instances["flame"].material
    flame.emissive = 32 * sv.kelvin(2900)
    made.environment = sv.Environment((0.02, 0.04, 0.09))
    made.add(sv.shapes.sphere(0.035), flame, position=(CANDLE[0], 1.1, CANDLE[2]), scale=(1, 2, 1), name="flame")
    eye, target = (0.25, 0.8, 5.75), (-0.1, 1.3, -2)
    made.camera = sv.Camera.look_at(eye, target, fov=44, ev100=-2.9).focus_on((0.3, 0.8, 0), 2.0)
    return made
