"""Loads mutated files; run by test_fuzz.py in a process with limits.

    PYTHONPATH=tests:tests/reliability python tests/reliability/fuzz.py FOLDER COUNT KIND...

Every mutant must load or raise a SolariError that names the file, within five seconds, print nothing, and open no file
outside the folder. The last line counts both. After a failure FOLDER/KIND has the smallest mutant that fails; after a
crash, the one that crashed.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import random
import resource
import signal
import sys
import time
import warnings
from pathlib import Path
from typing import Any

from fuzz_subjects import Subject, open_subject
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

import solari_vk as sv
from solari_vk.errors import SolariError

MEMORY_LIMIT = 3 * 2**30  # of address space, most of which the libraries only reserve
SECONDS = 5


def watch_files(folder: Path) -> list[str]:
    """The files outside a folder that are opened from now on, but for those of Python itself."""
    outside: list[str] = []
    places = folder, sys.prefix, sys.base_prefix, Path(sv.__file__).parent, Path(__file__).parent, "/proc", "/sys"
    allowed = tuple(map(str, places))

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
    said, began, refusal = io.StringIO(), time.monotonic(), ""
    signal.alarm(SECONDS)
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            subject.load()
    except SolariError as error:
        refusal = str(error)
    finally:
        signal.alarm(0)
    assert not refusal or refusal.encode().startswith(subject.named.encode()), f"the file isn't named: {refusal}"
    assert not outside, "opened outside the folder"
    assert not said.getvalue(), "printed"
    # Readers take the alarm's TimeoutError, which is an OSError, for a file that can't be read.
    assert time.monotonic() - began < SECONDS, "too slow"
    return "refused" if refusal else "loaded"


def fuzz(kind: str, folder: Path, count: int, outside: list[str]) -> dict[str, int]:
    """How many mutants were loaded and refused."""
    folder.mkdir()
    subject = open_subject(kind, folder)
    subject.load()
    counts = {"loaded": 0, "refused": 0}

    @settings(
        max_examples=count, derandomize=True, database=None, deadline=None, suppress_health_check=list(HealthCheck),
        phases=[Phase.generate, Phase.shrink],
    )  # fmt: skip
    @given(st.randoms(use_true_random=False))
    def check(generator: random.Random) -> None:
        subject.write(generator)
        counts[load(subject, outside)] += 1

    check()
    return counts


def peak_mib() -> int:
    """This process's peak memory; on Linux getrusage includes the parent's before exec."""
    status = Path("/proc/self/status")
    if status.exists():
        [line] = [line for line in status.read_text().splitlines() if line.startswith("VmHWM")]
        return int(line.split()[1]) // 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024


def expired(*_: Any) -> None:
    raise TimeoutError(f"longer than {SECONDS} s")


def main() -> None:
    folder, count, kinds = Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3:]
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_LIMIT, MEMORY_LIMIT))
    warnings.simplefilter("ignore", UserWarning)  # of pictures with an unusual shape, and the like
    signal.signal(signal.SIGALRM, expired)
    outside = watch_files(folder)
    counts = {kind: fuzz(kind, folder / kind, count, outside) for kind in kinds}
    print(json.dumps({"counts": counts, "peak_mib": peak_mib()}))


if __name__ == "__main__":
    main()
