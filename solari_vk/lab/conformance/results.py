"""What a run has found so far, from the messages of the processes that measure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from solari_vk.base.errors import SolariError
from solari_vk.lab.conformance.children import Death
from solari_vk.lab.conformance.faults import Fault, unexplained
from solari_vk.lab.conformance.outcomes import ERROR, STATUSES, Check, Outcome
from solari_vk.lab.conformance.recorder import Recorder
from solari_vk.lab.conformance.worker import OPENING, CheckBegan, CheckEnded, DeviceOpened, Message


class Results:
    """Collects messages, and prints a line for each check that ends.

    outcomes: all so far; seconds: the time of each check that ended; broken: checks that ended in a crash or hang, or
    lost the device; left_out: parts that aren't measured because others of their case ended so."""

    def __init__(self, groups: Mapping[str, Iterable[str]]) -> None:
        self.outcomes: list[Outcome] = []
        self.seconds: dict[Check, float] = {}
        self.facts: dict[str, str] = {}
        self.broken: list[Check] = []
        self.left_out: list[Check] = []
        self._groups = groups
        self._faults: list[Fault] = []
        self._current = Check("", "")
        self._first = 0  # the current check's first outcome

    def receive(self, message: Message) -> None:
        """Take a message. Raises the error for which the first process can't open its device or prepare the checks."""
        match message:
            case DeviceOpened():
                self.facts = self.facts or message.facts
                # Groups may open the device for another way to trace; the head of the report names each once.
                first, *others = self.facts["rays"].split("; ")
                other = f"{self._current.group} {message.facts['rays']}"
                if message.facts["rays"] != first and other not in others:
                    self.facts["rays"] += f"; {other}"
                self._faults = message.faults
            case CheckBegan():
                self._current = message.check
                self._first = len(self.outcomes)
            case Outcome():
                self._add(message)
            case SolariError():
                # Without a device there is nothing to report; later processes may fail where the first one did not.
                if self._current.case == OPENING and not self.facts:
                    raise message
                group, case, _ = self._current
                self._add(Outcome(group, self._current.rule, ERROR, case, reason=str(message)))
            case CheckEnded():
                self._end(message.seconds)

    def died(self, death: Death) -> None:
        """Record how a process ended at the current check."""
        made = self.outcomes[self._first :]
        last = f"; measured before: {made[-1].rule.name}" if made else ""
        Recorder(self._current, self._faults, self._add).died(death.status, death.ended, death.reason + last)
        self._end(death.seconds)

    def finish(self) -> list[str]:
        """What of the table wasn't measured to its end. After a whole run, count faults of no rule as errors."""
        left = {
            group: [case for case in cases if Check(group, case) not in self.seconds]
            for group, cases in self._groups.items()
        }
        # After a part of the suite a fault may be about a rule that was not measured.
        if self.facts and not any(left.values()):
            self.outcomes += unexplained(self._faults, self.outcomes)
        texts = []
        for group, cases in left.items():
            if not cases:
                continue
            if len(cases) == len(list(self._groups[group])):
                texts.append(f"group {group}")
            else:
                texts.append(f"{len(cases)} checks of {group}")
        return texts + [": ".join(check) for check in self.left_out]

    def _add(self, outcome: Outcome) -> None:
        self.outcomes.append(outcome)
        if outcome.ended:
            self.broken.append(self._current)

    def _end(self, seconds: float) -> None:
        self.seconds[self._current] = seconds
        made = self.outcomes[self._first :]
        if made:
            worst = min((outcome.status for outcome in made), key=STATUSES.index)
            name = ": ".join(filter(None, self._current))
            print(f"{name}: {worst} ({len(made)} results, {seconds:.1f} s)", flush=True)
