"""The device's queue: submissions, the timeline that counts them, and the deferred destruction of resources."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial

from solari_vk.base.errors import DeviceError
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.barriers import host_read_barrier
from solari_vk.gpu.device.callbacks import Callbacks, Loans
from solari_vk.gpu.device.gathering import GatheringDevice
from solari_vk.gpu.device.submission import SemaphoreValue, Submission

_WAIT_SLICE = 100_000_000  # nanoseconds: Python handles Ctrl-C between slices


class WorkQueue(GatheringDevice):
    """A device with its queue. Every submission increments the timeline; waiting means waiting for a timeline value."""

    def __init__(self, select: str | int | None, validation: bool, rays: str | None) -> None:
        super().__init__(select, validation, rays)
        self.submitted = 0
        self._completed = 0
        self._host_synced = 0
        self._owned: dict[int, Callable[[], None]] = {}
        self._next_token = 0
        self._shared: set[int] = set()
        # Timeline values and what to call when the timeline has reached them; values never fall.
        self._retired: deque[tuple[int, Callable[[], None]]] = deque()
        self._collecting = False
        self.loans = Loans()
        self.late: list[Callable[[], None]] = []
        """Are called while work is late, and raise DeviceError for what has failed that it waits for."""
        self._before_next: list[Callable[[raw.CData], None]] = []
        self._with_next: dict[raw.CData, None] = {}
        self.callbacks = Callbacks()
        timeline = raw.struct("VkSemaphoreTypeCreateInfo", semaphoreType=raw.VK_SEMAPHORE_TYPE_TIMELINE)
        self.timeline = self.create(
            "VkSemaphore", raw.struct("VkSemaphoreCreateInfo", pNext=timeline), "device timeline"
        )
        pool = raw.struct(
            "VkCommandPoolCreateInfo",
            flags=raw.VK_COMMAND_POOL_CREATE_TRANSIENT_BIT | raw.VK_COMMAND_POOL_CREATE_RESET_COMMAND_BUFFER_BIT,
            queueFamilyIndex=self.queue_family,
        )
        self._pool = self.create("VkCommandPool", pool, "device one-time commands")
        self._spare: list[Submission] = []  # of one command buffer each, which can be recorded again
        self._begin = raw.struct("VkCommandBufferBeginInfo", flags=raw.VK_COMMAND_BUFFER_USAGE_ONE_TIME_SUBMIT_BIT)
        self._counter = raw.ffi.new("uint64_t*")
        self._wait_value = raw.ffi.new("uint64_t*")
        self._wait_info = raw.struct(
            "VkSemaphoreWaitInfo", semaphoreCount=1, pSemaphores=[self.timeline], pValues=self._wait_value
        )

    # ---- submissions --------------------------------------------------------------------------------

    def submission(
        self,
        command_buffers: Sequence[raw.CData],
        waits: Sequence[SemaphoreValue] = (),
        signals: Sequence[SemaphoreValue] = (),
    ) -> Submission:
        """A submission for `submit_prepared`, which can be submitted many times."""
        return Submission(self.timeline, command_buffers, waits, signals)

    def submit(self, command_buffers: Sequence[raw.CData]) -> int:
        """Submit command buffers; returns the timeline value that marks their completion."""
        return self.submit_prepared(self.submission(command_buffers))

    def before_next_submit(self, record: Callable[[raw.CData], None]) -> None:
        """Have `record` called, and its commands submitted, just before the next submission."""
        self._before_next.append(record)

    def submit_with_next(self, commands: raw.CData) -> None:
        """Have recorded commands submitted at the head of the next submission; once, even if asked for twice.

        They run after the commands of all earlier calls of `before_next_submit`.
        """
        self.flush()
        # Asked for again, they move behind what was asked for meanwhile.
        self._with_next.pop(commands, None)
        self._with_next[commands] = None

    def start_with_next(self, record: Callable[[raw.CData], None], name: str = "") -> None:
        """Record one-time commands now, and have them submitted as by `submit_with_next`."""
        self.flush()
        recorded = self._record(record, name)
        self._with_next[recorded.commands[0]] = None
        self.retire(partial(self._spare.append, recorded))

    def submit_prepared(self, submission: Submission, *, internal: bool = False) -> int:
        """Submit; returns the timeline value that marks the completion of the commands.

        internal: for commands of the device's own, which don't count as the next submission.
        """
        self.check_open()
        if self._before_next and not internal:
            self.flush()
        value = self.submitted + 1
        self._hand_over_or_gather(submission, value, self._with_next)
        self.submitted = value
        if self._with_next:
            self._with_next.clear()
        if self._retired or self.loans.returned:
            self.collect()
        if self.messages:
            self.check_messages()
        return value

    def flush(self) -> None:
        """Submit now what waits for the next submission because of `before_next_submit`."""
        records = self._before_next
        if not records:
            return
        submitted = self.submitted
        self._before_next = []  # `record` may ask for more, which wait for the submission after this one

        def record_all(cmd: raw.CData) -> None:
            for i, record in enumerate(records):
                try:
                    record(cmd)
                except BaseException:
                    del records[i]  # what raised isn't tried again
                    raise

        try:
            self._start(record_all, "prepare resources")
        except BaseException:
            if self.submitted == submitted:  # the others still wait for the next submission
                self._before_next = records + self._before_next
            raise

    def start(self, record: Callable[[raw.CData], None], name: str = "") -> int:
        """Record one-time commands and submit them without waiting; returns the timeline value of their completion."""
        self.flush()
        return self._start(record, name)

    def run(self, record: Callable[[raw.CData], None], name: str = "") -> None:
        """Record one-time commands, submit them and wait until they are done."""
        self.await_value(self.start(record, name))

    def _start(self, record: Callable[[raw.CData], None], name: str) -> int:
        recorded = self._record(record, name)
        value = self.submit_prepared(recorded, internal=True)
        self.retire(partial(self._spare.append, recorded))
        return value

    def _record(self, record: Callable[[raw.CData], None], name: str) -> Submission:
        """One-time commands, which the caller puts into `_spare` when they are done."""
        recorded = self._spare.pop() if self._spare else self.submission([self._allocate_commands()])
        (commands,) = recorded.commands
        try:
            self.vk.vkBeginCommandBuffer(commands, self._begin)
            with self.label(commands, name or "one-time commands"):
                record(commands)
            self.vk.vkEndCommandBuffer(commands)
        except BaseException:
            self.vk.vkResetCommandBuffer(commands, 0)
            self._spare.append(recorded)
            raise
        return recorded

    def _allocate_commands(self) -> raw.CData:
        allocate = raw.struct("VkCommandBufferAllocateInfo", commandPool=self._pool, commandBufferCount=1)
        buffers = raw.ffi.new("VkCommandBuffer[1]")
        self.vk.vkAllocateCommandBuffers(self.handle, allocate, buffers)
        return buffers[0]

    @property
    def completed(self) -> int:
        """The timeline's value: all submissions up to it are done."""
        # Asking the driver takes longer than all else here: not once everything is known to be done.
        if self._completed < self.submitted:
            self.vk.vkGetSemaphoreCounterValue(self.handle, self.timeline, self._counter)
            self._completed = self._counter[0]
        return self._completed

    @property
    def idle(self) -> bool:
        """Whether no work is running or waiting to be submitted. A lost device is never idle."""
        return not (self.lost or self._before_next or self._with_next) and self.completed == self.submitted

    def wait(self, value: int) -> None:
        """Wait until the timeline reaches a value that a submission returned; then do what `poll` does."""
        self.await_value(value)
        self.callbacks.call()

    def wait_idle(self) -> None:
        """Wait for all work submitted so far or waiting to be submitted; then do what `poll` does."""
        self.flush()
        self.await_idle()
        self.callbacks.call()

    def poll(self) -> None:
        """Free what the device no longer uses, and call the callbacks (`Blas.prepare_compaction`) that are due.

        Only `poll`, `wait` and `wait_idle` call callbacks: all of them, before raising CallbackError if any raised.
        """
        self.collect()
        self.check_messages()
        self.callbacks.call()

    def await_value(self, value: int) -> None:
        """Wait until the timeline reaches a value, without calling callbacks: for waits inside other operations.

        Raises DeviceError on a closed device, which frames need before they write to mapped memory.
        """
        self.check_open()
        if value > self.submitted:
            raise DeviceError(f"wait for submission {value}, but there were only {self.submitted} submissions")
        if self._completed < value:
            self._hand_over()
            self._wait_value[0] = value
            # vkWaitSemaphores returns VK_TIMEOUT at the end of a slice, which is no error.
            while self.vk.vkWaitSemaphores(self.handle, self._wait_info, _WAIT_SLICE) != raw.VK_SUCCESS:
                self._check_late()
            self._completed = value
        if self._retired or self.loans.returned:
            self.collect()
        if self.messages:
            self.check_messages()

    def reaches(self, value: int, seconds: float) -> bool:
        """Wait until the timeline reaches a value, for some seconds at most; returns whether it has. `await_value` then
        does what else is due."""
        self.check_open()
        if self._completed < value:
            self._hand_over()
            self._wait_value[0] = value
            result = self.vk.vkWaitSemaphores(self.handle, self._wait_info, round(seconds * 1e9))
            return bool(result == raw.VK_SUCCESS)
        return True

    def _check_late(self) -> None:
        for check in self.late:
            check()

    def await_idle(self) -> None:
        """Wait for all submitted work, without calling callbacks or flushing `before_next_submit`.

        The allocator waits like this when memory runs out, possibly while such commands are being prepared.
        """
        if self._with_next:
            self.submit_prepared(self.submission([]), internal=True)
        self.await_value(self.submitted)

    def sync_host(self) -> None:
        """Wait for all submitted work and make its writes to mapped memory visible to the host."""
        if self.submitted == self._host_synced and not (self._before_next or self._with_next):
            return
        self.run(lambda cmd: self.vk.vkCmdPipelineBarrier2(cmd, host_read_barrier()), "host reads")
        self._host_synced = self.submitted

    # ---- lifetime -----------------------------------------------------------------------------------

    def register(self, destroy: Callable[[], None]) -> int:
        """Register how an object is destroyed; returns a token for `release`. Closing the device destroys the rest."""
        self._next_token += 1
        self._owned[self._next_token] = destroy
        return self._next_token

    def share(self, token: int) -> None:
        """Record that an object is the device's own, so that `undone_on_error` keeps it."""
        self._shared.add(token)

    @contextmanager
    def undone_on_error(self) -> Iterator[None]:
        """Destroy what was registered inside, if an error leaves it: for constructors of what owns several objects."""
        first = self._next_token
        try:
            yield
        except BaseException:
            for token in range(self._next_token, first, -1):
                if token not in self._shared:
                    self.release(token)
            raise

    def release(self, token: int) -> None:
        """Destroy an owned object once the work submitted so far is done. A second call has no effect."""
        if self.closed:
            return  # the end of the device destroys it
        self._shared.discard(token)
        destroy = self._owned.pop(token, None)
        if destroy is not None:
            self.retire(destroy)

    @property
    def live_objects(self) -> int:
        """How many owned objects exist, including those that wait for their destruction."""
        return len(self._owned) + len(self._retired)

    @property
    def objects_in_use(self) -> int:
        """`live_objects` without those that the device keeps for later, such as staging memory."""
        return self.live_objects - len(self._shared)

    def retire(self, destroy: Callable[[], None]) -> None:
        """Call `destroy` when all work submitted so far, or due with the next submission, is done."""
        if self.forked:
            return  # it is the parent's to destroy
        if self.closed:
            raise DeviceError(f"{self.name} {self.closed_how}")
        # What waits for the next submission may use the object too: its commands are recorded, not submitted.
        is_used_by_next = bool(self._with_next or self._before_next)
        last_use = self.submitted + 1 if is_used_by_next else self.submitted
        self._retired.append((last_use, destroy))
        self.collect()

    def collect(self) -> None:
        """Destroy the retired objects that the device no longer uses. Calls no callback."""
        if not (self._retired or self.loans.returned) or self.lost or self._collecting:
            return
        completed = self.completed
        self._collecting = True  # objects retired during destruction join this loop, which avoids recursion
        try:
            self.loans.collect()
            while self._retired and self._retired[0][0] <= completed:
                self._retired.popleft()[1]()
        finally:
            self._collecting = False

    def _finish(self) -> None:
        """Wait for all work, for a lost device at most a second, and destroy everything that is left."""
        # The function of the driver, not that of `vk`, which raises DeviceError on a lost device.
        wait = raw.ffi.cast("PFN_vkWaitSemaphores", raw.lib.vkGetDeviceProcAddr(self.handle, b"vkWaitSemaphores"))
        self._wait_value[0] = self.submitted
        waited = 0
        while wait(self.handle, self._wait_info, _WAIT_SLICE) == raw.VK_TIMEOUT and not (self.lost and waited > 10):
            waited += 1
            with suppress(DeviceError):
                self._check_late()
        self.loans.collect()  # what a last view's end gives back
        # In reverse order of creation: an object may depend on earlier ones, such as a view on its image.
        retired = [destroy for _, destroy in self._retired]
        for destroy in [*retired, *reversed(self._owned.values())]:
            destroy()
        self._retired.clear()
        self._owned.clear()
        self.callbacks.clear()

    def _destroy_queue(self) -> None:
        self.vk.vkDestroyCommandPool(self.handle, self._pool, raw.NULL)
        self.vk.vkDestroySemaphore(self.handle, self.timeline, raw.NULL)
