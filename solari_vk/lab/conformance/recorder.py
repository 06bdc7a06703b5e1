"""Turns what a check measures into outcomes, which it tells at once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from solari_vk.lab.conformance.faults import Fault, find_end
from solari_vk.lab.conformance.outcomes import ERROR, FAIL, FAULT, PASS, Check, Measurement, Outcome, Rule

_GONE = "known_faults.toml lists this rule as failing, but {}: remove the entry"


class Recorder:
    """The `rule` of a check: each outcome goes to `send` as soon as it is measured."""

    def __init__(self, check: Check, faults: Sequence[Fault], send: Callable[[Outcome], None]) -> None:
        self._check = check
        self._faults = faults
        self._send = send
        self._count = 0

    def _add(self, rule: Rule, status: str, made: Measurement | None = None, reason: str = "", ended: str = "") -> None:
        self._count += 1
        self._send(Outcome(self._check.group, rule, status, self._check.case, made, reason, ended))

    def __call__(self, measured: Measurement | Iterable[Measurement]) -> None:
        """Record one or more measurements."""
        # Each outcome is told at once, so that a crash loses none that came before it.
        for made in [measured] if isinstance(measured, Measurement) else measured:
            status, reason = self._status_of(made)
            self._add(made.rule, status, made, reason)

    def _status_of(self, made: Measurement) -> tuple[str, str]:
        """The status of a measurement and its reason, where the driver's known faults have one.

        A listed fault that is gone fails too, so that the list stays true.
        """
        fault = next((fault for fault in self._faults if fault.explains(made.rule, self._check.case)), None)
        if fault is None:
            return (PASS if made.holds else FAIL), ""
        if made.holds:
            return FAIL, _GONE.format("it holds")
        if fault.at_most is None:  # it is listed as the end of a check, not as a value
            return FAIL, ""
        if made.measured <= fault.at_most:
            return FAULT, f"{fault.evidence} Listed up to {fault.at_most:g}."
        return FAIL, f"known_faults.toml lists this rule as failing up to {fault.at_most:g} only: it grew worse"

    def unmeasured(self, rules: Rule | Iterable[Rule], status: str, reason: str) -> None:
        """Record why rules aren't measured: UNSUPPORTED by the device, NOT_RUN in this profile, or an ERROR."""
        for rule in [rules] if isinstance(rules, Rule) else rules:
            self._add(rule, status, reason=reason)

    def error(self, reason: str) -> None:
        """Record that the check ended in an error."""
        self._add(self._check.rule, ERROR, reason=reason)

    def died(self, status: str, ended: str, reason: str) -> None:
        """Record that the driver crashed or hung, or lost its device (status), and how: a FAULT if it is listed."""
        # Only the listed end is known: a hang is none where the list says that the check crashes.
        fault = find_end(self._faults, self._check, ended)
        self._add(self._check.rule, FAULT if fault else status, None, fault.evidence if fault else reason, ended)

    def finish(self) -> None:
        """Record what is wrong with a check that ran to its end: nothing was measured, or its known end is gone."""
        if not self._count:
            self.error("nothing was measured")
        if find_end(self._faults, self._check):
            self._add(self._check.rule, FAIL, reason=_GONE.format("the check ran to its end"))
