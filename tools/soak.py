"""Uses the renderers at random for as long as asked, under validation: soak.py --minutes N [--seed S] [FILE ...]

Each round opens a scene (builtin, or one of the files), a Renderer and a PathTracer, and makes random edits of
instances, materials, meshes, lights, cameras, clips, settings, sizes and views between frames. A round ends with these
checks: the path tracer's picture has the same bits as that of a new path tracer; the edited scene has the same depths
as when it is put on the device anew; settled realtime frames have the path tracer's mean within 10 %; nothing is left
on the device once all are closed; and the process's memory has stopped growing. Any exception, among them every
validation message, ends the run with exit code 1 and names the seed and the round.
"""

from __future__ import annotations

import argparse
import resource
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np

import solari_vk as sv
from solari_vk.passes.debug_views import views_of
from solari_vk.settings import DEFAULTS, FIELDS

BUILTIN = ("cornell_box", "sphere_grid", "mirror_hall", "many_lights")
WIDEST = 48  # pixels
GROWTH = 64e6  # bytes that the process may grow by after its first rounds
FIRST_ROUNDS = 4
# Settings that make frames too slow or memory too large for a soak if they are taken from their whole range.
MODEST = {"world_cache_cells": 1 << 16, "paths_bounces": 8, "denoise_frames": 64}


class Soak:
    """A scene with both renderers, and the random actions on them."""

    def __init__(self, device: sv.Device, scene: sv.Scene, rng: np.random.Generator) -> None:
        self.rng, self.scene, self.device = rng, scene, device
        self.counts: Counter[str] = Counter()
        self.added: list[sv.Instance] = []
        self.lamps: list[sv.PointLight] = []
        self.realtime = sv.Renderer(device, scene, self.size())
        self.reference = sv.PathTracer(device, scene, self.size(), max_bounces=4)

    def size(self) -> tuple[int, int]:
        width, height = self.rng.integers(1, WIDEST + 1, 2)
        return int(width), int(height)

    def act(self) -> None:
        """One random action, and sometimes a frame."""
        actions = [self.move, self.paint, self.add, self.remove, self.light, self.bend, self.set, self.resize,
                   self.look, self.view, self.animate, self.trace, self.reset]  # fmt: skip
        action = actions[self.rng.integers(len(actions))]
        self.counts[action.__name__] += 1
        action()
        if self.rng.random() < 0.7:
            frame = self.realtime.render()
            self.counts["realtime frames"] += 1
            if self.rng.random() < 0.3:
                assert np.isfinite(np.asarray(frame["radiance"])).all()
        if self.rng.random() < 0.2:
            self.reference.render(samples=self.reference.samples + 1)
            self.counts["samples"] += 1

    def any_instance(self) -> sv.Instance:
        instances = list(self.scene)
        return instances[self.rng.integers(len(instances))]

    def move(self) -> None:
        item = self.any_instance()
        transform = np.array(item.transform)
        transform[:3, 3] += 0.01 * self.scene.bounds.radius * self.rng.normal(size=3)
        item.transform = transform

    def paint(self) -> None:
        material = self.any_instance().material
        material.base_color = self.rng.random(3)
        material.perceptual_roughness, material.metallic = self.rng.random(2)
        if self.rng.random() < 0.2:
            material.emissive = self.rng.random(3) * 5

    def add(self) -> None:
        glass = sv.Material(base_color=self.rng.random(3), transmission=float(self.rng.integers(2)))
        at = self.scene.bounds.center + self.scene.bounds.radius * self.rng.normal(size=3) * 0.2
        sphere = sv.shapes.sphere(0.1 * self.scene.bounds.radius, segments=int(self.rng.integers(4, 24)))
        self.added.append(self.scene.add(sphere, glass, at))

    def remove(self) -> None:
        if self.added:
            self.scene.remove(self.added.pop(self.rng.integers(len(self.added))))

    def light(self) -> None:
        if self.lamps and self.rng.random() < 0.5:
            self.scene.remove(self.lamps.pop())
        else:
            at = self.scene.bounds.center + self.scene.bounds.radius * self.rng.normal(size=3) * 0.3
            radius = 0.05 * float(self.rng.integers(2))
            self.lamps.append(self.scene.add(sv.PointLight(at, intensity=1.0, radius=radius)))

    def bend(self) -> None:
        mesh = self.any_instance().mesh
        mesh.positions = mesh.positions + self.rng.normal(size=mesh.positions.shape) * 1e-3

    def set(self) -> None:
        name = list(FIELDS)[self.rng.integers(len(FIELDS))]
        field, default = FIELDS[name], DEFAULTS[name]
        if self.rng.random() < 0.3:
            self.realtime.settings.reset()
        elif field.choices:
            setattr(self.realtime.settings, name, field.choices[self.rng.integers(len(field.choices))])
        elif isinstance(default, bool):
            setattr(self.realtime.settings, name, bool(self.rng.integers(2)))
        elif name in MODEST:
            setattr(self.realtime.settings, name, MODEST[name])
        else:
            value = np.clip(default * 2.0 ** self.rng.normal(), field.low, field.high)
            setattr(self.realtime.settings, name, int(value) if isinstance(default, int) else float(value))
        names = views_of(self.realtime.settings.lighting)
        if self.realtime.view not in names:
            self.realtime.view = "picture"

    def resize(self) -> None:
        size = self.size()
        self.realtime.resize(size)
        self.reference.resize(size)

    def look(self) -> None:
        transform = np.array(self.scene.camera.transform)
        transform[:3, 3] += 0.02 * self.scene.bounds.radius * self.rng.normal(size=3)
        self.scene.camera.transform = transform

    def view(self) -> None:
        names = views_of(self.realtime.settings.lighting)
        self.realtime.view = names[self.rng.integers(len(names))]

    def animate(self) -> None:
        if self.scene.animations:
            self.scene.animate(float(self.rng.random() * 10), int(self.rng.integers(len(self.scene.animations))))

    def trace(self) -> None:
        with sv.RayTracer(self.device, self.scene) as tracer:
            tracer.trace(self.rng.normal(size=(64, 3)), self.rng.normal(size=(64, 3)))

    def reset(self) -> None:
        self.realtime.reset()

    def check(self) -> float:
        """Compare with new renderers; returns the realtime frame's mean over the path tracer's."""
        size = (24, 24)
        self.reference.resize(size)
        used = self.reference.render(samples=16)
        depth, radiance = used["depth"], np.asarray(used["radiance"])
        with sv.PathTracer(self.device, self.reference.binder, size, max_bounces=4) as tracer:
            same = np.array_equal(tracer.render(samples=16)["radiance"], radiance)
        assert same, "a path tracer that was used differs from a new one"
        with sv.PathTracer(self.device, self.scene, size, max_bounces=4) as tracer:
            same = np.array_equal(tracer.render(samples=1)["depth"], depth)
        assert same, "a scene that was edited is placed otherwise than on the device anew"
        self.realtime.settings.reset()
        self.realtime.view = "picture"
        self.realtime.resize(size)
        self.realtime.reset()
        frames = [np.asarray(self.realtime.render()["raw_radiance"]).mean() for _ in range(64)]
        with sv.PathTracer(self.device, self.scene, size) as truth:
            mean = np.asarray(truth.render(samples=256)["radiance"]).mean()
        return float(np.mean(frames[16:]) / mean) if mean > 0 else 1.0

    def close(self) -> None:
        self.realtime.close()
        self.reference.close()


def memory() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("files", nargs="*", type=Path)
    options = parser.parse_args()
    counts: Counter[str] = Counter()
    end, after_first, number = time.monotonic() + 60 * options.minutes, 0, 0
    ratios = []
    with sv.Device(validation=True) as device:
        while time.monotonic() < end:
            rng = np.random.default_rng((options.seed, number))
            subjects = [*BUILTIN, *options.files]
            subject = subjects[rng.integers(len(subjects))]
            try:
                scene = sv.load(subject) if isinstance(subject, Path) else sv.builtin(subject)
                soak = Soak(device, scene, rng)
                for _ in range(60):
                    soak.act()
                ratios.append(soak.check())
                assert 0.9 < ratios[-1] < 1.1, f"the realtime frame has {ratios[-1]:.2f} of the path tracer's light"
                soak.close()
                device.wait_idle()
                left = device.live_objects - len(device._shared)
                assert left == 0, f"{left} objects are left on the device"
            except BaseException:
                print(f"round {number} of seed {options.seed}, {subject}", file=sys.stderr)
                raise
            counts += soak.counts
            number += 1
            if number == FIRST_ROUNDS:
                after_first = memory()
            grown = memory() - after_first if after_first else 0
            assert grown < GROWTH, f"the process grew by {grown / 1e6:.0f} MB since round {FIRST_ROUNDS}"
            found = f"realtime {ratios[-1]:.3f} of the path tracer, {memory() / 1e6:.0f} MB"
            print(f"round {number}, {subject}: {found}", flush=True)
    print(f"{number} rounds without a fault: " + ", ".join(f"{count} {what}" for what, count in counts.most_common()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
