"""A folder of pictures whose rendering can be stopped and resumed: a journal beside them says what is finished."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from solari_vk.base.budget import load_budget
from solari_vk.base.errors import SolariError
from solari_vk.base.files import (
    NO_LINK,
    cannot_be,
    charge_json,
    make_beside,
    open_regular,
    read_regular,
    remove_unfinished,
    replace,
    whole_file,
    write_whole,
)
from solari_vk.base.folder_lock import lock_folder
from solari_vk.data.datasets.tasks import File, RenderTask
from solari_vk.renderers.cluster.device_session import OneDevice, pack
from solari_vk.renderers.cluster.worker_pool import TICK_SECONDS, WorkerPool
from solari_vk.scene.model import Camera, Scene

_APPENDING = os.O_WRONLY | os.O_APPEND | os.O_CREAT | NO_LINK | getattr(os, "O_BINARY", 0)
LATE_SECONDS = 60.0  # for which NFS, as it is set up by default, may not show a new file to another machine


class Journal:
    """The tasks whose files are in the journal's folder, one JSON line each, with the SHA-256 of each file.

    made_of: what all tasks of the folder have in common, by name. As long as the object lives, no other process can
    open it. Raises SolariError if another one has, for a journal of other pictures, and for one that can't be read.
    """

    def __init__(self, path: Path, made_of: dict[str, Any]) -> None:
        self._path = path
        # Two processes would render the same pictures, and mix their lines.
        self._lock = lock_folder(path.with_name(f"{path.name}.lock"))
        self._files: dict[str, dict[str, str]] = {}  # by the keys of the tasks
        # Through JSON and back, so that it can be compared with what was read: tuples become lists.
        head = json.loads(_as_json({"made_of": made_of}))
        begin = json.dumps(head, sort_keys=True) + "\n"
        *lines, rest = self._read().split(b"\n")
        # A process that was killed left a part of the first line, or of a later one. Only a journal is cut, so that no
        # other file of this name loses anything.
        if not lines and begin.encode().startswith(rest):
            self._cut(0)
            self._append(begin)
            return
        try:
            first, *others = [json.loads(line) for line in lines]
            recorded = dict(first["made_of"])
            self._files = {line["task"]: dict(line["files"]) for line in others}
        except (ValueError, TypeError, KeyError, RecursionError) as error:
            raise SolariError(f"{path}: is damaged: {error}: remove it, and all pictures are made anew") from None
        different = [name for name, value in head["made_of"].items() if recorded.get(name) != value]
        if different:
            raise SolariError(
                f"{path.parent}: its pictures were made with another {', another '.join(different)}: give another "
                f"folder, or remove {path}"
            )
        if rest:
            self._cut(sum(len(line) + 1 for line in lines))

    @property
    def stem(self) -> str:
        """The name of the journal's file without its suffix."""
        return self._path.stem

    @property
    def folder(self) -> Path:
        """Where the files are."""
        return self._path.parent

    def _read(self) -> bytes:
        if not os.path.lexists(self._path):
            return b""
        with load_budget():
            data = read_regular(self._path, str(self._path), follow=False)
            charge_json(data, str(self._path))
        return data

    def _cut(self, length: int) -> None:
        with self._opened() as file:
            file.truncate(length)

    def _append(self, text: str) -> None:
        with self._opened() as file:
            file.write(text.encode())

    @contextmanager
    def _opened(self) -> Iterator[BinaryIO]:
        try:
            with open(os.open(self._path, _APPENDING, 0o666), "ab") as file:
                yield file
        except OSError as error:
            raise cannot_be("written", self._path, error) from None

    def remove(self, tasks: Sequence[RenderTask]) -> None:
        """Remove the files of tasks, those in the journal of an earlier and longer run, and the journal, which is of
        no use then; the lock stays until the object is gone."""
        names = {name for task in tasks for name in task.files}
        names.update(name for files in self._files.values() for name in files)
        for name in (*names, self._path.name):
            with suppress(OSError):
                (self.folder / name).unlink()

    def check(self, tasks: Sequence[RenderTask]) -> None:
        """Raise SolariError if a task would replace a file that is in the folder as that of another one."""
        owners = {name: key for key, files in self._files.items() for name in files}
        for task in tasks:
            key = _key(task)
            for name in task.files:
                if owners.get(name, key) != key:
                    raise SolariError(
                        f"{self.folder / name}: is there already, with another camera, exposure or time, or from a run "
                        f"of another length: give another folder, or remove {self._path}"
                    )

    def has(self, task: RenderTask) -> bool:
        """Whether all files of a task are in the folder with the content that they had."""
        files = self._files.get(_key(task), {})
        return all(name in files and _sha256(self.folder / name) == files[name] for name in task.files)

    def record(self, task: RenderTask, files: dict[str, str]) -> None:
        """Record that a task's files are in the folder. files: the SHA-256 of each by its name."""
        # The line comes after the files, so that a task in the journal is always complete in the folder.
        self._files[_key(task)] = files
        self._append(json.dumps({"task": _key(task), "files": files}) + "\n")


def open_journal(path: Path, pool: WorkerPool | OneDevice, scene: Scene, tasks: Sequence[RenderTask]) -> Journal:
    """The journal of tasks, of which all have one style. Raises SolariError for a folder with other pictures."""
    if not tasks:
        raise SolariError(f"{path}: there is nothing to render: give at least one task")
    made_of = {"scene": pack(scene)[0], "device or code": pool.identity, "style": tasks[0].style}
    journal = Journal(path, made_of)
    journal.check(tasks)
    return journal


def render_tasks(
    pool: WorkerPool | OneDevice,
    scene: Scene,
    tasks: Sequence[RenderTask],
    path: Path,
    *,
    progress: Callable[[int], object] | None = None,
) -> int:
    """Render the tasks that aren't finished into the folder of their journal, `path`; returns the number of pictures
    that are there at the end.

    progress: is called with the number of finished pictures, about once a second; when it returns True, rendering ends.
    All tasks have one style. Raises SolariError without tasks, for a folder with other pictures, a file that can't be
    written, and when workers fail; pictures that are finished stay, and the next call goes on after them.
    """
    return render_missing(pool, scene, tasks, open_journal(path, pool, scene, tasks), progress)


def render_missing(
    pool: WorkerPool | OneDevice,
    scene: Scene,
    tasks: Sequence[RenderTask],
    journal: Journal,
    progress: Callable[[int], object] | None,
) -> int:
    """`render_tasks` with an open journal."""
    own = journal.folder / f"{journal.stem}.workers"
    remove_unfinished(journal.folder, {own.name, *(name for task in tasks for name in task.files)})
    missing = [task for task in tasks if not journal.has(task)]
    count = _count_views(tasks) - _count_views(missing)
    if progress is not None and progress(count):
        return count
    with ExitStack() as stack:
        if isinstance(pool, WorkerPool) and any(task.folder for task in missing):
            # A worker may go on for long with a task that was called off. In a folder of this run, which is gone then,
            # it can't replace pictures of a later run.
            folder = make_beside(own)
            stack.callback(shutil.rmtree, folder, ignore_errors=True)
            missing = [
                task if task.folder is None else dataclasses.replace(task, folder=str(folder)) for task in missing
            ]
        # Closing the generator cancels what the workers have not begun, also when an error ends the loop.
        results = stack.enter_context(closing(pool.map(scene, missing)))
        for done in results:
            # None comes about once a second while nothing is done, so that the progress can end the work.
            if done is not None:
                task, files = done
                _store(journal.folder, task, files)
                journal.record(task, {name: file.sha256 for name, file in files.items()})
                count += len(task.views)
            if progress is not None and progress(count):
                break
    return count


def _store(folder: Path, task: RenderTask, files: dict[str, File]) -> None:
    """Write the files that a worker sent, and wait for those that it wrote itself, in the task's folder."""
    for name, file in files.items():
        if file.data is None:
            written = Path(task.folder or folder) / name
            _await_file(written)
            if written.parent != folder:
                with whole_file(folder / name) as temporary:
                    replace(written, temporary)
        else:
            write_whole(folder / name, file.data)


def _await_file(path: Path) -> None:
    """Wait until a file that a worker wrote is seen here: network file systems show it late."""
    deadline = time.monotonic() + LATE_SECONDS
    while not path.exists():
        try:
            os.listdir(path.parent)  # has NFS look at the folder again
        except OSError as error:
            text = (
                f"{path.parent}: can't be read any more: {error.strerror}: bring the folder back, or give another one"
            )
            raise SolariError(text) from None
        if time.monotonic() > deadline:
            raise SolariError(
                f"{path}: a worker wrote it, but it isn't here: the folder isn't on a file system that all machines "
                "share: leave --shared-folder out, or give another folder"
            )
        time.sleep(TICK_SECONDS)


def _count_views(tasks: Sequence[RenderTask]) -> int:
    return sum(len(task.views) for task in tasks)


def _key(task: RenderTask) -> str:
    """What names a task in the journal: a hash of all that its pictures depend on."""
    return hashlib.sha256(_as_json(task).encode()).hexdigest()[:16]


def _as_json(value: Any) -> str:
    return json.dumps(value, default=_plain, sort_keys=True)


def _plain(value: Any) -> Any:
    # A camera is a checked object and no dataclass of plain values; jitter isn't a part of its pose.
    if isinstance(value, Camera):
        return {**value.pose(), "jitter": value.jitter.tolist()}
    if dataclasses.is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in dataclasses.fields(value) if field.compare}
    assert isinstance(value, np.generic)
    return value.item()


def _sha256(path: Path) -> str:
    try:
        with open_regular(path, str(path), follow=False) as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except SolariError:
        return ""
