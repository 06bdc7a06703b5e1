"""The examples of docs/examples run, are short, and compute what they say."""

from __future__ import annotations

import os
import re
import runpy
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.lab.conformance.faults import known_faults

FOLDER = Path(__file__).resolve().parents[3] / "docs/examples"
EXAMPLES = sorted(path.stem for path in FOLDER.glob("*.py"))
MANY_SAMPLES = ("gymnasium_worlds", "learn", "materials", "mujoco_worlds", "objects", "seeds", "turntable")  # see below


def load(name):
    return SimpleNamespace(**runpy.run_path(str(FOLDER / f"{name}.py")))


def code_of(page):
    """The text of a page of docs/, and its blocks of Python."""
    text = (FOLDER.parent / page).read_text(encoding="utf-8")
    return text, re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


def test_all_are_there_and_short():
    assert len(EXAMPLES) >= 10
    for path in [*FOLDER.glob("*.py"), *FOLDER.rglob("*.comp")]:
        longest = {"gymnasium_worlds": 70}.get(path.stem, 40)
        assert len(path.read_text(encoding="utf-8").splitlines()) < longest, path


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in MANY_SAMPLES else name for name in EXAMPLES]
)
def test_runs_as_a_program(any_device, name, tmp_path, monkeypatch):
    needed = {"learn": "torch", "gymnasium_worlds": "gymnasium"}.get(name, "mujoco" if "mujoco" in name else "numpy")
    pytest.importorskip(needed)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [name])
    monkeypatch.syspath_prepend(FOLDER)  # as of a program
    runpy.run_path(str(FOLDER / f"{name}.py"), run_name="__main__")
    assert len(list(tmp_path.iterdir())) == 1


def test_a_small_network_learns():
    """Of bright squares before noise, on the CPU, as of the pictures that the example renders."""
    pytest.importorskip("torch")
    random = np.random.default_rng(1)
    samples = []
    for x, y in random.integers((2, 2), (29, 21), (120, 2)):
        picture = random.uniform(0, 0.5, (3, 24, 32)).astype(np.float32)
        picture[:, y - 2 : y + 3, x - 2 : x + 3] += 0.4
        samples.append((picture, np.array([x, y], np.float32)))

    class Made(list):
        size = (32, 24)

    errors = list(load("learn").train(Made(samples)))
    assert errors[-1] < 0.25 * errors[0]


def test_the_guide_runs(any_device, capsys, tmp_path, monkeypatch):
    text, blocks = code_of("ray_tracing.md")
    monkeypatch.chdir(tmp_path)
    [(path, shader)] = re.findall(r"^<!-- file: (\S+) -->\n```glsl\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    Path(path).parent.mkdir(parents=True)
    Path(path).write_text(shader)
    for block in blocks:
        exec(compile(block, "ray_tracing.md", "exec"), {})
    printed = re.fullmatch(r"ready\n(\d+) of 100 rays hit 7\n", capsys.readouterr().out)
    assert 30 < int(printed[1]) < 70
    for target in re.findall(r"\]\(([^)]+)\)", text):
        assert (FOLDER.parent / target.partition("#")[0]).is_file(), target


def test_the_program_about_driver_faults_shows_them(device):
    """On a device without the fault all six lists are right. Where it is known to have it, the first list is right, and
    another wrong or missing."""
    _, [program] = code_of("driver_faults.md")
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=os.environ | {"PYTHONPATH": str(FOLDER.parents[2])},
        capture_output=True,
        text=True,
        check=False,
    )
    right = {"last": [0, 1, -1], "first": [-1, 1, 2], "mask 0": [-1, 1, 2]}
    lines = [f"{memory} memory, {name}: {hits}" for memory in ("new", "used") for name, hits in right.items()]
    known = known_faults(f"{device.properties.driver} {device.name}")
    found = done.stdout.splitlines()
    assert found[:1] == lines[:1], done.stdout + done.stderr
    faulty = any("hides no other instance" in fault.rule for fault in known)
    assert (found != lines) == faulty, done.stdout + done.stderr


def test_lidar_measures_distances(device):
    lidar = load("lidar")
    with sv.RayTracer(device, sv.builtin("closed_box", size=4.0)) as tracer:
        hits, points = lidar.scan(tracer, np.array([0.5, -0.3, 0.2]))
        assert set(tracer.instances) >= set(np.unique(hits["instance"]).tolist())
    assert hits.shape == (lidar.CHANNELS, lidar.STEPS)
    farthest = np.abs(points).max(axis=1)
    assert farthest == pytest.approx(np.full(hits.size, 2.0), abs=6 * lidar.NOISE)
    assert farthest.std() > lidar.NOISE / 3


def test_acoustics_decay_as_eyring_says(device):
    acoustics = load("acoustics")
    source = np.array([-1, 0, 1])
    listener = np.array([1, 0.5, -1])
    side = 4.0
    absorption = 0.2
    with sv.RayTracer(device, sv.builtin("closed_box", size=side)) as tracer:
        response = acoustics.impulse_response(tracer, source, listener, absorption)
    direct = np.linalg.norm(source - listener)
    first = int(direct / acoustics.SPEED * acoustics.RATE)
    assert np.flatnonzero(response)[0] == first
    assert response[first] == pytest.approx(1 / (4 * np.pi * direct**2))
    left = 10 * np.log10(np.cumsum(response[::-1])[::-1] / response.sum())
    measured = 2 * (np.argmax(left < -35) - np.argmax(left < -5)) / acoustics.RATE
    eyring = 24 * np.log(10) / acoustics.SPEED * side**3 / (-6 * side**2 * np.log(1 - absorption))
    assert measured == pytest.approx(eyring, rel=0.1)


def test_occlusion_of_closed_open_and_half_hidden_points(device):
    bake = load("bake_occlusion").bake
    closed = bake(device, sv.builtin("closed_box"), reach=100.0)
    assert all((part == 0).all() for part in closed)
    small = np.array([[0, 0, 0], [0, 0, 1e-3], [1e-3, 0, 0]], np.float32)
    wall = np.array([[-1e-2, -1, -1e3], [-1e-2, -1, 1e3], [-1e-2, 1e3, 0]], np.float32)
    alone = sv.Scene(sv.Instance(mesh=sv.Mesh(positions=small), material=sv.Material()))
    assert bake(device, alone)[0].tolist() == [1]
    alone.add(sv.Instance(mesh=sv.Mesh(positions=wall), material=sv.Material()))
    floor, _ = bake(device, alone, samples=4096, reach=100.0)
    assert floor[0] == pytest.approx(0.5, abs=0.03)
    assert bake(device, alone, samples=64, reach=1e-3)[0].tolist() == [1]  # the wall is out of reach


def test_a_sphere_is_where_its_equation_says(device):
    width, height = 64, 36
    picture = load("spheres").render(device, np.array([[0, 0, 0, 1]], np.float32), (width, height))
    x, y = np.meshgrid(2 * (np.arange(width) + 0.5) - width, 2 * (np.arange(height) + 0.5) - height)
    cosine = 1 / np.sqrt(1 + 0.36 * (x**2 + y**2) / height**2)
    seen = np.abs(picture - 0.02).max(axis=-1) > 1e-3
    assert np.mean(seen != (cosine > np.sqrt(1 - 1 / 25))) < 0.004  # silhouettes, seen from 5 m
    assert picture[height // 2, width // 2] == pytest.approx((0.5, 0.5, 1.0), abs=0.1), "the normal as a color"


def test_a_turntable_turns(device):
    turntable = load("turntable")
    radiance = turntable.turn(device, turntable.still_life(), views=2, size=(12, 16), frames=4)
    assert radiance.shape == (16, 24, 3)
    left, right = np.hsplit(radiance, 2)
    assert 0.5 < left.mean() / right.mean() < 2
    assert np.abs(left - right).mean() > 0.1 * left.mean()


def test_materials_differ_on_their_ball(device):
    materials = load("materials")
    white, red = sv.Material(base_color=0.9, roughness=1.0), sv.Material(base_color=(0.9, 0, 0), roughness=1.0)
    radiance, of_white, of_red = materials.compare(device, white, red, size=24, samples=16)
    assert radiance.shape == (24, 48, 3)
    assert of_red[0] == pytest.approx(of_white[0], rel=0.2)
    assert of_red[1] < 0.2 * of_white[1]


def test_heights_are_those_of_the_array(device):
    height_field = load("height_field")
    heights = np.random.default_rng(1).uniform(0, 1, (5, 7))
    scene = sv.Scene()
    scene.add(height_field.mesh_of(heights, 0.5))
    z, x = np.mgrid[:4, :6] * 0.5 + 0.25  # the middle of a quad lies on the diagonal that both triangles share
    with sv.RayTracer(device, scene) as tracer:
        found = height_field.heights_at(tracer, x, z)
        assert np.isnan(height_field.heights_at(tracer, -1.0, 0.0))
    np.testing.assert_allclose(found, (heights[:-1, :-1] + heights[1:, 1:]) / 2, atol=1e-4)


def test_objects_cover_the_picture(device):
    scene = sv.builtin("cornell_box")
    with sv.PathTracer(device, scene, (24, 24)) as tracer:
        frame = tracer.render(samples=1)
        found = load("objects").coverage(frame)
        nothing = np.isinf(frame["depth"]).mean()
    assert set(found) == {instance.name for instance in scene}
    assert sum(share for share, _ in found.values()) == pytest.approx(1 - nothing)


def test_seeds_vary_less_than_independent_samples(device):
    seeds = load("seeds")
    found, independent = seeds.pictures(device, sv.builtin("cornell_box"), range(8), size=(16, 16), samples=16)
    measured = (found @ seeds.LUMINANCE).var(axis=0, ddof=1).mean()
    assert 0.05 < measured / independent.mean() < 0.7


def test_worlds_of_mujoco(device):
    """Stepped, each its own way, and lit: what falls is seen to move in all worlds, and nowhere in the same way."""
    mujoco = pytest.importorskip("mujoco")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(FOLDER)
        worlds = load("mujoco_worlds")
        model = mujoco.MjModel.from_xml_path(worlds.MODEL)
        pictures = [found for found, _ in zip(worlds.frames(device, model, 6, (24, 24)), range(20), strict=False)]
    first, last = pictures[0], pictures[-1]
    assert first.shape == (6, 1, 24, 24, 3)
    assert np.isfinite(last).all()
    assert len({picture.tobytes() for picture in last}) == 6
    changed = np.abs(last - first).mean(axis=-1)[:, 0] > 0.2 * first.mean()
    assert changed[:, 4:20].any(axis=(1, 2)).all()


def test_an_environment_of_gymnasium(device):
    """Observations are seen, rewards are of where the ball is, and episodes that end begin anew a step later."""
    mujoco, gym = pytest.importorskip("mujoco"), pytest.importorskip("gymnasium")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(FOLDER)
        worlds = load("gymnasium_worlds")
    envs = worlds.Push(device, mujoco.MjModel.from_xml_path(worlds.MODEL), 4, (24, 24))
    pictures, _ = envs.reset(seed=3)
    assert gym.spaces.Box(0, 255, (4, 24, 24, 3), np.uint8).contains(pictures)
    assert len({picture.tobytes() for picture in pictures}) == 4
    first, earned = pictures, []
    for step in range(worlds.STEPS):
        places = np.array([one.xpos[-1, :2] for one in envs.data])
        pictures, rewards, ended, truncated, _ = envs.step(-places)
        np.testing.assert_allclose(rewards, [-np.hypot(*one.xpos[-1, :2]) for one in envs.data])
        earned.append(rewards.mean())
        assert not ended.any()
        assert truncated.all() == (step == worlds.STEPS - 1)
    assert earned[-1] > 0.5 * earned[0]
    assert (np.abs(pictures.astype(int) - first).max(axis=(1, 2, 3)) > 50).all()
    _, rewards, _, truncated, _ = envs.step(np.zeros((4, 2)))
    assert not rewards.any()
    assert not truncated.any()
    envs.close()
