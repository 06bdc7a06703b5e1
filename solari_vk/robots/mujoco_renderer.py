"""`sv.mujoco.Renderer`: the interface of `mujoco.Renderer`, with this renderer's light."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import Hints, SolariError, checked_constructor, quoted
from solari_vk.batch.batch import Batch
from solari_vk.gpu.acceleration.checks import whole_number
from solari_vk.gpu.device.device import Device
from solari_vk.renderers.path_tracer import PathTracer
from solari_vk.renderers.renderer import Renderer as RealtimeRenderer
from solari_vk.scene.files.mujoco.model_scene import Key, ModelScene, fixed_camera
from solari_vk.scene.material import Material
from solari_vk.scene.model import Camera, Instance, Mesh, Scene

REALTIME_FRAMES = 4  # of each picture
NOTHING = -1  # the number and the type of the background's object
RENDERERS = ("realtime", "reference")
_EMPTY = Mesh(np.array([(0.0, -1e6, 0.0), (1e-3, -1e6, 0.0), (0.0, -1e6, 1e-3)], np.float32), name="nothing")


@checked_constructor
class Renderer(Hints):
    """Pictures of a model of MuJoCo, by the calls of `mujoco.Renderer`. A context manager.

    model: an MjModel. height, width: in pixels, of any size. max_geom: the most geoms that are shown. font_scale: is
    taken as MuJoCo takes it, and pictures have no text. device: one that is open, else the renderer opens its own.
    renderer: "realtime" shows the denoised picture after `frames` frames of each call, whose light gathers from call to
    call; "reference" traces `samples` paths a pixel. seed: of its random numbers. ev100, tonemap: the exposure and the
    tone curve of pictures, by default none, so that a color which is lit by 1 is shown as the file has it.

    `lit` is the Scene: change its lights, or `lit.environment`, and the next picture shows it, as it does changes of
    the lights of the model. Depth and segmentation are those of MuJoCo's renderer: meters along the view axis, up to
    its far plane; numbers and types of objects, -1 for none, and transparent geoms count as solid. Raises SolariError
    for what is no MjModel, and where MuJoCo's raises an error.
    """

    def __init__(
        self,
        model: Any,
        height: int = 240,
        width: int = 320,
        max_geom: int = 10_000,
        font_scale: Any = None,
        *,
        device: Device | None = None,
        renderer: str = "realtime",
        frames: int = REALTIME_FRAMES,
        samples: int = 64,
        seed: int = 0,
        ev100: float = 0.0,
        tonemap: str = "none",
    ) -> None:
        if renderer not in RENDERERS:
            raise SolariError(f"mujoco.Renderer: renderer is one of {', '.join(RENDERERS)}, not {quoted(renderer)}")
        where = "mujoco.Renderer"
        self._size = whole_number(width, f"{where}: width", 1), whole_number(height, f"{where}: height", 1)
        self._frames = whole_number(frames, f"{where}: frames", 1)
        self._samples = whole_number(samples, f"{where}: samples", 1)
        self._kind = renderer
        self._seed = seed
        self._ev100 = ev100
        self._tonemap = tonemap
        self._shown = ModelScene(model, most_geoms=whole_number(max_geom, f"{where}: max_geom", 1))
        self._solid = _Solid(self._shown)
        self._mode = "color"
        self._updated = False
        self._owned: ExitStack | None = ExitStack()
        self._device = self._owned.enter_context(Device()) if device is None else device
        self._realtime: RealtimeRenderer | None = None
        self._paths: PathTracer | None = None
        self._labels: Batch | None = None

    @property
    def model(self) -> Any:
        """The MjModel."""
        return self._shown.model

    @property
    def scene(self) -> Any:
        """The MjvScene of the latest `update_scene`: geoms that are added to it are shown too."""
        return self._shown.visual

    @property
    def lit(self) -> Scene:
        """The Scene that is lit."""
        return self._shown.scene

    @property
    def height(self) -> int:
        """Of pictures, in pixels."""
        return self._size[1]

    @property
    def width(self) -> int:
        """Of pictures, in pixels."""
        return self._size[0]

    def enable_depth_rendering(self) -> None:
        """Have `render` return depth, float32 (height, width), in meters."""
        self._mode = "depth"

    def disable_depth_rendering(self) -> None:
        """Have `render` return colors, unless it returns segmentation."""
        self._mode = "color" if self._mode == "depth" else self._mode

    def enable_segmentation_rendering(self) -> None:
        """Have `render` return the number and the mjtObj of the object at each pixel, int32 (height, width, 2)."""
        self._mode = "segmentation"

    def disable_segmentation_rendering(self) -> None:
        """Have `render` return colors, unless it returns depth."""
        self._mode = "color" if self._mode == "segmentation" else self._mode

    def update_scene(self, data: Any, camera: Any = -1, scene_option: Any = None) -> None:
        """Show a state, MjData. camera: the number or the name of one of the model's, -1 for the free camera, or an
        MjvCamera. scene_option: an MjvOption, which says what is shown. Raises SolariError for an unknown camera."""
        self._shown.fill(data, self._camera(camera), scene_option)
        self._updated = True

    def _camera(self, camera: Any) -> Any:
        mujoco, model = self._shown.mujoco, self._shown.model
        if isinstance(camera, mujoco.MjvCamera):
            return camera
        number = camera
        if isinstance(camera, str):
            number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, camera)
            if number < 0:
                names = ", ".join(model.camera(index).name for index in range(model.ncam)) or "none"
                raise SolariError(f'mujoco.Renderer: the camera "{camera}" does not exist; there is {names}')
        if not isinstance(number, (int, np.integer)) or not -1 <= number < model.ncam:
            raise SolariError(
                f"mujoco.Renderer: a camera is a name, an MjvCamera or -1 to {model.ncam - 1}, not {quoted(camera)}"
            )
        return None if number == -1 else fixed_camera(mujoco, int(number))

    def render(self, *, out: NDArray[Any] | None = None) -> NDArray[Any]:
        """A picture of the latest `update_scene`: uint8 (height, width, 3), or depth or segmentation. out: an array of
        that shape, which is filled and returned. Raises SolariError before `update_scene`, after `close`, and for an
        `out` of another shape."""
        if self._owned is None:
            raise SolariError("mujoco.Renderer: render cannot be called after close")
        if not self._updated:
            raise SolariError("mujoco.Renderer: call update_scene before render")
        self._shown.show()
        camera = self._shown.camera("camera", self._size)
        camera.ev100 = self._ev100
        picture = self._color(camera) if self._mode == "color" else self._first_hits(camera)
        if out is None:
            return picture
        if out.shape != picture.shape:
            raise SolariError(f"mujoco.Renderer: out must have the shape {picture.shape}, not {out.shape}")
        out[...] = picture
        return out

    def _color(self, camera: Camera) -> NDArray[np.uint8]:
        assert self._owned is not None
        if self._kind == "reference":
            if self._paths is None:
                self._paths = self._owned.enter_context(PathTracer(self._device, self.lit, self._size, seed=self._seed))
            self._paths.reset()
            frame = self._paths.render(camera, samples=self._samples)
        else:
            if self._realtime is None:
                lit = RealtimeRenderer(self._device, self.lit, self._size, seed=self._seed)
                self._realtime = self._owned.enter_context(lit)
            for _ in range(self._frames):
                frame = self._realtime.render(camera)
        return frame.image(tonemap=self._tonemap)

    def _first_hits(self, camera: Camera) -> NDArray[Any]:
        """Depth or segmentation, at pixels' centers."""
        assert self._owned is not None
        self._solid.update()
        if self._labels is None:
            outputs = ("depth", "instance_id")
            self._labels = self._owned.enter_context(
                Batch(self._device, self._solid.scene, self._size, 1, outputs=outputs)
            )
        self._labels.render([camera])
        model = self._shown.model
        far = np.float32(model.vis.map.zfar * model.stat.extent)
        depth = self._labels["depth"][0]
        if self._mode == "depth":
            shown: NDArray[np.float32] = np.minimum(depth, far)
            return shown
        numbers = self._labels["instance_id"][0]
        table = np.full((max(self._labels.instances, default=0) + 2, 2), NOTHING, np.int32)
        for number, instance in self._labels.instances.items():
            kind, index, _ = self._solid.keys.get(instance, (NOTHING, NOTHING, 0))
            table[number] = index, kind
        found: NDArray[Any] = table[np.where(depth <= far, np.minimum(numbers, len(table) - 1), len(table) - 1)]
        return found

    def close(self) -> None:
        """Free everything on the device. Safe to call twice."""
        if self._owned is not None:
            self._owned.close()
            self._owned = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class _Solid:
    """The geoms of a ModelScene without their materials: rays hit what is transparent too."""

    def __init__(self, shown: ModelScene) -> None:
        self.scene = Scene()
        self.keys: dict[Instance, Key] = {}
        self._shown = shown
        self._instances: dict[Key, Instance] = {}
        self._material = Material()
        self.scene.add(Instance(_EMPTY, name="nothing"))  # batches need an instance

    def update(self) -> None:
        """Have geoms where they are now."""
        for key, source in self._shown.instances.items():
            instance = self._instances.get(key)
            if instance is None:
                instance = self.scene.add(Instance(source.mesh, self._material, source.transform))
                self._instances[key] = instance
                self.keys[instance] = key
            for name in ("mesh", "transform", "visible"):
                value = getattr(source, name)
                if getattr(instance, name) is not value:
                    setattr(instance, name, value)
