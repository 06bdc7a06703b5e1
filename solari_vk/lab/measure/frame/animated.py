"""The cost of a character that moves: its pose on the host, its vertices and structures on the device, the frame."""

from __future__ import annotations

import time
from collections import defaultdict

import numpy as np

from solari_vk.bound.poses.pose_commands import TIMED
from solari_vk.gpu.device.device import Device
from solari_vk.lab.measure.frame import passes
from solari_vk.lab.measure.frame.plan import Plan
from solari_vk.lab.measure.timing import device_seconds
from solari_vk.renderers.renderer import Renderer
from solari_vk.scene.model import Scene
from solari_vk.settings import Settings

HEAD = ["scene", "vertices", "host: pose", "vertices on the device", "refit", "frame in motion", "frame at rest"]
NOTE = (
    "Milliseconds, medians. The host samples the animation and assigns the poses; the device computes positions, "
    "normals and tangents and refits or builds the bottom-level structures. The frame, from call to done, includes "
    "both works of the device, the host's records of them and the top-level structure."
)


def measure(device: Device, scene: Scene, plan: Plan) -> list[str]:
    """A row of the table: a scene whose first animation plays at 60 frames a second."""
    spent: dict[str, list[float]] = defaultdict(list)
    camera = scene.camera
    with Renderer(device, scene, plan.growth_size, Settings()) as renderer:
        stopwatch = renderer.binder.time_poses()
        rest = passes.frame_times(renderer, camera, plan.warm_up_frames, plan.frames, plan.seconds)["frame"]
        for frame in range(plan.warm_up_frames + plan.frames):
            began = time.perf_counter()
            scene.animate(frame / 60)
            posed = 1e3 * (time.perf_counter() - began)
            whole = 1e3 * device_seconds(device, lambda: renderer.render(camera))
            if frame >= plan.warm_up_frames:
                for name, value in {"pose": posed, "frame": whole, **stopwatch.read()}.items():
                    spent[name].append(value)
    vertices = sum(len(instance.mesh.positions) for instance in scene if instance.posed)
    found = [float(np.median(spent[name])) if spent[name] else float("nan") for name in ("pose", *TIMED, "frame")]
    return [scene.name, f"{vertices:,}", *(f"{value:.2f}" for value in (*found, rest))]
