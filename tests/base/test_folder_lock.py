"""Two processes never write into one folder of pictures, and a dead one's lock is taken over."""

from __future__ import annotations

import errno
import gc
import os
import subprocess
import sys

import pytest
from support.files import files_limited_to

from solari_vk.base import folder_lock
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


@pytest.mark.parametrize("end", ["kill", "terminate", None])
def test_a_folder_has_one_owner(tmp_path, held, end):
    path = tmp_path / "journal.jsonl"
    with pytest.raises(SolariError, match=rf"process {held.pid} on \S+ writes into it: wait for it"):
        Journal(path, {"scene": 1})
    stop = held.stdin.close if end is None else getattr(held, end)
    stop()
    held.wait()
    journal = Journal(path, {"scene": 1})
    again = Journal(path, {"scene": 1})  # of the same process
    assert {file.name for file in tmp_path.iterdir()} == {"journal.jsonl", "journal.jsonl.lock"}
    del journal, again
    assert {file.name for file in tmp_path.iterdir()} == {"journal.jsonl"}


@pytest.mark.parametrize(
    "planted",
    [
        "a hard link",
        "a file",
        "JSON",
        "a folder",
        *(pytest.param(name, marks=pytest.mark.posix) for name in ("a link", "a pipe", "a link to a lock")),
    ],
)
@pytest.mark.parametrize("name", ["journal.jsonl.lock", "journal.jsonl"])
def test_what_somebody_put_there_stays(tmp_path, name, planted):
    """Neither the lock nor the journal takes anything else for its own, or follows a link."""
    place, victim = tmp_path / "views" / name, tmp_path / "victim"
    place.parent.mkdir()
    content = '{"process": 1, "host": "a"}' if planted == "a link to a lock" else '{"precious": 1}'
    victim.write_text(content)
    make = {
        "a hard link": lambda: place.hardlink_to(victim),
        "a file": lambda: place.write_text("precious"),  # without the end of a line
        "JSON": lambda: place.write_text(content),
        "a pipe": lambda: os.mkfifo(place),
        "a folder": place.mkdir,
    }
    make.get(planted, lambda: place.symlink_to(victim))()
    before = os.lstat(place)
    with pytest.raises(SolariError, match=name):
        Journal(place.parent / "journal.jsonl", {"scene": 1})
    after = os.lstat(place)
    assert (before.st_ino, before.st_size, before.st_mode) == (after.st_ino, after.st_size, after.st_mode)
    assert victim.read_text() == content
    assert os.listdir(place.parent) == [name]


@pytest.mark.posix
def test_the_lock_removes_what_it_made_and_nothing_else(tmp_path):
    path = tmp_path / "journal.jsonl"
    lock = tmp_path / "journal.jsonl.lock"
    journal = Journal(path, {"scene": 1})
    child = os.fork()
    if not child:
        del journal
        gc.collect()
        os._exit(0)
    os.waitpid(child, 0)
    assert lock.exists(), "a forked process isn't the owner"
    lock.rename(tmp_path / "moved")
    lock.write_text("precious")
    del journal
    assert (lock.read_text(), (tmp_path / "moved").exists()) == ("precious", True)


@pytest.mark.posix
def test_errors_of_the_system_are_named_and_leave_no_file_open(tmp_path, monkeypatch):
    def fail(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    count = len(os.listdir("/proc/self/fd"))
    with monkeypatch.context() as patched:
        patched.setattr(folder_lock.fcntl, "flock", fail)
        with pytest.raises(SolariError, match="lock: can't be locked: No locks available"):
            Journal(tmp_path / "journal.jsonl", {"scene": 1})
    assert not os.listdir(tmp_path)
    (tmp_path / "journal.jsonl.lock").write_text("precious")
    with pytest.raises(SolariError, match="isn't a lock of this package"):
        Journal(tmp_path / "journal.jsonl", {"scene": 1})
    assert len(os.listdir("/proc/self/fd")) == count


def test_a_journal_cut_short_goes_on(tmp_path):
    path = tmp_path / "journal.jsonl"
    Journal(path, {"scene": 1})
    whole = path.read_bytes()
    for length in range(len(whole)):
        path.write_bytes(whole[:length])
        Journal(path, {"scene": 1})
        assert path.read_bytes() == whole
    path.write_bytes(whole + b'{"task"')
    Journal(path, {"scene": 1})
    assert path.read_bytes() == whole
