"""The program of docs/guides/clusters.md, and the measurement that the page quotes, run."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from solari_vk.cli import main
from solari_vk.lab.measure import cluster
from solari_vk.renderers.cluster.device_session import DeviceOptions

ROOT = Path(__file__).resolve().parents[3]
PROGRAMS = re.findall(r"^```python\n(.*?)^```$", (ROOT / "docs/guides/clusters.md").read_text(), re.M | re.S)
SPAWN = """
if __name__ == "__main__":
    import multiprocessing
    here = Views()
    here[0]
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        for index, picture in enumerate(pool.map(Views().__getitem__, range(3))):
            assert (picture == here[index]).all()
"""


@pytest.fixture
def run_program(any_device, tmp_path):
    def run(text):
        (tmp_path / "program.py").write_text(text)
        environment = os.environ | {"PYTHONPATH": str(ROOT)}
        command = [sys.executable, "program.py"]
        return subprocess.run(command, cwd=tmp_path, env=environment, check=False, capture_output=True, text=True)

    return run


@pytest.mark.slow
def test_the_program_runs(run_program, tmp_path):
    program, _ = PROGRAMS
    small = program.replace("(160, 90)", "(16, 9)").replace("samples=64", "samples=2")
    done = run_program(small + "    assert picture.samples == 2\n")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "reference.exr").stat().st_size > 0
    names = {path.name for path in (tmp_path / "views").iterdir()}
    assert names == {"0.exr", "1.exr", "2.exr", "journal.jsonl"}


def test_views_are_the_same_in_processes_of_ones_own(run_program):
    done = run_program("import solari_vk as sv\n" + PROGRAMS[1] + SPAWN)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_a_program_without_a_guard_is_told(run_program):
    """Its workers would start workers."""
    done = run_program("import solari_vk as sv\nwith sv.cluster.WorkerPool(workers=1):\n    pass\n")
    assert done.returncode == 1
    last = done.stderr.splitlines()[-1]
    assert "SolariError: no worker can start" in last
    assert "__main__" in last


def test_the_measurement_takes_the_options_of_the_device(any_device, monkeypatch, capsys):
    seen = []

    def measure(opening, *given):
        seen.append(opening)
        return np.ones((1, 2)), np.ones((1, 2))

    monkeypatch.setattr(cluster, "_measure", measure)
    assert main(["bench", "cluster", "--workers", "2", "--device", "0", "--rays", "pipeline"]) == 0
    assert seen == [DeviceOptions("0", "pipeline")]


@pytest.mark.slow
def test_the_measurement_runs(any_device, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(cluster, "SIMULATED_WORKERS", (2,))
    monkeypatch.setattr(cluster, "ROUNDS", 2)
    page = tmp_path / "page.md"
    command = ["bench", "cluster", "--workers", "2", "--views", "4", "--size", "8x8", "--samples", "1", "--simulate"]
    assert main([*command, "--markdown", str(page)]) == 0, capsys.readouterr().err
    rows = [line.split("|")[1:-1] for line in page.read_text().splitlines() if line.startswith("| 2 |")]
    assert [len(row) for row in rows] == [6, 2, 4]
    assert all(float(cell) > 0 for row in rows for cell in row)
