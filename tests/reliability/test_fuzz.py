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
