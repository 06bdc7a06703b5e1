"""The command line, solari-vk. Its commands are listed in commands.py.

Exit codes: 0 done, 1 an internal error, a conformance rule that doesn't hold, or a data set or an animation of several
devices that isn't finished, 2 bad input or usage, 3 no device, 130 Ctrl-C before there was anything to keep.
"""

from __future__ import annotations

import sys

TYPE_CHECKING = False  # see the package
if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Any


def main(words: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    # Around the imports too, which take long enough to be interrupted.
    try:
        return _main(words)
    except KeyboardInterrupt:
        print("solari-vk: interrupted, nothing more was written", file=sys.stderr)
        return 130


def _main(words: Sequence[str] | None) -> int:
    import errno
    import traceback

    from solari_vk.base.errors import DeviceError, SolariError
    from solari_vk.cli.commands import COMMANDS
    from solari_vk.cli.options import parse

    _print_all_characters()
    try:
        command, job = parse(COMMANDS, words)
        code = command.run(job)
        if sys.stdout is not None:
            sys.stdout.flush()
    except SolariError as error:
        print(f"solari-vk: {error}", file=sys.stderr)
        return 3 if isinstance(error, DeviceError) else 2
    except MemoryError as error:
        print(f"solari-vk: this machine's memory isn't enough: {error or 'give smaller numbers'}", file=sys.stderr)
        return 2
    except BrokenPipeError:
        # The reader of the output closed it, as `head` does. Without stdout Python doesn't flush it at its end, which
        # would fail again.
        sys.stdout = None
        return 0
    except Exception as error:
        # The disk is full to which standard output goes; files of pictures are written with errors of their own.
        if isinstance(error, OSError) and error.errno == errno.ENOSPC:
            sys.stdout = None
            print(f"solari-vk: the output can't be written: {error.strerror}", file=sys.stderr)
            return 2
        traceback.print_exc()
        print("solari-vk: an internal error; please report it with the lines above", file=sys.stderr)
        return 1
    return code


def _print_all_characters() -> None:
    """Have what the output's encoding lacks printed as escapes, as errors are: pipes of Windows have no UTF-8."""
    reconfigure = getattr(sys.stdout, "reconfigure", None)
    if reconfigure is not None and sys.stdout.errors == "strict":
        reconfigure(errors="backslashreplace")


def _parser() -> Any:
    from solari_vk.cli.commands import COMMANDS
    from solari_vk.cli.options import make_parser

    return make_parser(COMMANDS)
