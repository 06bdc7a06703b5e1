"""The built-in scene `rooms`: many lamps, of which walls hide most from each surface."""

from __future__ import annotations

import colorsys
import math

import numpy as np
from numpy.typing import ArrayLike

from solari_vk.base.errors import SolariError
from solari_vk.scene import shapes
from solari_vk.scene.model import Camera, Material, Scene
from solari_vk.scene.parts import lamp, matte, place


def rooms(columns: int = 8, rows: int = 5, lamp_count: int = 25, seed: int = 1) -> Scene:
    """A house of closed rooms, 4 x 4 x 2.8 m, in a grid, with a door ajar between all neighbors.

    In each room `lamp_count` colored balls of light, 6 to 12 cm wide, hang at 1.5 to 2.6 m of height over four boxes.
    By default there are 40 rooms and 1,000 lamps, of which a surface sees few. The camera is in the middle room.
    """
    if min(columns, rows) < 1 or lamp_count < 0:
        raise SolariError("rooms: columns and rows must be at least 1, and lamp_count must not be negative")
    random = np.random.default_rng(seed)
    scene = Scene(name="rooms")
    side, height, wall, door = 4.0, 2.8, 0.12, (0.9, 2.1)
    cube, ball = shapes.box(), shapes.sphere(1.0, 10)
    paints = [matte(0.35 + 0.5 * random.random(3), f"paint {i}") for i in range(12)]
    glows = [lamp(60.0 * np.asarray(colorsys.hsv_to_rgb(i / 12, 0.5, 1.0)), f"glow {i}") for i in range(12)]

    def block(low: ArrayLike, high: ArrayLike, paint: Material) -> None:
        low, high = np.asarray(low, np.float64), np.asarray(high, np.float64)
        scene.add(cube, paint, place(high - low, (low + high) / 2))

    def divide(at: float, start: float, along_x: bool, has_door: bool) -> None:
        """A wall in the plane z = at, or x = at, from `start` on along the other axis."""
        paint = paints[int(random.integers(len(paints)))]
        gap = random.uniform(start + 0.5, start + side - 0.5 - door[0]) if has_door else start
        end = gap + door[0] if has_door else gap

        def piece(first: float, last: float, bottom: float, top: float) -> None:
            low, high = (first, bottom, at - wall / 2), (last, top, at + wall / 2)
            block(low if along_x else low[::-1], high if along_x else high[::-1], paint)

        piece(end, start + side, 0, height)
        if has_door:
            piece(start, gap, 0, height)
            piece(gap, end, door[1], height)
            # The leaf hangs at one side of the gap and is open by 15 to 40 degrees.
            turn = random.uniform(math.radians(15), math.radians(40)) + (0.0 if along_x else -math.pi / 2)
            hinge = np.array((gap, 0, at) if along_x else (at, 0, gap))
            leaf = place(turn=turn) @ place((door[0], door[1], 0.04), (door[0] / 2, door[1] / 2, 0))
            leaf[:3, 3] += hinge
            scene.add(cube, paints[0], leaf, name="door")

    width, depth = columns * side, rows * side
    block((0, -0.1, 0), (width, 0, depth), paints[1])
    block((0, height, 0), (width, height + 0.1, depth), matte(0.8, "ceiling"))
    for row, column in np.ndindex(rows + 1, columns):
        divide(row * side, column * side, True, 0 < row < rows)
    for row, column in np.ndindex(rows, columns + 1):
        divide(column * side, row * side, False, 0 < column < columns)
    for row, column in np.ndindex(rows, columns):
        corner = np.array((column * side, 0, row * side))
        for _ in range(4):
            size = random.uniform((0.3, 0.4, 0.3), (0.9, 1.2, 0.9))
            at = corner + np.array((random.uniform(0.8, side - 0.8), size[1] / 2, random.uniform(0.8, side - 0.8)))
            scene.add(cube, paints[int(random.integers(len(paints)))], place(size, at, random.uniform(0, math.pi)))
        for _ in range(lamp_count):
            at = corner + random.uniform((0.3, 1.5, 0.3), (side - 0.3, height - 0.2, side - 0.3))
            scene.add(ball, glows[int(random.integers(len(glows)))], place(random.uniform(0.03, 0.06), at), name="lamp")
    corner = side * np.array((columns // 2, 0, rows // 2))
    eye, target = corner + np.array((0.35, 1.75, side - 0.35)), corner + np.array((side - 0.6, 0.9, 0.6))
    scene.add(Camera.look_at(eye, target, vertical_fov=math.radians(68), ev100=2.0))
    return scene
