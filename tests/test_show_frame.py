"""tools/show_frame.py lists the whole frame: stages, passes, what they touch, barriers and resources."""

from __future__ import annotations

import itertools
import re
import runpy
from pathlib import Path

import pytest

import solari_vk as sv
from solari_vk.gpu.frame.frame import Row

TOOL = runpy.run_path(str(Path(__file__).resolve().parents[1] / "tools" / "show_frame.py"))
SIZE = (32, 24)


def passes(renderer: sv.Renderer | sv.PathTracer) -> list[str]:
    """The names of a frame's passes, in order, as its stages declare them."""
    return [step.name for stage in renderer._stages(SIZE) for step in stage.passes]


def listed(lines: list[str]) -> list[str]:
    """The names of the passes in a listing, without the numbers of repeated ones."""
    return [found[1] for line in lines if (found := re.match(r"  pass (\S+)", line))]


def test_passes_are_listed_by_stage_with_barriers_and_resources():
    rows = [Row("a/fill", (), ("x",), "", 0.5), Row("a/add", ("x", "y"), ("x",), "RAW x (a/fill)", None),
            Row("b/show", ("x",), ("z",), "RAW x (a/add)", None)]  # fmt: skip
    lines = TOOL["describe_passes"](rows)
    assert [" ".join(line.split()) for line in lines] == [
        "stage a", "pass a/fill 0.500 ms", "writes x",
        "barrier: RAW x (a/fill)", "pass a/add", "reads x, y", "writes x",
        "stage b", "barrier: RAW x (a/add)", "pass b/show", "reads x", "writes z",
    ]  # fmt: skip
    assert listed(lines) == ["a/fill", "a/add", "b/show"]
    assert listed(TOOL["describe_passes"](rows[1:])) != ["a/fill", "a/add", "b/show"]


@pytest.mark.parametrize("kind", [sv.Renderer, sv.PathTracer])
def test_the_frame_of_a_renderer_is_listed(device, capsys, kind):
    options = ["--reference"] if kind is sv.PathTracer else []
    assert TOOL["main"]([*options, "--size", "32x24", "--frames", "1"]) == 0
    said = capsys.readouterr().out
    lines = said.splitlines()
    with kind(device, sv.builtin("cornell_box"), SIZE) as renderer:
        expected = passes(renderer)
    assert listed(lines) == expected
    stages = [stage for stage, _ in itertools.groupby(name.partition("/")[0] for name in expected)]
    assert [line.removeprefix("stage ") for line in lines if line.startswith("stage ")] == stages
    if kind is sv.Renderer:
        di = said.index("pass restir_di/spatial_and_shade")
        assert "RAW di_temporal_reservoirs (restir_di/initial_and_temporal)" in said[said.index("stage restir_di") : di]
        assert re.search(r"^    writes di_diffuse, .*di_reservoirs", said[di:], re.MULTILINE)
        assert re.search(rf"^  di_diffuse +{12 * 32 * 24:,} bytes  buffer$", said, re.MULTILINE)
        assert re.search(rf"^  depth +{4 * 32 * 24:,} bytes  image 32x24, 1 x float32$", said, re.MULTILINE)
    else:
        assert re.search(rf"^  radiance_mean +{12 * 32 * 24:,} bytes  buffer$", said, re.MULTILINE)


def test_a_wrong_scene_is_one_line(capsys):
    assert TOOL["main"](["builtin:nowhere"]) == 2
    assert capsys.readouterr().err.startswith("show_frame: ")
