"""What "auto" takes on cards of which no list says whether ray queries or compute shaders trace faster."""

from __future__ import annotations

import subprocess
import sys

import pytest

import solari_vk
from solari_vk.base import disk_cache
from solari_vk.base.errors import SolariError
from solari_vk.cli import info, main
from solari_vk.gpu import ray_speed
from solari_vk.gpu.device import logical, measured_rays
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.rays import RAYS, RaySpeeds, is_unlisted

MEASURE = measured_rays._measure


@pytest.fixture
def unlisted(any_device, monkeypatch, tmp_path):
    """Devices count as cards of no list, about which nothing is known. What is measured on them, in turn."""
    results = []
    monkeypatch.setenv("SOLARI_VK_CACHE", str(tmp_path / "cache"))
    for module in (logical, info):
        monkeypatch.setattr(module, "is_unlisted", lambda *_: True)
    monkeypatch.setattr(measured_rays, "_of_process", {})
    monkeypatch.setattr(measured_rays, "_measure", lambda uuid: results.pop(0))
    return results


def opened(**options):
    with Device(**options) as device:
        return device.rays, (device.properties.uuid, device.properties.driver)


def info_line(capsys):
    assert main(["info"]) == 0
    return next(line for line in capsys.readouterr().out.splitlines() if "without --rays" in line).split(": ", 1)[1]


@pytest.mark.parametrize(
    ("kind", "driver", "lacked", "expected"),
    [
        ("discrete gpu", 3, "pipeline", True),  # of Mesa, for AMD
        ("integrated gpu", 0, "", True),
        ("discrete gpu", 4, "", False),  # of NVIDIA
        ("cpu", 13, "", False),
        ("discrete gpu", 3, "query", False),
        ("discrete gpu", 3, "compute", False),
    ],
)
def test_only_cards_of_no_list_are_measured(kind, driver, lacked, expected):
    assert is_unlisted({way: ["x"] if way == lacked else [] for way in RAYS}, kind, driver) == expected


@pytest.mark.parametrize("taken", ["query", "compute"])
def test_what_is_measured_is_kept(unlisted, monkeypatch, capsys, taken):
    assert opened(rays="compute")[0] == "compute"
    with monkeypatch.context() as patch:
        patch.setenv("SOLARI_VK_RAYS", "query")
        assert opened()[0] == "query"
    assert info_line(capsys) == "by ray queries or compute shaders, whichever is faster: measured at first use"
    unlisted.append(RaySpeeds("2026-11-30", **{"query": 1.0, "compute": 1.0, taken: 2.5}))
    rays, (uuid, driver) = opened()
    measured_rays._of_process.clear()  # as in another process
    assert rays == opened(rays="auto")[0] == taken
    words = ["compute shaders", "ray queries"] if taken == "compute" else ["ray queries", "compute shaders"]
    figures = f"{words[0]} traced 2.5 million rays a second, {words[1]} 1.0, measured on 2026-11-30"
    assert info_line(capsys) == f"by {words[0]}, because {figures}"
    assert measured_rays.known_speeds(uuid, driver + "1") is None
    monkeypatch.setattr(solari_vk, "__version__", "0")
    assert measured_rays.known_speeds(uuid, driver) is None


@pytest.mark.parametrize("content", [b"\xff", b"[1]", b'{"day": "x", "query": "1"}', b'{"day": "x", "query": 1}'])
def test_garbage_in_the_cache_is_measured_anew(unlisted, content):
    disk_cache.store(measured_rays._entry(*opened(rays="query")[1]), content)
    unlisted.append(RaySpeeds("2026-11-30", 1.0, 2.0))
    assert opened()[0] == "compute"


def test_without_a_cache_each_process_measures(unlisted, monkeypatch, tmp_path):
    (tmp_path / "file").touch()
    monkeypatch.setenv("SOLARI_VK_CACHE", str(tmp_path / "file"))
    unlisted.append(RaySpeeds("2026-11-30", 1.0, 2.0))
    with pytest.warns(match="can't be kept"):
        assert opened()[0] == "compute"
    assert opened()[0] == "compute"


@pytest.mark.parametrize(
    ("script", "reason"),
    [
        ("echo memory is full >&2; exit 1", "memory is full"),
        ("kill -11 $$", "its process ended with code -11"),
        ("exec sleep 9", "timed out after"),
        ("echo '{}'", "these are no speeds"),
        (None, "No such file"),
    ],
)
def test_where_measuring_fails_queries_are_taken(unlisted, monkeypatch, tmp_path, capsys, script, reason):
    program = tmp_path / "python"
    if script:
        program.write_text(f"#!/bin/sh\n{script}\n")
        program.chmod(0o700)
    monkeypatch.setattr(measured_rays, "_measure", MEASURE)
    with monkeypatch.context() as patch:
        patch.setattr(sys, "executable", str(program))
        patch.setattr(measured_rays, "LONGEST", 0.5)
        assert opened()[0] == "query"
    said = info_line(capsys)
    assert said.startswith("by ray queries, because measuring how fast it traces failed on 20")
    assert reason in said


ONE_OF_SEVERAL = """
import time
from solari_vk.gpu.device import measured_rays, rays
def measure(uuid):
    time.sleep(0.5)
    print("measured")
    return rays.RaySpeeds("today", 1.0, 2.0)
measured_rays._measure = measure
print(measured_rays.measured_speeds("uuid", "driver").fastest()[0])
"""


def test_of_several_processes_one_measures(unlisted):
    processes = [subprocess.Popen([sys.executable, "-c", ONE_OF_SEVERAL], stdout=subprocess.PIPE) for _ in range(3)]
    said = b"".join(process.communicate()[0] for process in processes)
    assert sorted(said.split()) == [b"compute"] * 3 + [b"measured"]


def test_a_device_is_measured_by_another_process(unlisted, monkeypatch):
    monkeypatch.setattr(measured_rays, "_measure", MEASURE)
    monkeypatch.setattr(measured_rays, "LONGEST", 600.0)  # software devices compile for long
    rays, identity = opened()
    speeds = measured_rays.known_speeds(*identity)
    assert not speeds.failure
    assert rays == ("compute" if speeds.compute > speeds.query else "query")


@pytest.mark.parametrize("scale", [1, 2])
def test_both_ways_must_find_the_same_hits(any_device, monkeypatch, scale):
    meshes = [ray_speed.wavy_sheets(), scale * ray_speed.wavy_sheets()]
    monkeypatch.setattr(ray_speed, "wavy_sheets", meshes.pop)
    monkeypatch.setattr(ray_speed, "RAYS", 1 << 14)
    with Device(rays="query") as by_query, Device(rays="compute") as by_compute:
        devices = {"query": by_query, "compute": by_compute}
        if scale == 1:
            assert min(ray_speed.speeds(devices).values()) > 0
            return
        with pytest.raises(SolariError, match="find other hits"):
            ray_speed.speeds(devices)
