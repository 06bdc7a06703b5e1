"""Adds a backports suite to apt, from the archive that this machine already takes its release from.

backports.py bookworm-backports   writes a file in apt's sources.list.d and prints its path
Address, key and all other options are copied from the release's own entry, in either of apt's two formats, so that
mirrors, proxies and local copies keep working.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

_ONE_LINE = re.compile(r"^\s*deb\s+(?P<options>\[[^\]]*\]\s+)?(?P<uri>\S+)\s+(?P<suite>\S+)\s+(?P<components>[^#]+)")
_FIELD = re.compile(r"^(?P<name>[^\s:#][^:]*):[ \t]*(?P<value>.*(?:\n[ \t].*)*)", re.MULTILINE)
_FALSE = ("no", "false", "without", "off", "disable", "0")


def from_one_line(text: str, release: str, backports: str) -> str | None:
    """A line for `backports`, made from the first line for `release` in a .list file; None without such a line."""
    for line in text.splitlines():
        found = _ONE_LINE.match(line)
        if found and found["suite"] == release and "main" in found["components"].split():
            return f"deb {found['options'] or ''}{found['uri']} {backports} main\n"
    return None


def from_stanzas(text: str, release: str, backports: str) -> str | None:
    """A stanza for `backports`, made from the first one for `release` in a .sources file, or None."""
    # The format of deb822: a comment may stand between the lines of a field.
    without_comments = "\n".join(line for line in text.splitlines() if not line.startswith("#"))
    for stanza in re.split(r"\n\s*\n", without_comments):
        fields = {found["name"].strip().lower(): found["value"] for found in _FIELD.finditer(stanza)}
        if (
            "deb" in fields.get("types", "").split()
            and release in fields.get("suites", "").split()
            and "main" in fields.get("components", "").split()
            and fields.get("enabled", "yes").strip().lower() not in _FALSE
        ):
            fields |= {"types": "deb", "suites": backports, "components": "main"}
            return "".join(f"{name.title()}: {value}\n" for name, value in fields.items())
    return None


def find_source(files: Iterable[tuple[str, str]], release: str, backports: str) -> tuple[str, str] | None:
    """(suffix, text) of a new file of sources, made from those of the present files; None if none has `release`."""
    for suffix, text in files:
        read = from_stanzas if suffix == ".sources" else from_one_line
        made = read(text, release, backports)
        if made is not None:
            return suffix, made
    return None


def apt_path(name: str) -> Path:
    """A path in apt's configuration."""
    shell = subprocess.run(["apt-config", "shell", "path", name], check=True, capture_output=True, text=True).stdout
    return Path(shell.strip().removeprefix("path=").strip("'\""))


def main(backports: str) -> str:
    """Write the file and return its path; exit with the reason if that fails."""
    folder = apt_path("Dir::Etc::sourceparts/d")
    candidates = [apt_path("Dir::Etc::sourcelist/f"), *sorted(folder.glob("*.list")), *sorted(folder.glob("*.sources"))]
    files = [(file.suffix, file.read_text(encoding="utf-8")) for file in candidates if file.is_file()]
    release = backports.removesuffix("-backports")
    source = find_source(files, release, backports)
    if source is None:
        sys.exit(f"apt has no source for {release} main in {folder.parent}, so {backports} can't be added")
    target = folder / f"solari-vk-backports{source[0]}"
    try:
        target.write_text(source[1], encoding="utf-8")
        # Readable for all, as the other files there are, whatever this user's umask is.
        target.chmod(0o644)
    except OSError as error:
        sys.exit(f"{target} can't be written: {error.strerror}")
    return str(target)


if __name__ == "__main__":
    if len(sys.argv) != 2 or not sys.argv[1].endswith("-backports"):
        sys.exit("usage: backports.py RELEASE-backports")
    print(main(sys.argv[1]))
