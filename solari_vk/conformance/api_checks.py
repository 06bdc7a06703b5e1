"""The document's rules for the order of builds, for compaction and for instances: kept, or refused before Vulkan."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import numpy as np

from solari_vk import rt
from solari_vk.conformance.bulk_checks import trace
from solari_vk.conformance.rules import WGPU, Measurement, Rule, count_wrong
from solari_vk.conformance.shader_runner import ShaderRunner
from solari_vk.errors import SolariError
from solari_vk.gpu.device.device import Device

_API, _COMPACTION = "wgpu's raytracing API", "Blas compaction"
_FLAT = np.array([(0, 0, 0), (2, 0, 0), (0, 2, 0)], np.float32)
_ABOVE, _DOWN = np.array((0.5, 0.5, 1.0)), np.array((0.0, 0.0, -1.0))


class _Scene:
    """Makes structures over one triangle and destroys them at its end."""

    def __init__(self, device: Device, stack: ExitStack) -> None:
        self.device, self._stack = device, stack

    def blas(self, **options: Any) -> rt.Blas:
        blas: rt.Blas = self.keep(rt.create_blas(self.device, [rt.Triangles(_FLAT)], **options))
        return blas

    def tlas(self) -> rt.Tlas:
        tlas: rt.Tlas = self.keep(rt.create_tlas(self.device, 4))
        return tlas

    def keep(self, item: Any) -> Any:
        self._stack.callback(item.destroy)
        return item

    def build(self, *blases: rt.Blas, height: float = 0.0) -> None:
        rt.build_acceleration_structures(self.device, [_entry(blas, height) for blas in blases])

    def place(self, tlas: rt.Tlas, *blases: rt.Blas, also: rt.Blas | None = None) -> None:
        package = rt.TlasPackage(tlas, [rt.TlasInstance(blas, custom_data=i) for i, blas in enumerate(blases)])
        rt.build_acceleration_structures(self.device, [_entry(also)] if also else [], [package])


def _entry(blas: rt.Blas, height: float = 0.0) -> rt.BlasBuildEntry:
    return rt.BlasBuildEntry(blas, [rt.Triangles(_FLAT + np.array((0, 0, height), np.float32))])


def _refused(call: Callable[..., Any], *arguments: Any, **options: Any) -> bool:
    try:
        call(*arguments, **options)
    except SolariError:
        return True
    return False


def measure_order(shaders: ShaderRunner) -> Iterator[Measurement]:
    """What the document forbids is refused, what it allows gives hits."""
    device, wrong = shaders.device, []

    def note(label: str, right: bool) -> None:
        if not right:
            wrong.append(label)

    def hit(tlas: rt.Tlas) -> bool:
        return bool(trace(shaders, tlas, _ABOVE, _DOWN)["t"][0] == 1)

    with ExitStack() as stack:
        scene = _Scene(device, stack)
        blas, tlas = scene.blas(), scene.tlas()
        note("a Tlas used before it is built", _refused(hit, tlas))
        note("a Tlas over a Blas never built", _refused(scene.place, tlas, blas))
        scene.place(tlas, blas, also=blas)
        note("built in the same call", hit(tlas))
        scene.build(blas)
        note("a Blas rebuilt under an old Tlas", _refused(hit, tlas))
        scene.place(tlas, blas)
        note("a Blas of an earlier call", hit(tlas))
        call = rt.BuildCall(device, [_entry(blas)])
        note("the same Blas twice in a call", _refused(rt.BuildCall, device, [_entry(blas), _entry(blas)]))
        blas.destroy()
        note("a Blas freed under its Tlas", _refused(hit, tlas))
        note("a freed Blas in a Tlas", _refused(scene.place, tlas, blas))
        note("a freed Blas built", _refused(call.submit))
        note("more instances than made for", _refused(scene.place, tlas, *[scene.blas()] * 5))
        tlas.destroy()
        note("a freed Tlas used", _refused(hit, tlas))
    rule = Rule("Blases are built in the same call as their Tlas or before, else refused", WGPU, _API)
    yield count_wrong(rule, wrong)
    wrong = []
    with ExitStack() as stack:
        made = _Scene(device, stack).blas()
        note("custom data of 25 bits", _refused(rt.TlasInstance, made, custom_data=1 << 24))
        note("negative custom data", _refused(rt.TlasInstance, made, custom_data=-1))
        note("mask of 9 bits", _refused(rt.TlasInstance, made, mask=0x100))
        note("NaN in a transform", _refused(rt.TlasInstance, made, np.full((3, 4), np.nan)))
        note("all 24 bits", not _refused(rt.TlasInstance, made, custom_data=0xFFFFFF))
    yield count_wrong(Rule("TlasInstance: only the first 24 bits of custom data may be set", WGPU, _API), wrong)


def measure_compaction(shaders: ShaderRunner) -> Iterator[Measurement]:
    """prepare_compaction, ready_for_compaction and compact, step by step."""
    device, wrong = shaders.device, []
    called: list[str] = []

    def note(label: str, right: bool) -> None:
        if not right:
            wrong.append(label)

    with ExitStack() as stack:
        scene = _Scene(device, stack)
        blas, tlas = scene.blas(), scene.tlas()
        note("prepared before it was built", _refused(blas.prepare_compaction))
        scene.build(blas)
        note("compacted before it was prepared", _refused(blas.compact) and not blas.ready_for_compaction)
        blas.prepare_compaction(lambda: called.append("cancelled"))
        scene.build(blas)
        device.wait_idle()
        note("a rebuild ends the preparation", not blas.ready_for_compaction and _refused(blas.compact))
        blas.prepare_compaction(lambda: called.append("ready"))
        device.wait_idle()
        note("ready when builds are done", blas.ready_for_compaction)
        # A rebuild may beat the cancelled query to its end: then its callback is right to have come before it.
        note("the callback is called once", called.count("ready") == 1)
        compacted = scene.keep(blas.compact())
        note("no larger", 0 < compacted.size <= blas.size)
        note("a compacted Blas built again", _refused(scene.build, compacted))
        note("a compacted Blas compacted again", _refused(compacted.prepare_compaction))
        scene.build(blas, height=-1)
        scene.place(tlas, compacted)
        note("independent of a rebuild", bool(trace(shaders, tlas, _ABOVE, _DOWN)["t"][0] == 1))
        blas.destroy()
        note("independent of its source's end", bool(trace(shaders, tlas, _ABOVE, _DOWN)["t"][0] == 1))
        bare = scene.blas(allow_compaction=False)
        scene.build(bare)
        note("prepared without allow_compaction", _refused(bare.prepare_compaction))
    yield count_wrong(Rule("prepare_compaction, ready_for_compaction, compact", WGPU, _COMPACTION), wrong)
