"""Worlds of MuJoCo, stepped and lit; their cameras' pictures side by side. `python mujoco_worlds.py [model.xml]`."""

import sys

import mujoco
import numpy as np
from mujoco_scene import MODEL  # the program beside this one

import solari_vk as sv


def frames(device, model, worlds=64, size=(64, 64)):
    """Radiance (worlds, cameras, height, width, 3), frame by frame; each world is pushed its own way."""
    data = [mujoco.MjData(model) for _ in range(worlds)]
    for one, push in zip(data, np.random.default_rng(1).normal(size=(worlds, model.nv)), strict=True):
        one.qvel += push
    with sv.mujoco.Batch(model, worlds, *size[::-1], device=device) as batch:
        while True:
            for one in data:
                mujoco.mj_step(model, one, nstep=10)
            yield batch.render(data)["radiance"]


if __name__ == "__main__":
    model = mujoco.MjModel.from_xml_path((sys.argv[1:] or [MODEL])[0])
    with sv.Device() as device:
        *_, last = (found[:, 0] for found, _ in zip(frames(device, model, 16), range(8), strict=False))
    sheet = np.hstack([np.vstack(column) for column in np.split(last, 4)])
    sv.save_image("worlds.png", sheet)
