"""Uses the renderers at random for as long as asked, under validation: soak.py --minutes N [--seed S] [FILE ...]

Each round opens a scene (built in, an animated character, or one of the files) and a Renderer, a PathTracer and a
RayTracer on it, and makes random edits of instances, materials, textures, meshes, lights, environments, cameras, clips,
settings, sizes and views between frames, traces rays, and writes pictures and reads them again. A round ends with these
checks: pictures and rays have the same bits as those of new renderers; the edited scene has the same depths as when it
is put on the device anew; settled realtime frames have the path tracer's mean within 10 % and their noise; nothing is
left on the device once all are closed; and neither the process nor the device's memory goes on growing. Every
DEVICE_ROUNDS rounds the device is closed and opened again. Any exception, among them every validation message, ends the
run with exit code 1 and names the seed and the round; --first makes it begin there.
"""

from __future__ import annotations

import argparse
import ctypes
import gc
import os
import resource
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import solari_vk as sv
from solari_vk.lab.measure.character import character
from solari_vk.passes.debug_views import views_of
from solari_vk.settings import DEFAULTS, FIELDS

Opening = Callable[[], sv.Scene]
BUILTIN = ("cornell_box", "sphere_grid", "mirror_hall", "many_lights")
OPENINGS: dict[str, Opening] = {
    "character": lambda: character(400, 8),
    **{name: lambda name=name: sv.builtin(name) for name in BUILTIN},
}
WIDEST = 48  # pixels
ACTIONS = 60
LONG_ROUND = 6  # every sixth round is long
LONG_ACTIONS = 300
SEEDS = 8  # runs of the comparison with the path tracer
BIAS = 0.1  # by which realtime frames may be off then
DEVICE_ROUNDS = 9
GROWTH = 64e6  # bytes that the process and the device's memory may grow by after the first rounds
FIRST_ROUNDS = 6
# Settings that make frames too slow or memory too large for a soak if they are taken from their whole range.
MODEST = {"world_cache_cells": 1 << 16, "paths_bounces": 8, "paths_short_history_samples": 3, "denoise_max_history": 64}


class Soak:
    """A scene with its renderers, and the random actions on them."""

    def __init__(self, device: sv.Device, scene: sv.Scene, rng: np.random.Generator, folder: Path) -> None:
        self.rng = rng
        self.scene = scene
        self.device = device
        self.folder = folder
        self.counts: Counter[str] = Counter()
        self.added: list[sv.Instance] = []
        self.lamps: list[Any] = []
        self.realtime = sv.Renderer(device, scene, self.size())
        self.reference = sv.PathTracer(device, scene, self.size(), max_bounces=4)
        self.tracer = sv.RayTracer(device, self.realtime.binder)

    def size(self) -> tuple[int, int]:
        width, height = self.rng.integers(1, WIDEST + 1, 2)
        return int(width), int(height)

    def one_of(self, values: Any) -> Any:
        return values[self.rng.integers(len(values))]

    def near(self, share: float) -> Any:
        """A place around the scene's center, at this share of its radius."""
        return self.scene.bounds.center + share * self.scene.bounds.radius * self.rng.normal(size=3)

    def act(self) -> None:
        """One random action, and often a frame."""
        action = self.one_of(
            [
                self.move,
                self.hide,
                self.paint,
                self.add,
                self.remove,
                self.light,
                self.surround,
                self.bend,
                self.set,
                self.resize,
                self.look,
                self.view,
                self.animate,
                self.trace,
                self.reset,
                self.save,
            ]
        )
        self.counts[action.__name__] += 1
        action()
        if self.rng.random() < 0.7:
            frame = self.realtime.render()
            self.counts["realtime frames"] += 1
            if self.rng.random() < 0.3:
                name = self.one_of(frame.keys())
                values = np.asarray(frame[name])
                assert values.dtype.kind != "f" or not np.isnan(values).any(), f"{name} has NaN"
                assert np.isfinite(np.asarray(frame["radiance"])).all()
        if self.rng.random() < 0.2:
            self.reference.render(samples=self.reference.samples + 1)
            self.counts["samples"] += 1

    def move(self) -> None:
        item = self.one_of(list(self.scene))
        transform = np.array(item.transform)
        transform[:3, 3] += 0.01 * self.scene.bounds.radius * self.rng.normal(size=3)
        item.transform = transform

    def hide(self) -> None:
        for item in self.added:
            item.visible = bool(self.rng.integers(2))

    def paint(self) -> None:
        material = self.one_of(list(self.scene)).material
        material.base_color = self.rng.random(3)
        material.perceptual_roughness, material.metallic = self.rng.random(2)
        if self.rng.random() < 0.2:
            material.emissive = self.rng.random(3) * 5
        if self.rng.random() < 0.3:
            pixels = self.rng.integers(0, 256, (*self.rng.integers(1, 9, 2), 4)).astype(np.uint8)
            material.base_color_texture = sv.Texture(sv.TextureImage(pixels)) if self.rng.random() < 0.7 else None

    def add(self) -> None:
        material = sv.Material(base_color=self.rng.random(3), transmission=float(self.rng.integers(2)))
        sphere = sv.shapes.sphere(0.1 * self.scene.bounds.radius, segments=int(self.rng.integers(4, 24)))
        self.added.append(self.scene.add(sphere, material, self.near(0.2)))

    def remove(self) -> None:
        if self.added:
            self.scene.remove(self.added.pop(self.rng.integers(len(self.added))))

    def light(self) -> None:
        if self.lamps and self.rng.random() < 0.5:
            self.scene.remove(self.lamps.pop(self.rng.integers(len(self.lamps))))
            return
        direction = self.rng.normal(size=3)
        radius = 0.05 * float(self.rng.integers(2))
        self.lamps.append(
            self.scene.add(
                self.one_of(
                    [
                        lambda: sv.PointLight(self.near(0.3), intensity=1.0, radius=radius),
                        lambda: sv.SpotLight(self.near(0.3), direction, intensity=1.0, radius=radius),
                        lambda: sv.DirectionalLight(direction, illuminance=1.0),
                    ]
                )()
            )
        )

    def surround(self) -> None:
        self.scene.environment = self.one_of(
            [
                lambda: None,
                lambda: sv.Environment(self.rng.random((4, 8, 3))),
                lambda: sv.Sky(self.rng.normal(size=3), intensity=1e-4),
            ]
        )()

    def bend(self) -> None:
        mesh = self.one_of(list(self.scene)).mesh
        mesh.positions = mesh.positions + self.rng.normal(size=mesh.positions.shape) * 1e-3

    def set(self) -> None:
        if self.rng.random() < 0.3:
            self.realtime.settings.reset()
        else:
            name = self.one_of(list(FIELDS))
            setattr(self.realtime.settings, name, self.value_of(name))
        if self.realtime.view not in views_of(self.realtime.settings.lighting):
            self.realtime.view = "picture"

    def value_of(self, name: str) -> Any:
        """A random value of a setting."""
        field, default = FIELDS[name], DEFAULTS[name]
        if field.choices:
            return self.one_of(field.choices)
        if isinstance(default, bool):
            return bool(self.rng.integers(2))
        if name in MODEST:
            return MODEST[name]
        value = np.clip(default * 2.0 ** self.rng.normal(), field.low, field.high)
        return int(value) if isinstance(default, int) else float(value)

    def resize(self) -> None:
        self.realtime.resize(self.size())
        self.reference.resize(self.size())

    def look(self) -> None:
        transform = np.array(self.scene.camera.transform)
        transform[:3, 3] += 0.02 * self.scene.bounds.radius * self.rng.normal(size=3)
        self.scene.camera.transform = transform

    def view(self) -> None:
        self.realtime.view = self.one_of(views_of(self.realtime.settings.lighting))

    def animate(self) -> None:
        if self.scene.animations:
            self.scene.animate(float(self.rng.random() * 10), int(self.rng.integers(len(self.scene.animations))))

    def trace(self) -> None:
        self.tracer.trace(self.rng.normal(size=(64, 3)), self.rng.normal(size=(64, 3)))

    def reset(self) -> None:
        self.realtime.reset()

    def save(self) -> None:
        frame = self.reference.render(samples=self.reference.samples + 1)
        path = self.folder / f"picture{self.one_of(('.png', '.exr', '.npy'))}"
        frame.save(path, layers=("depth", "albedo"), exposure=1.0)
        if path.suffix == ".npy":
            assert np.array_equal(np.load(path), frame["radiance"]), "a picture was written otherwise"

    def check(self) -> tuple[float, float]:
        """Compare with new renderers; returns the realtime frame's mean and the noise over the path tracer's mean."""
        size = (24, 24)
        # A few pixels are enough: what edits leave behind is seen anywhere in a picture.
        self.reference.resize(size)
        used = self.reference.render(samples=16)
        depth, radiance = used["depth"], np.asarray(used["radiance"])
        with sv.PathTracer(self.device, self.reference.binder, size, max_bounces=4) as tracer:
            same = np.array_equal(tracer.render(samples=16)["radiance"], radiance)
        assert same, "a path tracer that was used differs from a new one"
        with sv.PathTracer(self.device, self.scene, size, max_bounces=4) as tracer:
            same = np.array_equal(tracer.render(samples=1)["depth"], depth)
        assert same, "a scene that was edited is placed otherwise than on the device anew"
        rays = self.rng.normal(size=(64, 3)), self.rng.normal(size=(64, 3))
        with sv.RayTracer(self.device, self.scene) as new:
            same = np.array_equal(new.trace(*rays)["t"], self.tracer.trace(*rays)["t"])
        assert same, "a ray tracer that was used differs from a new one"
        self.realtime.settings.reset()
        self.realtime.view = "picture"
        self.realtime.resize(size)
        self.realtime.reset()
        self.realtime.frame_count = 0  # which random numbers depend on
        frames = [np.asarray(self.realtime.render()["raw_radiance"]) for _ in range(8)]
        with sv.Renderer(self.device, self.realtime.binder, size) as new:
            same = [np.array_equal(new.render()["raw_radiance"], frame) for frame in frames]
        assert all(same), f"frames of a renderer that was used differ from those of a new one: {same}"
        with sv.PathTracer(self.device, self.reference.binder, size) as tracer:
            return self.drift(tracer)

    def drift(self, tracer: sv.PathTracer) -> tuple[float, float]:
        """The realtime frame's mean over the path tracer's, and the standard deviation of that by noise. Both are
        rendered with several seeds, which say how far noise may take them apart."""
        means = np.zeros((2, SEEDS))
        for seed in range(SEEDS):
            self.realtime.seed = tracer.seed = seed
            self.realtime.reset()
            tracer.reset()
            # The first half lets the world cache and the histories settle.
            frames = [np.asarray(self.realtime.render()["raw_radiance"]).mean() for _ in range(32)]
            means[:, seed] = np.mean(frames[16:]), np.asarray(tracer.render(samples=64)["radiance"]).mean()
        (realtime, truth), noise = means.mean(axis=1), np.linalg.norm(means.std(axis=1, ddof=1)) / SEEDS**0.5
        assert abs(realtime - truth) <= BIAS * truth + 5 * noise, (
            f"realtime frames have {realtime / truth:.2f} of the path tracer's light, and noise of {noise / truth:.2f}"
        )
        return (float(realtime / truth), float(noise / truth)) if truth > 0 else (1.0, 0.0)

    def close(self) -> None:
        self.tracer.close()
        self.realtime.close()
        self.reference.close()


def run_round(
    device: sv.Device, opening: Opening, rng: np.random.Generator, count: int
) -> tuple[Counter[str], float, float]:
    """What was done in `count` actions, the realtime frame's mean over the path tracer's, and that ratio's noise."""
    with tempfile.TemporaryDirectory() as folder:
        soak = Soak(device, opening(), rng, Path(folder))
        for _ in range(count):
            soak.act()
        ratio, noise = soak.check()
        soak.close()
    device.wait_idle()
    assert device.objects_in_use == 0, f"{device.objects_in_use} objects are left on the device"
    return soak.counts, ratio, noise


class MallInfo(ctypes.Structure):
    """struct mallinfo2 of the C library."""

    _fields_ = [
        (name, ctypes.c_size_t)
        for name in (
            "arena",
            "ordblks",
            "smblks",
            "hblks",
            "hblkhd",
            "usmblks",
            "fsmblks",
            "uordblks",
            "fordblks",
            "keepcost",
        )
    ]


def memory() -> int:
    """Bytes that the process uses: what it has in memory, with the used part of the C library's heap instead of the
    whole. After random edits half of the heap is free memory in small pieces, more after each round."""
    gc.collect()
    library = ctypes.CDLL(None)
    library.mallinfo2.restype = MallInfo
    resident = int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()
    heaps = Path("/proc/self/smaps").read_text().split("[heap]\n")[1:]
    heap_resident = sum(int(heap.partition("Rss:")[2].split()[0]) * 1024 for heap in heaps)
    return resident - heap_resident + int(library.mallinfo2().uordblks)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="the number of the first round")
    parser.add_argument("files", nargs="*", type=Path)
    options = parser.parse_args()
    openings = OPENINGS | {str(path): lambda path=path: sv.load(path) for path in options.files}
    counts: Counter[str] = Counter()
    ratios: list[float] = []
    sizes: list[tuple[int, int, int]] = []
    end = time.monotonic() + 60 * options.minutes
    number = options.first
    device = sv.Device(validation=True)
    while time.monotonic() < end:
        rng = np.random.default_rng((options.seed, number))
        subject = list(openings)[rng.integers(len(openings))]
        try:
            count = LONG_ACTIONS if number % LONG_ROUND == LONG_ROUND - 1 else ACTIONS
            done, ratio, noise = run_round(device, openings[subject], rng, count)
            sizes.append((memory(), device.memory.bytes_reserved, len(os.listdir("/proc/self/fd"))))
            if len(sizes) > FIRST_ROUNDS:
                grown = np.subtract(sizes[-1], np.max(sizes[:FIRST_ROUNDS], axis=0))
                assert (grown < (GROWTH, GROWTH, 16)).all(), f"grown by bytes, device bytes and open files: {grown}"
        except BaseException:
            print(f"round {number} of seed {options.seed}, {subject}", file=sys.stderr)
            raise
        counts += done
        ratios.append(ratio)
        number += 1
        used, reserved, _ = sizes[-1]
        print(
            f"round {number}, {subject}: realtime {ratio:.3f} of the path tracer (noise {noise:.3f}), "
            f"{used / 1e6:.0f} MB, of which {reserved / 1e6:.0f} MB of the device",
            flush=True,
        )
        if number % DEVICE_ROUNDS == 0:
            device.close()
            device = sv.Device(validation=True)
    device.close()
    if ratios:
        print(
            f"{len(ratios)} rounds without a fault, realtime {min(ratios):.3f} to {max(ratios):.3f} of the path "
            "tracer: " + ", ".join(f"{count} {what}" for what, count in counts.most_common())
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
