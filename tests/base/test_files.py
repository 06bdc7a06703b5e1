"""Files that are written whole: what they may replace, and what an error says."""

from __future__ import annotations

import errno
import hashlib
import os
import re
import stat
import warnings

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.base import disk_cache
from solari_vk.base.errors import SolariError
from solari_vk.base.files import (
    cannot_be,
    check_writable,
    followed,
    open_regular,
    read_regular,
    replace,
    whole_file,
    write_whole,
)

STRANGER = 12345  # another user's number
IS_ROOT = hasattr(os, "geteuid") and os.geteuid() == 0


def write(path):
    write_whole(followed(path), "new")


@pytest.mark.posix
@pytest.mark.parametrize("attempt", [check_writable, write])
def test_pipes_and_devices_are_no_files(tmp_path, attempt):
    """As root one could replace them."""
    pipe, link = tmp_path / "pipe.md", tmp_path / "link.md"
    os.mkfifo(pipe)
    link.symlink_to(pipe)
    for path in (pipe, link):
        with pytest.raises(SolariError, match=rf"{path.name}: is a device or pipe: give the name of a file$"):
            attempt(path)
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    assert sorted(os.listdir(tmp_path)) == ["link.md", "pipe.md"]


@pytest.mark.posix
def test_a_link_stays_and_its_file_is_replaced(tmp_path):
    folder, link = tmp_path / "folder", tmp_path / "link.md"
    folder.mkdir()
    link.symlink_to("folder/file.md")
    for _ in range(2):  # a link to no file yet, and to a file
        check_writable(link)
        write(link)
        assert link.is_symlink()
        assert (folder / "file.md").read_text() == "new"
        (folder / "file.md").write_text("old")
    assert (os.listdir(folder), sorted(os.listdir(tmp_path))) == (["file.md"], ["folder", "link.md"])


@pytest.mark.posix
def test_a_link_into_no_folder_names_the_folder(tmp_path):
    link = tmp_path / "link.md"
    link.symlink_to("missing/file.md")
    with pytest.raises(SolariError, match=r"file.md: there is no folder .*missing: make it first$"):
        write(link)


@pytest.mark.posix
def test_a_name_that_is_too_long(tmp_path):
    for attempt in (check_writable, write):
        with pytest.raises(SolariError, match=r"can't be written: File name too long: choose a shorter name$"):
            attempt(tmp_path / f"{'a' * 300}.md")
        with pytest.raises(SolariError, match=r"a\\x00.md': has a null character: choose another name$"):
            attempt(tmp_path / "a\0.md")


def test_an_error_of_a_library_has_a_remedy(tmp_path):
    said = str(cannot_be("written", tmp_path / "a.mp4", RuntimeError("ffmpeg: unknown encoder")))
    assert said.endswith("unknown encoder: make room there, choose another folder, or mend what the reason names")


@pytest.mark.posix
def test_names_beside_a_file_can_not_be_foreseen_or_taken(tmp_path, monkeypatch):
    """A link that somebody put in the way is neither followed nor replaced."""
    seen = []
    for _ in range(2):
        with whole_file(tmp_path / "x.txt") as temporary:
            seen.append(temporary.name)
            temporary.write_text("new")
    assert len({*seen}) == 2
    monkeypatch.setattr("secrets.token_hex", lambda count: "known")
    (tmp_path / "victim").write_text("old")
    (tmp_path / ".x.known.txt").symlink_to(tmp_path / "victim")
    with pytest.raises(SolariError, match="File exists"):
        write(tmp_path / "x.txt")
    assert (tmp_path / "victim").read_text() == "old"


@pytest.mark.posix
def test_names_that_the_package_chose_lead_nowhere(tmp_path):
    """A link that somebody put where a file of a folder is written is replaced, and not what it leads to."""
    victim, link = tmp_path / "victim", tmp_path / "views.json"
    victim.write_text("precious")
    for target in (victim, tmp_path / "nowhere", "link"):
        link.unlink(missing_ok=True)
        link.symlink_to(target)
        write_whole(link, "new")
        assert (link.is_symlink(), link.read_text(), victim.read_text()) == (False, "new", "precious")
    link.unlink()
    link.symlink_to(victim)
    for read in (open_regular(link, "link", follow=False).__enter__, lambda: read_regular(link, "link", follow=False)):
        with pytest.raises(SolariError, match="link: can't be read"):
            read()


@pytest.mark.skipif(not IS_ROOT, reason="only root may give files away")
def test_links_of_other_users_lead_nowhere(tmp_path):
    victim, link = tmp_path / "victim.png", tmp_path / "picture.png"
    victim.write_text("precious")
    link.symlink_to(victim)
    os.lchown(link, STRANGER, STRANGER)
    tmp_path.chmod(0o1777)  # as /tmp
    with pytest.raises(SolariError, match=r"picture\.png: is a link of another user: remove it"):
        sv.save_image(link, np.zeros((2, 2, 3)))
    assert (link.is_symlink(), victim.read_text()) == (True, "precious")
    tmp_path.chmod(0o755)  # where only this user can have made it, as root for somebody
    sv.save_image(link, np.zeros((2, 2, 3)))
    assert link.is_symlink()
    assert victim.read_bytes()[1:4] == b"PNG"


def refuse():
    raise PermissionError(errno.EPERM, "not permitted")


@pytest.mark.posix
def test_a_new_file_has_no_more_readers_than_the_old_one(tmp_path, monkeypatch):
    """Whoever writes: the package, or a library to the name that it is given."""
    chown = os.chown
    black = np.zeros((2, 2, 3), np.float32)
    for name in ("a.png", "a.npy", "a.npz", "a.exr"):
        path = tmp_path / name
        for mode in (0o600, 0o640):
            path.touch()
            path.chmod(mode)
            sv.save_image(path, black)
            assert stat.S_IMODE(path.stat().st_mode) == mode, name
    if IS_ROOT:
        os.chown(path, STRANGER, STRANGER)
        sv.save_image(path, black)
        assert (path.stat().st_uid, path.stat().st_gid) == (STRANGER, STRANGER)
        path.chmod(0o664)
        # Members of a group may give files to it, and only root to another user.
        monkeypatch.setattr(os, "chown", lambda path, user, group: chown(path, user, group) if user == -1 else refuse())
        sv.save_image(path, black)
        assert (path.stat().st_uid, path.stat().st_gid) == (os.geteuid(), STRANGER)
        assert stat.S_IMODE(path.stat().st_mode) == 0o664
    monkeypatch.setattr(os, "chmod", lambda *_: refuse())  # as on a disk without modes
    sv.save_image(path, black)


def test_a_file_that_is_read_only_stays(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "access", lambda path, mode: False)  # as for all users but root
    (tmp_path / "a.png").write_text("precious")
    for attempt in (check_writable, write):
        with pytest.raises(SolariError, match="the file there is read-only: choose"):
            attempt(tmp_path / "a.png")
    assert (tmp_path / "a.png").read_text() == "precious"


def test_a_gltf_file_takes_nobody_else_s_bin(tmp_path):
    scene = sv.builtin("cornell_box")
    (tmp_path / "b.bin").write_text("precious")
    for _ in range(2):  # its own it replaces
        scene.save(tmp_path / "b.gltf")
    assert sorted(os.listdir(tmp_path)) == ["b-2.bin", "b.bin", "b.gltf"]
    assert (tmp_path / "b.bin").read_text() == "precious"
    assert len(sv.load(tmp_path / "b.gltf").instances) == len(scene.instances)


def entry_is_trusted(folder, monkeypatch):
    monkeypatch.setenv("SOLARI_VK_CACHE", str(folder))
    disk_cache._warned_of.clear()
    with warnings.catch_warnings(record=True) as noted:
        warnings.simplefilter("always")
        found = [disk_cache.load("entry") for _ in range(2)]
    for warning in noted:
        assert re.search("other users can write|is another user's|can't be trusted", str(warning.message))
    assert (len(noted), *found) in ((1, None, None), (0, b"mine", b"mine"), (0, None, None))
    return found[0] is not None


def give_group(path):
    os.chown(path, -1, STRANGER)
    path.chmod(0o770)


DOORS = {
    "all": lambda parent, cache: cache.chmod(0o777),
    "all, but not rename": lambda parent, cache: cache.chmod(0o1777),
    "all, one above": lambda parent, cache: parent.chmod(0o777),
    "a group": lambda parent, cache: give_group(cache),
    "a group, one above": lambda parent, cache: give_group(parent),
    "the owner": lambda parent, cache: os.chown(cache, STRANGER, -1),
    "the owner of what is above": lambda parent, cache: os.chown(parent, STRANGER, -1),
    "all, of an entry": lambda parent, cache: (cache / "entry").chmod(0o666),
    "a group, of an entry": lambda parent, cache: give_group(cache / "entry"),
    "the owner of an entry": lambda parent, cache: os.chown(cache / "entry", STRANGER, -1),
}


@pytest.mark.skipif(not IS_ROOT, reason="only root may give files away")
@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("links", [False, True])
def test_a_cache_is_trusted_if_nobody_else_can_write_on_the_whole_way(tmp_path, monkeypatch, door, links):
    parent = tmp_path / "parent"
    cache = parent / "cache"
    cache.mkdir(parents=True)
    content = b"mine"
    (cache / "entry").write_bytes(hashlib.sha256(content).digest() + content)
    way = tmp_path / "link" if links else cache
    if links:
        way.symlink_to(cache)
    assert entry_is_trusted(way, monkeypatch)
    parent.chmod(0o1777)  # as /tmp
    assert entry_is_trusted(way, monkeypatch)
    parent.chmod(0o755)
    DOORS[door](parent, cache)
    assert not entry_is_trusted(way, monkeypatch)


@pytest.mark.posix
def test_a_new_cache_is_its_user_s_alone(tmp_path, monkeypatch):
    monkeypatch.setenv("SOLARI_VK_CACHE", str(tmp_path / "a" / "b"))
    before = os.umask(0)
    try:
        disk_cache.store("c/entry", b"mine")
    finally:
        os.umask(before)
    assert disk_cache.load("c/entry") == b"mine"
    assert {stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("a", "a/b", "a/b/c")} == {0o700}
    assert stat.S_IMODE((tmp_path / "a/b/c/entry").stat().st_mode) == 0o600
    os.rename(tmp_path / "a/b/c/entry", tmp_path / "moved")
    (tmp_path / "a/b/c/entry").symlink_to(tmp_path / "moved")
    assert disk_cache.load("c/entry") is None


@pytest.mark.posix
def test_a_link_to_another_ending_is_refused(tmp_path):
    """Writers choose the format by the ending."""
    (tmp_path / "store").write_text("kept")
    (tmp_path / "picture.jpg").symlink_to("store")
    with pytest.raises(SolariError, match="ends otherwise"):
        sv.save_image(tmp_path / "picture.jpg", np.zeros((2, 2, 3), np.uint8))
    assert (tmp_path / "store").read_text() == "kept"


# ---- what Windows does otherwise --------------------------------------------------------------------


def in_use(path):
    """The error of Windows for a file that another program has open."""
    error = PermissionError(errno.EACCES, "used by another process", str(path))
    error.winerror = 32
    return error


def test_a_file_that_is_in_use_for_a_moment_is_replaced(tmp_path, monkeypatch):
    source, target = tmp_path / "new", tmp_path / "old"
    refusals = [in_use(target)] * 3
    move = os.replace

    def busy(*paths):
        if refusals:
            raise refusals.pop()
        move(*paths)

    source.write_text("new")
    monkeypatch.setattr(os, "replace", busy)
    replace(source, target)
    assert (refusals, target.read_text()) == ([], "new")


def test_a_file_that_stays_in_use_is_named_with_the_remedy(tmp_path, monkeypatch):
    def busy(*_):
        raise in_use(tmp_path)

    (tmp_path / "a.png").write_text("old")
    monkeypatch.setattr(os, "replace", busy)
    monkeypatch.setattr("solari_vk.base.files._IN_USE_SECONDS", 0.05)
    with pytest.raises(SolariError, match="used by another process: close the program that has it open"):
        write(tmp_path / "a.png")
    assert os.listdir(tmp_path) == ["a.png"]


def test_windows_long_paths_and_names_of_its_own(tmp_path, monkeypatch):
    error = FileNotFoundError(errno.ENOENT, "The system cannot find the path")
    error.winerror = 3
    for length in (242, 400):  # the name of the file that is written first is longer by 18
        long = tmp_path / "a".ljust(length - len(str(tmp_path)) - 1, "a")
        assert "enable long paths in Windows" in str(cannot_be("written", long, error))
    monkeypatch.setattr(os.path, "isreserved", lambda name: name.startswith("kept."), raising=False)
    with pytest.raises(SolariError, match=r"kept\.png: is a name that Windows keeps for itself"):
        write(tmp_path / "kept.png")
    write(tmp_path / "free.png")


def test_the_cache_is_read_where_files_have_no_owners(tmp_path, monkeypatch):
    """Windows says of every file that all may write it."""
    monkeypatch.setenv("SOLARI_VK_CACHE", str(tmp_path))
    monkeypatch.delattr(os, "geteuid", raising=False)
    disk_cache.store("entry", b"mine")
    (tmp_path / "entry").chmod(0o666)
    assert disk_cache.load("entry") == b"mine"


def test_the_cache_of_windows_is_local(monkeypatch):
    monkeypatch.delenv("SOLARI_VK_CACHE", raising=False)
    monkeypatch.setenv("LOCALAPPDATA", "/users/a/AppData/Local")
    monkeypatch.setattr("sys.platform", "win32")
    assert disk_cache.folder().as_posix() == "/users/a/AppData/Local/solari_vk/cache"
