"""The pictures of docs/explained/frame.md: what each stage of a realtime frame leaves, in a torch-lit room.

    python tools/frame_pictures.py KIT_FOLDER [-o docs/explained] [--size 320x180] [--frames 48]

KIT_FOLDER holds the .glb files of the KayKit Dungeon kit (CC0), from which tools/dungeon_room.py builds the room.
"""

from __future__ import annotations

import argparse
import runpy
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

import solari_vk as sv
from solari_vk.cli.options import size as pixels
from solari_vk.scene.builtin import place

# The sheets by name: debug views, and those of lighting=split. The camera turns for `motion`, which is the last.
SHEETS = {
    "world_cache": ("cache_cells", "cache_irradiance", "cache_samples", "cache_life"),
    "paths": ("paths_diffuse", "paths_specular", "paths_distance", "emission"),
    "guides": ("guide_diffuse_albedo", "guide_specular_albedo", "guide_normal", "guide_roughness"),
    "denoise": ("denoise_frames", "denoise_noise", "diffuse_radiance", "specular_radiance"),
    "gbuffer": ("base_color", "shading_normal", "roughness", "depth", "instance", "motion"),
}
SPLIT = ("light_tiles", "di_light", "di_visibility", "di", "gi_radiance", "gi", "specular", "picture")
COLUMNS = 2
GAP = 4  # pixels, and the height of a title
TITLE = 16


def sheet(panels: dict[str, Image.Image]) -> Image.Image:
    """Pictures with their names above them, in rows of COLUMNS."""
    width, height = next(iter(panels.values())).size
    rows = -(-len(panels) // COLUMNS)
    columns = min(COLUMNS, len(panels))
    whole = Image.new("RGB", (columns * (width + GAP) - GAP, rows * (height + TITLE)), "white")
    for number, (name, panel) in enumerate(panels.items()):
        row, column = divmod(number, COLUMNS)
        x = column * (width + GAP)
        y = row * (height + TITLE)
        ImageDraw.Draw(whole).text((x + 2, y + 2), name, fill="black")
        whole.paste(panel, (x, y + TITLE))
    return whole.quantize(256)  # a third of the bytes


def tone_mapped(radiance: np.ndarray, exposure: float, folder: Path) -> Image.Image:
    """Radiance (height, width, 3) as a picture."""
    path = folder / "one.png"
    sv.save_image(path, radiance, exposure=exposure)
    with Image.open(path) as picture:
        shown = picture.convert("RGB")
    path.unlink()
    return shown


def pictures_of(frame: sv.RenderedFrame, number: int, folder: Path) -> dict[str, Image.Image]:
    """A frame before and after the denoiser, by titles with its number."""
    exposure = frame.camera.exposure
    return {
        f"{name}, frame {number}": tone_mapped(frame[name], exposure, folder) for name in ("raw_radiance", "radiance")
    }


def save_views(renderer: sv.Renderer, views: tuple[str, ...], path: Path) -> None:
    """Save the sheet of debug views, each of one more frame."""
    camera, panels = renderer.binder.scene.camera, {}
    for view in views:
        renderer.view = view
        if view == "motion":
            camera.transform = camera.transform @ place(turn=np.radians(2))
        panels[view] = Image.fromarray(renderer.render()["display"][..., :3])
    sheet(panels).save(path, optimize=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kit", type=Path, metavar="KIT_FOLDER")
    parser.add_argument("-o", "--output", type=Path, default=Path(__file__).parents[1] / "docs" / "explained")
    parser.add_argument("--size", type=pixels, default=(320, 180))
    parser.add_argument("--frames", type=int, default=48)
    options = parser.parse_args()
    output = options.output
    output.mkdir(parents=True, exist_ok=True)
    scene = runpy.run_path(str(Path(__file__).with_name("dungeon_room.py")))["dungeon_room"](options.kit)
    with sv.Device() as device:
        with sv.Renderer(device, scene, options.size, sv.Settings(lighting="split")) as renderer:
            for _ in range(options.frames):
                renderer.render()
            save_views(renderer, SPLIT, output / "frame_split.png")
        with sv.Renderer(device, scene, options.size) as renderer:
            # The first frame has no history, the last one all that it can have.
            panels = pictures_of(renderer.render(), 1, output)
            for _ in range(options.frames - 2):
                renderer.render()
            panels |= pictures_of(renderer.render(), options.frames, output)
            sheet(panels).save(output / "frame_picture.png", optimize=True)
            for name, views in SHEETS.items():
                save_views(renderer, views, output / f"frame_{name}.png")


if __name__ == "__main__":
    main()
