"""Loads mutated files and bombs, and runs command lines; run by test_fuzz.py in a process with limits.

    PYTHONPATH=tests:tests/reliability python tests/reliability/fuzz.py FOLDER COUNT SEED KIND...

Every file must load or raise a SolariError that names the file, within five seconds of processor time (bombs and
commands 20) and four times as long by the clock, print nothing, take no more memory than its budget, and open no file
outside the folder. The last line counts both. After a failure FOLDER/KIND has the smallest mutant that fails; after a
crash, the one that crashed. The seed 0 makes the same mutants as the tests, another one others.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import os
import resource
import signal
import sys
import time
import warnings
from pathlib import Path
from typing import Any

from fuzz_subjects import Subject, open_subject
from hypothesis import HealthCheck, Phase, given, seed, settings, target

import solari_vk as sv
from solari_vk.base.budget import load_budget
from solari_vk.base.errors import SolariError

BUDGET = 256 * 2**20
SPARE = 48 * 2**20  # what the allocator keeps
MEMORY_LIMIT = 3 * 2**30  # of address space, most of which the libraries only reserve


def watch_files(folder: Path) -> list[str]:
    """The files outside a folder that are opened from now on, but for those of Python itself."""
    outside: list[str] = []
    places = folder, sys.prefix, sys.base_prefix, Path(sv.__file__).parent, Path(__file__).parent, "/proc", "/sys"
    allowed = tuple(map(os.path.realpath, places))

    def watch(event: str, arguments: tuple[Any, ...]) -> None:
        if event == "open" and isinstance(arguments[0], (str, bytes, Path)):
            path = os.path.realpath(os.fsdecode(arguments[0]))
            if not path.startswith(allowed):
                outside.append(path)

    sys.addaudithook(watch)
    return outside


def load(subject: Subject, outside: list[str]) -> str:
    """Load what was written: "loaded" or "refused". Raises anything else that is wrong."""
    outside.clear()
    said, refusal = io.StringIO(), ""
    began, used = time.monotonic(), time.process_time()
    before = forget_peak()
    printing = contextlib.redirect_stdout(said), contextlib.redirect_stderr(said)
    signal.alarm(4 * subject.seconds)
    try:
        with printing[0], printing[1], load_budget(BUDGET, subject.seconds / 2):
            subject.load()
    except SolariError as error:
        refusal = str(error)
    finally:
        signal.alarm(0)
    taken = memory("VmHWM") - before
    # Readers take the alarm's TimeoutError, which is an OSError, for a file that can't be read.
    assert time.process_time() - used < subject.seconds, "too slow"
    assert time.monotonic() - began < 4 * subject.seconds, "hung"  # other processes use the processor too
    refusal.encode()
    assert not refusal or refusal.startswith(subject.named), f"the file isn't named: {refusal}"
    assert subject.anywhere or not outside, "opened outside the folder"
    assert not said.getvalue(), "printed"
    assert taken <= BUDGET + SPARE, f"took {taken / 2**20:.0f} MiB"
    assert "this machine's memory" not in refusal, f"took memory that isn't charged: {refusal}"
    if subject.grows:
        target(math.log2(max(taken, 1)), label="memory")
    return "refused" if refusal else "loaded"


def fuzz(kind: str, folder: Path, count: int, number: int, outside: list[str]) -> dict[str, int]:
    """How many mutants were loaded and refused."""
    folder.mkdir()
    subject = open_subject(kind, folder)
    subject.load()
    counts = {"loaded": 0, "refused": 0}

    @settings(
        max_examples=count,
        derandomize=True,
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
        phases=[Phase.generate, Phase.shrink, *[Phase.target] * subject.grows],
    )
    @given(subject.changes)
    def check(changes: Any) -> None:
        subject.write(changes)
        counts[load(subject, outside)] += 1

    if number:
        check = seed(number)(check)
    check()
    return counts


def memory(field: str) -> int:
    """This process's memory in bytes by a field of Linux, 0 elsewhere: VmRSS now, VmHWM at most."""
    status = Path("/proc/self/status")
    lines = status.read_text().splitlines() if status.exists() else []
    return sum(int(line.split()[1]) * 1024 for line in lines if line.startswith(f"{field}:"))


def forget_peak() -> int:
    """Let the most memory be that of now; returns it. Without such a switch the most of all mutants counts."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
    return memory("VmRSS")


def expired(*_: Any) -> None:
    raise TimeoutError("too slow")


def main() -> None:
    folder = Path(sys.argv[1])
    count = int(sys.argv[2])
    number = int(sys.argv[3])
    kinds = sys.argv[4:]
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_LIMIT, MEMORY_LIMIT))
    warnings.simplefilter("ignore", UserWarning)  # of pictures with an unusual shape, and the like
    signal.signal(signal.SIGALRM, expired)
    outside = watch_files(folder)
    counts = {kind: fuzz(kind, folder / kind, count, number, outside) for kind in kinds}
    print(json.dumps({"counts": counts}))


if __name__ == "__main__":
    main()
