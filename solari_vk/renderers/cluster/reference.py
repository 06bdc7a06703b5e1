"""The reference path tracer on many devices: samples in chunks, summed in a fixed order.

A chunk is some consecutive samples of all pixels, so that any worker can trace any chunk. Sums are taken in
float64 in the order of the chunks' numbers, so that the bits of the picture don't depend on who traced what, and when.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from numbers import Integral
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError, quoted
from solari_vk.output import oidn
from solari_vk.output.error import ErrorEstimate, luminance
from solari_vk.renderers.cluster.device_session import DeviceSession, OneDevice
from solari_vk.renderers.cluster.worker_pool import WorkerPool
from solari_vk.renderers.sample_counts import FIRST_DENOISED_LOOK, check_target
from solari_vk.scene.model import Camera, Scene

CHUNKS = 32  # of a picture with few samples, so that as many workers have something to do
LARGEST_CHUNK = 64  # samples per pixel: a longer one would be lost as a whole with its worker
CHUNK_OF_TARGET = 16  # samples per pixel where an error ends the picture, which may then have a chunk too many
OF_ALL_SAMPLES = ("radiance", "raw_radiance", "variance")  # results of PathTracer


def chunk_samples(samples: int | None) -> int:
    """The samples per pixel of a chunk of a picture with so many samples; None: as many as its error takes."""
    if samples is None:
        return CHUNK_OF_TARGET
    return min(max(math.ceil(samples / CHUNKS), 1), LARGEST_CHUNK)


@dataclass(frozen=True)
class Chunk:
    """Some samples of all pixels, from a number on. names: further results that the chunk brings along."""

    index: int
    first_sample: int
    samples: int
    camera: Camera
    size: tuple[int, int]
    max_bounces: int
    seed: int
    names: tuple[str, ...] = ()
    guided: bool = False

    @property
    def name(self) -> str:
        """What the job is, for messages."""
        return f"chunk {self.index} of {self.samples} samples a pixel"

    @property
    def clip(self) -> None:
        """None: a chunk shows the scene as it was given."""

    def perform(self, session: DeviceSession) -> ChunkResult:
        """Trace the samples."""
        # The samples of all chunks are points of one low-discrepancy sequence, of which each has its own section.
        tracer = session.path_tracer(self.size, self.max_bounces, self.seed, self.first_sample)
        frame = tracer.render(self.camera, self.samples)
        width, height = self.size
        return ChunkResult(
            self.samples,
            frame["radiance"],
            tracer.read("luminance_deviations").reshape(height, width),
            tracer.rays,
            {name: frame[name] for name in self.names},
            tracer.read_guides() if self.guided else [],
        )


@dataclass(frozen=True)
class ChunkResult:
    """A chunk's mean radiance (height, width, 3), and the sum of squared deviations of luminance (height, width)."""

    samples: int
    mean: NDArray[np.float32]
    deviations: NDArray[np.float32]
    rays: int
    layers: dict[str, NDArray[Any]]
    guides: list[NDArray[Any]]


@dataclass
class ReferencePicture:
    """A picture of the reference path tracer, summed from chunks."""

    denoised: bool = False
    samples: int = 0
    """The number of samples per pixel."""
    rays: int = 0
    error: float = math.inf
    """The estimated error, as `PathTracer.error` has it; inf without a target."""
    layers: dict[str, NDArray[Any]] = field(default_factory=dict)
    """Further results by name, as PathTracer has them."""
    _mean: Any = 0.0
    _deviations: Any = 0.0
    _guides: list[NDArray[Any]] = field(default_factory=list)
    _waiting: dict[int, ChunkResult] = field(default_factory=dict)
    _next: int = 0
    _denoised: tuple[int, NDArray[np.float32]] | None = None

    @property
    def raw_radiance(self) -> NDArray[np.float32]:
        """The mean of the samples, (height, width, 3) in cd/m^2."""
        return np.asarray(self._mean, np.float32)

    @property
    def radiance(self) -> NDArray[np.float32]:
        """The picture, (height, width, 3) in cd/m^2, denoised by OIDN if that was asked for."""
        if not self.denoised:
            return self.raw_radiance
        if self._denoised is None or self._denoised[0] != self.samples:
            self._denoised = self.samples, oidn.denoise(self.raw_radiance, *self._guides)
        return self._denoised[1]

    @property
    def variance(self) -> NDArray[np.float32]:
        """Variance of the mean luminance (height, width) of independent samples; inf after a single sample."""
        count = self.samples
        if count < 2:
            return np.full(np.shape(self._deviations), np.inf, np.float32)
        return np.asarray(self._deviations / (count * (count - 1)), np.float32)

    def receive(self, index: int, result: ChunkResult) -> None:
        """Keep a chunk until it is added in its turn."""
        self._waiting[index] = result

    def add_next(self) -> bool:
        """Add the chunk whose turn it is, and return True; False if it hasn't been received."""
        chunk = self._waiting.pop(self._next, None)
        if chunk is None:
            return False
        self._add(chunk)
        self._next += 1
        return True

    def add_rest(self) -> None:
        """Add the chunks that are here, in order, though chunks before them are missing."""
        for index in sorted(self._waiting):
            self._add(self._waiting.pop(index))

    def _add(self, chunk: ChunkResult) -> None:
        # The mean and the sum of squared deviations of two sets of samples are merged as by Chan, Golub and LeVeque,
        # "Updating Formulae and a Pairwise Algorithm for Computing Sample Variances" (1979).
        before = self.samples
        count = before + chunk.samples
        difference = chunk.mean.astype(np.float64) - self._mean
        self._mean = self._mean + difference * (chunk.samples / count)
        self._deviations = self._deviations + chunk.deviations.astype(np.float64)
        if before:
            self._deviations += luminance(difference) ** 2 * (before * chunk.samples / count)
        self.samples = count
        self.rays += chunk.rays
        self.layers.update(chunk.layers)
        self._guides = self._guides or chunk.guides


def render_reference(
    pool: WorkerPool | OneDevice,
    scene: Scene,
    size: tuple[int, int],
    *,
    camera: Camera | None = None,
    samples: int | None = 256,
    seed: int = 0,
    max_bounces: int = 16,
    layers: Sequence[str] = (),
    denoise: bool = False,
    target_error: float | None = None,
    progress: Callable[[int, float], object] | None = None,
) -> ReferencePicture:
    """A picture with `samples` samples per pixel from all workers of a pool.

    camera: by default the scene's. layers: names of further results of PathTracer. denoise: `radiance` is denoised, in
    this process. target_error: the error at which the picture is done; samples may then be None, for as many as it
    takes. The error is looked at after the same chunks for any number of workers. progress: is called with the samples
    per pixel and the estimated error, about once a second; when it returns True, rendering ends with what is done.
    Raises SolariError for wrong options, and when workers fail.
    """
    _check_aim(samples, target_error)
    if denoise:
        oidn.check_installed()
    if camera is None:
        camera = scene.camera_for(size[0] / size[1])
    if isinstance(layers, str):
        layers = (layers,)
    # What the samples of all chunks make is the picture's; other layers are the same in each, so the first brings them.
    names = tuple(name for name in layers if name not in OF_ALL_SAMPLES)
    first = Chunk(0, 0, chunk_samples(samples), camera, size, max_bounces, seed, names, guided=denoise)
    picture = ReferencePicture(denoise)
    estimate = ErrorEstimate(FIRST_DENOISED_LOOK if denoise else 1)
    with closing(pool.map(scene, _chunks(first, samples))) as results:
        for done in results:
            if done is not None:
                job, result = done
                picture.receive(job.index, result)
            if _add_chunks(picture, estimate, target_error):
                break
            if progress is not None and picture.samples and progress(picture.samples, estimate.error):
                picture.add_rest()
                break
    picture.error = estimate.error
    picture.layers.update({name: getattr(picture, name) for name in OF_ALL_SAMPLES if name in layers})
    return picture


def _check_aim(samples: Any, target_error: Any) -> None:
    """Raise SolariError where nothing says how many samples a picture takes."""
    check_target(target_error, "render_reference")
    if samples is None and not target_error:
        raise SolariError("render_reference: give a number of samples, or a target_error above 0")
    if samples is not None and (not isinstance(samples, Integral) or samples < 1):
        raise SolariError(f"render_reference: samples must be a whole number from 1 on, not {quoted(samples)}")


def _add_chunks(picture: ReferencePicture, estimate: ErrorEstimate, target_error: float | None) -> bool:
    """Add the received chunks whose turn it is, until the target is met. Returns whether it is.

    The error is looked at after each chunk, so that the picture has the same chunks for any number of workers."""
    while picture.add_next():
        if target_error is not None and _estimated_error(estimate, picture) <= target_error:
            return True
    return False


def _chunks(first: Chunk, samples: int | None) -> Iterator[Chunk]:
    """All chunks of a picture, endless without a number of samples."""
    # Further results are the same for all samples, so only the first chunk brings them.
    yield first
    other = dataclasses.replace(first, names=(), guided=False)
    for index in itertools.count(1):
        begin = index * first.samples
        left = first.samples if samples is None else min(first.samples, samples - begin)
        if left <= 0:
            return
        yield dataclasses.replace(other, index=index, first_sample=begin, samples=left)


def _estimated_error(estimate: ErrorEstimate, picture: ReferencePicture) -> float:
    if picture.samples >= estimate.next_look:
        if picture.denoised:
            estimate.add_denoised(picture.samples, picture.raw_radiance, lambda: picture.radiance)
        else:
            estimate.add_mean(picture.samples, picture.raw_radiance)
    return estimate.error
