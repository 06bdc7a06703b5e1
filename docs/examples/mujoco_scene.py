"""A model of MuJoCo as a scene, with its primitives and its first camera. `python mujoco_scene.py [model.xml]`."""

import sys

import mujoco
import numpy as np

import solari_vk as sv

UP = np.array([(1, 0, 0, 0), (0, 0, 1, 0), (0, -1, 0, 0), (0, 0, 0, 1)])  # MuJoCo's z axis is up, ours is y
MESHES = {
    "BOX": lambda x, z, y: sv.shapes.box((-x, -y, -z), (x, y, z)), "SPHERE": lambda r, *_: sv.shapes.sphere(r),
    "CAPSULE": lambda r, y, _: sv.shapes.capsule(r, 2 * y), "CYLINDER": lambda r, y, _: sv.shapes.cylinder(r, 2 * y),
    "PLANE": lambda x, z, _: sv.shapes.plane(2 * x, 2 * z),
}  # fmt: skip


def load(arguments):
    """The model of a file, by default the one beside this program."""
    return mujoco.MjModel.from_xml_path((arguments or [f"{__file__[:-3]}.xml"])[0])


def make_scene(model):
    """Under a sky: an instance for each geom, with its number as the name."""
    scene = sv.Scene(environment=sv.Sky())
    for index, (kind, color) in enumerate(zip(model.geom_type, model.geom_rgba, strict=True)):
        mesh = MESHES[mujoco.mjtGeom(kind).name[7:]](*model.geom_size[index])
        scene.add(mesh, sv.Material(base_color=color[:3], roughness=0.6), name=str(index))
    return scene


def poses(data, kind):
    """Of geoms ("geom") or cameras ("cam") in the states of one or more worlds, (worlds, number, 4, 4)."""
    places, axes = (np.stack([getattr(one, f"{kind}_{what}") for one in data]) for what in ("xpos", "xmat"))
    found = np.tile(np.float64(UP), (*places.shape[:2], 1, 1))
    found[..., :3, :] = UP[:3, :3] @ np.concatenate([axes.reshape(*places.shape, 3), places[..., None]], axis=-1)
    return found @ UP.T if kind == "geom" else found


if __name__ == "__main__":
    model = load(sys.argv[1:])
