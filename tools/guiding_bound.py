#!/usr/bin/env python3
"""Prints how much noise rays could lose that are guided by what cells of the world cache have seen.

Usage: python tools/guiding_bound.py [--points 16] [--samples 256]

The scene is `door_ajar`: a dark room beside one with six lamps, with a door ajar between them. At points that the
camera sees, a panorama of the path tracer is the indirect light that comes in. From it follow the variances, over
squared means, of estimates of a diffuse surface's light by one ray: chosen by the cosine alone, and chosen in part by a
histogram of 8 x 8 directions, equal parts of a square around the hemisphere's disk, that has been learned perfectly
7 cm beside the point, in the same cell. It is a bound: no histogram is learned perfectly, and the light at a ray's end
has noise too.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from numpy.typing import NDArray

import solari_vk as sv
from solari_vk.scene.rooms import rooms
from solari_vk.settings import RAW

Floats = NDArray[np.float64]
SIZE, HEIGHT, BINS = (64, 36), 32, 8
SHARES = (0.0, 0.5, 0.7)  # of rays that are guided
OFFSET, BESIDE = 1e-3, 0.07  # meters


def door_ajar() -> sv.Scene:
    """Two rooms with a door ajar between them. The camera's has no lamp."""
    scene = rooms(columns=2, rows=1, lamp_count=6)
    scene.name = "door_ajar"
    for lamp in [one for one in scene.instances if one.name == "lamp" and one.transform[0, 3] > 4.0]:
        scene.remove(lamp)
    return scene


def relative_variances(light: Floats, learned: Floats) -> list[float]:
    """For each of SHARES. light, learned (HEIGHT, 2 * HEIGHT): radiance around the point and beside it, in panoramas
    whose middle is along the normal."""
    height, width = light.shape
    latitude = ((np.arange(height) + 0.5) / height - 0.5)[:, None] * np.pi
    longitude = ((np.arange(width) + 0.5) / width - 0.5)[None] * 2 * np.pi
    cosine = np.maximum(np.cos(latitude) * np.cos(longitude), 0.0)
    solid_angle = np.where(cosine > 0, np.cos(latitude) * (np.pi / height) * (2 * np.pi / width), 0.0)
    columns, rows = ((1 + x) / 2 * BINS for x in (np.cos(latitude) * np.sin(longitude), np.sin(latitude)))
    bins = rows.astype(int) * BINS + columns.astype(int)
    weights = np.bincount(bins.ravel(), (learned * cosine * solid_angle).ravel(), BINS**2)
    angles = np.bincount(bins.ravel(), solid_angle.ravel(), BINS**2)
    guided = (weights / np.maximum(angles, 1e-12) / max(weights.sum(), 1e-300))[bins]
    irradiance, found = float((light * cosine * solid_angle).sum()), []
    for share in SHARES:
        pdf = np.maximum((1 - share) * cosine / np.pi + share * guided, 1e-12)
        second_moment = float(((light * cosine) ** 2 / pdf * solid_angle).sum())
        found.append(second_moment / max(irradiance, 1e-300) ** 2 - 1)
    return found


def raw_variance(device: sv.Device, scene: sv.Scene, seeds: int = 4, frames: int = 16) -> Floats:
    """The variance of raw frames over their squared mean, by pixel (h, w)."""
    pictures: list[Any] = []
    with sv.Renderer(device, scene, SIZE, sv.Settings(**RAW, jitter=False)) as renderer:
        for renderer.seed in range(seeds):
            renderer.reset()
            made = (renderer.render()["raw_radiance"].sum(axis=-1, dtype=np.float64) for _ in range(2 * frames))
            pictures += list(made)[frames:]
    mean = np.mean(pictures, axis=0)
    return np.asarray(np.var(pictures, axis=0, ddof=1) / np.maximum(mean, 1e-9) ** 2)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, default=16)
    parser.add_argument("--samples", type=int, default=256)
    options = parser.parse_args()
    scene, panorama = door_ajar(), (2 * HEIGHT, HEIGHT)
    random = np.random.default_rng(0)
    columns, rows = (random.integers(2, side - 2, options.points) for side in SIZE)
    with sv.Device() as device:
        with sv.PathTracer(device, scene, SIZE) as tracer:
            frame = tracer.render(samples=1)
            positions, normals = (frame[name].astype(np.float64) for name in ("position", "geometric_normal"))
        whole = raw_variance(device, scene)
        found = []
        with sv.PathTracer(device, scene, panorama) as all_light, \
                sv.PathTracer(device, scene, panorama, max_bounces=0) as emission:  # fmt: skip
            for x, y in zip(columns, rows, strict=True):
                normal = normals[y, x]
                up = np.eye(3)[0 if abs(normal[1]) > 0.9 else 1]
                around = []
                for beside in (0.0, BESIDE):
                    eye = positions[y, x] + OFFSET * normal + beside * np.cross(normal, up)
                    camera = sv.Camera.look_at(eye, eye + normal, up=up, projection="equirectangular")
                    light = all_light.render(camera, samples=options.samples)["radiance"].sum(-1, dtype=np.float64)
                    lamps = emission.render(camera, samples=64)["radiance"].sum(-1, dtype=np.float64)
                    around.append(np.maximum(light - lamps, 0.0))
                found.append([*relative_variances(*around), whole[y, x]])
    heads = (*(f"{share:.0%} guided" for share in SHARES), "raw frame")
    for head, values in zip(heads, np.transpose(found), strict=True):
        print(f"{head:12} variance over squared mean, median of {options.points} points: {np.median(values):.2f}")
    by_cosine, by_half = np.transpose(found)[:2]
    print(f"guided half / by the cosine, median: {np.median(by_half / by_cosine):.2f}")


if __name__ == "__main__":
    main()
