"""Pictures for files: single views of the path tracer, and runs of frames of the realtime renderer.

The realtime renderer needs earlier frames. A run of pictures is cut into blocks of a fixed length, and a block begins
with the frames before it, which are rendered and not written. So its bits don't depend on who renders it.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.base.files import make_temporary_folder
from solari_vk.data.annotate.keypoints import keypoints
from solari_vk.data.annotate.optical_flow import OUTSIDE, Flow, optical_flow
from solari_vk.data.annotate.silhouettes import trace_silhouettes
from solari_vk.data.randomize.randomizer import Randomizer
from solari_vk.data.sensors.sensor import Sensor
from solari_vk.output.picture import WITH_LAYERS, write_npy, write_picture
from solari_vk.passes.reference import numbered_seed
from solari_vk.renderers.accumulator import FrameAccumulator
from solari_vk.renderers.cluster.device_session import DeviceSession
from solari_vk.scene.model import Camera, Instance, Scene
from solari_vk.scene.shutter import Shutter, between
from solari_vk.settings import Settings

BLOCK = 24  # pictures of the realtime renderer
SILHOUETTES = "silhouettes"  # runs as in annotate/silhouettes.py
KEYPOINTS = "keypoints"  # rows of an instance's number, u, v and state
FLOW = "optical_flow"  # u, v and state of the flow to the next view
FLOW_BACK = "optical_flow_back"  # the same, to the view before
TRACED = (SILHOUETTES, KEYPOINTS, FLOW, FLOW_BACK)
"""The layers that no renderer has, and that rays of their own find."""
RAW = "raw"  # the layer of a sensor's digital numbers
METERED_SIDE = 96  # pixels of the longer side of the pictures that choose the exposure
METERED_SAMPLES = 16  # of each of their pixels


@dataclass(frozen=True)
class View:
    """A picture to render.

    name: its file in the folder, of picture.SUFFIXES. time: seconds since the start of the style's clip.
    closing: the camera when the shutter closes for the last row, None for the same. before, after: the cameras of the
    views around it, for the flow to them.
    """

    name: str
    camera: Camera
    time: float | None = None
    closing: Camera | None = None
    before: Camera | None = None
    after: Camera | None = None


@dataclass(frozen=True)
class Style:
    """How pictures are rendered.

    With settings by the realtime renderer, each as the mean of `frames` frames, after `warm_up` frames before the first
    picture. Without settings by the path tracer with `samples` samples per pixel, denoised by OIDN if asked for.
    layers: names of further results of the renderer, and TRACED; RAW with a sensor. shutter: relative to the views'
    times; the warm-up has none. clip: the number of an animation of the scene. randomizer: changes the scene for each
    view, by its number. points: those of KEYPOINTS, as JSON.
    """

    size: tuple[int, int]
    seed: int = 0
    layers: tuple[str, ...] = ()
    tonemap: str = "agx"
    clip: int | None = None
    settings: Settings | None = None
    frames: int = 4
    warm_up: int = 16
    samples: int = 64
    max_bounces: int = 16
    denoise: bool = False
    randomizer: Randomizer | None = None
    points: str = "{}"
    sensor: Sensor | None = None
    shutter: Shutter | None = None

    @property
    def rendered(self) -> tuple[str, ...]:
        """The layers that the renderer has."""
        return tuple(name for name in self.layers if name not in (*TRACED, RAW))

    def randomized(self, scene: Scene, number: int) -> AbstractContextManager[None]:
        """A context in which the scene is as view `number` has it."""
        return nullcontext() if self.randomizer is None else self.randomizer.applied(scene, number)

    def objects(self, scene: Scene) -> list[Instance]:
        """The instances that have labels."""
        return list(scene.instances) if self.randomizer is None else self.randomizer.objects(scene)

    def files_of(self, view: View) -> list[str]:
        """The names of the files of a view, those of WITH_LAYERS with the layers inside."""
        path = Path(view.name)
        beside = [] if path.suffix.lower() in WITH_LAYERS else [f"{path.stem}.{layer}.npy" for layer in self.layers]
        return [view.name, *beside]


@dataclass(frozen=True)
class File:
    """A file that a worker wrote: its SHA-256, and its content unless it is in the shared folder."""

    sha256: str
    data: bytes | None


@dataclass(frozen=True)
class RenderTask:
    """Pictures that one worker renders in a row. first: the number of the first view among all.

    before: the views of the frames that are rendered first, for the realtime renderer's history. folder: where the
    worker writes; None: the files' contents come back. Raises SolariError if views have a time and others none.
    """

    style: Style
    first: int
    views: tuple[View, ...]
    before: tuple[View, ...] = ()
    folder: str | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        # A worker poses its scene for each view; one without a time would get the pose of the view before.
        if len({view.time is None for view in (*self.before, *self.views)}) > 1:
            raise SolariError(f"{self.name}: give all views of a task a time, or none")

    @property
    def clip(self) -> int | None:
        """The animation whose poses the views show; None: they show the scene as it was given."""
        return None if self.views[0].time is None else self.style.clip

    @property
    def files(self) -> list[str]:
        """The names of the files of all views."""
        return [name for view in self.views for name in self.style.files_of(view)]

    @property
    def name(self) -> str:
        """What the job is, for messages."""
        last = f" to {self.views[-1].name}" if len(self.views) > 1 else ""
        return f"picture {self.views[0].name}{last}"

    def perform(self, session: DeviceSession) -> dict[str, File]:
        """Render the pictures and write them; returns the files by name."""
        # Pictures are written to files either way: their bytes, not arrays, are what the journal hashes and a shared
        # folder holds.
        folder = make_temporary_folder() if self.folder is None else Path(self.folder)
        if not os.path.isdir(folder):
            raise SolariError(f"{folder}: the worker has no such folder: don't give --shared-folder, or share it")
        try:
            if self.style.settings is None:
                self._trace_paths(session, folder)
            else:
                self._render_frames(session, folder)
            contents = {name: (folder / name).read_bytes() for name in self.files}
        finally:
            if self.folder is None:
                shutil.rmtree(folder)
        files = {}
        for name, data in contents.items():
            files[name] = File(hashlib.sha256(data).hexdigest(), None if self.folder else data)
        return files

    def _trace_paths(self, session: DeviceSession, folder: Path) -> None:
        style = self.style
        for number, view in enumerate(self.views, self.first):
            self._pose(session, view)
            with style.randomized(session.scene, number):
                # Each view has random numbers of its own, which don't depend on who renders it.
                tracer = session.path_tracer(style.size, style.max_bounces, numbered_seed(style.seed, number))
                exposure = self._exposure(session, view)
                frame = tracer.render(view.camera, style.samples, denoise=style.denoise, **exposure)
                self._save(session, folder, view, frame, number)

    def _render_frames(self, session: DeviceSession, folder: Path) -> None:
        style = self.style
        assert style.settings is not None
        renderer = session.renderer(style.size, style.settings, style.seed)
        # The frame's number seeds its random numbers and jitter. It is that of one worker that rendered all views.
        renderer.frame_count = self.first * style.frames + style.warm_up - len(self.before)
        with style.randomized(session.scene, self.first):  # then the task has one view
            for view in self.before:
                self._pose(session, view)
                renderer.render(view.camera)
            for number, view in enumerate(self.views, self.first):
                self._pose(session, view)
                exposure = self._exposure(session, view)
                means = FrameAccumulator(renderer, style.rendered, exposes=bool(exposure))
                for _ in range(style.frames):
                    renderer.render(view.camera, **exposure)
                    means.add()
                self._save(session, folder, view, means, number)

    def _pose(self, session: DeviceSession, view: View) -> None:
        if view.time is not None and self.clip is not None:
            session.scene.animate(view.time, self.clip)

    def _exposure(self, session: DeviceSession, view: View) -> dict[str, Any]:
        """The arguments of `render` for the style's shutter."""
        if self.style.shutter is None:
            return {}
        shutter = self.style.shutter.at(view.time or 0.0)
        duration = (shutter.close - shutter.open + shutter.readout) or 1.0  # an instant has no way to go

        def pose(seconds: float) -> Camera:
            if self.clip is not None:
                session.scene.animate(seconds, self.clip)
            closing = view.camera if view.closing is None else view.closing
            return between(view.camera, closing, (seconds - shutter.open) / duration)

        return {"shutter": shutter, "pose": pose}

    def _save(self, session: DeviceSession, folder: Path, view: View, results: Any, number: int) -> None:
        for layer, values in self._traced_layers(session, view).items():
            write_npy(folder / f"{Path(view.name).stem}.{layer}.npy", values)
        # These go through the picture's writer, since .exr and .npz files hold them inside.
        layers: dict[str, NDArray[Any]] = {name: results[name] for name in self.style.rendered}
        if self.style.sensor is not None:
            seed = numbered_seed(self.style.seed, number)
            layers[RAW] = self.style.sensor.expose(results["radiance"], view.camera, seed=seed)
        write_picture(
            folder / view.name,
            results["radiance"],
            exposure=view.camera.exposure,
            tonemap=self.style.tonemap,
            layers=layers,
        )

    def _traced_layers(self, session: DeviceSession, view: View) -> dict[str, NDArray[Any]]:
        """Those of TRACED that the style has."""
        found: dict[str, NDArray[Any]] = {}
        if SILHOUETTES in self.style.layers:
            # BOP counts the pixels of an object around the picture too, which only pinhole cameras have.
            around = 0.0 if view.camera.has_lens else 1.0
            runs, _ = trace_silhouettes(session.ray_tracer(), view.camera, self.style.size, around=around)
            found[SILHOUETTES] = runs
        if KEYPOINTS in self.style.layers:
            found[KEYPOINTS] = self._keypoint_rows(session, view)
        if FLOW in self.style.layers:
            flow, _ = self._flows(session, view.camera, view.after)
            found[FLOW] = flow
        if FLOW_BACK in self.style.layers:
            _, flow_back = self._flows(session, view.before, view.camera)
            found[FLOW_BACK] = flow_back
        return found

    def _keypoint_rows(self, session: DeviceSession, view: View) -> NDArray[np.float64]:
        """A row of the instance's number, u, v and state for each keypoint, (N, 4)."""
        tracer = session.ray_tracer()
        points = json.loads(self.style.points)
        objects = self.style.objects(session.scene)
        found = keypoints(tracer, view.camera, self.style.size, points, instances=objects)
        rows = []
        for number, instance in sorted(tracer.instances.items()):
            rows += [(number, *point.pixel, point.state) for point in found.get(instance, {}).values()]
        return np.array(rows, np.float64).reshape(-1, 4)

    def _flows(
        self, session: DeviceSession, first: Camera | None, second: Camera | None
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """u, v and state (height, width, 3) from the first view to the second, and back; NaN and "outside" where there
        is no other view."""
        if first is None or second is None:
            nothing = np.full((self.style.size[1], self.style.size[0], 3), np.nan, np.float32)
            nothing[..., 2] = OUTSIDE
            return nothing, nothing
        forward, backward = optical_flow(session.ray_tracer(), (first, second), self.style.size)
        return _flow_layer(forward), _flow_layer(backward)


def _flow_layer(found: Flow) -> NDArray[np.float32]:
    return np.concatenate([found.flow, found.state[..., None]], axis=-1).astype(np.float32)


def blocks(style: Style, views: Sequence[View], *, length: int = BLOCK) -> list[RenderTask]:
    """Tasks of successive pictures, for the realtime renderer.

    The frames before the first picture show its view; those before a later block show the views before it.
    """
    tasks = []
    for start in range(0, len(views), length):
        # A later block has at least one frame before it, whose positions give the first picture its motion vectors.
        count = style.warm_up if start == 0 else max(style.warm_up, 1)
        frames = [view for view in views[:start] for _ in range(style.frames)]
        earlier = frames[-count:] if count else []
        before = [views[0]] * (count - len(earlier)) + earlier
        tasks.append(RenderTask(style, start, tuple(views[start : start + length]), tuple(before)))
    return tasks


@dataclass(frozen=True)
class Meter:
    """Finds the exposure that suits some cameras. randomizer: makes the scene for each, by its number."""

    cameras: tuple[Camera, ...]
    size: tuple[int, int]
    randomizer: Randomizer | None = None
    numbers: tuple[int, ...] = ()
    name: str = "metering"

    @property
    def clip(self) -> None:
        """None: the scene is metered as it was given."""

    def perform(self, session: DeviceSession) -> float:
        """The mean EV100 of small pictures."""
        # Small pictures have about the same luminances as large ones.
        scale = METERED_SIDE / max(self.size)
        size = (max(round(self.size[0] * scale), 1), max(round(self.size[1] * scale), 1))
        tracer = session.path_tracer(size, 16, 0)
        values = []
        style = Style(size, randomizer=self.randomizer)
        for number, camera in zip(self.numbers or range(len(self.cameras)), self.cameras, strict=True):
            with style.randomized(session.scene, number):
                tracer.render(camera, METERED_SAMPLES)
                values.append(tracer.auto_exposure())
        return float(np.mean(values))
