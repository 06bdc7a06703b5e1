"""Jobs of rendering, and the device that does them: it keeps the scene and the renderers from one job to the next."""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Generator, Iterable
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any, Protocol, Self, TypeAlias, TypeVar

from solari_vk.bound.binder import SceneBinder
from solari_vk.gpu.device.compiling import OnCompile
from solari_vk.gpu.device.device import Device
from solari_vk.renderers.cluster.identity import Identity
from solari_vk.renderers.path_tracer import PathTracer
from solari_vk.renderers.ray_tracer import RayTracer
from solari_vk.renderers.renderer import Renderer
from solari_vk.renderers.renderer_base import RendererBase
from solari_vk.scene.model import Scene
from solari_vk.settings import Settings


class Job(Protocol):
    """A part of the work, which any worker can do: a value that can be pickled."""

    @property
    def name(self) -> str:
        """What the job is, for messages."""

    @property
    def clip(self) -> int | None:
        """The animation whose poses the job shows, by its number; None: it shows the scene as it was given."""

    def perform(self, session: DeviceSession) -> Any:
        """Render on a session that has the scene; returns the result, which can be pickled."""


@dataclass(frozen=True)
class DeviceOptions:
    """How workers open their devices: arguments of `Device`."""

    device: str | None = None
    rays: str | None = None
    validation: bool | None = None

    def open(self, device: str | None = None) -> Device:
        """Open a device. device: the one to open if these arguments name none."""
        return Device(self.device or device, validation=self.validation, rays=self.rays)


def pack(scene: Scene) -> tuple[str, bytes]:
    """A scene as bytes, and the first 16 digits of their SHA-256, which equal scenes share."""
    # Protocol 5 stores arrays as they are in memory.
    data = pickle.dumps(scene, protocol=5)
    return hashlib.sha256(data).hexdigest()[:16], data


AnyRenderer = TypeVar("AnyRenderer", bound=RendererBase)


class DeviceSession:
    """A device with the latest jobs' scene and renderers, which later jobs use again."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self.identity = Identity.of(device)
        self._scene_key = ""
        self._clip: int | None = None  # that of the latest job
        self._owned = ExitStack()  # what depends on the scene
        self._ray_tracer: RayTracer | None = None
        # The renderer of each class, and the options that it was made with.
        self._renderers: dict[type[RendererBase], tuple[Any, RendererBase]] = {}

    def load_scene(self, key: str, data: bytes, clip: int | None) -> None:
        """Load the scene that `pack` made these from, unless it is loaded already, for a job of a clip or of none.

        A clip leaves its last pose behind: a job of none, or of another clip, then loads the scene anew.
        """
        is_posed_by_another = self._clip is not None and self._clip != clip
        if key != self._scene_key or is_posed_by_another:
            self.free_scene()
            self.scene: Scene = pickle.loads(data)
            self._binder = SceneBinder(self.device, self.scene)
            self._owned.callback(self._binder.destroy)
            self._scene_key = key
        self._clip = clip

    def path_tracer(self, size: tuple[int, int], max_bounces: int, seed: int, first_sample: int = 0) -> PathTracer:
        """A path tracer without samples: that of earlier jobs in this size, or a new one for another max_bounces."""
        # Assigning a seed or a first sample discards the samples of earlier jobs.
        tracer = self._renderer(PathTracer, max_bounces, size=size, max_bounces=max_bounces)
        tracer.seed = seed
        tracer.first_sample = first_sample
        return tracer

    def renderer(self, size: tuple[int, int], settings: Settings, seed: int) -> Renderer:
        """A realtime renderer without history."""
        renderer = self._renderer(Renderer, settings, size=size, settings=settings)
        renderer.seed = seed
        renderer.reset()
        return renderer

    def ray_tracer(self) -> RayTracer:
        """A tracer of rays through the scene."""
        if self._ray_tracer is None:
            self._ray_tracer = RayTracer(self.device, self._binder)
            self._owned.callback(self._ray_tracer.close)
        return self._ray_tracer

    def _renderer(self, kind: type[AnyRenderer], key: Any, size: tuple[int, int], **options: Any) -> AnyRenderer:
        """The renderer of earlier jobs, or a new one. key: the options that a renderer can't change."""
        made_with, renderer = self._renderers.pop(kind, (None, None))
        if renderer is not None and made_with != key:
            renderer.close()
            renderer = None
        if not isinstance(renderer, kind):
            renderer = kind(self.device, self._binder, size, **options)
            self._owned.callback(renderer.close)
        if renderer.size != size:
            renderer.resize(size)
        self._renderers[kind] = key, renderer
        return renderer

    def free_scene(self) -> None:
        """Free the scene and the renderers."""
        # All are freed by `_owned`, in the opposite order of their making: the binder last, which the others use.
        self._scene_key = ""
        self._ray_tracer = None
        self._renderers.clear()
        self._owned.close()

    def close(self) -> None:
        """Free the scene and close the device."""
        self.free_scene()
        self.device.close()


AnyJob = TypeVar("AnyJob", bound=Job)
Results: TypeAlias = Generator[tuple[AnyJob, Any] | None, None, None]
"""Jobs with their results, as they are done; None when nothing was done for a second."""


class OneDevice:
    """Does jobs one after the other on a device in this process. A context manager, as `WorkerPool` is.

    device, rays, validation, on_compile: as Device takes them.
    """

    worker_count = 1
    shares_files = True

    def __init__(
        self,
        device: str | None = None,
        rays: str | None = None,
        validation: bool | None = None,
        on_compile: OnCompile | None = None,
    ) -> None:
        self._device_options = DeviceOptions(device, rays, validation)
        self._on_compile = on_compile

    def __enter__(self) -> Self:
        self._session = DeviceSession(self._device_options.open())
        self.device.on_compile = self._on_compile
        return self

    def __exit__(self, *_: object) -> None:
        self._session.close()

    @property
    def device(self) -> Device:
        """The device that works."""
        return self._session.device

    @property
    def identity(self) -> Identity:
        """That of the device."""
        return self._session.identity

    def map(self, scene: Scene, jobs: Iterable[AnyJob]) -> Results[AnyJob]:
        """Yield each job with its result."""
        key, data = pack(scene)
        for job in jobs:
            self._session.load_scene(key, data, job.clip)
            yield job, job.perform(self._session)
