"""The command line: solari-vk render | view | dataset | settings | views | info (or doctor) | bench | conformance.

Exit codes: 0 done, 1 an internal error, a conformance rule that doesn't hold, or a data set or an animation of several
devices that isn't finished, 2 bad input or usage, 3 no device.
"""

from __future__ import annotations

import argparse
import errno
import sys
import traceback
from itertools import groupby
from pathlib import Path

from solari_vk.cli import bench, dataset, info, render, view
from solari_vk.cli.options import add_device_options
from solari_vk.errors import DeviceError, SolariError

_CONFORMANCE_FULL = "ten times the rays and instances, many more frames and tighter bounds: takes much longer"
_CONFORMANCE_EXIT = (
    "Exit code 0: every rule holds. Exceptions are rules whose feature the device lacks, rules that only --full "
    "measures, and listed faults of the driver that are within their bound; the report names all of them. 1: a rule "
    "doesn't hold, the driver crashed, hung or lost its device, a listed fault is gone or grew, a package for the "
    "measurement is missing, or Ctrl-C ended the run. 2: wrong usage. 3: no device."
)


def main(arguments: list[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    options = _parser().parse_args(arguments)
    try:
        code: int = options.run(options) or 0
        if sys.stdout is not None:
            sys.stdout.flush()
    except DeviceError as error:
        print(f"solari-vk: {error}", file=sys.stderr)
        return 3
    except SolariError as error:
        print(f"solari-vk: {error}", file=sys.stderr)
        return 2
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


def _parser() -> argparse.ArgumentParser:
    what = "Raytraced lighting on any Vulkan device that traces rays."
    parser = argparse.ArgumentParser(prog="solari-vk", description=what)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    render.add_parser(commands)
    view.add_parser(commands)
    dataset.add_parser(commands)

    for name, run, what in (
        ("settings", _settings, "list the settings and qualities, with meaning, range and default"),
        ("views", _views, "list the debug views, with meaning"),
    ):
        commands.add_parser(name, help=what).set_defaults(run=run)

    info.add_parser(commands)
    bench.add_parser(commands)

    conformance = commands.add_parser(
        "conformance", help="measure whether a device keeps the rules of the specification",
        description="Measure whether a device keeps the rules of the specification. Checks run in processes of their "
        "own, so that a driver that crashes or hangs ends one check only. " + _CONFORMANCE_EXIT,
    )  # fmt: skip
    conformance.set_defaults(run=_conformance)
    add_device_options(conformance)
    conformance.add_argument("--only", action="append", default=[], metavar="GROUP", help="one group (all; repeatable)")
    conformance.add_argument("--full", action="store_true", help=_CONFORMANCE_FULL)
    conformance.add_argument("--time-limit", type=float, metavar="SECONDS",
                             help="end a check that takes longer, as hung (600; with --full 6000)")
    conformance.add_argument("--in-process", action="store_true",
                             help="measure in this process, without time limit, for a debugger: a crash ends the run")
    for kind, what in (("junit", "JUnit XML"), ("markdown", "Markdown"), ("html", "HTML")):
        conformance.add_argument(f"--{kind}", type=Path, metavar="FILE", help=f"write the report as {what}")
    return parser


# ---- lists ------------------------------------------------------------------------------------------


def _settings(options: argparse.Namespace) -> None:
    from solari_vk.settings import DEFAULTS, FIELDS, QUALITIES, allowed

    for section, names in groupby(FIELDS, key=lambda name: FIELDS[name].section):
        print(f"{section}:")
        for name in names:
            print(f"  {name}={DEFAULTS[name]}  {allowed(name)}\n      {FIELDS[name].meaning}")
    print("qualities and the settings that they change:")
    for name, values in QUALITIES.items():
        print(f"  {name}: {' '.join(f'{key}={value}' for key, value in values.items()) or 'the defaults'}")


def _views(options: argparse.Namespace) -> None:
    from solari_vk.passes.debug_views import DEBUG_VIEWS

    for name, meaning in DEBUG_VIEWS.items():
        print(f"{name:{max(map(len, DEBUG_VIEWS))}}  {meaning}")


def _conformance(options: argparse.Namespace) -> int:
    from solari_vk.conformance.run import run
    from solari_vk.conformance.worker import Work

    return run(
        Work(options.device, options.full, options.rays), only=options.only, time_limit=options.time_limit,
        in_process=options.in_process, junit=options.junit, markdown=options.markdown, html=options.html,
    )  # fmt: skip
