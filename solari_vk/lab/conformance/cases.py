"""A check of the suite: what it may use, the cases in which it is measured, and devices that it doesn't run on."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from solari_vk.gpu.device.device import Device
from solari_vk.lab.conformance.outcomes import UNSUPPORTED
from solari_vk.lab.conformance.recorder import Recorder
from solari_vk.lab.conformance.rules import Measurement, Rule
from solari_vk.lab.shader_runner import ShaderRunner


@dataclass(frozen=True)
class Run:
    """What a check may use: the suite's shaders with their device, the profile, and what records missing features.

    part: the only part of the case that is to be measured; all when empty."""

    rule: Recorder
    shaders: ShaderRunner
    full: bool
    part: str = ""

    @property
    def device(self) -> Device:
        """The device under test."""
        return self.shaders.device


Measure = Callable[[Run], Iterable[Measurement]]


def cases_of(name: str, measure: Callable[..., Iterable[Measurement]], *cases: Any) -> dict[str, Measure]:
    """measure(run, case), or measure(run, *case) for tuples, under names with the case."""

    def bind(*values: Any) -> Measure:
        return lambda run: measure(run, *values)

    given = [case if isinstance(case, tuple) else (case,) for case in cases]
    return {"-".join(map(str, (name, *values))): bind(*values) for values in given}


def by(rays: str, rules: Iterable[Rule], measure: Measure) -> Measure:
    """A check of one way to trace rays, whose rules a device that was opened for the other way doesn't support."""

    def check(run: Run) -> Iterable[Measurement]:
        if run.device.rays == rays:
            return measure(run)
        lacked = ", ".join(run.device.missing_rays[rays])
        other = f"the device is opened for rays by {run.device.rays}, not by {rays}"
        run.rule.unmeasured(rules, UNSUPPORTED, f"the device lacks {lacked}" if lacked else other)
        return ()

    return check
