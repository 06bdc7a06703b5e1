"""Groups whose checks end as on a faulty driver, in place of solari_vk.lab.conformance.groups."""

from __future__ import annotations

import ctypes
import gc
import multiprocessing
import os
import signal
import sys
import time
from multiprocessing.connection import Connection
from pathlib import Path

from solari_vk.gpu.device import raw
from solari_vk.lab.conformance.outcomes import Measurement, Rule


def measuring(*actions):
    """A check that measures one rule, does something, and measures another."""

    def measure(run):
        yield Measurement(Rule("measured before", "a document", "a section"), 0.0)
        for action in actions:
            action(run)
        yield Measurement(Rule("measured after", "a document", "a section"), 0.0)

    return measure


def lose_device(run):
    def submit(*_):
        return raw.VK_ERROR_DEVICE_LOST

    run.device.vk.vkQueueSubmit2 = raw._checked(submit, "vkQueueSubmit2", run.device._on_error)
    run.device.run(lambda cmd: None)


def close_pipe(run):
    # The pipe to the parent is held by a frame of the worker, where no name reaches it.
    for connection in [item for item in gc.get_objects() if isinstance(item, Connection)]:
        connection.close()


def fail_at_second_part(run):
    if run.part != "first":
        os.abort()


def say_so(run):
    print("driver: out of \x1b[31mregisters", file=sys.stderr, flush=True)


def sleep(run):
    time.sleep(1000)


def note_process(run):
    Path("child").write_text(str(os.getpid()))


GROUPS = {
    "faults": {
        "aborts": measuring(say_so, lambda run: os.abort()),
        "reads address 0": measuring(lambda run: ctypes.string_at(0)),
        "sleeps": measuring(sleep),
        "loses the device": measuring(lose_device),
        "raises": measuring(lambda run: 1 / 0),
        "is killed": measuring(lambda run: os.kill(os.getpid(), signal.SIGKILL)),
        "closes its pipe": measuring(close_pipe),
        "leaves": measuring(lambda run: os._exit(0)),
        "in parts": measuring(fail_at_second_part),
        "in vain": lambda run: [],
        "works": measuring(),
    },
    "after them": {"works": measuring()},
    "slow": {"works": measuring(note_process), "sleeps": measuring(sleep), "never begins": measuring()},
}
RAYS = {}


def parts(check):
    return ["first", "second", "third"] if check.case == "in parts" else []


# Only in a child: the parent imports this module too.
if multiprocessing.parent_process() is not None and os.environ.get("ABORT_AT_OPENING"):
    os.abort()
