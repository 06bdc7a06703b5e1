"""`solari-vk bench`: its pages, the kernels that it compares with, and the counts of rays."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from support.files import GltfWriter

from solari_vk.base.errors import SolariError
from solari_vk.bound.binder import SceneBinder
from solari_vk.cli import main
from solari_vk.lab.measure import denoised, frame_costs, frame_figures, frame_ms, lamps, tree_order
from solari_vk.lab.measure.bare_rays import plain_tracer
from solari_vk.lab.measure.character import character
from solari_vk.lab.measure.frame_passes import QUICK, against_bare_rays, count_rays
from solari_vk.lab.measure.report import Report
from solari_vk.lab.measure.scenes import from_file, glowing
from solari_vk.renderers.ray_tracer import RayTracer
from solari_vk.renderers.renderer import Renderer
from solari_vk.scene.builtin import builtin
from solari_vk.scene.model import Camera
from solari_vk.settings import Settings


def cells(line):
    return line.strip("| ").split(" | ")


def test_page_has_all_figures(device, capsys, monkeypatch, tmp_path):
    monkeypatch.setattr("sys.argv", ["solari-vk", "bench", "rays"])
    report = Report(device, tmp_path / "page.md", "Speed", ["What it is."])
    report.figure("a speed", 1234.5678, "rays/s", "aim 2")
    report.figure("a size", 1234567.0, "bytes")
    report.table("More", ["scene", "ms"], [["box", "1.5"]], "A note.")
    report.table("Wide", ["scene", *("w" * 70 for _ in range(4))], [["box", "1", "2", "3", "4"]], "word " * 100)
    lines = (tmp_path / "page.md").read_text().splitlines()
    assert max(map(len, lines)) <= 160
    boxes = [line for line in lines if line.startswith("| box")]
    assert boxes == ["| box | 1.5 |", "| box | 1 | 2 |", "| box | 3 | 4 |"]
    assert [line[: line.index(":")] for line in lines[4:8]] == ["- date", "- commit", "- command", "- device"]
    assert lines[:3] == ["# Speed", "", "What it is."]
    for line in (
        "| a speed | 1,234.568 rays/s | aim 2 |",
        "| a size | 1,234,567 bytes |  |",
        "## More",
        "A note.",
        "| scene | ms |",
        "| --- | ---: |",
    ):
        assert line in lines
    assert device.name in "".join(lines)
    assert device.properties.driver in "".join(lines)
    assert "1,234.568 rays/s  (aim 2)" in capsys.readouterr().out


def test_ways_to_build_trees(device, monkeypatch):
    """They find the same hits, and their orders are those that they say."""
    # A few rays are enough to compare hits.
    monkeypatch.setattr(tree_order, "SIZE", (8, 8))
    scene = builtin("cornell_box")
    rates = tree_order.measure(device, scene)
    assert rates.keys() == set(tree_order.HEAD[1:])
    assert min(rates.values()) > 0
    rng = np.random.default_rng(1)
    low, high = scene.bounds
    rays = rng.uniform(low, high, (500, 3)).astype(np.float32), rng.normal(size=(500, 3)).astype(np.float32)
    found = []
    for name, handed in tree_order.ORDERS.items():
        with handed(), RayTracer(device, tree_order.one_mesh(scene) if name == "one mesh" else scene) as tracer:
            found.append(tracer.trace(*rays)["t"])
            orders = tracer.binder.triangle_orders.values()
            assert all((order == np.arange(len(order))).all() for order in orders) == (name == "as given")
    np.testing.assert_allclose(found, [found[0]] * len(found), rtol=1e-5)


def test_subjects(tmp_path):
    """Scenes of scripts, and a number of emissive triangles that leaves the geometry as it is."""
    (tmp_path / "made.py").write_text(
        "import solari_vk as sv\ndef made(path):\n    return sv.builtin('cornell_box', size=float(path.name))\n"
    )
    scene = from_file(tmp_path / "made.py:3.0")
    assert scene.name == "made"
    assert scene.bounds.max[1] == pytest.approx(3.0)
    with pytest.raises(SolariError, match="there is no such Python file"):
        from_file(Path("9" * 5000 + ".py:3.0"))  # no file can have this name
    totals = set()
    for count in (8, 500, 5000):
        counts = {item.material.name: len(item.mesh.triangles) for item in glowing(count, 1000)}
        assert counts["lamp"] == count or count == 5000
        totals.add(counts["lamp"] + counts.get("dark", 0))
    assert len(totals) == 1


def test_wrong_usage(any_device, tmp_path):
    for words in ([], ["lamps"]):
        assert main(["bench", *words, "--markdown", str(tmp_path / "none" / "page.md")]) == 2
    for file in ("none.gltf", "none.py:folder"):
        assert main(["bench", "frame", str(tmp_path / file)]) == 2


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


@pytest.mark.parametrize("lighting", ["paths", pytest.param("split", marks=pytest.mark.slow)])
def test_rays_are_counted_by_pass(device, lighting):
    """Without mirrors the guides trace no rays. By paths a pixel traces one or two rays from each vertex; by separate
    passes at most one to its light, and temporal reuse at most two."""
    scene, size = builtin("cornell_box"), (24, 24)
    binder = SceneBinder(device, scene)
    rays = count_rays(device, binder, scene.camera, size, warm_up=8, frames=2, settings=Settings(lighting=lighting))
    binder.destroy()
    limits = {
        "paths": {"paths/first_ray": (1, 3), "paths/later_rays": (0, 12), "world_cache/sample": (0, 3)},
        "split": {
            "solari019/restir_di/spatial_and_shade": (0.3, 1),
            "solari019/restir_gi/initial": (0.9, 99),
            "solari019/restir_gi/temporal": (0.3, 2),
            "solari019/world_cache/sample_direct": (0, 99),
            "solari019/world_cache/sample_indirect": (0, 99),
        },
    }
    for name, (low, high) in limits[lighting].items():
        assert low < rays[name] <= high, name
    stages = {name.split("/")[-2] for name in rays}
    if lighting == "paths":
        assert stages == {"world_cache", "paths", "guides"}
    else:
        assert stages == {"world_cache", "restir_di", "restir_gi", "specular_gi", "guides"}
        assert "solari019/restir_di/initial_and_temporal" not in rays
        assert rays["guides/write"] == 0


def test_nothing_to_trace_is_no_ratio(device):
    scene = builtin("cornell_box")
    away = Camera.look_at((0, 0, 9), (0, 0, 99))
    with Renderer(device, scene, (8, 8)) as renderer:
        assert all(np.isnan(against_bare_rays(renderer, away, 1.0, 1)))


def test_page_of_the_frame_names_the_way(lent_device, tmp_path, monkeypatch):
    for section in ("_passes", "_start", "_host", "_growth", "_animated"):
        monkeypatch.setattr(frame_figures, section, lambda *_: None)
    monkeypatch.setattr(frame_figures, "_memory", lambda device, report: report.figure("way", 1.0, device.rays))
    for way in ("query", "pipeline"):
        page = tmp_path / "page.md"
        assert main(["bench", "frame", "--quick", "--rays", way, "--markdown", str(page)]) == 0
        assert {f"- rays: by {way}", f"| way | 1.000 {way} |  |"} <= set(page.read_text().splitlines())


@pytest.mark.slow  # minutes of compiling
@pytest.mark.parametrize("way", ["query", "pipeline"])
def test_quick_page_of_the_frame(lent_device, tmp_path, monkeypatch, way):
    """The page has every section but that of the slow test below, and pictures are written; times and counts of rays
    are positive. By default growth is not measured."""
    monkeypatch.setattr(frame_figures, "_animated", lambda *_: None)
    if way == "query":
        monkeypatch.setattr(frame_costs, "frame_time", lambda *_: 1.0)
    page, pictures = tmp_path / "page.md", tmp_path / "pictures"
    quick = ["bench", "frame", "--quick", "--rays", way]
    assert main([*quick, "--markdown", str(page), "--pictures", str(pictures)]) == 0
    lines = page.read_text().splitlines()
    assert f"- rays: by {way}" in lines
    titles = [line[3:].partition(",")[0] for line in lines if line.startswith("## ")]
    assert titles == [
        "Passes at 16x16",
        "Rays per pixel at 16x16",
        "Against bare rays at 16x16",
        "Start",
        "Python's time for a frame",
        "Growth with pixels",
        "Growth with triangles",
        "Growth with instances",
        "Growth with lights",
        "Memory of a frame",
    ]

    def numbers(row: str, section: str = titles[0]) -> list[float]:
        start = next(at for at, line in enumerate(lines) if line.startswith(f"## {section}"))
        found = next(line for line in lines[start:] if line.startswith(f"| {row} |"))
        return [float(cell.replace(",", "")) for cell in cells(found)[1:]]

    for row in ("frame, from call to done", "frame in a stream, raster G-buffer", "frame in a stream, traced G-buffer"):
        assert len(numbers(row)) == 2
        assert min(numbers(row)) > 0
    assert all(2 < count < 40 for count in numbers("all", "Rays per pixel at 16x16"))
    assert sorted(path.name for path in pictures.iterdir()) == ["cornell_box.png", "many_lights.png"]


@pytest.mark.slow  # as are the benchmark's own figures
def test_quick_page_of_the_denoiser(lent_device, tmp_path, monkeypatch):
    """A table for each case, pictures, and references that the second run takes from the folder."""
    page, pictures, kept = (tmp_path / name for name in ("page.md", "pictures", "kept"))
    quick = ["bench", "denoise", "--quick", "--markdown", str(page), "--references", str(kept)]
    assert main([*quick, "--pictures", str(pictures)]) == 0
    before = page.read_text().splitlines()
    titles = [line.partition(", ")[2] for line in before if line.startswith("## ")]
    assert titles == ["still", "camera turns", "camera orbits", "short block moves", "lamp moves"]
    assert {path.stem.partition(", ")[2] for path in pictures.iterdir()} == set(titles)
    for path in kept.iterdir():
        # References with twice the light, in place of those that the first run has kept.
        held = dict(np.load(path))
        np.savez(path, references=held["references"] * 2, view=held["view"])
    cases = denoised.cases
    monkeypatch.setattr(denoised, "cases", lambda *given: itertools.islice(cases(*given), 1))
    assert main(quick) == 0
    assert page.read_text().splitlines()[-1] not in before


@pytest.mark.slow
def test_quick_page_of_compared_settings(lent_device, tmp_path):
    """With the settings of the preset errors and their ratio are as before; without the denoiser they rise."""
    page = tmp_path / "page.md"
    command = ["bench", "settings", "--quick", "--markdown", str(page), "--change"]
    assert main([*command, "denoise=on", "--change", "denoise=off,antialiasing=off"]) == 0
    same, other = (cells(line) for line in page.read_text().splitlines() if line.startswith("| cornell_box"))
    assert same[3] == same[4]
    assert same[5].startswith("1.00")
    assert float(other[7]) > 2 * float(other[6]) == 2 * float(same[6])
    assert main([*command, "denose=on"]) == 2
    assert main([*command, "denoise=on", "--scene", "cornel_box"]) == 2


def test_page_of_times_that_are_given(lent_device, tmp_path, monkeypatch):
    measured = frame_ms.milliseconds(lent_device, builtin("cornell_box"), (16, 16), 1000.0, 9)
    assert measured.shape == (8,)
    assert measured.min() > 0
    # The frames of a quarter: a slow first one, seven slow ones after the cut, and the others.
    quarter = np.array([50.0, *[20.0] * 7, *[10.0] * 92])
    monkeypatch.setattr(frame_ms, "milliseconds", lambda device, scene, size, aim, frames: np.tile(quarter - aim, 4))
    page = tmp_path / "page.md"
    given = ["bench", "frame-ms", "--scene", "cornell_box", "--markdown", str(page)]
    assert main(given) == 0
    rows = [cells(line)[1:] for line in page.read_text().splitlines() if line.startswith("| cornell_box")]
    assert rows == [
        ["0", "10.00", "20.00", "", "50.00", "10.00", "50.00"],
        ["7.5", "2.50", "12.50", "1.67", "42.50", "2.50", "42.50"],
        ["10", "0.00", "10.00", "1.00", "40.00", "0.00", "40.00"],
    ]
    assert main([*given, "--frames", "35"]) == 2


@pytest.mark.slow
def test_page_of_lamps(device, tmp_path, monkeypatch):
    """As many meshes as clusters of one mesh have the same light, with about the same error."""
    monkeypatch.setattr(lamps, "CONVERGED", 64)
    monkeypatch.setattr(lamps, "PARTS", (1, 10))
    page = tmp_path / "page.md"
    assert main(["bench", "lamps", "--triangles", "1280", "--markdown", str(page)]) == 0
    one, many = (
        [float(cell.split(" ±")[0]) for cell in line.split("|")[3:8]]
        for line in page.read_text().splitlines()
        if line.startswith("| 1,280")
    )
    assert min(*one, *many) > 0
    assert 0.5 < one[4] / many[4] < 2


@pytest.mark.slow  # minutes of compiling
def test_quick_page_of_portals(lent_device, tmp_path):
    page = tmp_path / "page.md"
    assert main(["bench", "portals", "--quick", "--markdown", str(page)]) == 0
    rows = [cells(line) for line in page.read_text().splitlines() if line.startswith("| one color")]
    assert [row[1] for row in rows] == ["path tracer, 4 samples", "raw frame 2", "denoised frame 2"]
    assert all(float(row[-1]) for row in rows)


@pytest.mark.slow
def test_compared_scenes_are_chosen_and_their_truth_is_kept(lent_device, tmp_path):
    """A second run takes the path tracer's pictures from the folder: with twice the light, errors are others."""
    page, kept = tmp_path / "page.md", tmp_path / "kept"
    command = [
        "bench",
        "settings",
        "--quick",
        "--markdown",
        str(page),
        "--change",
        "paths_candidates=1",
        "--scene",
        "lamp_gap",
        "--references",
        str(kept),
    ]
    assert main(command) == 0
    (before,) = (cells(line) for line in page.read_text().splitlines() if line.startswith("| lamp_gap"))
    (path,) = kept.iterdir()
    held = dict(np.load(path))
    np.savez(path, references=held["references"] * 2, view=held["view"])
    assert main(command) == 0
    (after,) = (cells(line) for line in page.read_text().splitlines() if line.startswith("| lamp_gap"))
    assert before[3] != after[3]
    ratios = np.array([[before[at + 1], before[at], before[-2 + of]] for of, at in ((0, 3), (1, 6))], float)
    spent = float(before[10]) / float(before[9])
    assert ratios[:, 0] / ratios[:, 1] * spent == pytest.approx(ratios[:, 2], rel=0.05, abs=0.02)


def test_page_of_loading(lent_device, tmp_path):
    """Sizes are those of the files and of their contents, and the memory is as large as the contents."""
    writer = GltfWriter()
    positions = np.random.default_rng(1).normal(size=(3000, 3))
    material = writer.add("materials", emissiveTexture={"index": writer.image(np.zeros((512, 1000, 3)))})
    mesh = writer.mesh({"POSITION": positions, "TEXCOORD_0": positions[:, :2]}, material=material)
    for _ in range(3):
        writer.node(mesh=mesh)
    embedded = writer.save(tmp_path / "one.glb")
    parted = writer.save(tmp_path / "two.gltf", "external")
    page = tmp_path / "page.md"
    assert main(["bench", "load", str(embedded), str(parted), "--markdown", str(page)]) == 0
    rows = [cells(line) for line in page.read_text().splitlines() if ".gl" in line[:12]]
    whole = parted.stat().st_size + parted.with_suffix(".bin").stat().st_size
    for row, size in zip(rows, (embedded.stat().st_size, whole), strict=True):
        assert float(row[1]) == pytest.approx(size / 1e6, abs=0.01)
        assert row[2:6] == ["3", "1,000", "1", "0.5"]
        read, images, upload, held = map(float, row[6:])
        assert read >= images > 0
        assert upload > 0
        assert 512 * 1000 * 4 * 4 / 3 / 1e6 < held < 6


@pytest.mark.slow
def test_the_row_of_an_animated_character(device):
    row = frame_costs.measure_character(device, character(1000, 5), QUICK)
    assert len(row) == len(frame_costs.CHARACTER_HEAD)
    assert row[0] == "character"
    assert int(row[1].replace(",", "")) == pytest.approx(1000, rel=0.1)
    *parts, moving, _ = map(float, row[2:])
    assert 0 < sum(parts) < moving
