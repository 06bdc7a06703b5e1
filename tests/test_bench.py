"""`solari-vk bench`: the page it writes, and the kernel that `RayTracer.trace` is measured by."""

from __future__ import annotations

import numpy as np

from solari_vk.bench import Figures
from solari_vk.cli import main
from solari_vk.gpu.frame import Pass, Stage
from solari_vk.scene.builtin import builtin
from solari_vk.tracer import RayTracer, SceneFrame


def test_page_has_all_figures(device, capsys):
    say = Figures()
    say("a speed", 1234.5678, "rays/s", "aim 2")
    say("a size", 1234567.0, "bytes")
    page = say.markdown(device)
    assert "| a speed | 1,234.568 rays/s | aim 2 |" in page
    assert "| a size | 1,234,567 bytes |  |" in page
    assert device.name in page
    assert device.properties.driver in page
    assert "1,234.568 rays/s  (aim 2)" in capsys.readouterr().out


def test_folder_is_needed(any_device, tmp_path):
    assert main(["bench", "--markdown", str(tmp_path / "none" / "page.md")]) == 2


def test_plain_kernel_finds_what_the_tracer_does(device):
    rng, scene = np.random.default_rng(2), builtin("cornell_box")
    low, high = scene.bounds()
    rays = {"plain_origins": rng.uniform(low, high, (1000, 3)), "plain_directions": rng.normal(size=(1000, 3))}
    with RayTracer(device, scene) as tracer:
        hits = tracer.trace(*rays.values())
        buffers = {name: device.buffer(12_000, name) for name in rays}
        for name, values in rays.items():
            buffers[name].upload(values.astype(np.float32))
        stage = Stage("plain", buffers={"plain_distances": 1000}, passes=[Pass("bench/plain", threads=1000)])
        with SceneFrame(device, tracer.binder, [stage], external=buffers) as frame:
            frame.submit()
            assert np.array_equal(frame["plain_distances"], hits["t"])
        for buffer in buffers.values():
            buffer.destroy()
    assert 0.5 < np.isfinite(hits["t"]).mean() < 1
