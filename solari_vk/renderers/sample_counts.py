"""How many samples the path tracer's pixels take: a number, or what an error needs."""

from __future__ import annotations

import math
from collections.abc import Callable
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError, quoted, warn
from solari_vk.gpu.frame.frame import Frame
from solari_vk.output.adaptive import SamplePlan
from solari_vk.output.error import ErrorEstimate
from solari_vk.passes import reference

FIRST_DENOISED_LOOK = 8  # samples of the first denoised picture whose error is estimated


def check_target(target: Any, where: str) -> None:
    """Raise SolariError unless a picture may end at this error; None is for none."""
    # An infinite error would end a picture before its first sample, and NaN none.
    if target is not None and not (isinstance(target, Real) and 0 <= float(target) < math.inf):
        raise SolariError(f"{where}: target_error must be a finite number from 0 on, not {quoted(target)}")


class SampleCounts:
    """Counts the samples of a picture, and says how many are wanted up to the next estimate of its error.

    frame: with the path tracer's stage. read: reads its results by name. size: (width, height).
    """

    def __init__(self, frame: Frame, size: tuple[int, int], read: Callable[[str], NDArray[Any]]) -> None:
        self._frame = frame
        self._size = size
        self._read = read
        self.denoises = False
        self.begin()

    def begin(self) -> None:
        """Begin a new picture."""
        self.samples = 0
        """The samples per pixel so far, of the pixel that has most."""
        self._target: float | None = None
        self._plan: SamplePlan | None = None  # where pixels may have different numbers of samples
        self._begin_evenly()

    def _begin_evenly(self) -> None:
        self._plan = None
        self._frame.uniforms["path_sampling.has_sample_ranges"] = 0
        self._begin_estimating()

    def _begin_estimating(self) -> None:
        # Denoised pictures of very few samples say little about those of more.
        self._estimate = ErrorEstimate(max(FIRST_DENOISED_LOOK if self.denoises else 1, self.samples))

    def set_target(self, target: float | None, denoises: bool, limit: int | None = None) -> None:
        """Set the error that is wanted from now on, None for no estimates, and whether it is that of denoised pictures;
        warn if there are more samples than the limit that will be given to `samples_to_take`.

        Only pictures that aren't denoised, with a target above 0, have pixels with different numbers of samples.
        """
        if limit is not None and self.samples > limit:
            warn(
                f"the picture has {self.samples} samples of earlier calls, more than {limit}: call reset() before "
                "render for a new one"
            )
        # The error of a denoised picture is another one, which is estimated in another way.
        if denoises != self.denoises:
            self.denoises = denoises
            self._begin_estimating()
        self._target = target
        if target and not denoises:
            self._plan = self._plan or SamplePlan(self._size, reference.SAMPLE_BLOCK, self.samples)
        elif self._plan is not None:
            # All pixels must have the same number again before a picture without a plan goes on.
            self._plan.begin_even_pass()
            self._write_ranges(self._plan)

    def samples_to_take(self, limit: int) -> int:
        """The samples per pixel up to the next estimate of the error; 0 when the picture is done, or has `limit`."""
        if self._plan is not None and not self._plan.remaining:
            if self._target and not self.denoises:
                self._plan_pass(self._plan, limit, self._target)
            else:  # the pass after which all pixels have the same number is done
                self._begin_evenly()
        if self._plan is not None:
            return self._plan.remaining
        if self._target is None:
            return max(limit - self.samples, 0)
        if self._estimate_error() <= self._target:
            return 0
        return max(min(limit, self._estimate.next_look) - self.samples, 0)

    def _plan_pass(self, plan: SamplePlan, limit: int, target: float) -> None:
        """Choose how many samples each pixel takes next, where they lower the error most."""
        if self.samples:
            costs = self._frame["ray_count"].reshape(self._size[::-1])  # a sample costs as much as its rays
            plan.estimate_error(self._read("raw_radiance"), costs)
        plan.begin_pass_towards(target, limit)
        self._write_ranges(plan)

    def demand_more(self) -> None:
        """Have all pixels take more samples, whatever the error is."""
        if self._plan is not None and not self._plan.remaining:
            self.set_target(None, self.denoises)
            self.samples_to_take(0)

    @property
    def is_uneven(self) -> bool:
        """Whether pixels may take different numbers of samples, so that dispatches don't tell what a sample costs."""
        return self._plan is not None

    def limited(self, count: int) -> int:
        """`count`, or the samples up to the next estimate where pixels have different numbers."""
        return count if self._plan is None else min(count, self._plan.remaining)

    @property
    def first(self) -> int:
        """The number of the next sample, which the shader counts from."""
        return self.samples if self._plan is None else self._plan.traced

    def record_samples(self, count: int) -> None:
        """Count samples that pixels have taken."""
        if self._plan is None:
            self.samples += count
        else:
            self._plan.traced += count
            self.samples = self._plan.samples

    @property
    def counts(self) -> NDArray[np.int64]:
        """The samples (height, width) of each pixel."""
        return np.full(self._size[::-1], self.samples) if self._plan is None else self._plan.counts

    @property
    def error(self) -> float:
        """The latest estimate; inf before there is one."""
        if self._target is None:
            return math.inf
        return self._estimate.error if self._plan is None else self._plan.error

    def _write_ranges(self, plan: SamplePlan) -> None:
        self._frame.resource("sample_ranges").upload(np.stack([plan.begins, plan.ends], axis=1).astype(np.uint32))
        self._frame.uniforms["path_sampling.has_sample_ranges"] = 1

    def _estimate_error(self) -> float:
        if self.samples >= self._estimate.next_look:
            mean = self._read("raw_radiance")
            if self.denoises:
                self._estimate.add_denoised(self.samples, mean, lambda: self._read("radiance"))
            else:
                self._estimate.add_mean(self.samples, mean)
        return self._estimate.error
