"""From measured pairs to a verdict: means with their uncertainty, criteria, and what a claim comes to."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.errors import SolariError
from solari_vk.measure.statistics import interval

if TYPE_CHECKING:
    from solari_vk.measure.claims.workbench import Workbench

Values = NDArray[np.float64]

# ---- criteria ---------------------------------------------------------------------------------------


class Criterion(Protocol):
    """What a measure has to show."""

    def margin(self, before: Values, after: Values) -> Values:
        """How far each run is on the right side: the mean must be above 0, and its 95 % interval too."""

    @property
    def text(self) -> str:
        """In words."""


@dataclass(frozen=True)
class Falls:
    """The size of the number falls at least so many times."""

    by: float

    def margin(self, before: Values, after: Values) -> Values:
        """Of runs in pairs."""
        return np.abs(before) - self.by * np.abs(after)

    @property
    def text(self) -> str:
        return f"falls at least {self.by:g} times" if self.by > 1 else "falls"


@dataclass(frozen=True)
class Faster:
    """A time falls at least so many times, by the logarithm of the ratio: what slows both of a pair slows no ratio."""

    by: float

    def margin(self, before: Values, after: Values) -> Values:
        """Of runs in pairs."""
        return np.log(np.maximum(before, 1e-9)) - np.log(np.maximum(self.by * after, 1e-9))

    @property
    def text(self) -> str:
        return f"is at least {self.by:g} times faster" if self.by > 1 else "is faster"


@dataclass(frozen=True)
class Rises:
    """The signed number rises by more than so much."""

    by: float = 0.0

    def margin(self, before: Values, after: Values) -> Values:
        """Of runs in pairs."""
        return after - before - self.by

    @property
    def text(self) -> str:
        return f"rises by more than {self.by:g}" if self.by else "rises"


@dataclass(frozen=True)
class Keeps:
    """The number stays as it was: the mean of the change lies within a share of it."""

    within: float

    def margin(self, before: Values, after: Values) -> Values:
        """Signed like the mean's, so that runs which scatter to both sides do not count as a change."""
        change = (after - before) / max(float(np.abs(before).mean()), 1e-30)
        return self.within - change * (1.0 if change.mean() >= 0 else -1.0)

    @property
    def text(self) -> str:
        return f"changes by no more than {100 * self.within:g} %"


@dataclass(frozen=True)
class GrowsAtMost:
    """The size of the number grows at most so many times."""

    times: float

    def margin(self, before: Values, after: Values) -> Values:
        """Of runs in pairs."""
        return self.times * np.abs(before) - np.abs(after)

    @property
    def text(self) -> str:
        return "does not grow" if self.times == 1 else f"grows at most {self.times:g} times"


@dataclass(frozen=True)
class EndsBelow:
    """The mean ends up no larger than so, on either side of 0."""

    bar: float

    def margin(self, before: Values, after: Values) -> Values:
        """Signed like the mean's, so that runs which scatter about 0 count as 0."""
        return self.bar - after * (1.0 if after.mean() >= 0 else -1.0)

    @property
    def text(self) -> str:
        return f"ends within {self.bar:g}"


# ---- measures and claims ----------------------------------------------------------------------------


@dataclass
class Measure:
    """One number before and after, over the same seeds.

    `reason`: why, when the criterion fails though the runs agree. Without criterion the number only informs.
    """

    what: str
    unit: str
    before: ArrayLike
    after: ArrayLike
    criterion: Criterion | None = None
    reason: str = ""

    def __post_init__(self) -> None:
        self.runs_before = np.asarray(self.before, np.float64).ravel()
        self.runs_after = np.asarray(self.after, np.float64).ravel()
        if len(self.runs_before) != len(self.runs_after) or not len(self.runs_before):
            raise ValueError(f"{self.what}: as many runs before as after are needed, and at least one")
        if not (np.isfinite(self.runs_before).all() and np.isfinite(self.runs_after).all()):
            raise ValueError(f"{self.what}: a number is not finite")

    @property
    def ratio(self) -> float:
        """Size before over size after; infinite when nothing is left."""
        before, after = abs(float(self.runs_before.mean())), abs(float(self.runs_after.mean()))
        return before / after if after else (math.inf if before else 1.0)

    def failure(self) -> str:
        """Why the criterion is not met; empty when it is, or when there is none."""
        if self.criterion is None:
            return ""
        mean, half_width = interval(self.criterion.margin(self.runs_before, self.runs_after))
        if mean - half_width > 0 or (half_width == 0 and mean >= 0):
            return ""
        if mean > 0:
            return f"{self.what}: the spread of {len(self.runs_before)} runs is too wide to tell"
        return f"{self.what}: {self.reason}" if self.reason else f"{self.what} does not do so: {self.criterion.text}"


@dataclass
class Outcome:
    """What measuring a claim gave. `pictures`: file name, caption and 8-bit pixels of each."""

    measures: Sequence[Measure]
    pictures: Sequence[tuple[str, str, NDArray[np.uint8]]] = field(default_factory=tuple)
    note: str = ""

    @property
    def reproduces(self) -> bool:
        """Whether every criterion is met."""
        return not any(measure.failure() for measure in self.measures)

    @property
    def verdict(self) -> str:
        """In words."""
        failures = [text for measure in self.measures if (text := measure.failure())]
        return f"does not reproduce, because {'; '.join(failures)}" if failures else "reproduces"


@dataclass(frozen=True)
class Claim:
    """What a post says, what is compared, and how it is measured. `row`: what the claim is about, in two words."""

    name: str
    row: str
    post: str
    says: str
    scene: str
    before: str
    after: str
    measure: Callable[[Workbench], Outcome]


def select(claims: Iterable[Claim], only: Sequence[str]) -> list[Claim]:
    """The claims of these names, all of them without any. Raises SolariError for a name that none has."""
    every = list(claims)
    names = [claim.name for claim in every]
    for name in only:
        if name not in names:
            raise SolariError(f"there is no claim '{name}'; there are {', '.join(names)}")
    return [claim for claim in every if not only or claim.name in only]
