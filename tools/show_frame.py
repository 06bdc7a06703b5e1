#!/usr/bin/env python3
"""Prints a renderer's frame as a table: passes by resources (r reads, w writes), barriers with why, milliseconds.

Usage: tools/show_frame.py [FILE.glb | builtin:NAME] [--size 256x256] [--frames 3]
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from solari_vk.gpu.frame.frame import Row


def format_rows(rows: Sequence[Row]) -> str:
    """The table of `Frame.describe()`: resources as columns, in the order in which the frame comes to them."""
    resources = list(dict.fromkeys(name for row in rows for name in (*row.writes, *row.reads)))
    width = max(len(row.name) for row in rows)
    height = max((len(name) for name in resources), default=0)
    indent = " " * (width + 15)
    lines = [indent + " ".join(name.rjust(height)[at] for name in resources) for at in range(height)]
    for row in rows:
        if row.barrier:
            lines.append(f"{'':{width}}  -- barrier: {row.barrier}")
        cells = []
        for name in resources:
            reads, writes = name in row.reads, name in row.writes
            cells.append("x" if reads and writes else "w" if writes else "r" if reads else ".")
        time = "" if row.milliseconds is None else f"{row.milliseconds:8.3f} ms"
        lines.append(f"{row.name:{width}}  {time:>11}  " + " ".join(cells))
    return "\n".join([*lines, "r reads, w writes, x both; a barrier lets all before it finish first"])


def main(arguments: Sequence[str] | None = None) -> int:
    """Render a few frames and print them; returns the exit code."""
    import solari_vk as sv
    from solari_vk.gpu.frame.frame import Frame

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", nargs="?", default="builtin:cornell_box")
    parser.add_argument("--size", default="256x256")
    parser.add_argument("--frames", type=int, default=3)
    options = parser.parse_args(arguments)
    try:
        width, height = (int(part) for part in options.size.split("x"))
    except ValueError:
        parser.error(f"--size {options.size}: give it as 256x256")
    try:
        name = options.scene.removeprefix("builtin:")
        scene = sv.builtin(name) if name != options.scene else sv.load_gltf(name)
        camera = next(iter(scene.cameras), None) or sv.frame_camera(scene, aspect=width / height)
        with sv.Device() as device:
            renderer = sv.PathTracer(device, scene, (width, height))
            for samples in range(1, options.frames + 1):
                renderer.render(camera, samples)
            for frame in [value for value in vars(renderer).values() if isinstance(value, Frame)]:
                print(format_rows(frame.describe()))
            renderer.close()
    except sv.SolariError as error:
        print(f"show_frame: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
