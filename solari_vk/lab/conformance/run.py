"""Runs the suite as `solari-vk conformance` does: each group in processes of its own, with a report in any case."""

from __future__ import annotations

import importlib
import signal
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from solari_vk.base.errors import SolariError
from solari_vk.base.files import check_writable, followed, write_whole
from solari_vk.lab.conformance.children import measure_in_child
from solari_vk.lab.conformance.outcomes import RED, Check
from solari_vk.lab.conformance.report import Report
from solari_vk.lab.conformance.results import Results
from solari_vk.lab.conformance.worker import SuiteOptions, measure_checks

TIME_LIMIT = 600.0  # seconds for a check; ten times as many with --full
_LONGEST = 1_000_000  # seconds; a pipe can be polled for 2**31 ms
_MOST_PARTS = 3  # that may end in a crash or hang before the other parts of their case are left out


def run(
    options: SuiteOptions,
    *,
    only: Sequence[str] = (),
    time_limit: float | None = None,
    in_process: bool = False,
    junit: Path | None = None,
    markdown: Path | None = None,
    html: Path | None = None,
) -> int:
    """Run groups (all by default), print the report and write it to files; 0 when it is green, else 1.

    Ctrl-C and SIGTERM end the run, but not the report. Raises SolariError for wrong arguments or variables,
    DeviceError when no device fits.
    """
    groups = importlib.import_module(options.table).GROUPS
    _check_arguments(groups, only, time_limit, (junit, markdown, html))
    started = time.monotonic()
    results = Results(groups)
    # A check can only be ended with its process.
    limit = None if in_process else time_limit or TIME_LIMIT * (10 if options.full else 1)
    # SIGTERM ends the run as Ctrl-C does, so that the report is written then too.
    previous_handler = signal.signal(signal.SIGTERM, signal.default_int_handler)
    interrupted = False
    try:
        for group in only or groups:
            _run_group(options, [Check(group, case) for case in groups[group]], results, limit)
    except KeyboardInterrupt:
        interrupted = True
    finally:
        signal.signal(signal.SIGTERM, previous_handler)
    left_out = results.finish()
    seconds = time.monotonic() - started
    report = Report(results.facts, results.outcomes, options.full, seconds, results.seconds, left_out, interrupted)
    print(f"\n{report.text()}")
    for path, text in ((junit, report.junit), (markdown, report.markdown), (html, report.html)):
        if path is not None:
            write_whole(followed(path), text())
            print(f"wrote {path}")
    return int(interrupted or any(outcome.status in RED for outcome in results.outcomes))


def _check_arguments(
    groups: Mapping[str, object], only: Sequence[str], time_limit: float | None, files: Sequence[Path | None]
) -> None:
    unknown = [name for name in only if name not in groups]
    if unknown:
        raise SolariError(f"--only {unknown[0]}: there is no such group; there are {', '.join(groups)}")
    if time_limit is not None and not 0 < time_limit <= _LONGEST:
        raise SolariError(f"--time-limit {time_limit:g}: must be more than 0 and at most {_LONGEST:,} seconds")
    for file in files:
        if file is not None:
            check_writable(file)


def _run_group(options: SuiteOptions, checks: list[Check], results: Results, limit: float | None) -> None:
    """Measure the checks of a group, in a new process after each that ends in a crash or hang or loses the device.

    Such a check is measured again by its parts, if it has any, each of which can end in the same way."""
    parts_of = importlib.import_module(options.table).parts
    parts_lost: Counter[str] = Counter()
    while checks:
        _measure_apart(options, checks, results, limit)
        left = [check for check in checks if check not in results.seconds]
        if len(left) == len(checks):
            return  # no device could be opened
        for check in set(checks) & set(results.broken):
            if not check.part:
                # What stops the driver is one of the parts: each is measured by itself.
                left = [Check(check.group, check.case, part) for part in parts_of(check)] + left
                continue
            parts_lost[check.case] += 1
            if parts_lost[check.case] >= _MOST_PARTS:
                # Each lost part costs a process, or a whole time limit: the rest of the case would end so too.
                results.left_out += [other for other in left if other.part and other.case == check.case]
                left = [other for other in left if other not in results.left_out]
        checks = left


def _measure_apart(options: SuiteOptions, checks: Sequence[Check], results: Results, limit: float | None) -> None:
    """Measure checks up to one that ends the process: in a child, or in this process without a limit."""
    if limit is None:
        measure_checks(options, checks, results.receive)
        return
    death = measure_in_child(options, checks, results.receive, limit)
    if death is not None:
        results.died(death)
