"""Worlds of MuJoCo, stepped and lit; their cameras' pictures side by side. `python mujoco_worlds.py [model.xml]`."""

import sys

import mujoco
import numpy as np

import solari_vk as sv

UP = np.array([(1, 0, 0, 0), (0, 0, 1, 0), (0, -1, 0, 0), (0, 0, 0, 1)])  # MuJoCo's z axis is up, ours is y
SHAPES = {"plane": lambda x, z, _: sv.shapes.plane(2 * x, 2 * z), "sphere": lambda x, *_: sv.shapes.sphere(x),
          "capsule": lambda x, y, _: sv.shapes.capsule(x, 2 * y), "box": lambda x, z, y: sv.shapes.box((-x, -y, -z), (x, y, z)),
          "cylinder": lambda x, y, _: sv.shapes.cylinder(x, 2 * y)}  # fmt: skip
MODEL = """<mujoco><worldbody><geom type="plane" size="2 2 1"/><camera pos="0 -2 1.2" xyaxes="1 0 0 0 .5 1"/>
<body pos="0 0 .8"><freejoint/><geom type="box" size=".2 .1 .3" rgba=".8 .2 .1 1"/></body>
<body pos=".3 0 1.4"><freejoint/><geom type="capsule" size=".1 .15" rgba=".1 .3 .8 1"/></body></worldbody></mujoco>"""


def simulate(device, model, worlds=64, frames=8, size=(64, 64)):
    """Radiance (worlds, cameras, height, width, 3) after some frames of 10 steps each."""
    data, scene = [mujoco.MjData(model) for _ in range(worlds)], sv.Scene(environment=sv.Sky())
    for index, (kind, color) in enumerate(zip(model.geom_type, model.geom_rgba, strict=True)):
        mesh = SHAPES[mujoco.mjtGeom(kind).name[7:].lower()](*model.geom_size[index])
        scene.add(mesh, sv.Material(base_color=color[:3], roughness=0.6), name=str(index))
    batch = sv.Batch(device, scene, size, worlds * model.ncam, renderer="realtime", worlds=worlds, outputs=())
    for frame in range(frames):
        for one, push in zip(data, np.random.default_rng(1).normal(size=(worlds, model.nv)), strict=True):
            one.qvel += push * (frame == 0)
            mujoco.mj_step(model, one, nstep=10)
        poses = {name: np.tile(UP, (worlds, count, 1, 1)) for name, count in (("geom", model.ngeom), ("cam", model.ncam))}
        for name, to in poses.items():
            to[..., :3, 3] = [getattr(one, f"{name}_xpos") @ UP[:3, :3].T for one in data]
            to[..., :3, :3] = [UP[:3, :3] @ getattr(one, f"{name}_xmat").reshape(-1, 3, 3) for one in data]
        for index, transforms in enumerate(poses["geom"].swapaxes(0, 1)):
            batch.transforms[str(index)] = transforms @ UP.T
        batch.render(poses["cam"].reshape(-1, 4, 4), fov=np.tile(model.cam_fovy, worlds), ev100=14)
    return batch["radiance"].reshape(worlds, model.ncam, *size[::-1], 3)


if __name__ == "__main__":
    model = mujoco.MjModel.from_xml_path(sys.argv[1]) if len(sys.argv) > 1 else mujoco.MjModel.from_xml_string(MODEL)
    with sv.Device() as device:
        pictures = simulate(device, model)[:, 0]
    sv.save_image("worlds.png", np.hstack(np.vstack(pictures).reshape(8, -1, *pictures.shape[2:])), exposure=2**-14)
