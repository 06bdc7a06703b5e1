#!/usr/bin/env python3
"""Prints a renderer's frame: stages, passes with what they read and write, barriers with their reasons, resources.

Usage: python tools/show_frame.py [FILE.glb | builtin:NAME] [--reference] [--size 256x256] [--frames 3]
                                  [--stages FILE.py]
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import runpy
import sys
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from solari_vk.gpu.frame.frame import Row

ROOT = Path(__file__).resolve().parents[1]
WIDTH = 120


def describe_passes(rows: Sequence[Row]) -> list[str]:
    """The lines for `Frame.describe()`: a stage's name, then its passes with barriers and resources."""
    lines, stage = [], None
    for row in rows:
        if row.stage != stage:
            stage = row.stage
            lines.append(f"stage {stage}")
        if row.barrier:
            lines += _wrapped("  barrier: ", row.barrier)
        time = "" if row.milliseconds is None else f"{row.milliseconds:10.3f} ms"
        lines.append(f"  pass {row.name:42}{time}".rstrip())
        for verb, names in (("reads", row.reads), ("writes", row.writes)):
            if names:
                lines += _wrapped(f"    {verb:6} ", ", ".join(names))
    return lines


def _wrapped(start: str, text: str) -> list[str]:
    return textwrap.wrap(text, WIDTH, initial_indent=start, subsequent_indent=" " * len(start))


def describe_resources(resources: Mapping[str, Any]) -> list[str]:
    """The lines for resources by name: kind and size of each."""
    from solari_vk.gpu.device.image import Image

    lines = ["resources"]
    for name, resource in sorted(resources.items()):
        size = getattr(resource, "size", None)
        kind = type(resource).__name__.lower()
        if isinstance(resource, Image):
            kind += f" {resource.width}x{resource.height}, {resource.channels} x {resource.dtype}"
        lines.append(f"  {name:32}{'' if size is None else f'{size:,} bytes':>20}  {kind}")
    return lines


def main(arguments: Sequence[str] | None = None) -> int:
    """Render a few frames and print the last one; returns the exit code."""
    import solari_vk as sv
    from solari_vk.cli.options import size

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", nargs="?", default="builtin:cornell_box")
    parser.add_argument("--reference", action="store_true", help="the path tracer's frame, not the realtime one")
    parser.add_argument("--size", type=size, default=(256, 256), metavar="WxH", help="pixels (256x256)")
    parser.add_argument("--frames", type=int, default=3, help="frames to render before (3)")
    parser.add_argument(
        "--stages", metavar="FILE.py", help="a file whose function add_stages(renderer) adds stages of your own"
    )
    options = parser.parse_args(arguments)
    try:
        name = options.scene.removeprefix("builtin:")
        scene = sv.builtin(name) if name != options.scene else sv.load_gltf(name)
        camera = scene.camera_for(options.size[0] / options.size[1])
        kind = sv.PathTracer if options.reference else sv.Renderer
        with sv.Device() as device, kind(device, scene, options.size) as renderer:
            if options.stages:
                functions = runpy.run_path(options.stages)
                if "add_stages" not in functions:
                    raise sv.SolariError(f"{options.stages} has no function add_stages(renderer)")
                functions["add_stages"](renderer)
            for count in range(1, options.frames + 1):
                # The path tracer is told how many samples the picture has after a call, so that each takes one more.
                renderer.render(camera, **({"samples": count} if options.reference else {}))
            rows = renderer.describe()
            names = {name for row in rows for name in (*row.reads, *row.writes)}
            resources = {name: renderer.resource(name) for name in names}
            print("\n".join([*describe_passes(rows), *describe_resources(resources)]))
    except sv.SolariError as error:
        print(f"show_frame: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    # Where this Python lacks the package's dependencies, that of tools/test has them.
    python = ROOT / ".venv/bin/python"
    if importlib.util.find_spec("vulkan") is None and python.is_file():
        os.execv(python, [str(python), *sys.argv])
    sys.path.insert(0, str(ROOT))
    sys.exit(main())
