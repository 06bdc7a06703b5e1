"""`solari-vk bench load`: sizes of files, and the times from a file to a scene on the device."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from solari_vk.bound.binder import SceneBinder
from solari_vk.gpu.device.device import Device
from solari_vk.lab.measure.figures import device_seconds
from solari_vk.lab.measure.report import measuring
from solari_vk.scene.files.gltf.images import Images
from solari_vk.scene.load import load
from solari_vk.scene.material import TEXTURES
from solari_vk.scene.model import Scene

RUNS = 3
HEAD = ["file", "MB", "instances", "triangles", "images", "Mpixels", "read, s", "of it images, s", "to the device, s",
        "on the device, MB"]  # fmt: skip
INTRO = (f"Times are wall-clock, each the best of {RUNS} runs. A MB is a million bytes.",)
NOTE = (
    "The file's size includes the files that it names. Triangles are those of different meshes. Reading ends with "
    "arrays in memory; images, of glTF files, are opened and decoded by several threads. The device's part is packing, "
    "copies, levels of textures, and acceleration structures. The memory is that of the scene, without frames."
)


def run(select: str | None, files: Sequence[Path], *, rays: str | None = None, markdown: Path | None = None) -> None:
    """Measure and print a table; markdown: a page to write too.

    Raises SolariError for files that can't be loaded, and without a folder for the page.
    """
    with measuring(select, rays, markdown, "Loading", *INTRO) as (device, report):
        report.table("Files", HEAD, [measure(device, path) for path in files], NOTE)


def measure(device: Device, path: Path) -> list[str]:
    """A row of the table."""
    read = []
    decode = []
    upload = []
    for _ in range(RUNS):
        with _time_of_images() as spent:
            started = time.perf_counter()
            scene = load(path)
            read.append(time.perf_counter() - started)
        decode.append(sum(spent))
        binder = SceneBinder(device, scene)
        upload.append(device_seconds(device, binder.update))
        held = device.memory.bytes_used
        binder.destroy()
        device.wait_idle()
        # The difference is what the scene held; the device keeps memory of its own.
        held -= device.memory.bytes_used
    # Materials share images; each counts once.
    pixels = {id(image): image.pixels.shape[0] * image.pixels.shape[1] for image in _images(scene)}
    triangles = sum(len(mesh.triangles) for mesh in set(scene.meshes))
    return [
        path.name,
        f"{_bytes(path) / 1e6:.2f}",
        f"{len(scene.instances):,}",
        f"{triangles:,}",
        str(len(pixels)),
        f"{sum(pixels.values()) / 1e6:.1f}",
        # The smallest time is that with the least other work on the machine.
        *(f"{min(times):.3f}" for times in (read, decode, upload)),
        f"{held / 1e6:.1f}",
    ]


def _images(scene: Scene) -> Iterator[Any]:
    """The images of all textures, several times if they are used so."""
    for material in scene.materials:
        for slot in TEXTURES:
            texture = getattr(material, slot)
            if texture is not None:
                yield texture.image


def _bytes(path: Path) -> int:
    """The size of a file with the files that it names, if it is a .gltf file."""
    names = set()
    if path.suffix.lower() == ".gltf":
        content = json.loads(path.read_text(encoding="utf-8"))
        listed = [*content.get("buffers", ()), *content.get("images", ())]
        names = {entry["uri"] for entry in listed if not entry.get("uri", "data:").startswith("data:")}
    files = [path, *(path.parent / unquote(name) for name in names)]
    return sum(file.stat().st_size for file in files if os.path.isfile(file))


@contextmanager
def _time_of_images() -> Iterator[list[float]]:
    """The seconds of each call that reads the images of a glTF file."""
    spent: list[float] = []
    read = Images.read

    def timed(self: Images, *arguments: Any) -> None:
        started = time.perf_counter()
        read(self, *arguments)
        spent.append(time.perf_counter() - started)

    # By setattr, because mypy refuses the assignment of a method.
    setattr(Images, "read", timed)  # noqa: B010
    try:
        yield spent
    finally:
        setattr(Images, "read", read)  # noqa: B010
