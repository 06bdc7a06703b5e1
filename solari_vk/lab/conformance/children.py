"""Measures checks in a child process, so that a driver that crashes or hangs ends one check and not the run."""

from __future__ import annotations

import faulthandler
import multiprocessing
import os
import pickle
import re
import signal
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from solari_vk.lab.conformance.outcomes import CRASH, HANG, Check
from solari_vk.lab.conformance.worker import CheckBegan, Send, SuiteOptions, measure_checks

LEAVING = "leaving the process"
# After that long the process is left to the system.
_GRACE = 10.0  # seconds for a process to end after its pipe was closed, or after SIGABRT
_PACKAGE = Path(__file__).resolve().parents[2]
# A line of a traceback that faulthandler writes.
_FRAME = re.compile(r'File "(.+)", line (\d+) in (.+)')


@dataclass(frozen=True)
class Death:
    """How a child ended that didn't reach its end.

    status: CRASH or HANG; ended: the signal, the exit code or the limit; reason: what else is known; seconds: since
    its last check began."""

    status: str
    ended: str
    reason: str
    seconds: float


def measure_in_child(options: SuiteOptions, checks: Sequence[Check], send: Send, limit: float) -> Death | None:
    """`measure_checks` in a new process; `limit`: seconds for each check. Returns None when the child reached its end.

    Whatever stops this function, such as Ctrl-C, kills the child too."""
    # A forked child would share the state of the driver, which must not be used by two processes.
    context = multiprocessing.get_context("spawn")
    receiving, sending = context.Pipe(duplex=False)
    # Windows removes no file that a process has open which is about to end, and drivers start some of their own.
    with TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        log = Path(folder) / "output"
        child = context.Process(target=_run, args=(options, checks, sending, str(log)), daemon=True)
        child.start()
        # Only the child holds the sending end now, so that the pipe ends when the child does.
        sending.close()
        try:
            return _watch(child, receiving, send, limit, log)
        finally:
            child.kill()
            child.join(_GRACE)
            receiving.close()


def _run(options: SuiteOptions, checks: Sequence[Check], sending: Connection, log: str) -> None:
    """The child. What it and the driver print goes to a file; Ctrl-C is for the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    output = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    for stream in (sys.stdout, sys.stderr):
        os.dup2(output, stream.fileno())
    # A crash then writes the Python functions that it happened in.
    faulthandler.enable()
    measure_checks(options, checks, sending.send)
    # Tells the parent that all checks were measured: a driver may still crash while the process ends.
    sending.send(CheckBegan(Check(checks[0].group, LEAVING)))


def _watch(child: BaseProcess, receiving: Any, send: Send, limit: float, log: Path) -> Death | None:
    """Pass the child's messages on until it ends or is too slow."""
    case = ""
    began = time.monotonic()
    while receiving.poll(max(began + limit - time.monotonic(), 0)):
        try:
            message = receiving.recv()
        except (EOFError, OSError, pickle.UnpicklingError):
            seconds = time.monotonic() - began
            child.join(_GRACE)
            # An exit code of 0 alone doesn't prove that all checks were measured.
            if child.exitcode == 0 and case == LEAVING:
                return None
            ended, reason = _explain(child.exitcode)
            return Death(CRASH, ended, reason + _last_words(log), seconds)
        if isinstance(message, CheckBegan):
            case = message.check.case
            began = time.monotonic()
        send(message)
    assert child.pid is not None
    os.kill(child.pid, signal.SIGABRT)  # makes faulthandler write where the child is
    child.join(_GRACE)
    return Death(HANG, f"{limit:g} s", f"it was killed after {limit:g} s{_last_words(log)}", limit)


def _explain(code: int | None) -> tuple[str, str]:
    """How a child ended that closed its pipe too early, in a word and in a sentence."""
    if code is None:
        return "closed its pipe", "the process closed its pipe, but did not end"
    if code >= 0:
        return f"exit code {code}", f"the process left with exit code {code}"
    name = signal.Signals(-code).name
    hint = ", as the system does when memory runs out" if name == "SIGKILL" else ""
    return name, f"the process was killed by {name}{hint}"


def _last_words(log: Path) -> str:
    """What a child printed last, and where it was: in which function of a check, and in which of the package."""
    text = log.read_text(encoding="utf-8", errors="replace") if log.exists() else ""
    said, _, trace = text.partition("Fatal Python error:")
    frames = [(Path(file), f"{name} ({Path(file).name}:{line})") for file, line, name in _FRAME.findall(trace)]
    # Frames are listed from the innermost: the check, and what it called in the package.
    check = next((i for i, (file, _) in enumerate(frames) if file.stem.endswith("_checks")), len(frames) - 1)
    inside = [place for file, place in frames[:check] if _PACKAGE in file.parents]
    places = [place for _, place in frames[check : check + 1]] + inside[:1]
    lines = ["".join(filter(str.isprintable, line)).strip() for line in said.splitlines()]
    last = next((line[:200] for line in reversed(lines) if line), "")
    return (f", in {', '.join(places)}" if places else "") + (f"; its last words: {last}" if last else "")
