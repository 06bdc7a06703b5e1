"""`solari-vk render` with a file's animations: movies of a clip, pictures of a moment, and wrong options."""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image

import solari_vk as sv
from solari_vk.cli import main
from solari_vk.cli.commands import COMMANDS
from solari_vk.cli.loading import load_scene
from solari_vk.cli.options import parse
from solari_vk.cli.render import make_job
from solari_vk.data.cli.dataset import _cameras
from solari_vk.data.cli.jobs import DatasetJob

SMALL = ["--size", "24x16", "--environment", "none"]


@pytest.fixture
def render(lent_device, tmp_path, capsys):
    def run(source, *arguments):
        code = main(["render", str(source), *SMALL, *map(str, arguments), "-o", str(tmp_path / "picture.png")])
        return code, capsys.readouterr().err

    return run


def seen(path):
    """Where a picture of a debug view isn't black, (h, w)."""
    return np.asarray(Image.open(path)).any(axis=2)


def test_a_movie_of_a_clip(render, moving, tmp_path):
    code, said = render(moving, "--animate", "file", "--clip", "slide", "--fps", 4, "--view", "depth", "--warm-up", 1)
    assert code == 0, said
    assert "picture 4 of 4" in said
    places = [np.argwhere(seen(path))[:, 1].mean() for path in sorted(tmp_path.glob("picture.*.png"))]
    assert len(places) == 4
    assert (np.diff(places) > 2).all(), "the triangle goes to the right"


@pytest.mark.parametrize("orbit", ["render --animate orbit", "render --animate orbit:90", "dataset --views 8"])
def test_an_orbit_shows_all_of_a_file(tmp_path, orbit):
    """An object that doesn't stand in its own origin; its middle doesn't wander from side to side."""
    scene = sv.Scene(sv.Instance(sv.shapes.box((1, 0, -1), (7, 1, 1))))
    scene.save(tmp_path / "long.glb")
    words = [*orbit.split(), str(tmp_path / "long.glb"), "--size", "200x150", "-o", "turn.gif"]
    options = parse(COMMANDS, words)[1]
    job = options if isinstance(options, DatasetJob) else make_job(options)
    subject = load_scene(job, seen_all_round=isinstance(job, DatasetJob))
    cameras = _cameras(subject, job)[0] if isinstance(job, DatasetJob) else subject.cameras
    seen = np.array([camera.project(scene.bounds.corners, (200, 150)) for camera in cameras])
    count = 8 if isinstance(job, DatasetJob) else 48
    assert (len(cameras), (seen > 0).all(), (seen < (200, 150)).all()) == (count, True, True)
    assert (seen[..., 0].min() < 12) or (seen[..., 1].min() < 9)
    middle = np.array([camera.project(scene.bounds.center, (200, 150)) for camera in cameras]).reshape(-1, 2)
    np.testing.assert_allclose(middle[:, 0], 99.5, atol=0.02)  # pixels are counted at their centers


def test_pictures_of_a_moment(render, moving, tmp_path):
    sizes = []
    for seconds in (0.2, 1.0):
        code, said = render(moving, "--clip", 1, "--time", seconds, "--view", "depth", "--frames", 1, "--warm-up", 0)
        assert code == 0, said
        sizes.append(seen(tmp_path / "picture.png").sum())
    assert sizes[1] > 4 * sizes[0] > 0
    orbit = "--samples", 1, "--animate", "orbit", "--frames", 1
    code, said = render(moving, "--clip", 1, "--time", 1.0, *orbit)
    assert code == 0, said


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--animate", "file", "--clip", "jump"], ["jump", "slide"]),
        (["--animate", "file", "--clip", "7"], ["7"]),
        (["--clip", "9" * 5000, "--time", "1"], ["grow", "slide"]),
        (["--scene", "9" * 5000], ["scene"]),
        (["--animate", "slide"], ["--animate slide: is a clip", "--animate file --clip 'slide'"]),
        (["--clip", "slide"], ["--clip slide", "--time"]),
        (["--time", "nan"], ["finite"]),
        (["--animate", "file", "--time", "1"], ["--time 1", "--animate file"]),
    ],
)
def test_wrong_options(render, moving, arguments, words):
    code, said = render(moving, *arguments)
    assert code == 2
    assert all(word in said for word in words), said


def test_a_scene_without_animations(render):
    for arguments, word in ((["--animate", "file"], "--animate file"), (["--time", "1"], "--time")):
        code, said = render("builtin:cornell_box", *arguments)
        assert code == 2
        assert f"{word}: builtin:cornell_box has no animations" in said


def test_how_long_an_animation_lasts(moving, tmp_path):
    """Pictures a second cut time finer, and don't change how long a turn, a clip or a path takes."""
    path = tmp_path / "path.json"
    path.write_text('[{"position": [0, 1, 5], "target": [0, 1, 0]}, {"position": [3, 1, 5], "target": [0, 1, 0]}]')
    kinds = {"orbit": [], "orbit:40": [], str(path): [], "file": ["--clip", "slide"]}

    def count(animate, *more):
        words = ["render", str(moving), *SMALL, "-o", "a.gif", "--animate", animate, *kinds[animate], *map(str, more)]
        return len(load_scene(make_job(parse(COMMANDS, words)[1])).cameras)

    for fps in (12, 30):
        # The second of the path has a picture at both ends.
        assert [count(kind, "--fps", fps) for kind in kinds] == [2 * fps, 2 * fps, fps + 1, fps]
        assert [count(kind, "--fps", fps, "--duration", 3) for kind in kinds] == [3 * fps] * 4
    assert count("orbit", "--fps", 30, "--frames", 7) == 7


def test_poses_of_a_path_keep_their_exposures(tmp_path):
    sv.Scene(sv.Instance(sv.shapes.box()), sv.DirectionalLight((0, -1, 0))).save(tmp_path / "lit.glb")
    path = tmp_path / "path.json"
    words = ["render", str(tmp_path / "lit.glb"), "-o", str(tmp_path / "a.gif"), "--animate", str(path)]
    for own, options, expected in (({}, [], None), ({"ev100": 5}, [], 5), ({"ev100": 5}, ["--exposure", "2"], 2)):
        poses = [{"position": [x, 1, 5], "target": [0, 1, 0], **own} for x in (0, 3)]
        path.write_text(json.dumps(poses))
        loaded = load_scene(make_job(parse(COMMANDS, [*words, *options])[1]))
        assert loaded.auto_exposure == (expected is None)
        assert expected is None or {camera.ev100 for camera in loaded.cameras} == {expected}
