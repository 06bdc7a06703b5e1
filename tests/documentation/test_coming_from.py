"""The page for those who come from other programs: each call of ours in its tables is there, and runs in its order."""

from __future__ import annotations

import inspect
import re
import tomllib

import pytest
from test_pages import DOCS, SMALLER, blocks, folder, text_of  # noqa: F401  # `folder` is a fixture

import solari_vk as sv
from solari_vk.base.errors import OTHER_WORDS, other_words
from solari_vk.cli import _parser

PAGE = DOCS / "guides/coming_from.md"
ON_A_DEVICE = {"tracer": sv.PathTracer, "renderer": sv.Renderer, "frame": sv.RenderedFrame}


def calls():
    """The code in the last cells of the tables of calls."""
    for rows in tomllib.loads(text_of(OTHER_WORDS))["programs"].values():
        for _, here in rows:
            yield from re.findall(r"`([^`]+)`", here)


def run(code, names):
    for shown, smaller in (*SMALLER.items(), (r"\(320, 180\)", "(16, 9)")):
        code = re.sub(shown, smaller, code)
    if code.startswith("solari-vk "):
        _parser().parse_args(code.split()[1:])
    elif code == "solid=False":
        sv.Material(transmission=1, solid=False)
    elif code.startswith("scene.animate("):
        sv.load("character.glb").animate(*eval(code.removeprefix("scene.animate").replace(")", ",)"), names))
    else:
        exec(compile(code, PAGE.name, "exec"), names)


def names_of_the_page():
    return {"mesh": pytest.importorskip("trimesh").creation.box(), "seconds": 0.5, "clip": 0}


def test_calls_are_there(folder):  # noqa: F811
    """Those that need no device run; the others name methods and results that are there."""
    assert len(list(calls())) > 70
    names = names_of_the_page()
    (program,) = blocks(PAGE, "python")
    run("\n".join(line for line in program.splitlines() if "evice" not in line), names)
    for code in calls():
        if not re.search(r"\b(device|tracer|renderer|frame)\b", code):
            run(code, names)
        for name, method in re.findall(r"\b(tracer|renderer|frame)\.(\w+)", code):
            assert hasattr(ON_A_DEVICE[name], method), code
        for name in re.findall(r"(?:tracer|frame)\[\"(\w+)\"\]", code):
            assert name in sv.PathTracer.OUTPUTS, code
        for call in re.findall(r"sv\.(?:PathTracer|Renderer|RayTracer)", code):
            assert eval(call, {"sv": sv})


@pytest.mark.slow
def test_calls_run(lent_device, folder):  # noqa: F811
    names = names_of_the_page()
    for code in (*blocks(PAGE, "python"), *calls()):
        run(code, names)
    names["device"].close()


def test_words_of_other_programs_are_none_of_ours():
    """Advice such as "none is written" would hide an option that has come since."""
    for asked, words in other_words().items():
        first, _, rest = asked.partition(".")
        if not hasattr(sv, first):
            continue
        called = getattr(getattr(sv, first), rest) if rest else getattr(sv, first)
        parameters = set(inspect.signature(called).parameters) if callable(called) else set()
        assert not parameters & words.keys(), f"{asked} takes these"
