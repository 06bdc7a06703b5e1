"""A mesh from a numpy array of heights: a picture in the sun, and heights by rays. `python height_field.py`."""

import numpy as np

import solari_vk as sv


def mesh_of(heights, spacing):
    """A mesh of heights (rows, columns) in meters that lie `spacing` meters apart, the first at the origin."""
    rows, columns = heights.shape
    z, x = np.mgrid[:rows, :columns] * spacing
    positions = np.stack([x, heights, z], axis=-1).reshape(-1, 3)
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]))
    return sv.Mesh(positions, np.concatenate([np.stack([a, c, b], axis=1), np.stack([a, d, c], axis=1)]))


def heights_at(tracer, x, z):
    """Heights of the scene below points (...), NaN where there is nothing, by rays from high above."""
    origins = np.stack(np.broadcast_arrays(x, 1e3, z), axis=-1)
    hits = tracer.trace(origins, (0, -1, 0))
    return np.where(hits["instance"] >= 0, hits["position"][..., 1], np.nan)


if __name__ == "__main__":
    z, x = np.mgrid[:64, :64] / 8
    scene = sv.Scene(sv.DirectionalLight((-2, -1, -0.5), illuminance=20_000))
    scene.add(mesh_of(np.sin(x) * np.cos(z) + 0.2 * np.sin(3 * x + z), 0.125), sv.Material(roughness=1.0))
    with sv.Device() as device:
        with sv.RayTracer(device, scene) as tracer:
            print("heights along z = 4:", heights_at(tracer, np.linspace(0, 7, 8), 4.0).round(2))
        with sv.PathTracer(device, scene, (192, 128)) as tracer:
            tracer.render(samples=32).save("hills.png", exposure="auto")
