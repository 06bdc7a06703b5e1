"""Renders docs/gallery/ and writes the page that shows it.

    python tools/gallery [NAME ...] [-o docs/gallery] [--samples N] [--size 1600x900] --assets FOLDER

Each NAME.py in stills/ is one large picture by the path tracer, denoised; each NAME.py beside this file is a feature,
which two pictures side by side show. The docstring is the caption, and `scene(assets)` makes the scene, whose camera is
used; `assets` is a folder of glTF files that aren't part of this project. A file may also have

- SAMPLES: of the path tracer, by pixel;
- ASPECT: width over height of each of the two pictures;
- exposure(scene): further arguments of `render`;
- draw(device, scene, picture), of a feature: what stands beside its picture in place of a realtime frame;
- panels(assets), of a feature: two scenes by their labels, shown by the path tracer without a denoiser. Without it the
  left picture is the path tracer's, denoised, and the right one a realtime frame.

Without names all are rendered.
"""

from __future__ import annotations

import argparse
import runpy
from pathlib import Path
from typing import Any

from PIL import Image, ImageDraw, ImageFont

import solari_vk as sv

HERE = Path(__file__).parent
FEATURES = sorted(path.stem for path in HERE.glob("[a-z]*.py"))
STILLS = ("bubbles", "dungeon", "dusk", "stained_window", "watch", "fox")  # in the page's order
WIDTH, HEIGHT = 1600, 900
GAP = 4  # pixels between two pictures
FRAMES = 64
SAMPLES = 64


def defined_by(name: str) -> dict[str, Any]:
    """What the file of a feature or of a large picture defines."""
    return runpy.run_path(str(HERE / ("stills" if name in STILLS else ".") / f"{name}.py"))


def path_traced(device: sv.Device, scene: sv.Scene, size: tuple[int, int], **options: Any) -> Image.Image:
    with sv.PathTracer(device, scene, size) as tracer:
        return Image.fromarray(tracer.render(**options).image())


def realtime(device: sv.Device, scene: sv.Scene, size: tuple[int, int], **options: Any) -> Image.Image:
    with sv.Renderer(device, scene, size) as renderer:
        for _ in range(FRAMES):
            frame = renderer.render(**options)
        return Image.fromarray(frame.image())


def beside(pictures: dict[str, Image.Image]) -> Image.Image:
    """Pictures of one size side by side, each with its label in the lower left corner."""
    width, height = next(iter(pictures.values())).size
    whole = Image.new("RGB", (len(pictures) * (width + GAP) - GAP, height), "white")
    font = ImageFont.load_default(max(width // 40, 12))
    for number, (label, picture) in enumerate(pictures.items()):
        whole.paste(picture, (number * (width + GAP), 0))
        place = (number * (width + GAP) + width // 60, height - width // 60)
        draw = ImageDraw.Draw(whole, "RGBA")
        left, top, right, bottom = draw.textbbox(place, label, font, "lb")
        draw.rectangle((left - 6, top - 4, right + 6, bottom + 4), (0, 0, 0, 150))
        draw.text(place, label, "white", font, "lb")
    return whole


def picture_of(device: sv.Device, name: str, size: tuple[int, int], samples: int | None, assets: Path) -> Image.Image:
    """A large picture, or the two of a feature."""
    found = defined_by(name)
    options: dict[str, Any] = {"samples": samples or found.get("SAMPLES", SAMPLES)}
    width = (size[0] - GAP) // 2
    half = width, round(width / found.get("ASPECT", 16 / 9))
    if "panels" in found:
        return beside(
            {label: path_traced(device, scene, half, **options) for label, scene in found["panels"](assets).items()}
        )
    scene = found["scene"](assets)
    exposure = found["exposure"](scene) if "exposure" in found else {}
    options |= {"denoise": True, **exposure}
    if name in STILLS:
        return path_traced(device, scene, size, **options)
    left = path_traced(device, scene, half, **options)
    if "draw" in found:
        return beside({"path tracer": left, "drawn": found["draw"](device, scene, left)})
    return beside({"path tracer": left, f"realtime, frame {FRAMES}": realtime(device, scene, half, **exposure)})


def page() -> str:
    """The text of docs/gallery.md."""
    lines = [
        "# Gallery\n",
        "Click on a picture to enlarge it. `python tools/gallery` makes them; each has a file with its scene there.",
        "The large ones are by the path tracer, denoised.\n",
    ]
    for name in (*STILLS, *FEATURES):
        if name == FEATURES[0]:
            lines += [
                "## Three flight helmets by the sea\n",
                "By `tools/helmets.py`, in the light of a photograph.\n",
                "[![Three flight helmets by the sea](helmets.jpg)](helmets.jpg)\n",
            ]
            lines += [
                "## Feature by feature\n",
                "On the left the path tracer, on the right one denoised frame of the",
                f"realtime renderer, its {FRAMES}th, unless the pictures say otherwise.\n",
            ]
        title, _, caption = (defined_by(name)["__doc__"] or name).strip().partition("\n")
        title, caption = title.rstrip("."), caption.strip()
        lines += [
            f"{'##' if name in STILLS else '###'} {title}",
            "",
            *([caption, ""] if caption else []),
            f"[![{title}](gallery/{name}.jpg)](gallery/{name}.jpg)",
            "",
        ]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", default=[*STILLS, *FEATURES], metavar="NAME")
    parser.add_argument("-o", "--output", type=Path, default=HERE.parents[1] / "docs" / "gallery")
    parser.add_argument("--samples", type=int)
    parser.add_argument("--size", default=f"{WIDTH}x{HEIGHT}")
    parser.add_argument("--assets", type=Path, required=True)
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    width, height = map(int, options.size.split("x"))
    device = sv.Device()
    for name in options.names:
        print(name, flush=True)
        picture = picture_of(device, name, (width, height), options.samples, options.assets)
        picture.save(options.output / f"{name}.jpg", quality=92, subsampling=0, optimize=True)
    options.output.with_suffix(".md").write_text(page())


if __name__ == "__main__":
    main()
