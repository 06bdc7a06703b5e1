"""`solari-vk conformance`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from solari_vk.cli.jobs import DeviceOptions
from solari_vk.cli.options import flag, option

EXIT_CODES = (
    "Exit code 0: every rule holds. Exceptions are rules whose feature the device lacks, rules that only --full "
    "measures, and listed faults of the driver that are within their bound; the report names all of them. 1: a rule "
    "doesn't hold, the driver crashed, hung or lost its device, a listed fault is gone or grew, a package for the "
    "measurement is missing, or Ctrl-C ended the run. 2: wrong usage. 3: no device."
)


@dataclass(frozen=True, kw_only=True)
class ConformanceJob(DeviceOptions):
    """What is measured, and which reports are written."""

    DESCRIPTION: ClassVar = (
        "Measure whether a device keeps the rules of the specification. Checks run in processes of their own, so that "
        f"a driver that crashes or hangs ends one check only. {EXIT_CODES}"
    )

    only: tuple[str, ...] = option("one group (all; repeatable)", "GROUP", action="append", default=())
    full: bool = flag("up to a hundred times as many rays, instances and structures: takes much longer")
    time_limit: float | None = option(
        "end a check that takes longer, as hung (600; with --full 6000)", "SECONDS", type=float
    )
    in_process: bool = flag("measure in this process, without time limit, for a debugger: a crash ends the run")
    junit: Path | None = option("write the report as JUnit XML", "FILE", type=Path)
    markdown: Path | None = option("write the report as Markdown", "FILE", type=Path)
    html: Path | None = option("write the report as HTML", "FILE", type=Path)


def run(job: ConformanceJob) -> int:
    """Measure and report; returns the exit code."""
    from solari_vk.lab.conformance.run import run
    from solari_vk.lab.conformance.worker import SuiteOptions

    return run(
        SuiteOptions(job.device, job.full, job.rays),
        only=job.only,
        time_limit=job.time_limit,
        in_process=job.in_process,
        junit=job.junit,
        markdown=job.markdown,
        html=job.html,
    )
