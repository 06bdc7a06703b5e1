"""The device of a group: opened for the way that the group is about, and what a report says where that fails."""

from __future__ import annotations

import pytest

from solari_vk.conformance import probe_checks, worker
from solari_vk.conformance.cases import by
from solari_vk.conformance.recorder import Recorder
from solari_vk.conformance.rules import UNSUPPORTED, Check
from solari_vk.conformance.worker import Work
from solari_vk.errors import DeviceError
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.physical import PhysicalDevice


@pytest.fixture
def lacking(any_device, monkeypatch):
    """Devices report that they have no ray queries; without a choice by the environment."""
    monkeypatch.delenv("SOLARI_VK_RAYS", raising=False)
    lacks_of = PhysicalDevice._lacks_of
    monkeypatch.setattr(PhysicalDevice, "_lacks_of", lambda self, names: lacks_of(self, names) + [
        name for name in names if name == "VK_KHR_ray_query"])  # fmt: skip


def told(opened):
    """Why the probes by ray queries aren't measured on this device."""
    outcomes = []
    rule = Recorder(Check("ray_queries", "probes-fresh"), [], outcomes.append)
    measure = by("query", probe_checks.rules(), None)
    assert not measure(type("Run", (), {"rule": rule, "device": opened}))
    assert {outcome.status for outcome in outcomes} == {UNSUPPORTED}
    (reason,) = {outcome.reason for outcome in outcomes}
    return reason


def test_the_report_names_what_the_device_lacks(lacking):
    with worker._open_device(Work(), "query") as opened:
        assert opened.rays == "pipeline"
        assert told(opened) == "the device lacks VK_KHR_ray_query"


def test_the_report_names_the_way_that_the_user_chose(any_device):
    with worker._open_device(Work(rays="pipeline"), "query") as opened:
        assert told(opened) == "the device is opened for rays by pipeline, not by query"


@pytest.mark.parametrize("way", ["query", "pipeline"])
def test_a_device_that_has_the_way_is_opened_for_it(any_device, monkeypatch, way):
    monkeypatch.delenv("SOLARI_VK_RAYS", raising=False)
    with worker._open_device(Work(), way) as opened:
        assert opened.rays == way


def test_a_failure_to_open_is_no_missing_feature(any_device, monkeypatch):
    """vkCreateDevice fails for ray pipelines, which the device claims to have."""
    monkeypatch.delenv("SOLARI_VK_RAYS", raising=False)

    def make(select, rays):
        if rays == "pipeline":
            raise DeviceError("vkCreateDevice: VK_ERROR_INITIALIZATION_FAILED")
        return Device(select, rays=rays)

    monkeypatch.setattr(worker, "Device", make)
    with pytest.raises(DeviceError, match="INITIALIZATION_FAILED"):
        worker._open_device(Work(), "pipeline")
