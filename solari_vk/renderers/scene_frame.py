"""Passes over a scene that a SceneBinder holds on the device."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import ExitStack
from typing import Any

from solari_vk.base.errors import Hints, SolariError, checked_constructor
from solari_vk.bound.binder import SceneBinder
from solari_vk.gpu.acceleration.checks import check_kind
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import Frame, Stage
from solari_vk.scene.model import Scene


def bind_scene(
    device: Device, scene: Scene | SceneBinder | Sequence[Scene], who: str, owned: ExitStack, *, many: bool = False
) -> SceneBinder:
    """The binder that holds a scene on the device: one made for a Scene, which `owned` frees, or the one that is given.

    Objects that are given the same SceneBinder share the scene's memory on the device, which the caller frees. who: the
    class that asks, for messages. many: whether it may be a list of scenes, or a SceneBinder of one. Raises SolariError
    for a device or a scene of the wrong type.
    """
    checked_device(device, who)
    if not (many and isinstance(scene, (list, tuple))):
        check_kind(scene, (Scene, SceneBinder), f"{who}: the scene", "give a solari_vk.Scene, or a SceneBinder")
    if isinstance(scene, SceneBinder):
        device.check_owns(scene, f"{who}: the SceneBinder")
        if scene.has_many_scenes and not many:
            raise SolariError(f"{who}: the SceneBinder has a list of scenes, which Batch shows: give that of one scene")
        return scene
    binder = SceneBinder(device, scene)
    owned.callback(binder.destroy)
    return binder


@checked_constructor
class SceneFrame(Frame, Hints):
    """A frame of custom passes over a scene.

    Shaders that include "scene/bindings.glsl" have the scene in descriptor set 0, and its features as constants.
    Each `submit` first applies the scene's edits. `external`, which may replace resources of the scene, and the other
    options are those of `Frame`; glsl_root is the folder (or the folders) of the custom shaders, which may include the
    package's by their paths.
    """

    def __init__(
        self,
        device: Device,
        scene: Scene | SceneBinder,
        stages: Sequence[Stage],
        *,
        external: Mapping[str, Any] | None = None,
        **options: Any,
    ) -> None:
        self._owned = ExitStack()
        self.binder = bind_scene(device, scene, type(self).__name__, self._owned, many=True)
        try:
            # The shaders are compiled for the features that the scene has, so it must be on the device before.
            self.binder.update(self)
            self._bound_version = self.binder.bindings_version
            self._replaced = frozenset(external or ())
            resources = self._scene_resources | dict(external or {})
            super().__init__(device, stages, external=resources, features=self.binder.features, **options)
        except BaseException:
            self._owned.close()
            raise

    def rebuild(
        self,
        stages: Sequence[Stage] | None = None,
        external: Mapping[str, Any] | None = None,
        features: Collection[str] | None = None,
    ) -> None:
        """As `Frame.rebuild`; external resources are added to the scene's."""
        if external is not None:
            self._replaced = frozenset(external)
            external = self._scene_resources | dict(external)
        super().rebuild(stages, external, features)

    @property
    def _scene_resources(self) -> dict[str, Any]:
        return {name: made for name, made in self.binder.resources.items() if name not in self._replaced}

    def apply_edits(self) -> None:
        """Apply the scene's edits before the next frame, for callers that need to see the edited scene first."""
        self.check_open()
        binder = self.binder
        binder.update(self)
        # A buffer that has grown is another one, which descriptors must name.
        if binder.bindings_version != self._bound_version:
            self._bound_version = binder.bindings_version
            self.bind(self._scene_resources)
        # Other features are other constants of the pipelines.
        if self.features != binder.features:
            self.rebuild(features=binder.features)

    def submit(self, before: Sequence[raw.CData] = ()) -> int:
        """Apply the scene's edits and run the next frame; returns the device's timeline value."""
        self.apply_edits()
        return self.submit_applied(before)

    def submit_applied(self, before: Sequence[raw.CData] = ()) -> int:
        """As `submit`, but for a scene whose edits `apply_edits` has applied already."""
        return super().submit(before)

    def close(self) -> None:
        """Safe to call twice."""
        super().close()
        self._owned.close()  # after the frame, whose commands use the scene's memory


def checked_device(device: Device, what: str) -> Device:
    check_kind(device, Device, f"{what}: the device", "give a solari_vk.Device")
    return device
