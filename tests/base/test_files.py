"""Files that are written whole: what they may replace, and what an error says."""

from __future__ import annotations

import os
import stat

import pytest

from solari_vk.base import disk_cache
from solari_vk.base.errors import SolariError
from solari_vk.base.files import cannot_be, check_writable, whole_file, write_whole


def write(path):
    write_whole(path, "new")


@pytest.mark.parametrize("attempt", [check_writable, write])
def test_pipes_and_devices_are_no_files(tmp_path, attempt):
    """As root one could replace them."""
    pipe, link = tmp_path / "pipe.md", tmp_path / "link.md"
    os.mkfifo(pipe)
    link.symlink_to(pipe)
    for path in (pipe, link):
        with pytest.raises(SolariError, match=f"{path.name}: is a device or pipe: give the name of a file$"):
            attempt(path)
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    assert sorted(os.listdir(tmp_path)) == ["link.md", "pipe.md"]


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


def test_a_link_into_no_folder_names_the_folder(tmp_path):
    link = tmp_path / "link.md"
    link.symlink_to("missing/file.md")
    with pytest.raises(SolariError, match=r"link.md: there is no folder .*missing: make it first$"):
        write(link)


def test_a_name_that_is_too_long(tmp_path):
    for attempt in (check_writable, write):
        with pytest.raises(SolariError, match=r"can't be written: File name too long: choose a shorter name$"):
            attempt(tmp_path / f"{'a' * 300}.md")
        with pytest.raises(SolariError, match=r"a\\x00.md': has a null character: choose another name$"):
            attempt(tmp_path / "a\0.md")


def test_an_error_of_a_library_has_a_remedy(tmp_path):
    said = str(cannot_be("written", tmp_path / "a.mp4", RuntimeError("ffmpeg: unknown encoder")))
    assert said.endswith("unknown encoder: make room there, choose another folder, or mend what the reason names")


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


def test_a_cache_that_others_can_write_is_not_used(tmp_path, monkeypatch):
    monkeypatch.setenv("SOLARI_VK_CACHE", str(tmp_path))
    disk_cache.store("entry", b"mine")
    assert disk_cache.load("entry") == b"mine"
    tmp_path.chmod(0o777)
    with pytest.warns(UserWarning, match="where other users can write.*mode 700"):
        assert disk_cache.load("entry") is None
