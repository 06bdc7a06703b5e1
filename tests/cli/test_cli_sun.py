"""`solari-vk render --sun`: studies of the sun at a place."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

import solari_vk as sv
from solari_vk.cli import main
from solari_vk.cli.commands import COMMANDS
from solari_vk.cli.loading import load_scene
from solari_vk.cli.options import parse
from solari_vk.cli.render import make_job

BERLIN = ["--place", "52.5,13.4"]
DAY = "2026-06-21T04:50+02:00/2026-06-21T13:00+02:00"
TRACED = ["--mode", "reference", "--samples", "8"]


@pytest.fixture(scope="module")
def box(tmp_path_factory):
    path = tmp_path_factory.mktemp("sun") / "box.glb"
    sv.Scene(sv.Instance(sv.shapes.box())).save(path)
    return str(path)


def loaded(box, *words):
    return load_scene(make_job(parse(COMMANDS, ["render", box, "-o", "a.png", "--mode", "realtime", *words])[1]))


def test_a_still_picture_has_the_sun_of_its_time(box):
    found = loaded(box, *BERLIN, "--sun", "2026-06-21T15:00+02:00")
    expected = sv.Sky(place=(52.5, 13.4), time="2026-06-21 15:00+02:00").sun_direction
    np.testing.assert_array_equal(found.scene.environment.sun_direction, expected)
    assert found.auto_exposure
    job = parse(COMMANDS, ["view", box, "--place", "-33.9,151.2", "--sun", "2026-06-21T15:00+10:00"])[1]
    assert parse(COMMANDS, ["view", box, *job.words()])[1] == job


def test_a_place_has_two_numbers(capsys):
    with pytest.raises(SystemExit):
        parse(COMMANDS, ["render", "a.glb", "-o", "a.png", "--place", "52.5"])
    assert "'52.5' is not LAT,LON" in capsys.readouterr().err


def test_an_animation_moves_the_sun(box, tmp_path, lent_device):
    words = [*BERLIN, "--sun", DAY, "--animate", "sun", "--frames", "3"]
    found = loaded(box, *words)
    heights = []
    for picture in range(3):
        found.pose(picture, 24)
        heights.append(found.scene.environment.sun_direction[1])
    assert heights[0] < 0.02 < 0.3 < heights[1] < heights[2]
    means = {}
    for exposure, options in {"auto": ["--exposure", "auto"], "each": []}.items():
        output = tmp_path / f"{exposure}.png"
        few = ["--size", "24x16", "--warm-up", "1", "--average", "1", "--mode", "realtime", "--frames", "2"]
        assert main(["render", box, *words, *few, *options, "-o", str(output)]) == 0
        means[exposure] = [np.asarray(Image.open(tmp_path / f"{exposure}.000{n}.png")).mean() for n in (0, 1)]
    # The exposure of the dawn makes noon white; with its own each picture is seen.
    assert means["auto"][1] > 240
    assert means["each"][1] < 220


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["--sun", "2026-06-21T15:00+02:00"], "--sun and --place go together"),
        ([*BERLIN, "--sun", "2026-06-21T15:00"], "has no zone"),
        (["--exposure", "each"], "--exposure each: is of the pictures of an animation"),
        ([*BERLIN, "--sun", DAY], "a still picture has one time"),
        ([*BERLIN, "--animate", "sun"], "--sun and --place go together"),
        ([*BERLIN, "--sun", DAY, "--animate", "sun", "--environment", "studio"], "leave one of the two out"),
        ([*BERLIN, "--sun", DAY, "--animate", "sun", "--shutter", "0.1"], "--animate sun: has no motion blur"),
        ([*BERLIN, "--sun", DAY, "--animate", "sun", *TRACED], "leave out --samples, of the path tracer"),
    ],
)
def test_refused(box, words, why):
    with pytest.raises(sv.SolariError, match=why):
        loaded(box, *words)
