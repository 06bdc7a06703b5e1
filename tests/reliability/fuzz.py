"""Loads mutated files and prints what went wrong; run by test_fuzz.py in a process with limits.

    PYTHONPATH=tests:tests/reliability python tests/reliability/fuzz.py KIND FOLDER COUNT SEED

Every mutant must load or raise a SolariError that names the file, within five seconds, print nothing, and open no file
outside the folder; the last line counts both. After a crash the file FOLDER.seed has the seed.
"""

from __future__ import annotations

import io
import json
import os
import random
import resource
import signal
import sys
import time
import traceback
import warnings
from pathlib import Path
from typing import Any

from fuzz_subjects import open_subject

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


def main() -> None:
    kind, folder, count, seed = sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4])
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_LIMIT, MEMORY_LIMIT))
    warnings.simplefilter("ignore", UserWarning)  # of pictures with an unusual shape, and the like
    subject = open_subject(kind, folder)
    subject.load()
    counts = {"loaded": 0, "refused": 0, "failed": 0}
    at = os.open(f"{folder}.seed", os.O_CREAT | os.O_WRONLY)
    outside = watch_files(folder)
    for number in range(seed, seed + count):
        os.pwrite(at, b"%20d" % number, 0)
        subject.write(random.Random(number))
        sys.stdout = sys.stderr = said = io.StringIO()
        began = time.monotonic()
        signal.alarm(SECONDS)
        try:
            outcome, wrong = "loaded", ""
            try:
                subject.load()
            except SolariError as error:
                outcome = "refused"
                if not str(error).encode().startswith(subject.named.encode()):
                    wrong = f"the file isn't named: {error}"
            if outside or said.getvalue():
                wrong = f"opened outside the folder: {outside}, printed: {said.getvalue()}"
            # Readers take the alarm's TimeoutError, which is an OSError, for a file that can't be read.
            if time.monotonic() - began >= SECONDS:
                wrong = f"longer than {SECONDS} s"
        except BaseException:
            wrong = traceback.format_exc()
        finally:
            signal.alarm(0)
            sys.stdout, sys.stderr = sys.__stdout__, sys.__stderr__
        outside.clear()
        counts["failed" if wrong else outcome] += 1
        if wrong:
            print(f"seed {number}: {wrong}", flush=True)
    print(json.dumps({**counts, "peak_mib": _peak_mib()}))


def _peak_mib() -> int:
    """This process's peak memory; on Linux getrusage includes the parent's before exec."""
    status = Path("/proc/self/status")
    if status.exists():
        [line] = [line for line in status.read_text().splitlines() if line.startswith("VmHWM")]
        return int(line.split()[1]) // 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024


def _expired(*_: Any) -> None:
    raise TimeoutError(f"longer than {SECONDS} s")


if __name__ == "__main__":
    signal.signal(signal.SIGALRM, _expired)
    main()
