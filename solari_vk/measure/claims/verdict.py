"""From measured pairs to a verdict: means with their uncertainty, criteria, and whether a claim reproduces."""

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
        """By how much each pair of runs meets the criterion; negative where it misses it.

        The criterion is met when the 95 % interval of the mean lies above 0.
        """

    @property
    def text(self) -> str:
        """The criterion in words, with the measure as the subject."""


@dataclass(frozen=True)
class Falls:
    """The absolute value falls at least by this factor."""

    by: float

    def margin(self, before: Values, after: Values) -> Values:
        return np.abs(before) - self.by * np.abs(after)

    @property
    def text(self) -> str:
        return f"falls at least {self.by:g} times" if self.by > 1 else "falls"


@dataclass(frozen=True)
class Faster:
    """A time falls at least by this factor. Runs are compared by the logarithm of their ratio, which doesn't change
    when other work slows both runs of a pair."""

    by: float

    def margin(self, before: Values, after: Values) -> Values:
        return np.log(np.maximum(before, 1e-9)) - np.log(np.maximum(self.by * after, 1e-9))

    @property
    def text(self) -> str:
        return f"is at least {self.by:g} times faster" if self.by > 1 else "is faster"


@dataclass(frozen=True)
class Rises:
    """The signed number rises by more than this difference."""

    by: float = 0.0

    def margin(self, before: Values, after: Values) -> Values:
        return after - before - self.by

    @property
    def text(self) -> str:
        return f"rises by more than {self.by:g}" if self.by else "rises"


@dataclass(frozen=True)
class Keeps:
    """The mean changes by no more than this share of the number before."""

    within: float

    def margin(self, before: Values, after: Values) -> Values:
        """The sign of the mean change is taken out, so that runs which scatter to both sides count as no change."""
        change = (after - before) / max(float(np.abs(before).mean()), 1e-30)
        return self.within - change * (1.0 if change.mean() >= 0 else -1.0)

    @property
    def text(self) -> str:
        return f"changes by no more than {100 * self.within:g} %"


@dataclass(frozen=True)
class GrowsAtMost:
    """The absolute value grows at most by this factor."""

    times: float

    def margin(self, before: Values, after: Values) -> Values:
        return self.times * np.abs(before) - np.abs(after)

    @property
    def text(self) -> str:
        return "does not grow" if self.times == 1 else f"grows at most {self.times:g} times"


@dataclass(frozen=True)
class EndsBelow:
    """The mean after is no further from 0 than this."""

    bar: float

    def margin(self, before: Values, after: Values) -> Values:
        """The sign of the mean is taken out, so that runs which scatter about 0 count as 0."""
        return self.bar - after * (1.0 if after.mean() >= 0 else -1.0)

    @property
    def text(self) -> str:
        return f"ends within {self.bar:g}"


# ---- measures and claims ----------------------------------------------------------------------------


@dataclass
class Measure:
    """One number before and after, over the same seeds. Without a criterion it only informs."""

    what: str
    unit: str
    before: ArrayLike
    after: ArrayLike
    criterion: Criterion | None = None

    def __post_init__(self) -> None:
        self.runs_before = np.asarray(self.before, np.float64).ravel()
        self.runs_after = np.asarray(self.after, np.float64).ravel()
        if len(self.runs_before) != len(self.runs_after) or not len(self.runs_before):
            raise ValueError(f"{self.what}: needs as many runs before as after, and at least one")
        if not (np.isfinite(self.runs_before).all() and np.isfinite(self.runs_after).all()):
            raise ValueError(f"{self.what}: a number is not finite")

    @property
    def ratio(self) -> float:
        """The absolute value before over that after; infinite when the latter is 0."""
        before, after = abs(float(self.runs_before.mean())), abs(float(self.runs_after.mean()))
        return before / after if after else (math.inf if before else 1.0)

    def failure(self) -> str:
        """How the criterion is missed, from what was measured; empty when it is met or when there is none."""
        if self.criterion is None:
            return ""
        mean, half_width = interval(self.criterion.margin(self.runs_before, self.runs_after))
        if mean - half_width > 0 or (half_width == 0 and mean >= 0):
            return ""
        if mean > 0:
            return f"{self.what}: the spread of {len(self.runs_before)} runs is too wide to tell"
        before, after = (float(runs.mean()) for runs in (self.runs_before, self.runs_after))
        return f"{self.what} goes from {before:.3g} to {after:.3g}, where the claim asks that it {self.criterion.text}"


@dataclass
class Outcome:
    """What measuring a claim gave.

    pictures: file name, caption and 8-bit pixels of each. untestable: why this renderer can't test the claim at all.
    """

    measures: Sequence[Measure]
    pictures: Sequence[tuple[str, str, NDArray[np.uint8]]] = field(default_factory=tuple)
    note: str = ""
    untestable: str = ""

    @property
    def reproduces(self) -> bool:
        """Whether every criterion is met."""
        return not self.untestable and not any(measure.failure() for measure in self.measures)

    @property
    def verdict(self) -> str:
        """One sentence without its full stop."""
        if self.untestable:
            return f"cannot be tested here, because {self.untestable}"
        failures = [text for measure in self.measures if (text := measure.failure())]
        return f"does not reproduce, because {'; '.join(failures)}" if failures else "reproduces"


@dataclass(frozen=True)
class Claim:
    """What a post says, what is compared, and how it is measured. row: the claim's subject in two words."""

    name: str
    row: str
    post: str
    says: str
    scene: str
    before: str
    after: str
    measure: Callable[[Workbench], Outcome]


def select(claims: Iterable[Claim], only: Sequence[str]) -> list[Claim]:
    """The claims with these names, or all claims when there are no names. Raises SolariError for an unknown name."""
    every = list(claims)
    names = [claim.name for claim in every]
    for name in only:
        if name not in names:
            raise SolariError(f"there is no claim '{name}'; there are {', '.join(names)}")
    return [claim for claim in every if not only or claim.name in only]
