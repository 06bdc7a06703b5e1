"""What a new user writes from imagination: scripts that run, and errors of the others, which lead to the answer.

The scripts are as they were written, but for lines of which an error message said what to write in their place.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from support.assets import asset

import solari_vk as sv
from solari_vk.gpu.device.device import Device

SCRIPTS = sorted((Path(__file__).parent / "scripts").glob("*.py"))
SMALLER = {r"\((320, ?180|320, ?240|64, ?64)\)": "(32, 24)", r"range\((8|12|10|20|30|32)\)": "range(2)",
           r"samples=\d+": "samples=2"}  # fmt: skip


@pytest.mark.slow
@pytest.mark.filterwarnings("error:the picture is black", "error:.*has no light")
@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)
def test_a_script_runs(any_device, tmp_path, monkeypatch, path):
    program = path.read_text(encoding="utf-8")
    for name in re.findall(r"^(?:import|from) (trimesh|imageio_ffmpeg)", program, re.MULTILINE):
        pytest.importorskip(name)
    if ".mp4" in program:
        pytest.importorskip("imageio_ffmpeg")
    for name in re.findall(r"\.\./shared/assets/(\w+)", program):
        folder = asset(name)
        (tmp_path / "shared" / "assets").mkdir(parents=True, exist_ok=True)
        (tmp_path / "shared" / "assets" / name).symlink_to(folder)
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    for shown, run in SMALLER.items():
        program = re.sub(shown, run, program)
    names = {"__name__": "__main__"}
    try:
        exec(compile(program, path.name, "exec"), names)
    finally:
        for value in names.values():
            if isinstance(value, Device):
                value.close()


@pytest.mark.parametrize(("line", "message"), [
    ("sv.EnvironmentMap", "did you mean 'Environment'"),
    ("sv.Studio", "did you mean 'studio_lights'"),
    ("sv.rt.trace", r"solari_vk.RayTracer\(device, scene\) traces arrays of rays"),
    ("sv.Scene().add_light(0)", "did you mean 'add'"),
    ("sv.Scene().animate('Run', time=0.3)", r"Scene.animate has no option 'time'; there are seconds, clip, loop"),
    ("sv.Camera.look_at((0, 1, 0), (0, 0, 1), fov=60)", "no field 'fov'; did you mean 'vertical_fov'"),
    ("sv.Camera.look_at((0, 1, 0), (0, 0, 1), vertical_fov=60)", "between 0.0001 and 3.14149 radians, not 60"),
    ("sv.Camera.look_at((0, 1, 0), (0, 0, 1), orthographic=2)", "did you mean 'orthographic_height'"),
    ("sv.Material(base_color=np.zeros((4, 4, 3)))", "an image belongs in a field for textures, such as base_color_tex"),
])  # fmt: skip
def test_errors_lead_to_the_answer(line, message):
    import numpy as np

    with pytest.raises((sv.SolariError, AttributeError), match=message):
        eval(line, {"sv": sv, "np": np})
