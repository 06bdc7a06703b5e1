"""What is being compiled: a device tells it by name, and commands show what takes long."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time

import pytest

import solari_vk as sv
from solari_vk.gpu.device.compile_notes import CompileNotes
from solari_vk.gpu.device.compiling import Compiling, announced

PASSES = {f"reference/{name}" for name in ("start", "next_wave", "trace_wave", "shade_wave", "accumulate")}


def test_a_device_names_what_it_compiles(any_device):
    """Every shader, pipeline and, on a software device, machine code, once and in order; nothing in later frames."""
    seen: list[Compiling] = []
    scene = sv.builtin("cornell_box")
    for material in scene.materials:
        material.double_sided = True  # no look for hidden backs, which has shaders of its own
    # A device of its own has no pipelines of other tests.
    with (
        sv.Device(validation=True, on_compile=seen.append) as device,
        sv.PathTracer(device, scene, (16, 16), max_bounces=2) as tracer,
    ):
        tracer.render(samples=1)
        pipelines = len(PASSES) + 1  # next_wave has two
        counts = {"shaders": len(PASSES), "pipelines": pipelines}
        if device.properties.kind == "cpu":
            counts["machine code"] = pipelines
        expected = [(kind, number, count) for kind, count in counts.items() for number in range(count + 1)]
        latest = seen[-len(expected) :]
        assert [(s.what, s.done, s.total) for s in latest] == expected
        for kind in counts:
            names = [re.sub(r"passes/|\.comp| #\d", "", state.name) for state in latest if state.what == kind]
            assert names.pop() == ""  # at the end
            assert set(names) == PASSES  # those that take longest come last
        assert str(seen[-2]).startswith("compiling ")
        seen.clear()
        tracer.render(samples=2)
        assert seen == []


@pytest.mark.slow
def test_a_device_names_ray_pipelines(any_device):
    seen: list[Compiling] = []
    with (
        sv.Device(validation=True, rays="pipeline", on_compile=seen.append) as device,
        sv.PathTracer(device, sv.builtin("cornell_box"), (16, 16), max_bounces=2) as tracer,
    ):
        tracer.render(samples=1)
        software = device.properties.kind == "cpu"
    assert (("machine code", "reference/trace_wave") in [(state.what, state.name) for state in seen]) == software


def test_an_error_ends_the_list():
    """At once, though the error's traceback keeps the comprehension, and with it the iterator over the items."""
    seen: list[Compiling] = []

    def fail() -> None:
        with announced(seen.append, "shaders", ["a", "b"], [1, 0]) as items:
            [1 // item for item in items]

    with pytest.raises(ZeroDivisionError):
        fail()
    assert [(state.done, state.name) for state in seen] == [(0, "a"), (1, "b"), (2, "")]
    assert str(seen[1]) == "compiling shaders 2 of 2: b"


@pytest.mark.parametrize("patience", [60.0, 0.05])
def test_only_what_takes_long_is_shown_until_it_is_done(patience):
    shown: list[str] = []
    notes = CompileNotes(patience)
    notes.show_by(shown.append)
    notes(Compiling("pipelines", 0, 3, "a"))
    while patience < 1 and not shown:
        time.sleep(0.01)
    for state in (
        ("pipelines", 1, 3, "b"),
        ("pipelines", 3, 3, ""),
        ("machine code", 0, 1, "c"),
        ("machine code", 1, 1, ""),
    ):
        notes(Compiling(*state))
    assert shown == (["compiling pipelines 1 of 3: a", "compiling pipelines 2 of 3: b", ""] if patience < 1 else [])


def test_a_device_says_what_takes_long_on_stderr(any_device, capsys, monkeypatch):
    """Unless it is asked not to."""
    with sv.Device() as device:
        device.on_compile.patience = 0
        device.on_compile(Compiling("pipelines", 0, 2, "a"))
        time.sleep(0.2)
        device.on_compile(Compiling("pipelines", 2, 2, ""))
    assert capsys.readouterr().err == "compiling pipelines 1 of 2: a\n"
    with sv.Device(on_compile=None) as device:
        assert device.on_compile is None
    with pytest.raises(sv.SolariError, match="on_compile is a function, None or 'stderr', not 'stdout'"):
        sv.Device(on_compile="stdout")
    monkeypatch.setattr("sys.stderr", None)  # as a daemon has it
    CompileNotes()


def test_a_command_says_what_takes_long(any_device, tmp_path):
    """In a process without caches, in which the driver has a second of work; nothing counts as quick."""
    environment = os.environ | {"MESA_SHADER_CACHE_DISABLE": "true", "GALLIVM_PERF": "nopt"}
    program = (
        "import sys; from solari_vk.cli import main; from solari_vk.gpu.device import compile_notes as notes; "
        "notes.PATIENCE = notes.PAUSE = 0; "
        "sys.exit(main(sys.argv[1:]))"
    )
    command = [
        sys.executable,
        "-c",
        program,
        "render",
        "builtin:cornell_box",
        "-o",
        str(tmp_path / "box.png"),
        "--mode",
        "reference",
        "--samples",
        "1",
        "--size",
        "32x32",
    ]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert re.search(r"compiling (pipelines|machine code) \d of \d: reference/trace_wave", done.stderr)
    assert re.search(r"wrote .*, in [\d.]+ s after compiling for [\d.]+ s, EV100", done.stderr)
