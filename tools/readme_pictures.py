"""The README's small pictures: a walk through a room in realtime, one of its frames before and after the denoiser, and
256 worlds that are lit at once.

    python tools/readme_pictures.py [-o docs] [--size 320x180] [--frames 24] [--worlds 256]

On a processor with two cores this takes some minutes.
"""

from __future__ import annotations

import argparse
import math
import runpy
from pathlib import Path

import numpy as np
from PIL import Image

import solari_vk as sv
from solari_vk.cli.options import size as pixels

GALLERY = Path(__file__).with_name("gallery")
FRAMES_A_SECOND = 12
WARM_UP = 12  # frames before the first that is kept
COLUMNS = 32  # worlds side by side
VIEW = (40, 40)


def camera_at(turn: float) -> sv.Camera:
    """The camera on a closed path through the room, at a fraction of a turn."""
    angle = 2 * math.pi * turn
    place = (0.4 + 0.8 * math.sin(angle), 1.5 + 0.15 * math.cos(angle), 4.4 - 0.4 * math.cos(angle))
    return sv.Camera.look_at(place, (0.05 + 0.3 * math.sin(angle), 1.7, -3), fov=50, ev100=2.6)


def walk(device: sv.Device, size: tuple[int, int], count: int, output: Path) -> None:
    """Save interior.webp, and denoising.jpg of a frame in its middle."""
    scene = runpy.run_path(str(GALLERY / "stills" / "dusk.py"))["scene"](GALLERY)
    beside = runpy.run_path(str(GALLERY / "__main__.py"))["beside"]
    pictures = []
    with sv.Renderer(device, scene, size) as renderer:
        for number in range(-WARM_UP, count):
            frame = renderer.render(camera_at(number / count))
            if number < 0:
                continue
            pictures.append(Image.fromarray(frame.image()))
            if number == count // 2:
                noisy = sv.encode_picture(frame["raw_radiance"], exposure=frame.camera.exposure)
                panels = {"one path a pixel": Image.fromarray(noisy), "the same frame, denoised": pictures[-1]}
                beside(panels).save(output / "denoising.jpg", quality=88, optimize=True)
    rest = {"append_images": pictures[1:], "duration": 1000 // FRAMES_A_SECOND, "loop": 0}
    pictures[0].save(output / "interior.webp", save_all=True, quality=70, method=6, **rest)


def worlds(device: sv.Device, count: int, output: Path) -> None:
    """Save worlds.jpg: one batch, each view a world with its own lamp, colors and places of the blocks."""
    scene = sv.builtin("cornell_box")
    random = np.random.default_rng(3)
    names = ["short block", "tall block"]
    places = np.stack([np.tile(scene.instances[name].transform, (count, 1, 1)) for name in names], axis=1)
    places[:, :, [0, 2], 3] += random.uniform(-0.25, 0.25, (count, 2, 2))
    camera = sv.Camera.look_at((1, 1, -2), (1, 0.95, 0))
    options = {"renderer": "realtime", "worlds": count, "outputs": (), "seed": 1}
    with sv.Batch(device, scene, VIEW, count, **options) as batch:
        batch.transforms[names] = places
        for name in names:
            colors = random.uniform(0.15, 0.95, (count, 3))
            batch.world_materials[name] = [sv.Material(base_color=color, roughness=0.4) for color in colors]
        strengths = random.uniform(8, 30, count)
        colors = [sv.kelvin(temperature) for temperature in random.uniform(2200, 9000, count)]
        batch.world_materials["lamp"] = [sv.Material(emissive=lamp) for lamp in strengths[:, None] * colors]
        for number in range(WARM_UP):
            batch.render(np.tile(camera.transform, (count, 1, 1)), fov=50, ev100=-1, reset=number == 0)
        views = batch["display"][..., :3]
    height, width = views.shape[1:3]
    rows = views.reshape(-1, min(COLUMNS, count), height, width, 3).swapaxes(1, 2)  # pixels of a row lie side by side
    sheet = Image.fromarray(rows.reshape(len(rows) * height, -1, 3))
    sheet.save(output / "worlds.jpg", quality=85, optimize=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=Path(__file__).parents[1] / "docs")
    parser.add_argument("--size", type=pixels, default=(320, 180))
    parser.add_argument("--frames", type=int, default=24)
    parser.add_argument("--worlds", type=int, default=256)
    options = parser.parse_args()
    with sv.Device() as device:
        worlds(device, options.worlds, options.output)
        walk(device, options.size, options.frames, options.output)


if __name__ == "__main__":
    main()
