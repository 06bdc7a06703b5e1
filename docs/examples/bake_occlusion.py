"""Ambient occlusion of every triangle, by a compute shader of our own. `python bake_occlusion.py [scene] [out.npz]`."""

import sys
from pathlib import Path

import numpy as np

import solari_vk as sv


def centers(instance):
    """The middle and the unit normal of each triangle of an instance, in the world: two arrays (N, 3)."""
    linear, mesh = instance.transform[:3, :3], instance.mesh
    corners = mesh.positions[mesh.triangles] @ linear.T + instance.transform[:3, 3]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals *= np.sign(np.linalg.det(linear))  # a mirrored instance keeps its front
    return corners.mean(axis=1), normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)


def bake(device, scene, samples=256, reach=1.0):
    """For each instance how open its triangles' fronts are, 0 to 1, to a distance of `reach` meters."""
    parts = [centers(instance) for instance in scene]
    count = sum(len(positions) for positions, _ in parts)
    stage = sv.Stage("bake", buffers={"points": count, "openness": count}, passes=[sv.Pass("occlusion", threads=count)])
    with sv.SceneFrame(device, scene, [stage], glsl_root=Path(__file__).parent / "glsl") as frame:
        points = np.zeros(count, frame.binding("points").element)
        points["position"], points["normal"] = map(np.concatenate, zip(*parts, strict=True))
        frame.resource("points").upload(points)
        frame.uniforms.update({"baking.count": count, "baking.samples": samples, "baking.reach": reach})
        frame.submit()
        return np.split(frame["openness"], np.cumsum([len(positions) for positions, _ in parts])[:-1])


if __name__ == "__main__":
    arguments = [*sys.argv[1:], "cornell_box", "occlusion.npz"][: max(2, len(sys.argv) - 1)]
    with sv.Device() as device:
        np.savez_compressed(arguments[1], *bake(device, sv.builtin(arguments[0])))
