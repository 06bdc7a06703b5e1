"""Renders docs/gallery/: for each feature the path tracer beside one denoised frame, and the page of them all.

    python tools/gallery [NAME ...] [-o docs/gallery] [--samples 1024] [--assets FOLDER]

Each NAME.py beside this file is a feature. Its docstring is the caption, and `scene(assets)` makes the scene, whose
camera is used; `assets` is a folder of glTF files that aren't part of this project. `exposure(scene)`, if there is one,
has further arguments of `render`. SIZE is another size. `draw(device, scene, picture)` makes what stands beside the
path tracer's picture in place of the realtime frame. Without names all are rendered.
"""

from __future__ import annotations

import argparse
import runpy
from pathlib import Path
from typing import Any

from PIL import Image

import solari_vk as sv

HERE = Path(__file__).parent
FEATURES = sorted(path.stem for path in HERE.glob("[a-z]*.py"))
SIZE = (320, 240)
FRAMES = 64


def feature(name: str) -> dict[str, Any]:
    """What a feature's file defines."""
    return runpy.run_path(str(HERE / f"{name}.py"))


def render(device: sv.Device, found: dict[str, Any], path: Path, samples: int, assets: Path | None) -> None:
    """Save the two pictures of a feature side by side, with one exposure."""
    scene, (width, height) = found["scene"](assets), found.get("SIZE", SIZE)
    exposure = found["exposure"](scene) if "exposure" in found else {}
    with sv.PathTracer(device, scene, (width, height)) as reference:
        left = Image.fromarray(reference.render(samples=samples, **exposure).image())
    if "draw" in found:
        right = found["draw"](device, scene, left)
    else:
        with sv.Renderer(device, scene, (width, height)) as renderer:
            for _ in range(FRAMES):
                frame = renderer.render(**exposure)
            right = Image.fromarray(frame.image())
    both = Image.new("RGB", (2 * width + 4, height), "white")
    both.paste(left, (0, 0))
    both.paste(right, (width + 4, 0))
    both.save(path, optimize=True)


def page(names: list[str]) -> str:
    """The text of docs/gallery.md."""
    lines = [
        "# Gallery\n",
        "[![Three flight helmets by the sea](helmets.jpg)](helmets.jpg)\n",
        "`tools/helmets.py` makes this picture by the path tracer, with a thin lens, and denoises it.\n",
        f"Below: the path tracer, and beside it one denoised frame of the realtime renderer, its {FRAMES}th, or",
        "what the title names.",
        "`python tools/gallery` renders all of them.\n",
    ]
    for name in names:
        title, _, caption = (feature(name)["__doc__"] or name).strip().partition("\n")
        lines += [f"## {title.rstrip('.')}", "", *([caption.strip(), ""] if caption.strip() else []),
                  f"![{title.rstrip('.')}](gallery/{name}.png)", ""]  # fmt: skip
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", default=FEATURES, metavar="NAME")
    parser.add_argument("-o", "--output", type=Path, default=HERE.parents[1] / "docs" / "gallery")
    parser.add_argument("--samples", type=int, default=1024)
    parser.add_argument("--assets", type=Path, default=None)
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    device = sv.Device()
    for name in options.names:
        print(name, flush=True)
        render(device, feature(name), options.output / f"{name}.png", options.samples, options.assets)
    options.output.with_suffix(".md").write_text(page(FEATURES))


if __name__ == "__main__":
    main()
