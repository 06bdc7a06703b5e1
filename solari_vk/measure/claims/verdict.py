"""From measured pairs to a verdict: means with their uncertainty, criteria, and whether a claim reproduces."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from solari_vk.errors import SolariError
from solari_vk.measure.statistics import interval

if TYPE_CHECKING:
    from solari_vk.measure.claims.workbench import Workbench

Values = NDArray[np.float64]

# ---- criteria ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Criterion:
    """What a measure has to show.

    text: in words, with the measure as the subject. margin: from arrays before and after, by how much each pair of runs
    meets the criterion, negative where it misses it. The criterion is met when the 95 % interval of the mean lies above
    0.
    """

    text: str
    margin: Callable[[Values, Values], Values]


def _mean_sign(values: Values) -> float:
    """The sign of the mean. Multiplied by it, runs that scatter around 0 average to about 0, unlike absolute values."""
    return 1.0 if values.mean() >= 0 else -1.0


def falls(by: float) -> Criterion:
    """The absolute value falls at least by this factor."""
    text = f"falls at least {by:g} times" if by > 1 else "falls"
    return Criterion(text, lambda before, after: np.abs(before) - by * np.abs(after))


def faster(by: float) -> Criterion:
    """A time falls at least by this factor. Runs are compared by the logarithm of their ratio, which doesn't change
    when other work slows both runs of a pair."""
    text = f"is at least {by:g} times faster" if by > 1 else "is faster"
    return Criterion(text, lambda before, after: np.log(np.maximum(before, 1e-9) / np.maximum(by * after, 1e-9)))


def keeps(within: float) -> Criterion:
    """The mean changes by no more than this share of the number before."""

    def margin(before: Values, after: Values) -> Values:
        change = (after - before) / max(float(np.abs(before).mean()), 1e-30)
        return within - change * _mean_sign(change)

    return Criterion(f"changes by no more than {100 * within:g} %", margin)


def grows_at_most(times: float) -> Criterion:
    """The absolute value grows at most by this factor."""
    return Criterion(f"grows at most {times:g} times", lambda before, after: times * np.abs(before) - np.abs(after))


def ends_below(bar: float) -> Criterion:
    """The mean after is no further from 0 than this."""
    return Criterion(f"ends within {bar:g}", lambda before, after: bar - after * _mean_sign(after))


RISES = Criterion("rises", lambda before, after: after - before)
"""The signed number rises."""


# ---- measures and claims ----------------------------------------------------------------------------


@dataclass
class Measure:
    """One number before and after, over the same seeds. Without a criterion it only informs."""

    what: str
    unit: str
    before: Values
    after: Values
    criterion: Criterion | None = None

    def __post_init__(self) -> None:
        self.before, self.after = np.asarray(self.before, np.float64), np.asarray(self.after, np.float64)
        if self.before.shape != self.after.shape or not self.before.size:
            raise ValueError(f"{self.what}: needs as many runs before as after, and at least one")
        if not np.isfinite([self.before, self.after]).all():
            raise ValueError(f"{self.what}: a number is not finite")

    @property
    def ratio(self) -> float:
        """The absolute value before over that after; infinite when the latter is 0."""
        before, after = abs(float(self.before.mean())), abs(float(self.after.mean()))
        return before / after if after else (math.inf if before else 1.0)

    def failure(self) -> str:
        """How the criterion is missed, from what was measured; empty when it is met or when there is none."""
        if self.criterion is None:
            return ""
        mean, half_width = interval(self.criterion.margin(self.before, self.after))
        if mean - half_width > 0 or (half_width == 0 and mean >= 0):
            return ""
        if mean > 0:
            return f"{self.what}: the spread of {len(self.before)} runs is too wide to tell"
        change = f"{self.before.mean():.3g} to {self.after.mean():.3g}"
        return f"{self.what} goes from {change}, where the claim asks that it {self.criterion.text}"


@dataclass
class Outcome:
    """What measuring a claim gave. pictures: file name, caption and 8-bit pixels of each. untestable: why this renderer
    can't test the claim at all."""

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
        """The verdict as a sentence, without the final period."""
        if self.untestable:
            return f"cannot be tested here, because {self.untestable}"
        failures = [text for measure in self.measures if (text := measure.failure())]
        return f"does not reproduce, because {'; '.join(failures)}" if failures else "reproduces"


@dataclass(frozen=True)
class Claim:
    """What a post says, what is compared, and how it is measured."""

    name: str
    post: str
    says: str
    scene: str
    before: str
    after: str
    measure: Callable[[Workbench], Outcome]


def select(claims: Iterable[Claim], only: Sequence[str]) -> list[Claim]:
    """The claims with these names, or all claims when there are no names. Raises SolariError for an unknown name."""
    known = {claim.name: claim for claim in claims}
    for name in only:
        if name not in known:
            raise SolariError(f"there is no claim '{name}'; there are {', '.join(known)}")
    return [claim for name, claim in known.items() if not only or name in only]
