"""The faults of drivers that are known: the entries of known_faults.toml."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

from solari_vk.base.errors import SolariError
from solari_vk.lab.conformance.outcomes import ERROR, Check, Outcome, Rule

FILE = Path(__file__).resolve().parent / "known_faults.toml"


@dataclass(frozen=True)
class Fault:
    """An entry of known_faults.toml: a measured value above the bar, up to `at_most`, or how a check `ends`."""

    driver: str
    rule: str
    evidence: str
    at_most: float | None = None
    ends: str = ""
    case: str = "*"

    def __post_init__(self) -> None:
        if (self.at_most is None) == (not self.ends):
            raise TypeError("it must have either at_most or ends")

    def explains(self, rule: Rule, case: str) -> bool:
        """Whether the fault is about this rule in this case."""
        return fnmatchcase(rule.name, self.rule) and fnmatchcase(case, self.case)


def known_faults(driver: str, file: Path = FILE) -> list[Fault]:
    """The known faults of a driver. Raises SolariError for a file that isn't TOML and for an incomplete entry."""
    try:
        listed = tomllib.loads(file.read_text(encoding="utf-8")).get("fault", [])
        return [fault for fault in (Fault(**entry) for entry in listed) if fault.driver in driver]
    except (OSError, ValueError) as error:
        raise SolariError(f"{file}: {error}: mend the file, or install solari_vk again to get its own") from error
    except TypeError as error:
        raise SolariError(f"{file}: an entry needs driver, rule, evidence, and at_most or ends: {error}") from error


def find_end(faults: Iterable[Fault], check: Check, ended: str = "") -> Fault | None:
    """The known fault because of which a check doesn't finish. ended: only a fault that ends the check in this way."""
    # A check that ends the process has no measured value to hold against a bar.
    told = (fault for fault in faults if fault.ends and fault.explains(check.rule, check.case))
    return next((fault for fault in told if ended in ("", fault.ends)), None)


def unexplained(faults: Iterable[Fault], outcomes: Iterable[Outcome]) -> list[Outcome]:
    """An error for each fault that no outcome of a whole run is about."""
    made = list(outcomes)
    # Otherwise an entry would outlive the rule that it is about.
    unused = (fault for fault in faults if not any(fault.explains(o.rule, o.case) for o in made))
    reason = "no rule of that name: remove the entry, or mend it"
    return [Outcome(FILE.name, Rule(fault.rule, "", ""), ERROR, reason=reason) for fault in unused]
