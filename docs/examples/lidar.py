"""A spinning lidar in a scene: a cloud of points with what each belongs to. `python lidar.py [scene] [out.npz]`."""

import sys

import numpy as np

import solari_vk as sv

CHANNELS, STEPS = 64, 1024
ELEVATIONS = np.radians(np.linspace(-25, 15, CHANNELS))
RANGE, NOISE = 60.0, 0.01  # meters: the farthest echo, and one standard deviation of a distance


def scan(tracer, position, seed=0):
    """One turn of the sensor: hits (CHANNELS, STEPS), and points (N, 3) with noise along their rays."""
    azimuths = np.linspace(0, 2 * np.pi, STEPS, endpoint=False)
    elevation, azimuth = np.meshgrid(ELEVATIONS, azimuths, indexing="ij")
    flat = np.cos(elevation)
    directions = np.stack([flat * np.cos(azimuth), np.sin(elevation), flat * np.sin(azimuth)], axis=-1)
    hits = tracer.trace(position, directions, t_min=0.05, t_max=RANGE)
    echo = hits["instance"] >= 0
    distances = hits["t"][echo] + np.random.default_rng(seed).normal(0, NOISE, echo.sum())
    return hits, position + distances[:, None] * directions[echo]


def main(name="many_lights", out="lidar.npz"):
    scene = sv.builtin(name) if name.isidentifier() else sv.load_gltf(name)
    position = scene.bounds.center
    with sv.Device() as device, sv.RayTracer(device, scene) as tracer:
        hits, points = scan(tracer, position)
        rows = hits["instance"][hits["instance"] >= 0]
        names = [tracer.instances[row].name for row in rows.tolist()]
    np.savez_compressed(out, points=points, names=names)
    print(f"{len(points):,} echoes of {hits.size:,} rays, from {len(set(rows.tolist())):,} things: {out}")


if __name__ == "__main__":
    main(*sys.argv[1:])
