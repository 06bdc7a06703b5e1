"""Worlds of MuJoCo, stepped and lit; their cameras' pictures side by side. `python mujoco_worlds.py [model.xml]`."""

import sys

import mujoco
import numpy as np
from mujoco_scene import MODEL, make_scene, poses  # the program beside this one

import solari_vk as sv


def frames(device, model, worlds=64, size=(64, 64)):
    """Radiance (worlds, cameras, height, width, 3), frame by frame; each world is pushed its own way."""
    data = [mujoco.MjData(model) for _ in range(worlds)]
    for one, push in zip(data, np.random.default_rng(1).normal(size=(worlds, model.nv)), strict=True):
        one.qvel += push
    options = {"renderer": "realtime", "worlds": worlds, "outputs": ()}
    with sv.Batch(device, make_scene(model), size, worlds * model.ncam, **options) as batch:
        while True:
            for one in data:
                mujoco.mj_step(model, one, nstep=10)
            for index, transforms in enumerate(poses(data, "geom").swapaxes(0, 1)):
                batch.transforms[str(index)] = transforms
            batch.render(poses(data, "cam").reshape(-1, 4, 4), fov=np.tile(model.cam_fovy, worlds), ev100=14)
            yield batch["radiance"].reshape(worlds, model.ncam, *size[::-1], 3)


if __name__ == "__main__":
    model = mujoco.MjModel.from_xml_path((sys.argv[1:] or [MODEL])[0])
    with sv.Device() as device:
        *_, last = (found[:, 0] for found, _ in zip(frames(device, model, 16), range(8), strict=False))
    sheet = np.hstack([np.vstack(column) for column in np.split(last, 4)])
    sv.save_image("worlds.png", sheet, exposure=2**-14)
