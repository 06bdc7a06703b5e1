"""A robot's file (URDF, or MuJoCo's MJCF) as a glTF file. `python mujoco_scene.py [model.xml | robot.urdf]`."""

import sys

import solari_vk as sv

MODEL = f"{__file__.removesuffix('.py')}.xml"

if __name__ == "__main__":
    sv.load((sys.argv[1:] or [MODEL])[0]).save("model.glb")
