"""A model of MuJoCo, or a robot in URDF, as a scene, saved. `python mujoco_scene.py [model.xml | robot.urdf]`."""

import sys

import mujoco
import numpy as np

import solari_vk as sv

MODEL = f"{__file__.removesuffix('.py')}.xml"
UP = np.array([(1.0, 0, 0, 0), (0, 0, 1, 0), (0, -1, 0, 0), (0, 0, 0, 1)])  # MuJoCo's z axis is up, ours is y
SHAPES = {"PLANE": lambda x, z, _: sv.shapes.plane(2 * x, 2 * z), "SPHERE": lambda r, *_: sv.shapes.sphere(r),
          "CAPSULE": lambda r, y, _: sv.shapes.capsule(r, 2 * y), "CYLINDER": lambda r, y, _:
          sv.shapes.cylinder(r, 2 * y), "BOX": lambda x, z, y: sv.shapes.box((-x, -y, -z), (x, y, z))}  # fmt: skip


def poses(data, kind):
    """Of geoms ("geom") or cameras ("cam") in the states of one or more worlds, (worlds, number, 4, 4)."""
    places, axes = (np.stack([getattr(one, f"{kind}_{what}") for one in data]) for what in ("xpos", "xmat"))
    found = np.tile(UP, (*places.shape[:2], 1, 1))
    found[..., :3, :] = UP[:3, :3] @ np.concatenate([axes.reshape(*places.shape, 3), places[..., None]], axis=-1)
    return found @ UP.T if kind == "geom" else found


def mesh_of(model, geom):
    kind = mujoco.mjtGeom(model.geom_type[geom]).name[7:]
    if kind != "MESH":
        return SHAPES[kind](*model.geom_size[geom])
    mesh = model.mesh(model.geom_dataid[geom])
    vertices = model.mesh_vert[mesh.vertadr[0] :][: mesh.vertnum[0]]
    return sv.Mesh(vertices @ UP[:3, :3].T, model.mesh_face[mesh.faceadr[0] :][: mesh.facenum[0]])


def make_scene(model):
    """Under a sky, with an instance for each geom, whose number is its name."""
    scene, data = sv.Scene(), mujoco.MjData(model)
    scene.environment = sv.Sky()
    mujoco.mj_forward(model, data)
    for index, pose in enumerate(poses([data], "geom")[0]):
        material = sv.Material(base_color=model.geom_rgba[index, :3], roughness=0.6)
        scene.add(mesh_of(model, index), material, pose, name=str(index))
    for pose, fov in zip(poses([data], "cam")[0], model.cam_fovy, strict=True):
        scene.add(sv.Camera(transform=pose, fov=float(fov), ev100=14))
    return scene


if __name__ == "__main__":
    make_scene(mujoco.MjModel.from_xml_path((sys.argv[1:] or [MODEL])[0])).save("model.glb")
