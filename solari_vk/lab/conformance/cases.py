"""A check of the suite: what it may use, the cases in which it is measured, and devices that it doesn't run on."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from solari_vk.gpu.device.device import Device
from solari_vk.lab.conformance.outcomes import UNSUPPORTED, Measurement, Rule
from solari_vk.lab.conformance.recorder import Recorder
from solari_vk.lab.shader_runner import ShaderRunner


@dataclass(frozen=True)
class CheckContext:
    """What a check may use: the suite's shaders with their device, the profile, and what records missing features.

    part: the only part of the case that is to be measured; all when empty."""

    recorder: Recorder
    shaders: ShaderRunner
    full: bool
    part: str = ""

    @property
    def device(self) -> Device:
        """The device under test."""
        return self.shaders.device


Measure = Callable[[CheckContext], Iterable[Measurement]]


def with_shaders(measure: Callable[[ShaderRunner], Iterable[Measurement]]) -> Measure:
    """A check that only runs shaders."""
    return lambda context: measure(context.shaders)


def with_device(measure: Callable[[Device], Iterable[Measurement]]) -> Measure:
    """A check that only needs a device."""
    return lambda context: measure(context.device)


def cases_of(name: str, measure: Callable[..., Iterable[Measurement]], *cases: Any) -> dict[str, Measure]:
    """measure(context, case), or measure(context, *case) for tuples, under names with the case."""

    def bind(*values: Any) -> Measure:
        return lambda context: measure(context, *values)

    arguments = [case if isinstance(case, tuple) else (case,) for case in cases]
    return {"-".join(map(str, (name, *values))): bind(*values) for values in arguments}


def by(rays: str, rules: Iterable[Rule], measure: Measure) -> Measure:
    """A check of one way to trace rays, whose rules a device that was opened for the other way doesn't support."""

    def check(context: CheckContext) -> Iterable[Measurement]:
        if context.device.rays == rays:
            return measure(context)
        # A check of the other way would say nothing about this one, so its rules count as unsupported.
        lacked = ", ".join(context.device.missing_rays[rays])
        other = f"the device is opened for rays by {context.device.rays}, not by {rays}"
        context.recorder.unmeasured(rules, UNSUPPORTED, f"the device lacks {lacked}" if lacked else other)
        return ()

    return check
