"""Thousands of mutated files, bombs and command lines: each works or is refused with a SolariError, quickly and within
its budget of memory."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from fuzz_bombs import BOMBS
from fuzz_seeds import GLTF, IMAGES, MESHES, OTHERS, RADIANCE

GROUPS = {
    "scenes": GLTF,
    "images": IMAGES,
    "meshes": MESHES,
    "environments": RADIANCE,
    "others": OTHERS,
    "bombs": BOMBS,
    "command lines": ("commands",),
}


@pytest.mark.parametrize(
    ("group", "count"),
    [
        *((group, 60) for group in GROUPS if group != "bombs"),
        *(pytest.param(group, 1000, marks=pytest.mark.slow) for group in GROUPS),
    ],
)
def test_mutated_files(tmp_path, group, count):
    """count: of mutants of each kind of file; bombs take longer."""
    count = count // 6 if group == "bombs" else count
    command = [sys.executable, "-W", "error::RuntimeWarning", str(Path(__file__).with_name("fuzz.py"))]
    # Threads of the linear algebra library would only reserve memory.
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(sys.path)}
    run = subprocess.run(
        [*command, str(tmp_path), str(count), "0", *GROUPS[group]],
        capture_output=True,
        text=True,
        timeout=300 + 10 * count,
        env=environment,
        cwd=tmp_path,
        check=False,
    )
    assert run.returncode == 0, run.stdout[-5000:] + run.stderr[-5000:]
    found = json.loads(run.stdout.splitlines()[-1])
    for kind, counts in found["counts"].items():
        least = 0 if kind in BOMBS else count // (100 if kind == "commands" else 25)
        assert min(counts.values()) > least, f"{kind}: both outcomes must be common, or this proves little"


# ---- mutated glTF files that load are rendered under validation by both renderers: finite pictures, no hang ----


RENDERED_COUNT = 250  # mutants of each kind that load


@pytest.mark.slow
def test_mutants_are_rendered(device, tmp_path):
    """A thousand, among them all kinds of glTF files."""
    program = Path(__file__).with_name("render_mutants.py")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    if "(LLVM 15" in device.name:
        environment["GALLIVM_PERF"] = "nopt"  # it would optimize shaders with many features for minutes
    done = subprocess.run(
        [sys.executable, program, tmp_path, str(RENDERED_COUNT), "0", *GLTF],
        capture_output=True,
        text=True,
        timeout=7200,
        env=environment,
        cwd=tmp_path,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-5000:] + done.stderr[-5000:]
    counts = json.loads(done.stdout.splitlines()[-1])
    assert set(counts) == set(GLTF)
    for kind, found in counts.items():
        assert found["rendered"] > RENDERED_COUNT // 2, f"{kind}: most mutants that load must be rendered: {found}"
