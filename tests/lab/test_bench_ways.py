"""`solari-vk bench ways`: its table, and its warning of methods that find other hits."""

from __future__ import annotations

import numpy as np
import pytest

from solari_vk.base.errors import SolariError
from solari_vk.cli import main
from solari_vk.gpu.device.device import Device
from solari_vk.lab.measure import ways
from solari_vk.renderers.ray_tracer import RayTracer
from solari_vk.scene.builtin import builtin
from solari_vk.scene.model import Camera

COMMAND = ["bench", "ways", "--scene", "cornell_box", "--size", "64x36"]


@pytest.fixture
def measure(any_device, monkeypatch, tmp_path):
    """measure(*words) -> the lines of the page, and the cells of each row of its table. Nothing warms up for long."""
    monkeypatch.setattr(ways, "RAYS_WARM_UP", 0.0)
    monkeypatch.setattr(ways, "FRAME_WARM_UP", 0.0)

    def run(*words):
        assert main([*COMMAND, *words, "--markdown", str(tmp_path / "page.md")]) == 0
        lines = (tmp_path / "page.md").read_text().splitlines()
        return lines, [line.strip("| ").split(" | ") for line in lines if line.startswith("| cornell_box")]

    return run


def test_every_method_has_figures(measure):
    with Device() as device:
        methods = [method for method, missing in device.missing_rays.items() if not missing]
    lines, rows = measure()
    assert f"- rays: by {', '.join(methods)}" in lines
    assert [row[0] for row in rows] == [f"cornell_box, {method}" for method in methods]
    for _, *cells, other in rows:
        figures = np.array([cell.strip(")").replace(",", "").split(" (") for cell in cells], float)
        assert figures.shape == (6, 2)
        assert np.isfinite(figures).all()
        assert figures.min() > 0
        assert float(other.strip("%")) <= 0.1
    assert all(cell.endswith("(1.00)") for cell in rows[0][1:-1])


def test_other_hits_are_told(measure, monkeypatch):
    """One method traces a hundredth of the rays backwards."""
    traced = ways.plain_tracer

    def turned(device, binder, origins, directions):
        some = np.arange(len(directions))[:, None] % 100 == 0
        return traced(device, binder, origins, np.where(some & (device.rays == "compute"), -directions, directions))

    monkeypatch.setattr(ways, "plain_tracer", turned)
    monkeypatch.setattr(ways, "_frame_times", lambda *_: (1.0, 1.0))
    monkeypatch.setattr(ways, "_sample_time", lambda *_: 1.0)
    (_, alone), (lines, rows) = measure("--rays", "compute"), measure()
    assert [row[0] for row in alone] == ["cornell_box, compute"]
    if len(rows) > 1:
        assert 0.5 < float(rows[-1][-1].strip("%")) < 1.1
        assert any(line.startswith("cornell_box, compute: ") and "can't be compared" in line for line in lines)


def test_rays_start_before_surfaces(device):
    scene = builtin("cornell_box")
    with RayTracer(device, scene) as tracer:
        (origins, directions), (points, scattered) = ways.make_rays(tracer, scene.camera, (16, 16))
        hits = tracer.trace(origins, directions)
        hits = hits[np.isfinite(hits.t)]
        assert tracer.trace(points, hits.position - points).t == pytest.approx(1, rel=0.01)
        cosines = np.abs((hits.normal * scattered).sum(axis=1))
        assert cosines.mean() == pytest.approx(2 / 3, abs=0.05)
        with pytest.raises(SolariError, match="the camera of cornell_box sees no surface"):
            ways.make_rays(tracer, Camera.look_at((0, 0, 9), (0, 0, 99)), (4, 4))
