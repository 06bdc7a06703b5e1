"""The sources pass the linter and the type checker, tools/show_frame.py lists a renderer's whole frame, and
tools/size.py measures a checkout."""

from __future__ import annotations

import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

import solari_vk as sv
from solari_vk.gpu.frame.frame import Row

ROOT = Path(__file__).resolve().parents[1]
TOOLS = ROOT / "tools"
SHOW_FRAME = runpy.run_path(str(TOOLS / "show_frame.py"))
SIZE = (32, 24)


def listed(lines: list[str]) -> list[str]:
    """The names of the passes in a listing, without the numbers of repeated ones."""
    matches = [re.match(r"  pass (\S+)", line) for line in lines]
    return [match[1] for match in matches if match]


def test_passes_are_listed_by_stage_with_barriers_and_resources():
    rows = [
        Row("a", "a/fill", (), ("x",), "", 0.5),
        Row("a", "a/add", ("x", "y"), ("x",), "RAW x (a/fill)", None),
        Row("b", "b/show", ("x",), ("z",), "RAW x (a/add)", None),
    ]
    lines = SHOW_FRAME["describe_passes"](rows)
    assert [" ".join(line.split()) for line in lines] == [
        "stage a",
        "pass a/fill 0.500 ms",
        "writes x",
        "barrier: RAW x (a/fill)",
        "pass a/add",
        "reads x, y",
        "writes x",
        "stage b",
        "barrier: RAW x (a/add)",
        "pass b/show",
        "reads x",
        "writes z",
    ]
    assert listed(lines) == ["a/fill", "a/add", "b/show"]


@pytest.mark.parametrize("kind", [sv.Renderer, sv.PathTracer])
def test_the_frame_of_a_renderer_is_listed(lent_device, capsys, kind):
    options = ["--reference"] if kind is sv.PathTracer else []
    assert SHOW_FRAME["main"]([*options, "--size", "32x24", "--frames", "1"]) == 0
    said = capsys.readouterr().out
    lines = said.splitlines()
    with kind(lent_device, sv.builtin("cornell_box"), SIZE) as renderer:
        expected = [step.name for stage in renderer.stages for step in stage.passes]
        stages = [stage.name for stage in renderer.stages if stage.passes]
    assert listed(lines) == expected
    assert [line.removeprefix("stage ") for line in lines if line.startswith("stage ")] == stages
    if kind is sv.Renderer:
        compose = said.index("pass display/compose")
        trace = said.index("pass paths/first_ray")
        barrier = ", ".join(f"RAW paths_{lobe} (paths/later_rays #6)" for lobe in ("diffuse", "specular"))
        assert barrier in said[trace:compose]
        assert re.search(r"^    writes .*paths_diffuse, .*paths_specular", said[trace:], re.MULTILINE)
        assert re.search(rf"^  paths_diffuse +{16 * 32 * 24:,} bytes  buffer$", said, re.MULTILINE)
        assert re.search(rf"^  depth +{4 * 32 * 24:,} bytes  image 32x24, 1 x float32$", said, re.MULTILINE)
    else:
        assert re.search(rf"^  radiance_mean +{12 * 32 * 24:,} bytes  buffer$", said, re.MULTILINE)


def test_stages_of_a_file_are_listed(lent_device, tmp_path, capsys):
    file = tmp_path / "stages.py"
    file.write_text("import solari_vk as sv\ndef add_stages(made): made.add_stage(stage, after='reference')\n")
    shader = tmp_path / "passes/own.comp"
    shader.parent.mkdir()
    shader.write_text("#version 460\nlayout(set = 1, r8) uniform image2D own;\nvoid main() {}\n")
    own = "sv.Stage('own', images={'own': (4, 4)}, passes=[sv.Pass('own', threads=1)], glsl_root="
    file.write_text(f"{file.read_text()}stage = {own}{str(tmp_path)!r})\n")
    wanted = ["--reference", "--size", "16x12", "--frames", "1", "--stages"]
    assert SHOW_FRAME["main"]([*wanted, str(file)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[lines.index("stage own") + 1].startswith("  pass own")
    file.write_text("")
    assert SHOW_FRAME["main"]([*wanted, str(file)]) == 2
    assert capsys.readouterr().err.endswith("stages.py has no function add_stages(renderer)\n")


def test_a_wrong_scene_is_one_line(capsys):
    assert SHOW_FRAME["main"](["builtin:nowhere"]) == 2
    assert capsys.readouterr().err.startswith("show_frame: ")


def test_size_measures_another_checkout(tmp_path):
    sources = {
        "solari_vk/__init__.py": "",
        "solari_vk/a.py": "from solari_vk import b, f\n",
        "solari_vk/b.py": "def f():\n    import solari_vk.c\n",
        "solari_vk/c.py": "import solari_vk.a\n",
        "solari_vk/d.py": "import solari_vk.a\nimport solari_vk.e\n",
        "solari_vk/e.py": "import solari_vk.d\n",
        "solari_vk/f.py": "",
        "glsl/x/y.comp": f"{'/' * 121}\n{'/' * 120}\n",
        "tests/test_x.py": "def test_x():\n    pass\n",
    }
    for name, text in sources.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    done = subprocess.run([sys.executable, TOOLS / "size.py", tmp_path], capture_output=True, text=True, check=True)
    lines = [" ".join(line.split()) for line in done.stdout.splitlines()]
    for line in (
        "7 solari_vk",
        "2 glsl/x",
        "11 solari_vk + glsl + tests",
        "GLSL lines over 120 columns: 1",
        "import circles: 2, the longest of 3 modules",
        "solari_vk.a solari_vk.b solari_vk.c",
        "solari_vk.d solari_vk.e",
        "2 solari_vk/b.py",
    ):
        assert line in lines
    assert lines[-1].startswith("tests: 1 test collected")


# ---- the linter, the formatter and the strict type checker, which pyproject.toml configures ----


def run(*command: str) -> None:
    done = subprocess.run([sys.executable, "-m", *command], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_ruff():
    run("ruff", "check", "--no-cache", "solari_vk", "tests", "tools", "hatch_build.py")


def test_mypy():
    run("mypy")


def test_format():
    run("ruff", "format", "--no-cache", "--check", "solari_vk", "tests", "tools", "hatch_build.py")
