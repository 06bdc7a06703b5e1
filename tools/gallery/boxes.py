"""Boxes: what is seen of an object, the whole of it, and its box in space.

Yellow: `frame.boxes()`, the pixels that show it. Blue, dashed: `silhouette.box`, as if nothing were before it. White:
`sv.boxes_3d`, with its pose before the camera.
"""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

import solari_vk as sv

YELLOW = (255, 210, 40)
BLUE = (60, 160, 255)
WHITE = (255, 255, 255)


def scene(assets: Path | None) -> sv.Scene:
    """Boxes, a ball, a cone and a ring on a floor, some before others."""
    made = sv.Scene()
    made.add(sv.shapes.quad((0, 0, 0), (0, 0, 4), (4, 0, 0)), sv.Material(base_color=0.45, roughness=0.8), name="floor")
    made.add(sv.shapes.quad((0, 4, 1), (1.2, 0, 0), (0, 0, 1.2)), sv.Material(emissive=(16, 15, 14)), name="lamp")
    things = (
        ("crate", sv.shapes.box((-0.5, 0, -0.35), (0.5, 0.7, 0.35)), (-0.75, 0, -0.5), 0.5, (0.75, 0.5, 0.25)),
        ("ball", sv.shapes.sphere(0.38, 48), (0.0, 0.38, 0.5), 0.0, (0.2, 0.45, 0.8)),
        ("cone", sv.shapes.cone(0.4, 1.1, 48), (0.6, 0.55, -0.6), 0.0, (0.8, 0.2, 0.15)),
        ("ring", sv.shapes.torus(0.34, 0.12, 48), (1.15, 0.12, 0.3), 0.0, (0.25, 0.65, 0.35)),
    )
    for name, shape, at, turn, color in things:
        thing = made.add(shape, sv.Material(base_color=color, roughness=0.4), at, name=name)
        thing.rotation = turn
        thing.label = name
    made.camera = sv.Camera.look_at((0.5, 1.7, 3.8), (0.15, 0.4, 0), vertical_fov=0.6, ev100=0.2)
    return made


def draw(device: sv.Device, made: sv.Scene, picture: Image.Image) -> Image.Image:
    """The picture with boxes."""
    drawn = picture.copy()
    pen = ImageDraw.Draw(drawn)
    things = [thing for thing in made.instances if thing.label]
    with sv.RayTracer(device, made) as tracer:
        whole = sv.silhouettes(tracer, made.camera, picture.size)
    with sv.PathTracer(device, made, picture.size) as reference:
        seen = reference.render(samples=1).boxes()
    for thing, box in sv.boxes_3d(things, made.camera, picture.size).items():
        corners = np.asarray(box.pixels) + 0.5
        for one, other in combinations(range(8), 2):
            if bin(one ^ other).count("1") == 1:  # corners of an edge differ in one axis
                pen.line([tuple(corners[one]), tuple(corners[other])], WHITE)
        left, top, width, height = whole[thing].box
        _dashed(pen, (left, top, left + width - 1, top + height - 1))
        left, top, width, height = seen[thing]
        pen.rectangle((left, top, left + width - 1, top + height - 1), outline=YELLOW)
    return drawn


def _dashed(pen: ImageDraw.ImageDraw, box: tuple[int, int, int, int]) -> None:
    left, top, right, bottom = box
    for x in range(left, right, 8):
        for y in (top, bottom):
            pen.line([(x, y), (min(x + 4, right), y)], BLUE)
    for y in range(top, bottom, 8):
        for x in (left, right):
            pen.line([(x, y), (x, min(y + 4, bottom))], BLUE)
