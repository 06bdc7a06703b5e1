"""Two processes never write into one folder of pictures, and a dead one's lock is taken over."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest
from support.files import files_limited_to

from solari_vk.base.errors import SolariError
from solari_vk.data.datasets.journal import Journal

HOLD = """
import sys
from pathlib import Path
from solari_vk.data.datasets.journal import Journal
journal = Journal(Path(sys.argv[1]), {"scene": 1})
print("held", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def held(tmp_path):
    """A process that has the journal open."""
    command = [sys.executable, "-c", HOLD, str(tmp_path / "journal.jsonl")]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "held\n"
        yield process
        process.kill()


def test_a_full_disk_is_one_error_and_leaves_no_lock(tmp_path):
    lock = tmp_path / "journal.jsonl.lock"
    with files_limited_to(0), pytest.raises(SolariError, match=rf"{lock}: can't be written: .*: make room there"):
        Journal(tmp_path / "journal.jsonl", {"scene": 1})
    assert not lock.exists()
    Journal(tmp_path / "journal.jsonl", {"scene": 1})


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGTERM, None])
def test_a_folder_has_one_owner(tmp_path, held, end):
    path = tmp_path / "journal.jsonl"
    with pytest.raises(SolariError, match=rf"process {held.pid} on \S+ writes into it: wait for it"):
        Journal(path, {"scene": 1})
    held.stdin.close() if end is None else held.send_signal(end)
    held.wait()
    journal = Journal(path, {"scene": 1})
    again = Journal(path, {"scene": 1})  # of the same process
    assert {file.name for file in tmp_path.iterdir()} == {"journal.jsonl", "journal.jsonl.lock"}
    del journal, again
    assert {file.name for file in tmp_path.iterdir()} == {"journal.jsonl"}
