"""`solari-vk bench`: its page, the kernels that it compares with, and the counts of rays."""

from __future__ import annotations

import numpy as np

from solari_vk.cli import main
from solari_vk.measure.bare_rays import plain_tracer
from solari_vk.measure.frame.passes import against_bare_rays, count_rays
from solari_vk.measure.report import Report
from solari_vk.renderer import Renderer
from solari_vk.scene.binder import SceneBinder
from solari_vk.scene.builtin import builtin
from solari_vk.scene.model import Camera
from solari_vk.tracer import RayTracer


def test_page_has_all_figures(device, capsys, tmp_path):
    report = Report(device, tmp_path / "page.md", "Speed", ["What it is."])
    report.figure("a speed", 1234.5678, "rays/s", "aim 2")
    report.figure("a size", 1234567.0, "bytes")
    report.table("More", ["scene", "ms"], [["box", "1.5"]], "A note.")
    lines = (tmp_path / "page.md").read_text().splitlines()
    assert lines[:3] == ["# Speed", "", "What it is."]
    for row in ("| a speed | 1,234.568 rays/s | aim 2 |", "| a size | 1,234,567 bytes |  |", "## More", "A note.",
                "| scene | ms |", "| --- | ---: |", "| box | 1.5 |"):  # fmt: skip
        assert row in lines
    assert device.name in "".join(lines)
    assert device.properties.driver in "".join(lines)
    assert "1,234.568 rays/s  (aim 2)" in capsys.readouterr().out


def test_folder_is_needed(any_device, tmp_path):
    assert main(["bench", "--markdown", str(tmp_path / "none" / "page.md")]) == 2


def test_plain_kernel_finds_what_the_tracer_does(device):
    rng, scene = np.random.default_rng(2), builtin("cornell_box")
    low, high = scene.bounds
    origins = rng.uniform(low, high, (1000, 3)).astype(np.float32)
    directions = rng.normal(size=(1000, 3)).astype(np.float32)
    with RayTracer(device, scene) as tracer, plain_tracer(device, tracer.binder, origins, directions) as plain:
        hits = tracer.trace(origins, directions)
        plain.submit()
        assert np.array_equal(plain["plain_distances"], hits["t"])
    assert 0.5 < np.isfinite(hits["t"]).mean() < 1


def test_rays_are_counted_by_pass(device):
    """A pixel traces at most one ray to its light, and without mirrors the guides trace none."""
    scene, size = builtin("cornell_box"), (24, 24)
    binder = SceneBinder(device, scene)
    rays = count_rays(device, binder, scene.camera, size, warm_up=8, frames=2)
    assert 0.3 < rays["restir_di/spatial_and_shade"] <= 1
    assert rays["restir_di/initial_and_temporal"] == rays["guides/write"] == 0
    assert rays["restir_gi/initial_and_temporal"] > 0.9
    assert min(rays["world_cache/sample_direct"], rays["world_cache/sample_indirect"]) > 0
    stages = {name.partition("/")[0] for name in rays}
    assert stages == {"world_cache", "restir_di", "restir_gi", "specular_gi", "guides"}
    binder.destroy()


def test_nothing_to_trace_is_no_ratio(device):
    scene = builtin("cornell_box")
    away = Camera.look_at((0, 0, 9), (0, 0, 99))
    with Renderer(device, scene, (8, 8)) as renderer:
        assert all(np.isnan(against_bare_rays(renderer, away, 1.0, 1)))
