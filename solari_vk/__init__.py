"""Solari's raytraced lighting on any Vulkan device that traces rays.

    import solari_vk as sv

    scene = sv.builtin("cornell_box")
    with sv.Device() as device, sv.Renderer(device, scene, (640, 360)) as renderer:
        for _ in range(24):  # light accumulates over frames
            frame = renderer.render()
        radiance = frame["radiance"]  # (360, 640, 3) in cd/m^2
        frame.save("cornell_box.png")

Names are imported on first use, so that importing the package is fast and needs no Vulkan.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.2.0"

_HOMES = {
    "errors": ("CallbackError", "DeviceError", "SolariError", "ValidationError"),
    "gpu.device.device": ("Device", "list_devices"),
    "gpu.frame.frame": ("Frame", "HitGroup", "Pass", "RayPass", "Stage"),
    "scene.animation.clip": ("Animation",),
    "scene.animation.keyframes": ("Channel",),
    "scene.deformation": ("Deformation",),
    "scene.animation.rig": ("Rig",),
    "scene.matrices": ("euler",),
    "scene.model": (
        "Camera", "DirectionalLight", "Environment", "Instance", "Material", "Mesh", "Scene", "Texture", "TextureImage",
    ),
    "scene.lights.portal": ("Portal",),
    "scene.lights.profile": ("LightProfile",),
    "scene.lights.punctual": ("PointLight", "SpotLight"),
    "bound.binder": ("SceneBinder",),
    "scene.gltf": ("load_gltf",),
    "scene.group": ("Group",),
    "scene.load": ("load",),
    "scene.camera_rig": ("CameraRig",),
    "scene.colmap": ("ColmapImage", "load_colmap", "save_colmap"),
    "scene.opening": ("open",),
    "scene.builtin": ("builtin",),
    "scene.lights.sky": ("Sky",),
    "scene.lights.temperature": ("kelvin",),
    "scene.labels": ("label_instances",),
    "scene.shutter": ("Shutter",),
    "scene.studio": ("studio_lights",),
    "annotate.bop": ("BopWriter",),
    "annotate.boxes": ("Box3D", "boxes_3d"),
    "annotate.keypoints": ("Keypoint", "keypoints"),
    "annotate.optical_flow": ("Flow", "optical_flow"),
    "annotate.silhouettes": ("Silhouette", "silhouettes"),
    "bands": ("render_large",),
    "output.annotations": ("Annotations", "instance_table"),
    "batch": ("Batch",),
    "output.compare": ("Difference", "compare"),
    "output.kitti": ("save_kitti_disparity", "save_kitti_flow"),
    "output.movie": ("save_video",),
    "output.picture": ("check_output", "save_image"),
    "output.shards": ("save_shards",),
    "output.tone_mapping": ("auto_exposure", "encode_picture", "tonemap"),
    "reference": ("PathTracer",),
    "randomize.randomizer": ("Randomizer",),
    "rendered": ("RenderedFrame",),
    "renderer": ("Renderer",),
    "sensors.lidar": ("Lidar",),
    "sensors.lidar_scan": ("LidarScan",),
    "sensors.sensor": ("Sensor",),
    "sensors.structured_light": ("StructuredLightCamera",),
    "sensors.time_of_flight": ("DepthImage", "TimeOfFlightCamera"),
    "settings": ("Settings",),
    "frame": ("SceneFrame",),
    "light_meter": ("illuminance",),
    "tracer": ("RayTracer",),
    "cluster.views": ("Views",),
    "viewer.app": ("Viewer",),
}
_MODULES = {"cluster": "cluster", "notebook": "notebook", "rt": "rt", "shapes": "scene.shapes"}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

__all__ = [
    "Animation", "Annotations", "Batch", "BopWriter", "Box3D", "CallbackError", "Camera", "CameraRig", "Channel",
    "ColmapImage", "Deformation", "DepthImage", "Device", "DeviceError", "Difference", "DirectionalLight",
    "Environment", "Flow", "Frame", "Group", "HitGroup", "Instance", "Keypoint", "Lidar", "LidarScan", "LightProfile",
    "Material", "Mesh", "Pass", "PathTracer", "PointLight", "Portal", "Randomizer", "RayPass", "RayTracer",
    "RenderedFrame", "Renderer", "Rig", "Scene", "SceneBinder", "SceneFrame", "Sensor", "Settings", "Shutter",
    "Silhouette", "Sky", "SolariError", "SpotLight", "Stage", "StructuredLightCamera", "Texture", "TextureImage",
    "TimeOfFlightCamera", "ValidationError", "Viewer", "Views", "__version__", "auto_exposure", "boxes_3d", "builtin",
    "check_output", "cluster", "compare", "encode_picture", "euler", "illuminance", "instance_table", "kelvin",
    "keypoints", "label_instances", "list_devices", "load", "load_colmap", "load_gltf", "notebook", "open",
    "optical_flow", "render_large", "rt", "save_colmap", "save_image", "save_kitti_disparity", "save_kitti_flow",
    "save_shards", "save_video", "shapes", "silhouettes", "studio_lights", "tonemap",
]  # fmt: skip

if TYPE_CHECKING:
    from solari_vk import cluster, notebook, rt
    from solari_vk.annotate.bop import BopWriter
    from solari_vk.annotate.boxes import Box3D, boxes_3d
    from solari_vk.annotate.keypoints import Keypoint, keypoints
    from solari_vk.annotate.optical_flow import Flow, optical_flow
    from solari_vk.annotate.silhouettes import Silhouette, silhouettes
    from solari_vk.bands import render_large
    from solari_vk.batch import Batch
    from solari_vk.bound.binder import SceneBinder
    from solari_vk.cluster.views import Views
    from solari_vk.errors import CallbackError, DeviceError, SolariError, ValidationError
    from solari_vk.frame import SceneFrame
    from solari_vk.gpu.device.device import Device, list_devices
    from solari_vk.gpu.frame.frame import Frame, HitGroup, Pass, RayPass, Stage
    from solari_vk.light_meter import illuminance
    from solari_vk.output.annotations import Annotations, instance_table
    from solari_vk.output.compare import Difference, compare
    from solari_vk.output.kitti import save_kitti_disparity, save_kitti_flow
    from solari_vk.output.movie import save_video
    from solari_vk.output.picture import check_output, save_image
    from solari_vk.output.shards import save_shards
    from solari_vk.output.tone_mapping import auto_exposure, encode_picture, tonemap
    from solari_vk.randomize.randomizer import Randomizer
    from solari_vk.reference import PathTracer
    from solari_vk.rendered import RenderedFrame
    from solari_vk.renderer import Renderer
    from solari_vk.scene import shapes
    from solari_vk.scene.animation.clip import Animation
    from solari_vk.scene.animation.keyframes import Channel
    from solari_vk.scene.animation.rig import Rig
    from solari_vk.scene.builtin import builtin
    from solari_vk.scene.camera_rig import CameraRig
    from solari_vk.scene.colmap import ColmapImage, load_colmap, save_colmap
    from solari_vk.scene.deformation import Deformation
    from solari_vk.scene.gltf import load_gltf
    from solari_vk.scene.group import Group
    from solari_vk.scene.labels import label_instances
    from solari_vk.scene.lights.portal import Portal
    from solari_vk.scene.lights.profile import LightProfile
    from solari_vk.scene.lights.punctual import PointLight, SpotLight
    from solari_vk.scene.lights.sky import Sky
    from solari_vk.scene.lights.temperature import kelvin
    from solari_vk.scene.load import load
    from solari_vk.scene.matrices import euler
    from solari_vk.scene.model import (
        Camera,
        DirectionalLight,
        Environment,
        Instance,
        Material,
        Mesh,
        Scene,
        Texture,
        TextureImage,
    )
    from solari_vk.scene.opening import open
    from solari_vk.scene.shutter import Shutter
    from solari_vk.scene.studio import studio_lights
    from solari_vk.sensors.lidar import Lidar
    from solari_vk.sensors.lidar_scan import LidarScan
    from solari_vk.sensors.sensor import Sensor
    from solari_vk.sensors.structured_light import StructuredLightCamera
    from solari_vk.sensors.time_of_flight import DepthImage, TimeOfFlightCamera
    from solari_vk.settings import Settings
    from solari_vk.tracer import RayTracer
    from solari_vk.viewer.app import Viewer


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return import_module(f"solari_vk.{_MODULES[name]}")
    home = _HOME_OF.get(name)
    if home is None:
        from solari_vk.errors import unknown_attribute

        raise unknown_attribute("solari_vk has no", name, lambda: __all__)
    value = getattr(import_module(f"solari_vk.{home}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
