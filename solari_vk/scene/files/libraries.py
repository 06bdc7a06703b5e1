"""Libraries that read compressed files. They are optional: the extra `formats` of the package brings them all."""

from __future__ import annotations

from collections.abc import Iterable
from importlib import import_module, util
from typing import Any

from solari_vk.base.errors import SolariError, warn

INSTALL = "pip install 'solari-vk[formats]'"


def warn_of_missing(remarks: Iterable[str]) -> None:
    """Warn of those remarks about a file of which a library would show more: they mustn't be missed."""
    for remark in remarks:
        if INSTALL in remark:
            warn(remark)


def is_installed(module: str) -> bool:
    """Whether a library is there, by its module."""
    return util.find_spec(module) is not None


def library(module: str, who: str, install: str = INSTALL) -> Any:
    """A library by its module. Raises SolariError, which names `who` needs it, if the library is missing or broken.
    install: the command that brings it."""
    try:
        return import_module(module)
    except ImportError as error:
        raise SolariError(f'{who} needs a library that isn\'t installed ({error}): install it by "{install}"') from None


def zstd(who: str) -> Any:
    """The module that reads Zstandard: of Python from 3.14 on, else a copy of it for older versions."""
    return library("compression.zstd" if util.find_spec("compression") else "backports.zstd", who)
