"""The setup scripts: backports from both formats of apt's sources, the list of missing things, errors in one line."""

from __future__ import annotations

import os
import re
import runpy
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
backports = runpy.run_path(str(ROOT / "tools" / "backports.py"))
find_source = backports["find_source"]

STANZAS = """\
# a comment
Types: deb
URIs: https://mirror.example.org/debian-security
Suites: bookworm-security
Components: main

Types: deb
Enabled: no
URIs: https://mirror.example.org/disabled
Suites: bookworm
Components: main

Types: deb deb-src
URIs: https://mirror.example.org/debian
# another
Suites: bookworm bookworm-updates
Components: main contrib
Signed-By:
 -----BEGIN PGP PUBLIC KEY BLOCK-----
 .
 mDMEabc=
 -----END PGP PUBLIC KEY BLOCK-----
"""
STANZA = """\
Types: deb
Uris: https://mirror.example.org/debian
Suites: bookworm-backports
Components: main
Signed-By:\x20
 -----BEGIN PGP PUBLIC KEY BLOCK-----
 .
 mDMEabc=
 -----END PGP PUBLIC KEY BLOCK-----
"""
LINES = """\
# deb https://mirror.example.org/commented bookworm main
deb-src https://mirror.example.org/source bookworm main
deb https://mirror.example.org/debian bookworm-security main
deb [arch=amd64 signed-by=/usr/share/keyrings/a.gpg] mirror+file:/etc/apt/list bookworm contrib main # here
"""


@pytest.mark.parametrize(
    ("files", "suffix", "text"),
    [
        ([(".sources", STANZAS)], ".sources", STANZA),
        (
            [(".list", LINES)],
            ".list",
            "deb [arch=amd64 signed-by=/usr/share/keyrings/a.gpg] mirror+file:/etc/apt/list bookworm-backports main\n",
        ),
        ([(".list", "\n"), (".sources", STANZAS), (".list", LINES)], ".sources", STANZA),
    ],
)
def test_backports_are_the_first_file_s_source_with_another_suite(files, suffix, text):
    assert find_source(files, "bookworm", "bookworm-backports") == (suffix, text)
    assert find_source(files, "trixie", "trixie-backports") is None


def run(*command, **options):
    return subprocess.run(command, capture_output=True, text=True, check=False, **options)


def test_nothing_is_missing_here():
    done = run(sys.executable, ROOT / "tools" / "missing.py", "demo")
    assert (done.stdout.strip(), done.returncode) == ("", 0)


@pytest.fixture
def bare(tmp_path):
    """An environment whose PATH has a shell's usual tools but no Python and no package manager."""
    folder = tmp_path / "bin"
    folder.mkdir()
    for name in ("sh", "cat", "dirname", "basename", "id", "uname", "paste", "sed", "mkdir", "tail", "cksum", "date"):
        found = shutil.which(name)
        assert found is not None
        (folder / name).symlink_to(found)
    return {key: value for key, value in os.environ.items() if key != "PYTHON"} | {"PATH": str(folder)}


@pytest.mark.parametrize("script", ["demo", "test", "docs"])
def test_unknown_system_is_told_what_to_install(script, bare, tmp_path):
    tools = tmp_path / "checkout/tools"  # has no environment yet
    shutil.copytree(ROOT / "tools", tools, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tools.parent)
    done = run(tools / script, env=bare)
    assert done.returncode == 1
    first, second = done.stderr.splitlines()[:2]
    assert first == "setup: missing: Python 3.11 or later with venv. Install it and run this again:"
    assert ("python3 python3-venv on Debian" if script == "docs" else "python3-venv libvulkan1 libshaderc1") in second
    assert ("vulkan-validationlayers" in second) == (script == "test")


def test_mistakes_are_told_before_anything_is_set_up(bare):
    done = run(ROOT / "tools" / "demo", "no_such_file.glb", env=bare)
    assert (done.returncode, done.stderr) == (1, "setup: there is no file no_such_file.glb\n")
    done = run(ROOT / "tools" / "bare")
    assert (done.returncode, done.stderr.split(":")[:2]) == (1, ["bare", " usage"])


def run_steps(*lines, **environment):
    program = ["set -eu", f"root={ROOT}", '. "$root/tools/setup.sh"', *lines]
    return run("sh", input="\n".join(program), env=os.environ | environment)


@pytest.mark.parametrize(("command", "said"), [("true", "long 5 s, last one 12 s\n"), ("false", "")])
def test_steps_are_timed_and_a_failure_ends_them(command, said, tmp_path):
    times = tmp_path / "times"
    times.write_text("\n".join(map(str, (10, 15, 15, 15, 15, 27))) + "\n")
    (tmp_path / "date").write_text(f"#!/bin/sh\nhead -n 1 {times}\nsed -i 1d {times}\n")
    (tmp_path / "date").chmod(0o755)
    done = run_steps(
        "steps=",
        "step long true",
        f"step quick {command}",
        "step 'last one' true",
        'echo "$steps"',
        PATH=f"{tmp_path}:{os.environ['PATH']}",
    )
    assert (done.stdout, done.returncode) == (said, int(command == "false"))


@pytest.mark.parametrize(
    ("backports", "packages"),
    [("true", r"-t \w*-backports mesa-vulkan-drivers"), ("fail 'no network'", "mesa-vulkan-drivers")],
)
def test_mesa_is_installed_without_backports_where_they_cannot_be_had(backports, packages):
    done = run_steps(
        "dpkg() { false; }",
        "candidate() { echo 22.3.6; }",
        f"add_backports() {{ {backports}; }}",
        'apt_install() { echo "$*"; }',
        "install_mesa",
    )
    assert re.fullmatch(packages, done.stdout.splitlines()[-1])
    assert done.returncode == 0


@pytest.mark.parametrize(
    ("mesa", "said", "status"), [("sleep 0.3; echo Mesa", ["pip", "Mesa", "done"], 0), ("exit 3", ["pip"], 3)]
)
def test_a_driver_is_installed_while_pip_works(mesa, said, status):
    done = run_steps(
        "can_use_apt() { true; }",
        "find_python() { true; }",
        "has_driver() { false; }",
        "has_good_device() { true; }",
        f"install_mesa() {{ {mesa}; }}",
        "begin_driver",
        "echo pip",
        "install_driver",
        "echo done",
    )
    assert (done.stdout.split("\n")[:-1], done.returncode) == (said, status), done.stderr
