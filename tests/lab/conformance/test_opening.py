"""The device of a group: opened for the way that the group is about, and what a report says where that fails."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from solari_vk.base.errors import DeviceError
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.physical import PhysicalDevice
from solari_vk.lab.conformance import probe_checks, worker
from solari_vk.lab.conformance.cases import by
from solari_vk.lab.conformance.outcomes import UNSUPPORTED, Check
from solari_vk.lab.conformance.recorder import Recorder
from solari_vk.lab.conformance.worker import SuiteOptions, Worker


@pytest.fixture(autouse=True)
def no_choice(any_device, monkeypatch):
    monkeypatch.delenv("SOLARI_VK_RAYS", raising=False)


def told(options):
    """How the device of ray queries traces, and why the probes by ray queries aren't measured on it."""
    outcomes = []
    recorder = Recorder(Check("ray_queries", "probes-fresh"), [], outcomes.append)
    with Worker(options, "ray_queries") as opened:
        assert not by("query", probe_checks.rules(), None)(SimpleNamespace(recorder=recorder, device=opened.device))
        ((status, reason),) = {(outcome.status, outcome.reason) for outcome in outcomes}
        assert status == UNSUPPORTED
        return opened.device.rays, reason


def test_the_report_names_what_the_device_lacks_or_the_user_chose(monkeypatch):
    chosen = "the device is opened for rays by pipeline, not by query"
    assert told(SuiteOptions(rays="pipeline")) == ("pipeline", chosen)
    lacks_of = PhysicalDevice._lacks_of
    no_queries = ["VK_KHR_ray_query"]
    monkeypatch.setattr(
        PhysicalDevice,
        "_lacks_of",
        lambda self, names: lacks_of(self, names) + [name for name in names if name in no_queries],
    )
    assert told(SuiteOptions()) == ("pipeline", "the device lacks VK_KHR_ray_query")


def test_a_device_that_has_the_way_is_opened_for_it():
    for group, way in (("ray_queries", "query"), ("ray_pipelines", "pipeline"), ("compute_rays", "compute")):
        with Worker(SuiteOptions(), group) as opened:
            assert opened.device.rays == way


@pytest.mark.parametrize(("group", "way"), [("compute_rays", "query"), ("ray_traversal", "compute")])
def test_trees_and_structures_of_drivers_are_not_taken_for_each_other(group, way):
    outcomes = []
    with Worker(SuiteOptions(rays=way), group) as opened:
        opened.measure(Check(group, "watertight"), outcomes.append)
    assert [outcome.status for outcome in outcomes] == [UNSUPPORTED]
    assert f"opened for rays by {way}, not by" in outcomes[0].reason


def test_a_failure_to_open_is_no_missing_feature(monkeypatch):
    """vkCreateDevice fails for ray pipelines, which the device claims to have."""

    def make(select, rays):
        if rays == "pipeline":
            raise DeviceError("vkCreateDevice: VK_ERROR_INITIALIZATION_FAILED")
        return Device(select, rays=rays)

    monkeypatch.setattr(worker, "Device", make)
    with pytest.raises(DeviceError, match="INITIALIZATION_FAILED"):
        Worker(SuiteOptions(), "ray_pipelines")
