"""Spheres that no triangle makes: boxes that rays meet, and a shader that generates the hits. `python spheres.py`."""

import sys
from pathlib import Path

import numpy as np

import solari_vk as sv
from solari_vk import rt


def render(device, spheres, size=(320, 180)):
    """A picture (height, width, 3) of spheres (N, 4), each a center and a radius, seen from z = 5 along -z."""
    spheres = np.asarray(spheres, np.float32)
    boxes = rt.Aabbs(np.hstack([spheres[:, :3] - spheres[:, 3:], spheres[:, :3] + spheres[:, 3:]]))
    blas, tlas = rt.create_blas(device, [boxes], name="spheres"), rt.create_tlas(device, 1)
    rt.build_acceleration_structures(
        device, [rt.BlasBuildEntry(blas, [boxes])], [rt.TlasPackage(tlas, [rt.TlasInstance(blas)])]
    )
    stage = sv.Stage(
        "spheres",
        buffers={"spheres": len(spheres), "picture": size[0] * size[1]},
        passes=[sv.Pass("spheres", threads=size)],
    )
    with sv.Frame(device, [stage], external={"tlas": tlas}, glsl_root=Path(__file__).parent / "glsl") as frame:
        frame.resource("spheres").upload(spheres)
        frame.uniforms["view.size"] = size
        frame.submit()
        picture = frame["picture"].reshape(size[1], size[0], 3)
    tlas.destroy()
    blas.destroy()
    return picture


if __name__ == "__main__":
    random = np.random.default_rng(2)
    cloud = np.hstack([random.uniform(-2, 2, (200, 3)), random.uniform(0.05, 0.3, (200, 1))])
    with sv.Device(rays="query") as device:
        sv.save_image(sys.argv[1] if len(sys.argv) > 1 else "spheres.png", render(device, cloud), exposure=1.0)
