"""Runs the suite as `solari-vk conformance` does: with pytest, whatever project it is called from."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from solari_vk.conformance.groups import GROUPS
from solari_vk.errors import SolariError

FOLDER = Path(__file__).resolve().parent


def run(
    select: str | None = None, *, only: Sequence[str] = (), full: bool = False,
    junit: Path | None = None, markdown: Path | None = None, html: Path | None = None,
) -> int:  # fmt: skip
    """Run groups (all by default) and print the report; 0 when it is green, else 1 (`solari-vk conformance --help`).

    Raises SolariError for an unknown group or without pytest, DeviceError when no device fits.
    """
    unknown = [name for name in only if name not in GROUPS]
    if unknown:
        raise SolariError(f"--only {unknown[0]}: there is no such group; there are {', '.join(GROUPS)}")
    for file in (junit, markdown, html):
        if file is not None and not file.resolve().parent.is_dir():
            raise SolariError(f"{file}: there is no folder {file.resolve().parent}")
    try:
        import pytest
    except ImportError as error:
        raise SolariError("the conformance suite runs with pytest: pip install solari-vk[test]") from error
    from solari_vk.conformance.suite import Suite

    suite = Suite(select, full, only, markdown, html)
    suite.open()  # without a device there is no point in collecting tests
    arguments = ["-c", str(FOLDER / "pytest.ini"), "--rootdir", str(FOLDER), str(FOLDER)]
    if junit is not None:
        arguments += ["--junitxml", str(junit.resolve())]
    return 0 if pytest.main(arguments, plugins=[suite]) == pytest.ExitCode.OK else 1
