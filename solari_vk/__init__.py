"""Solari's raytraced lighting on any Vulkan device that traces rays.

    import solari_vk as sv

    sv.render("model.glb", (640, 360)).save("picture.png")

or, frame by frame:

    scene = sv.builtin("cornell_box")
    with sv.Device() as device, sv.Renderer(device, scene, (640, 360)) as renderer:
        for _ in range(24):  # light accumulates over frames
            frame = renderer.render()
        radiance = frame["radiance"]  # (360, 640, 3) in cd/m^2
        frame.save("cornell_box.png")

Names are imported on first use, so that importing the package is fast and needs no Vulkan.
"""

from __future__ import annotations

import sys

# Type checkers take this for true. Modules such as typing take long to import: Ctrl-C meanwhile would end the command
# line with a traceback, before it can say so.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from types import CodeType
    from typing import Any

__version__ = "0.2.0"

# The public names, and the modules that define them. Type checkers read these imports. Python doesn't run them, but it
# compiles them, and `_modules_by_name` reads the names from the compiled code. One import a line, sorted by module.
if TYPE_CHECKING:
    from solari_vk.base.errors import CallbackError as CallbackError
    from solari_vk.base.errors import DeviceError as DeviceError
    from solari_vk.base.errors import SolariError as SolariError
    from solari_vk.base.errors import ValidationError as ValidationError
    from solari_vk.batch.batch import Batch as Batch
    from solari_vk.bound.binder import SceneBinder as SceneBinder
    from solari_vk.data import cluster as cluster
    from solari_vk.data.annotate.bop import BopWriter as BopWriter
    from solari_vk.data.annotate.boxes import Box3D as Box3D
    from solari_vk.data.annotate.boxes import boxes_3d as boxes_3d
    from solari_vk.data.annotate.keypoints import Keypoint as Keypoint
    from solari_vk.data.annotate.keypoints import keypoints as keypoints
    from solari_vk.data.annotate.optical_flow import Flow as Flow
    from solari_vk.data.annotate.optical_flow import optical_flow as optical_flow
    from solari_vk.data.annotate.silhouettes import Silhouette as Silhouette
    from solari_vk.data.annotate.silhouettes import silhouettes as silhouettes
    from solari_vk.data.datasets.views import Views as Views
    from solari_vk.data.randomize.randomizer import Randomizer as Randomizer
    from solari_vk.data.sensors.lidar import Lidar as Lidar
    from solari_vk.data.sensors.lidar_scan import LidarScan as LidarScan
    from solari_vk.data.sensors.sensor import Sensor as Sensor
    from solari_vk.data.sensors.structured_light import StructuredLightCamera as StructuredLightCamera
    from solari_vk.data.sensors.time_of_flight import DepthImage as DepthImage
    from solari_vk.data.sensors.time_of_flight import TimeOfFlightCamera as TimeOfFlightCamera
    from solari_vk.gpu.device.device import Device as Device
    from solari_vk.gpu.device.device import list_devices as list_devices
    from solari_vk.gpu.frame.frame import Frame as Frame
    from solari_vk.gpu.frame.frame import HitGroup as HitGroup
    from solari_vk.gpu.frame.frame import Pass as Pass
    from solari_vk.gpu.frame.frame import RayPass as RayPass
    from solari_vk.gpu.frame.frame import Stage as Stage
    from solari_vk.output.annotations import Annotations as Annotations
    from solari_vk.output.annotations import instance_table as instance_table
    from solari_vk.output.annotations import merge_coco as merge_coco
    from solari_vk.output.compare import Difference as Difference
    from solari_vk.output.compare import compare as compare
    from solari_vk.output.kitti import save_kitti_disparity as save_kitti_disparity
    from solari_vk.output.kitti import save_kitti_flow as save_kitti_flow
    from solari_vk.output.movie import save_video as save_video
    from solari_vk.output.picture import check_output as check_output
    from solari_vk.output.picture import save_image as save_image
    from solari_vk.output.sequences.denoise import Denoised as Denoised
    from solari_vk.output.sequences.denoise import denoise as denoise
    from solari_vk.output.shards import save_shards as save_shards
    from solari_vk.output.tone_mapping import auto_exposure as auto_exposure
    from solari_vk.output.tone_mapping import encode_picture as encode_picture
    from solari_vk.output.tone_mapping import tonemap as tonemap
    from solari_vk.renderers import rt as rt
    from solari_vk.renderers.illuminance import illuminance as illuminance
    from solari_vk.renderers.large_pictures import render_large as render_large
    from solari_vk.renderers.path_tracer import PathTracer as PathTracer
    from solari_vk.renderers.ray_tracer import RayTracer as RayTracer
    from solari_vk.renderers.renderer import Renderer as Renderer
    from solari_vk.renderers.results import RenderedFrame as RenderedFrame
    from solari_vk.renderers.scene_frame import SceneFrame as SceneFrame
    from solari_vk.robots import isaac_lab as isaac_lab
    from solari_vk.robots import mujoco as mujoco
    from solari_vk.robots import newton as newton
    from solari_vk.scene import shapes as shapes
    from solari_vk.scene.animation.clip import Animation as Animation
    from solari_vk.scene.animation.keyframes import Channel as Channel
    from solari_vk.scene.animation.rig import Rig as Rig
    from solari_vk.scene.builtin import builtin as builtin
    from solari_vk.scene.camera_rig import CameraRig as CameraRig
    from solari_vk.scene.files.colmap import ColmapImage as ColmapImage
    from solari_vk.scene.files.colmap import load_colmap as load_colmap
    from solari_vk.scene.files.colmap import save_colmap as save_colmap
    from solari_vk.scene.files.gltf import load_gltf as load_gltf
    from solari_vk.scene.group import Group as Group
    from solari_vk.scene.labels import label_instances as label_instances
    from solari_vk.scene.lights.light import kelvin as kelvin
    from solari_vk.scene.lights.portal import Portal as Portal
    from solari_vk.scene.lights.profile import LightProfile as LightProfile
    from solari_vk.scene.lights.punctual import PointLight as PointLight
    from solari_vk.scene.lights.punctual import SpotLight as SpotLight
    from solari_vk.scene.lights.sky import Sky as Sky
    from solari_vk.scene.load import load as load
    from solari_vk.scene.load import open as open
    from solari_vk.scene.matrices import euler as euler
    from solari_vk.scene.meshes.deformation import Deformation as Deformation
    from solari_vk.scene.model import Camera as Camera
    from solari_vk.scene.model import DirectionalLight as DirectionalLight
    from solari_vk.scene.model import Environment as Environment
    from solari_vk.scene.model import Instance as Instance
    from solari_vk.scene.model import Material as Material
    from solari_vk.scene.model import Mesh as Mesh
    from solari_vk.scene.model import Scene as Scene
    from solari_vk.scene.model import Texture as Texture
    from solari_vk.scene.model import TextureImage as TextureImage
    from solari_vk.scene.presenting.studio_lights import studio_lights as studio_lights
    from solari_vk.scene.shutter import Shutter as Shutter
    from solari_vk.settings import Settings as Settings
    from solari_vk.studio import notebook as notebook
    from solari_vk.studio.one_line import render as render
    from solari_vk.studio.one_line import serve as serve
    from solari_vk.studio.one_line import view as view
    from solari_vk.studio.viewer.app import Viewer as Viewer


def _modules_by_name(code: CodeType) -> dict[str, str]:
    """The module of each public name, by the imports above.

    Compiled code lists its names in the order in which it uses them first: a module, then what is imported from it. The
    source isn't read, because it may be missing: programs that PyInstaller packs have compiled code alone.
    """
    modules: dict[str, str] = {}
    module = ""
    for name in code.co_names:
        if name.startswith("solari_vk."):
            module = name
        elif name.startswith("_") and module:
            break  # what this module defines after the imports
        elif module:
            modules[name] = module
    return modules


_MODULES = _modules_by_name(sys._getframe().f_code)
__all__ = ["__version__", *_MODULES]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        from solari_vk.base.errors import unknown_attribute

        raise unknown_attribute("solari_vk has no", name, lambda: sorted(__all__))
    from importlib import import_module

    module = import_module(_MODULES[name])
    if not hasattr(module, name):
        # The name is that of a module, such as `rt`, which is no attribute of its package before it is imported.
        import_module(f"{_MODULES[name]}.{name}")
    value = getattr(module, name)
    globals()[name] = value  # so that Python finds it at once the next time
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
