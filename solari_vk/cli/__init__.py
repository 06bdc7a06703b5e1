"""The command line: solari-vk render | view | dataset | settings | views | info (or doctor) | bench | conformance.

Exit codes: 0 done, 1 an internal error, a conformance rule that doesn't hold, or a data set or an animation of several
devices that isn't finished, 2 bad input or usage, 3 no device.
"""

from __future__ import annotations

import errno
import sys
import traceback
from typing import Any

from solari_vk.cli.commands import COMMANDS
from solari_vk.cli.options import make_parser, parse
from solari_vk.errors import DeviceError, SolariError


def main(words: list[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    try:
        command, job = parse(COMMANDS, words)
        code = command.run(job)
        if sys.stdout is not None:
            sys.stdout.flush()
    except SolariError as error:
        print(f"solari-vk: {error}", file=sys.stderr)
        return 3 if isinstance(error, DeviceError) else 2
    except BrokenPipeError:  # the reader of our output closed it
        sys.stdout = None
        return 0
    except KeyboardInterrupt:
        print("solari-vk: interrupted, nothing was written", file=sys.stderr)
        return 1
    except Exception as error:
        if isinstance(error, OSError) and error.errno == errno.ENOSPC:
            sys.stdout = None  # what it holds can't be written
            print(f"solari-vk: the output can't be written: {error.strerror}", file=sys.stderr)
            return 2
        traceback.print_exc()
        print("solari-vk: an internal error; please report it with the lines above", file=sys.stderr)
        return 1
    return code


def _parser() -> Any:
    return make_parser(COMMANDS)
