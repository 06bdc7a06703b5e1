"""Frames have the barriers that they need, docstrings of stages name their inputs and outputs, and the page of buffers
is that of this code."""

from __future__ import annotations

import re
import runpy
from contextlib import closing
from fnmatch import fnmatch
from pathlib import Path

import pytest

from solari_vk.base.errors import ValidationError
from solari_vk.gpu.shaders.compiler import compile_shader
from solari_vk.gpu.shaders.spirv import reflect

ROOT = Path(__file__).resolve().parents[2]
BUFFERS = runpy.run_path(str(ROOT / "tools/buffers.py"))


@pytest.fixture(scope="module")
def frames(bound_device):
    return list(BUFFERS["frames"](bound_device))


@pytest.fixture(scope="module")
def accessed(frames):
    """{source of a stage: (inputs, outputs)} in all frames."""
    found = {}
    for stages, rows in frames:
        for source, *names in BUFFERS["inputs_and_outputs"](stages, rows):
            for known, new in zip(found.setdefault(source, (set(), set())), names, strict=True):
                known |= new
    return found


def differences(docstring, accessed):
    """What a docstring of a stage leaves out or names in vain."""
    for what, names in zip(("Inputs", "Outputs"), accessed, strict=True):
        text = re.search(rf"{what}: (.*?)(?:Outputs:|\Z)", docstring, re.DOTALL)
        patterns = re.findall(r"`(\S+)`", text[1]) if text else []
        yield from (f"{what} lack {name}" for name in sorted(names) if not any(fnmatch(name, p) for p in patterns))
        yield from (f"{what} name {p} in vain" for p in patterns if not any(fnmatch(name, p) for name in names))


def check_barriers(device, frame, barriers):
    """Synchronization validation sees what recorded commands access, without compiling and running them."""
    for slot in frame._slots:
        slot.record(barriers)
    device.check_messages()


def test_frames_have_the_barriers_that_they_need(frames, bound_device):
    for _, frame in BUFFERS["made_frames"](bound_device):
        check_barriers(bound_device, frame, frame._barriers)


# Passes whose missing barrier synchronization validation reports. It doesn't see what atomic operations write, as
# passes that list pixels do.
MISSED = ("denoise/reflection_motion", "taa/confidence")


@pytest.mark.provokes_validation
def test_missing_barriers_are_noticed(frames, bound_device):
    with closing(BUFFERS["made_frames"](bound_device)) as made:
        _, frame = next(made)
        numbers = [
            number
            for number, barrier in enumerate(frame._barriers)
            if barrier is not None and frame._accesses[number].name in MISSED
        ]
        assert len(numbers) == len(MISSED)
        for number in numbers:
            without = [*frame._barriers[:number], None, *frame._barriers[number + 1 :]]
            with pytest.raises(ValidationError, match="SYNC-HAZARD"):
                check_barriers(bound_device, frame, without)


def test_the_common_layout_has_what_frames_bind(frames):
    """All but an attachment, and what frames of many views alone bind."""
    used = {name for _, rows in frames for row in rows for name in (*row.reads, *row.writes)}
    many = {"views", "world_structures", "world_changes", "world_cache_worlds"}
    common = reflect(compile_shader("passes/layout.comp")).bindings
    assert used - common.keys() == {"raster_depth", *many}


def test_docstrings_of_stages_name_inputs_and_outputs(accessed):
    assert len(accessed) == 21
    wrong = {
        f"{source.file}: {source.docstring[:40]}": list(differences(source.docstring, names))
        for source, names in accessed.items()
    }
    assert not {stage: found for stage, found in wrong.items() if found}


def test_a_missing_and_a_superfluous_name_are_noticed():
    found = list(differences("Inputs: `a*`, `c`. Outputs: `d`.", ({"a1", "b"}, {"d"})))
    assert found == ["Inputs lack b", "Inputs name c in vain"]


def test_the_page_of_buffers_is_current(frames):
    page = (ROOT / "docs/explained/buffers.md").read_text(encoding="utf-8")
    assert page == BUFFERS["page"](frames), "run python tools/buffers.py > docs/explained/buffers.md"
