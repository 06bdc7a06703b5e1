"""Renders docs/sensors.png: a picture, its raw numbers, a lidar's points and a depth camera's image of one scene.

python tools/sensor_pictures.py [-o docs/sensors.png] [--samples 256]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

import solari_vk as sv

SIZE = (240, 180)
DARKEST = 0.15


def colors(share: NDArray[np.float64]) -> NDArray[np.uint8]:
    """From blue over green and yellow to red, (..., 3)."""
    stops = np.array([(40, 60, 160), (30, 150, 170), (90, 190, 90), (230, 200, 60), (210, 60, 40)], np.float64)
    at = np.clip(share, 0, 1) * (len(stops) - 1)
    low = np.minimum(at.astype(int), len(stops) - 2)
    part = (at - low)[..., None]
    return ((1 - part) * stops[low] + part * stops[low + 1]).astype(np.uint8)


def mosaic(raw: NDArray[np.uint16], sensor: sv.Sensor) -> NDArray[np.uint8]:
    """Digital numbers in the colors of their filters, each twice as large: the middle of the picture."""
    share = np.clip((raw - sensor.black_level) / (sensor.white_level - sensor.black_level), 0, 1) ** (1 / 2.2)
    picture = np.zeros((*raw.shape, 3))
    for row in range(2):
        for column in range(2):
            channel = "RGB".index(sensor.bayer[2 * row + column])
            picture[row::2, column::2, channel] = share[row::2, column::2]
    height, width = raw.shape
    # The middle quarter of the sides, each number as 4x4 pixels, so that the filters can be told apart.
    middle = picture[height * 3 // 8 : height * 5 // 8, width * 3 // 8 : width * 5 // 8]
    return (255 * middle.repeat(4, axis=0).repeat(4, axis=1)).astype(np.uint8)


def cloud(points: NDArray[np.void], camera: sv.Camera) -> NDArray[np.uint8]:
    """Points of a lidar as a camera sees them, colored by their height."""
    picture = np.full((SIZE[1], SIZE[0], 3), 20, np.uint8)
    at = np.stack([points["x"], points["y"], points["z"]], -1).astype(np.float64)
    pixels = camera.project(at, SIZE)
    inside = (np.isfinite(pixels) & (pixels > -0.5) & (pixels < np.array(SIZE) - 0.5)).all(axis=-1)
    columns, rows = np.rint(pixels[inside]).astype(int).T
    brightness = np.clip(DARKEST + points["intensity"][inside, None], 0, 1)
    picture[rows, columns] = colors(at[inside, 1] / at[:, 1].max()) * brightness
    return picture


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=Path(__file__).parents[1] / "docs" / "sensors.png")
    parser.add_argument("--samples", type=int, default=256)
    options = parser.parse_args()
    scene = sv.builtin("cornell_box")
    camera = scene.camera_for(SIZE[0] / SIZE[1])
    sensor = sv.Sensor(iso=3200, bayer="RGGB", quantum_efficiency=(0.35, 0.6, 0.45))
    lidar = sv.Lidar.preset("OS1-128", min_range=0.1)
    tof = sv.TimeOfFlightCamera(signal=20_000, rays_per_pixel=2)
    with sv.Device() as device:
        with sv.PathTracer(device, scene, SIZE) as path_tracer:
            frame = path_tracer.render(camera, samples=options.samples)
            parts = [frame.image(), mosaic(sensor.expose(frame, seed=1), sensor)]
        with sv.RayTracer(device, scene) as tracer:
            parts.append(cloud(lidar.scan(tracer, (1, 1, 0.2), seed=1).points, camera))
            depth = tof.capture(tracer, camera, SIZE, seed=1).depth
    near, far = np.nanmin(depth), np.nanmax(depth)
    shown = colors(np.nan_to_num((depth - near) / (far - near)))
    parts.append(np.where(np.isfinite(depth)[..., None], shown, 20).astype(np.uint8))
    rows = [part[: SIZE[1], : SIZE[0]] for part in parts]
    Image.fromarray(np.concatenate(rows, axis=1)).save(options.output, optimize=True)


if __name__ == "__main__":
    main()
