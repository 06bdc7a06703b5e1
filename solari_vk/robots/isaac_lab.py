"""A renderer for Isaac Lab's interface `BaseRenderer`, for scenes whose physics Newton has.

It follows the public text of `isaaclab.renderers.BaseRenderer` (3.0) and hasn't been run with Isaac Lab.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from solari_vk.base.errors import SolariError
from solari_vk.robots.newton import SensorCamera
from solari_vk.scene.files.libraries import library

INSTALL = "pip install 'isaaclab[all]'"
# Isaac Lab's names of outputs, those of `SensorCamera.update`, and channels and the type of numbers.
OUTPUTS = {
    "rgba": ("color_image", 4, "uint8"),
    "rgb": ("color_image", 3, "uint8"),
    "albedo": ("albedo_image", 4, "uint8"),
    "depth": ("forward_depth_image", 1, "float32"),
    "distance_to_image_plane": ("forward_depth_image", 1, "float32"),
    "distance_to_camera": ("depth_image", 1, "float32"),
    "normals": ("normal_image", 3, "float32"),
}


@dataclass
class _RenderData:
    """Of one camera: its picture's width and height, and what Isaac Lab gave."""

    width: int
    height: int
    outputs: dict[str, Any] = field(default_factory=dict)
    poses: Any = None
    rays: Any = None


def renderer(model: Any = None, state: Any = None, **options: Any) -> Any:
    """A renderer of Isaac Lab's interface `BaseRenderer`, which draws by `sv.newton.SensorCamera`.

    model: the `newton.Model`, by default that of Isaac Lab's Newton physics. state: the `newton.State`, or a function
    that returns it. options: those of `sv.newton.SensorCamera`. It makes the outputs rgb, rgba, albedo, depth,
    distance_to_image_plane, distance_to_camera and normals. Untested: it is written after the interface's text. Raises
    SolariError without Isaac Lab.
    """
    base: Any = library("isaaclab.renderers", "isaac_lab.renderer", INSTALL)
    warp: Any = library("warp", "isaac_lab.renderer", INSTALL)

    class Renderer(base.BaseRenderer):  # type: ignore[misc]
        """Isaac Lab's calls, handed to a SensorCamera."""

        def __init__(self) -> None:
            self.sensor: SensorCamera | None = None

        def _state(self) -> Any:
            if state is not None:
                return state() if callable(state) else state
            return _manager().get_state()

        def supported_output_types(self) -> dict[Any, Any]:
            return {
                base.RenderBufferKind(name): base.RenderBufferSpec(channels, getattr(warp, kind))
                for name, (_, channels, kind) in OUTPUTS.items()
            }

        def prepare_stage(self, stage: Any, num_envs: int) -> None:
            """Newton's model has all that is drawn."""

        def create_render_data(self, spec: Any) -> _RenderData:
            if self.sensor is None:
                self.sensor = SensorCamera(_manager().get_model() if model is None else model, **options)
                self.sensor.create_default_light()
            return _RenderData(int(spec.cfg.width), int(spec.cfg.height))

        def set_outputs(self, render_data: _RenderData, output_data: dict[str, Any]) -> None:
            unknown = output_data.keys() - OUTPUTS.keys()
            if unknown:
                raise SolariError(
                    f"isaac_lab.renderer: has no {', '.join(sorted(unknown))}: ask for {', '.join(OUTPUTS)}"
                )
            render_data.outputs = dict(output_data)

        def update_transforms(self) -> None:
            """`render` reads the state."""

        def update_geometries(self) -> None:
            """Meshes of Newton's shapes don't change."""

        def update_camera(self, render_data: _RenderData, positions: Any, orientations: Any, intrinsics: Any) -> None:
            assert self.sensor is not None
            where = self.sensor.device
            poses = [
                [*place, *_turned(turn)]
                for place, turn in zip(positions.warp.numpy(), orientations.warp.numpy(), strict=True)
            ]
            render_data.poses = warp.array(np.array(poses, np.float32), dtype=warp.transformf, device=where)
            if render_data.rays is None:
                focal = float(intrinsics.warp.numpy()[0][1, 1])
                size = render_data.width, render_data.height
                angle = 2 * np.arctan(render_data.height / (2 * focal))
                render_data.rays = SensorCamera.compute_camera_rays_pinhole(
                    *size, camera_fov=float(angle), device=where
                )

        def render(self, render_data: _RenderData) -> None:
            assert self.sensor is not None
            views = render_data.poses.shape[0]
            images = {}
            for name in {OUTPUTS[name][0] for name in render_data.outputs}:
                kind = {"normal_image": warp.vec3f}.get(name, warp.float32 if "depth" in name else warp.uint32)
                images[name] = self.sensor.allocate_image(views, render_data.width, render_data.height, kind)
            self.sensor.update(self._state(), render_data.poses, render_data.rays, **images)
            for name, target in render_data.outputs.items():
                source, channels, kind = OUTPUTS[name]
                values = images[source].numpy()
                if kind == "uint8":
                    values = values.view(np.uint8).reshape(*values.shape, 4)[..., :channels]
                target.warp.assign(np.ascontiguousarray(values).reshape(target.warp.numpy().shape))

        def read_output(self, render_data: _RenderData, camera_data: Any) -> None:
            """`render` has written into Isaac Lab's own arrays."""

        def cleanup(self, render_data: _RenderData | None) -> None:
            """A camera has nothing of its own on the device."""

        def close(self) -> None:
            if self.sensor is not None:
                self.sensor.close()

    return Renderer()


def _manager() -> Any:
    return library("isaaclab_newton.physics.newton_manager", "isaac_lab.renderer", INSTALL).NewtonManager


def _turned(quaternion: Any) -> tuple[float, ...]:
    """A quaternion (x, y, z, w) of Isaac Lab's camera as one of Newton's."""
    # Isaac Lab's cameras look along x with z up, Newton's along -z with y up: a third of a turn about (1, -1, -1).
    x, y, z, w = (float(value) for value in quaternion)
    a, b, c, d = 0.5, -0.5, -0.5, 0.5
    return (
        w * a + x * d + y * c - z * b,
        w * b - x * c + y * d + z * a,
        w * c + x * b - y * a + z * d,
        w * d - x * a - y * b - z * c,
    )
