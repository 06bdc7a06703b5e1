"""Procedural scenes for tests, pictures and measurements; the same arguments give the same scene.

Each function returns a Scene with one camera, whose ev100 suits the picture. Lengths are in meters and emission is in
cd/m^2. `builtin(name)` makes a scene by name.
"""

from __future__ import annotations

import colorsys
import inspect
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.base.errors import SolariError, checked_keywords, is_name, quoted, unknown_name
from solari_vk.scene import shapes
from solari_vk.scene.checks import FloatArray
from solari_vk.scene.matrices import rotation
from solari_vk.scene.model import Camera, DirectionalLight, Instance, Material, Mesh, Scene

EV100_OF_UNIT_EXPOSURE = -math.log2(1.2)  # the exposure factor is 1


def rgb(value: ArrayLike) -> FloatArray:
    """One number or three as a color (3,)."""
    return np.broadcast_to(np.asarray(value, np.float32), (3,))


def matte(color: ArrayLike, name: str = "", **fields: Any) -> Material:
    """A nearly Lambertian material: rough, with F0 = 0. A faint sheen remains at grazing angles.

    By default cameras look through its back, so that rooms can be seen from anywhere.
    """
    fields = {"double_sided": False} | fields
    return Material(base_color=rgb(color), perceptual_roughness=1.0, reflectance=rgb(0), name=name, **fields)


def lamp(radiance: ArrayLike, name: str = "lamp", **fields: Any) -> Material:
    """A material that emits light and reflects almost none."""
    return matte(0.0, name, emissive=rgb(radiance), **fields)


def place(scale: ArrayLike = 1.0, at: ArrayLike = (0, 0, 0), turn: float = 0.0) -> NDArray[np.float64]:
    """The matrix (4, 4) that scales, then turns about y by `turn` radians, then moves to `at` in meters."""
    transform = np.eye(4)
    transform[:3, :3] = rotation((0, 1, 0), turn) @ np.diag(np.broadcast_to(np.asarray(scale, np.float64), (3,)))
    transform[:3, 3] = at
    return transform


def cornell_box(size: float = 2.0, radiance: ArrayLike = (17.0, 12.0, 4.0)) -> Scene:
    """The Cornell box as measured at Cornell (graphics.cornell.edu/online/box/data.html).

    The measured box, 548.8 mm high, is scaled to `size` meters of height; it stands on y = 0, its open
    side at z = 0 and towards -z, where the camera is. The lamp, 130 x 105 mm of the measured box, fills a
    hole in the ceiling, so nothing overlaps. Colors are the usual Rec. 709 rendition of the measured
    spectra (McGuire's CornellBox-Original), and all surfaces are matte.
    """
    scale = size / 548.8

    def mesh(*corners: ArrayLike, name: str) -> Mesh:
        return shapes.polygons(*(scale * np.asarray(c, np.float64) for c in corners), name=name)

    def block(top: list[tuple[int, int]], height: int, name: str) -> Mesh:
        upper = [(x, height, z) for x, z in top]
        faces: list[ArrayLike] = [upper]
        for (x0, z0), (x1, z1) in zip(top, [*top[1:], top[0]], strict=True):
            faces.append([(x1, height, z1), (x0, height, z0), (x0, 0, z0), (x1, 0, z1)])
        return mesh(*faces, name=name)

    h = 548.8
    hole = [(343, h, 227), (343, h, 332), (213, h, 332), (213, h, 227)]
    ceiling = [(556, h, 0), (556, h, 559.2), (0, h, 559.2), (0, h, 0)]
    around = [[ceiling[i], ceiling[(i + 1) % 4], hole[(i + 1) % 4], hole[i]] for i in range(4)]
    white = (0.725, 0.71, 0.68)
    red = (0.63, 0.065, 0.05)
    green = (0.14, 0.45, 0.091)
    floor = [(552.8, 0, 0), (0, 0, 0), (0, 0, 559.2), (549.6, 0, 559.2)]
    back = [(549.6, 0, 559.2), (0, 0, 559.2), (0, h, 559.2), (556, h, 559.2)]
    right = [(0, 0, 559.2), (0, 0, 0), (0, h, 0), (0, h, 559.2)]
    left = [(552.8, 0, 0), (549.6, 0, 559.2), (556, h, 559.2), (556, h, 0)]
    short = [(130, 65), (82, 225), (240, 272), (290, 114)]
    tall = [(423, 247), (265, 296), (314, 456), (472, 406)]
    scene = Scene(name="cornell_box")
    scene.add(mesh(floor, back, *around, name="room"), matte(white, "white"), name="room")
    scene.add(mesh(left, name="left"), matte(red, "red"), name="left wall")
    scene.add(mesh(right, name="right"), matte(green, "green"), name="right wall")
    blocks = matte(white, "block")
    scene.add(block(short, 165, "short"), blocks, name="short block")
    scene.add(block(tall, 330, "tall"), blocks, name="tall block")
    scene.add(mesh(hole, name="lamp"), lamp(radiance), name="lamp")
    eye, target = scale * np.array((278, 273, -800)), scale * np.array((278, 273, 0))
    # The measured camera: a sensor of 25 mm behind a focal length of 35 mm.
    fov = 2 * math.atan(0.0125 / 0.035)
    scene.add(Camera.look_at(eye, target, vertical_fov=fov, near=0.005 * size, ev100=-1.0))
    return scene


def closed_box(albedo: float = 0.5, emission: float = 1.0, size: float = 2.0) -> Scene:
    """The inside of a cube of `size` meters whose walls all emit `emission` and reflect `albedo`.

    With Lambert walls the radiance after k bounces is emission (1 - albedo^(k+1)) / (1 - albedo), the same
    everywhere. The camera is off the center, so that no symmetry hides a mistake.
    """
    half = np.full(3, size / 2)
    material = matte(albedo, "glowing wall", emissive=rgb(emission))
    walls = Instance(mesh=shapes.box(-half, half, inward=True), material=material, name="walls")
    # Radiance reaches emission / (1 - albedo).
    ev100 = EV100_OF_UNIT_EXPOSURE + math.log2(max(2 * emission / max(1 - albedo, 0.05), 1e-6))
    eye, target = size * np.array((0.13, 0.07, 0.21)), size * np.array((-0.4, -0.3, -0.5))
    camera = Camera.look_at(eye, target, vertical_fov=math.radians(90), ev100=ev100)
    return Scene(walls, camera, name="closed_box")


def many_lights(
    sphere_count: int = 441, box_count: int = 8000, extent: float = 60.0, sphere_segments: int = 12, seed: int = 1
) -> Scene:
    """Colored emissive spheres in a square grid over a plane with random boxes.

    The plane is `extent` meters wide; the grid of spheres (21 x 21 by default) fills it at 2 to 4 m of height.
    Boxes are 0.2 to 1.2 m wide and 0.2 to 2 m high. All boxes share one mesh, and so do all spheres.
    """
    if min(sphere_count, box_count) < 0 or not extent > 0:
        raise SolariError("many_lights: counts must not be negative, and extent must be positive")
    random = np.random.default_rng(seed)
    scene = Scene(name="many_lights")
    half = extent / 2
    ground = shapes.quad((0, 0, 0), (0, 0, half), (half, 0, 0), name="ground")
    scene.add(ground, matte(0.6, "ground"), name="ground")
    cube = shapes.box()
    paints = [
        Material(
            base_color=rgb(0.25 + 0.6 * random.random(3)),
            perceptual_roughness=0.2 + 0.8 * random.random(),
            metallic=float(random.random() < 0.2),
            name=f"paint {i}",
        )
        for i in range(16)
    ]
    for _ in range(box_count):
        width, height, depth = random.uniform((0.2, 0.2, 0.2), (1.2, 2.0, 1.2))
        x, z = random.uniform(-half, half, 2)
        transform = place((width, height, depth), (x, height / 2, z), random.uniform(0, math.pi))
        scene.add(cube, paints[int(random.integers(len(paints)))], transform)
    ball = shapes.sphere(0.15, sphere_segments)
    colors = [colorsys.hsv_to_rgb(i / 24, 0.7, 1.0) for i in range(24)]
    glows = [lamp(400.0 * np.asarray(color), f"glow {i}") for i, color in enumerate(colors)]
    side = max(math.ceil(math.sqrt(sphere_count)), 1)
    for i in range(sphere_count):
        x, z = ((np.array((i % side, i // side)) + 0.5) / side - 0.5) * extent
        glow = glows[int(random.integers(len(glows)))]
        scene.add(ball, glow, (x, random.uniform(2, 4), z))
    eye, target = (0, 0.16 * extent, 0.48 * extent), (0, 0, 0.1 * extent)
    scene.add(Camera.look_at(eye, target, vertical_fov=math.radians(50), ev100=2.5))
    return scene


def rooms(columns: int = 8, rows: int = 5, lamp_count: int = 25, seed: int = 1) -> Scene:
    """A house of closed rooms, 4 x 4 x 2.8 m, in a grid, with a door ajar between all neighbors.

    In each room `lamp_count` colored balls of light, 6 to 12 cm wide, hang at 1.5 to 2.6 m of height over four boxes.
    By default there are 40 rooms and 1,000 lamps, of which a surface sees few. The camera is in the middle room.
    """
    if min(columns, rows) < 1 or lamp_count < 0:
        raise SolariError("rooms: columns and rows must be at least 1, and lamp_count must not be negative")
    house = _House(seed)
    width, depth = columns * ROOM_SIDE, rows * ROOM_SIDE
    house.block((0, -0.1, 0), (width, 0, depth), house.paints[1])
    house.block((0, ROOM_HEIGHT, 0), (width, ROOM_HEIGHT + 0.1, depth), matte(0.8, "ceiling"))
    # The walls at the house's edges have no doors.
    for row, column in np.ndindex(rows + 1, columns):
        house.wall(row * ROOM_SIDE, column * ROOM_SIDE, along_x=True, has_door=0 < row < rows)
    for row, column in np.ndindex(rows, columns + 1):
        house.wall(column * ROOM_SIDE, row * ROOM_SIDE, along_x=False, has_door=0 < column < columns)
    for row, column in np.ndindex(rows, columns):
        house.furnish(ROOM_SIDE * np.array((column, 0, row)), lamp_count)
    corner = ROOM_SIDE * np.array((columns // 2, 0, rows // 2))
    eye = corner + np.array((0.35, 1.75, ROOM_SIDE - 0.35))
    target = corner + np.array((ROOM_SIDE - 0.6, 0.9, 0.6))
    house.scene.add(Camera.look_at(eye, target, vertical_fov=math.radians(68), ev100=2.0))
    return house.scene


ROOM_SIDE = 4.0
ROOM_HEIGHT = 2.8
WALL = 0.12  # meters thick
DOOR_WIDTH, DOOR_HEIGHT = 0.9, 2.1


class _House:
    """The scene of `rooms` while it is built. The order of its random numbers is part of the scene."""

    def __init__(self, seed: int) -> None:
        self.scene = Scene(name="rooms")
        self._random = np.random.default_rng(seed)
        self._cube = shapes.box()
        self._ball = shapes.sphere(1.0, 10)
        self.paints = [matte(0.35 + 0.5 * self._random.random(3), f"paint {i}") for i in range(12)]
        colors = [np.asarray(colorsys.hsv_to_rgb(i / 12, 0.5, 1.0)) for i in range(12)]
        self._glows = [lamp(60.0 * color, f"glow {i}") for i, color in enumerate(colors)]

    def _paint(self) -> Material:
        return self.paints[int(self._random.integers(len(self.paints)))]

    def block(self, low: ArrayLike, high: ArrayLike, paint: Material) -> None:
        """An axis-aligned box between two corners."""
        low, high = np.asarray(low, np.float64), np.asarray(high, np.float64)
        self.scene.add(self._cube, paint, place(high - low, (low + high) / 2))

    def wall(self, at: float, start: float, *, along_x: bool, has_door: bool) -> None:
        """A wall in the plane z = at, or x = at, from `start` on along the other axis."""
        paint = self._paint()
        end = start + ROOM_SIDE
        if not has_door:
            self._piece(at, along_x, (start, end), (0, ROOM_HEIGHT), paint)
            return
        gap = self._random.uniform(start + 0.5, end - 0.5 - DOOR_WIDTH)
        self._piece(at, along_x, (gap + DOOR_WIDTH, end), (0, ROOM_HEIGHT), paint)
        self._piece(at, along_x, (start, gap), (0, ROOM_HEIGHT), paint)
        self._piece(at, along_x, (gap, gap + DOOR_WIDTH), (DOOR_HEIGHT, ROOM_HEIGHT), paint)
        # The leaf hangs at one side of the gap and is open by 15 to 40 degrees.
        turn = self._random.uniform(math.radians(15), math.radians(40)) + (0.0 if along_x else -math.pi / 2)
        leaf = place(turn=turn) @ place((DOOR_WIDTH, DOOR_HEIGHT, 0.04), (DOOR_WIDTH / 2, DOOR_HEIGHT / 2, 0))
        leaf[:3, 3] += (gap, 0, at) if along_x else (at, 0, gap)
        self.scene.add(self._cube, self.paints[0], leaf, name="door")

    def _piece(
        self, at: float, along_x: bool, across: tuple[float, float], heights: tuple[float, float], paint: Material
    ) -> None:
        """A part of a wall, by its ends along the wall and its heights."""
        low = (across[0], heights[0], at - WALL / 2)
        high = (across[1], heights[1], at + WALL / 2)
        if along_x:
            self.block(low, high, paint)
        else:
            self.block(low[::-1], high[::-1], paint)

    def furnish(self, corner: NDArray[np.float64], lamp_count: int) -> None:
        """Four boxes and the lamps of a room, whose corner (3,) with the smallest coordinates is given."""
        random = self._random
        for _ in range(4):
            size = random.uniform((0.3, 0.4, 0.3), (0.9, 1.2, 0.9))
            x, z = random.uniform(0.8, ROOM_SIDE - 0.8), random.uniform(0.8, ROOM_SIDE - 0.8)
            at = corner + np.array((x, size[1] / 2, z))
            self.scene.add(self._cube, self._paint(), place(size, at, random.uniform(0, math.pi)))
        for _ in range(lamp_count):
            at = corner + random.uniform((0.3, 1.5, 0.3), (ROOM_SIDE - 0.3, ROOM_HEIGHT - 0.2, ROOM_SIDE - 0.3))
            glow = self._glows[int(random.integers(len(self._glows)))]
            self.scene.add(self._ball, glow, place(random.uniform(0.03, 0.06), at), name="lamp")


def mirror_hall(length: float = 8.0) -> Scene:
    """A hall 4 m wide, 3 m high and `length` meters long with facing mirrors on both long sides.

    Three balls (red matte, gold, glass-like black) stand between them under a strip of light. The
    mirrors are metals of roughness 0 and reflect 95 %.
    """
    low, high = np.array((-2, 0, -length / 2)), np.array((2, 3, length / 2))
    room = shapes.box(low, high, inward=True)
    scene = Scene(Instance(mesh=room, material=matte(0.7, "plaster"), name="room"), name="mirror_hall")
    mirror = Material(base_color=rgb(0.95), metallic=1.0, perceptual_roughness=0.0, name="mirror")
    for side in (-1.0, 1.0):
        # The mirrors are 1 cm in front of the walls and smaller than them, so that the walls frame the reflections.
        mesh = shapes.quad((side * 1.99, 1.5, 0), (0, 0, side * (length / 2 - 0.2)), (0, 1.3, 0), name="mirror")
        scene.add(mesh, mirror, name="mirror")
    strip = shapes.quad((0, 2.98, 0), (0.25, 0, 0), (0, 0, length / 2 - 1), name="strip light")
    scene.add(strip, lamp((12.0, 11.0, 9.5)), name="strip light")
    ball = shapes.sphere(0.5, 48)
    balls = (
        Material(base_color=rgb((0.7, 0.08, 0.05)), perceptual_roughness=0.7, name="red"),
        Material(base_color=rgb((1.0, 0.77, 0.34)), metallic=1.0, perceptual_roughness=0.25, name="gold"),
        Material(base_color=rgb(0.02), perceptual_roughness=0.0, name="black glass"),
    )
    for x, z, material in zip((-0.7, 0.6, -0.3), (-1.5, 0.0, 1.3), balls, strict=True):
        scene.add(ball, material, (x, 0.5, z), name=material.name)
    scene.add(Camera.look_at((1.3, 1.6, length / 2 - 0.6), (-0.9, 1.0, -0.5), vertical_fov=math.radians(65), ev100=0.5))
    return scene


def thin_wall(thickness: float = 0.02, radiance: float = 20.0) -> Scene:
    """A closed room, 4 x 2 x 2 m, halved by a thin wall: the lamp is on the left, no light is on the right.

    Everything is matte. The camera looks down from above; single-sided materials hide the ceiling's back side from it,
    so that both halves are visible. The right half must be exactly black.
    """
    room = Instance(mesh=shapes.box((-2, 0, -1), (2, 2, 1), inward=True), material=matte(0.7, "plaster"), name="room")
    # The wall extends beyond floor, ceiling and sides, so that no ray passes its edges.
    wall = shapes.box((-thickness / 2, -0.1, -1.1), (thickness / 2, 2.1, 1.1))
    light = shapes.quad((-1, 1.98, 0), (0.4, 0, 0), (0, 0, 0.4), name="lamp")
    return Scene(
        room,
        Instance(mesh=wall, material=matte(0.7, "wall"), name="wall"),
        Instance(mesh=light, material=lamp(radiance), name="lamp"),
        Camera.look_at((0, 6.5, 3.2), (0, 0.8, 0), vertical_fov=math.radians(32), ev100=2.0),
        name="thin_wall",
    )


def sphere_grid(columns: int = 8, rows: int = 3, base_color: ArrayLike = (0.9, 0.55, 0.25)) -> Scene:
    """Balls of 0.45 m radius, 1 m apart, in front of a wall: roughness grows from 0 to 1 to the right, metallic from 0
    to 1 upwards. Lit by a large soft lamp from the left and a small one from the right, both above the camera."""
    if min(columns, rows) < 1:
        raise SolariError("sphere_grid: columns and rows must be at least 1")
    scene = Scene(name="sphere_grid")
    ball = shapes.sphere(0.45, 48)
    for row in range(rows):
        for column in range(columns):
            roughness, metallic = column / max(columns - 1, 1), row / max(rows - 1, 1)
            material = Material(base_color=rgb(base_color), perceptual_roughness=roughness, metallic=metallic)
            at = (column - (columns - 1) / 2, row + 0.5, 0)
            scene.add(ball, material, at, name=f"ball {column} {row}")
    width = float(columns + rows)
    floor = [(-2 * width, 0, -1), (-2 * width, 0, 2 * width), (2 * width, 0, 2 * width), (2 * width, 0, -1)]
    wall = [(-2 * width, 0, -1), (2 * width, 0, -1), (2 * width, 2 * width, -1), (-2 * width, 2 * width, -1)]
    scene.add(shapes.polygons(floor, wall, name="stage"), matte(0.4, "stage"), name="stage")
    for name, x, half, radiance in (("soft lamp", -width, 0.35, 9.0), ("small lamp", width, 0.08, 60.0)):
        mesh = shapes.facing_quad((x, width, width), half * width)
        scene.add(mesh, lamp(radiance), name=name)
    distance = 0.5 * max(columns / 1.6, rows) / math.tan(math.radians(15)) + 1.2
    eye, target = (0, rows / 2 + 0.6, distance), (0, rows / 2, 0)
    scene.add(Camera.look_at(eye, target, vertical_fov=math.radians(30), ev100=0.3))
    return scene


def shiny_floor(
    roughness: ArrayLike = (0.1, 0.2, 0.3), metallic: float = 0.95, base_color: ArrayLike = (0.95, 0.9, 0.8)
) -> Scene:
    """Matte balls in the sun over a floor of rough metal, under a black sky.

    The floor, 6 x 6 m, has a strip with a ball for each roughness. That is GGX's alpha, the square of perceptual
    roughness. The balls' indirect light is the floor's highlight of the sun, which leaves the floor mostly one way.
    """
    alphas = np.atleast_1d(np.asarray(roughness, np.float64))
    if not len(alphas) or alphas.min() < 0 or alphas.max() > 1:
        raise SolariError(f"shiny_floor: roughness must be numbers from 0 to 1, not {quoted(roughness)}")
    scene = Scene(name="shiny_floor")
    ball = shapes.sphere(0.6, 48)
    half = 3.0 / len(alphas)
    paints = [matte(color, "paint") for color in ((0.7, 0.7, 0.7), (0.65, 0.2, 0.12), (0.15, 0.4, 0.6))]
    for i, alpha in enumerate(alphas.tolist()):
        x = (2 * i + 1) * half - 3
        metal = Material(
            base_color=rgb(base_color), metallic=metallic, perceptual_roughness=math.sqrt(alpha), name="metal"
        )
        scene.add(shapes.quad((x, 0, 0), (0, 0, 3), (half, 0, 0), name="strip"), metal, name=f"floor {i}")
        scene.add(ball, paints[i % len(paints)], (x, 1.1, -0.3), name=f"ball {i}")
    travels = np.array((0.15, -0.75, -0.6), np.float32)
    scene.add(DirectionalLight(direction=travels, illuminance=10.0, color=rgb((1, 0.95, 0.85)), name="sun"))
    scene.add(Camera.look_at((0, 1.9, 7.5), (0, 0.6, 0), vertical_fov=math.radians(36), ev100=1.5))
    return scene


def polished_floor(roughness: ArrayLike = (0.0, 0.0025, 0.01), base_color: ArrayLike = (0.02, 0.02, 0.02)) -> Scene:
    """`shiny_floor` with a floor of dark polished stone, a dielectric: what it reflects is most of what it shows."""
    scene = shiny_floor(roughness, 0.0, base_color)
    scene.name = "polished_floor"
    return scene


def sunlit_metal_floor(roughness: float = 0.02) -> Scene:
    """A matte room, 4 x 2.5 x 5 m, with a window to the sun, a red ball and a floor of metal. Most of its light is what
    the floor reflects of the sun, which paths from the walls find by chance alone. roughness: GGX's alpha."""
    scene = Scene(name="sunlit_metal_floor")
    plaster = matte((0.7, 0.7, 0.7), "plaster")
    walls = (
        *(
            ((-0.1, 0, 0), (0, 2.5, 5)),
            ((0, 0, -0.1), (4, 2.5, 0)),
            ((0, 0, 5), (4, 2.5, 5.1)),
            ((0, 2.5, 0), (4, 2.6, 5)),
        ),
        # Around the window.
        *(
            ((4, 0, 0), (4.1, 0.9, 5)),
            ((4, 1.9, 0), (4.1, 2.5, 5)),
            ((4, 0.9, 0), (4.1, 1.9, 1.5)),
            ((4, 0.9, 3), (4.1, 1.9, 5)),
        ),
    )
    for i, (low, high) in enumerate(walls):
        scene.add(shapes.box(low, high), plaster, name=f"wall {i}")
    metal = Material(
        base_color=rgb((0.9, 0.85, 0.8)), metallic=1.0, perceptual_roughness=math.sqrt(roughness), name="metal"
    )
    scene.add(shapes.quad((2, 0, 2.5), (0, 0, 2.5), (2, 0, 0)), metal, name="floor")
    scene.add(shapes.sphere(0.4, 32), matte((0.6, 0.2, 0.2), "red"), (1.2, 0.4, 1.5), name="ball")
    scene.add(DirectionalLight(direction=np.array((-1.6, -1.2, -0.25), np.float32), illuminance=8e4, name="sun"))
    scene.add(Camera.look_at((2, 1.3, 4.7), (1.8, 1.1, 0), vertical_fov=math.radians(65), ev100=9.0))
    return scene


def lamp_gap(gap: float = 0.03) -> Scene:
    """A closed matte room, 4 x 3 x 4 m, with a block. Its lamp is a flat panel, 1.2 x 0.6 m, `gap` meters below the
    ceiling, and emits on both sides, so that the ceiling around it shines."""
    if not 0 < gap < 3:
        raise SolariError(f"lamp_gap: gap must be more than 0 and less than the room's 3 m, not {gap:g}")
    low, high = np.array((-2, 0, -2)), np.array((2, 3, 2))
    scene = Scene(name="lamp_gap")
    scene.add(shapes.box(low, high, inward=True), matte((0.6, 0.57, 0.5), "plaster"), name="room")
    scene.add(
        shapes.box((-0.4, 0, -0.4), (0.4, 1.2, 0.4)),
        matte((0.6, 0.15, 0.1), "red"),
        place(at=(0.5, 0, -0.5), turn=0.4),
        name="block",
    )
    panel = shapes.quad((0, 3 - gap, -0.4), (0.6, 0, 0), (0, 0, 0.3), name="panel")
    scene.add(panel, lamp((20.0, 18.0, 15.0), double_sided=True), name="lamp")
    eye, target = (-1.3, 1.4, 1.9), (0.1, 1.6, -0.6)
    scene.add(Camera.look_at(eye, target, vertical_fov=math.radians(72), ev100=1.0))
    return scene


_FUNCTIONS: tuple[Callable[..., Scene], ...] = (
    *(cornell_box, closed_box, many_lights, rooms, mirror_hall),
    *(thin_wall, sphere_grid, shiny_floor, polished_floor, sunlit_metal_floor, lamp_gap),
)
SCENES = {function.__name__: function for function in _FUNCTIONS}


@checked_keywords(who="solari_vk")
def builtin(name: str, **arguments: Any) -> Scene:
    """A built-in scene by name, with its function's arguments. Raises SolariError for an unknown name or argument."""
    if not is_name(name, SCENES):
        raise unknown_name("there is no built-in scene", name, SCENES)
    signature = inspect.signature(SCENES[name])
    try:
        signature.bind(**arguments)
    except TypeError as error:
        raise SolariError(f"built-in scene '{name}': {error}; it takes {', '.join(signature.parameters)}") from None
    return SCENES[name](**arguments)
