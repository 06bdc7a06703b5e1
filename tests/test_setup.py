"""The setup scripts: backports from both formats of apt's sources, the list of missing things, errors in one line."""

from __future__ import annotations

import os
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
LINES = """\
# deb https://mirror.example.org/commented bookworm main
deb-src https://mirror.example.org/source bookworm main
deb https://mirror.example.org/debian bookworm-security main
deb [arch=amd64 signed-by=/usr/share/keyrings/a.gpg] mirror+file:/etc/apt/list bookworm contrib main # here
"""


def test_stanza_keeps_all_but_the_suite():
    suffix, text = find_source([(".sources", STANZAS)], "bookworm", "bookworm-backports")
    assert suffix == ".sources"
    assert text.splitlines() == [
        "Types: deb",
        "Uris: https://mirror.example.org/debian",
        "Suites: bookworm-backports",
        "Components: main",
        "Signed-By: ",
        " -----BEGIN PGP PUBLIC KEY BLOCK-----",
        " .",
        " mDMEabc=",
        " -----END PGP PUBLIC KEY BLOCK-----",
    ]


def test_line_keeps_its_options():
    made = find_source([(".list", LINES)], "bookworm", "bookworm-backports")
    options = "[arch=amd64 signed-by=/usr/share/keyrings/a.gpg]"
    assert made == (".list", f"deb {options} mirror+file:/etc/apt/list bookworm-backports main\n")


def test_first_file_with_the_release_counts():
    made = find_source([(".list", "\n"), (".sources", STANZAS), (".list", LINES)], "bookworm", "bookworm-backports")
    assert made[0] == ".sources"
    assert find_source([(".list", LINES), (".sources", STANZAS)], "trixie", "trixie-backports") is None


def test_nothing_is_missing_here():
    done = subprocess.run(
        [sys.executable, ROOT / "tools" / "missing.py", "demo"], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == ""


@pytest.fixture
def bare_path(tmp_path):
    """A PATH with a shell's usual tools but without Python and a package manager."""
    for name in ("sh", "cat", "dirname", "basename", "id", "uname", "paste", "sed", "mkdir", "tail", "cksum", "date"):
        found = shutil.which(name)
        assert found is not None
        (tmp_path / name).symlink_to(found)
    return str(tmp_path)


@pytest.mark.parametrize("script", ["demo", "test"])
def test_unknown_system_is_told_what_to_install(script, bare_path):
    environment = {key: value for key, value in os.environ.items() if key != "PYTHON"} | {"PATH": bare_path}
    done = subprocess.run([ROOT / "tools" / script], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    first, second = done.stderr.splitlines()[:2]
    assert first == "setup: missing: Python 3.11 or later with venv. Install it and run this again:"
    assert "python3-venv libvulkan1 libshaderc1" in second
    assert ("vulkan-validationlayers" in second) == (script == "test")


@pytest.mark.parametrize(("command", "said"), [("true", "long 5 s, last one 12 s\n"), ("false", "")])
def test_steps_are_timed_and_a_failure_ends_them(command, said, tmp_path):
    times = tmp_path / "times"
    times.write_text("\n".join(map(str, (10, 15, 15, 15, 15, 27))) + "\n")
    (tmp_path / "date").write_text(f"#!/bin/sh\nhead -n 1 {times}\nsed -i 1d {times}\n")
    (tmp_path / "date").chmod(0o755)
    lines = ["set -eu", f"root={ROOT}", '. "$root/tools/setup.sh"', "steps=", "step long true", f"step quick {command}",
             "step 'last one' true", 'echo "$steps"']  # fmt: skip
    environment = os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}"}
    done = subprocess.run(["sh"], input="\n".join(lines), env=environment, capture_output=True, text=True, check=False)
    assert (done.stdout, done.returncode) == (said, int(command == "false"))


@pytest.mark.parametrize(("mesa", "said", "status"), [
    ("sleep 0.3; echo Mesa", ["pip", "Mesa", "done"], 0),
    ("exit 3", ["pip"], 3),
])  # fmt: skip
def test_a_driver_is_installed_while_pip_works(mesa, said, status):
    lines = ["set -eu", f"root={ROOT}", '. "$root/tools/setup.sh"', "can_use_apt() { true; }",
             "find_python() { true; }", "has_driver() { false; }", "has_device() { true; }",
             f"install_mesa() {{ {mesa}; }}", "begin_driver", "echo pip", "install_driver", "echo done"]  # fmt: skip
    done = subprocess.run(["sh"], input="\n".join(lines), capture_output=True, text=True, check=False)
    assert (done.stdout.split("\n")[:-1], done.returncode) == (said, status), done.stderr


def test_bare_asks_for_a_folder():
    done = subprocess.run([ROOT / "tools" / "bare"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.split(":")[:2]) == (1, ["bare", " usage"])


def test_docs_say_that_python_is_missing(bare_path, tmp_path):
    checkout = tmp_path / "checkout"  # has no environment yet
    shutil.copytree(ROOT / "tools", checkout / "tools", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", checkout)
    environment = {key: value for key, value in os.environ.items() if key != "PYTHON"} | {"PATH": bare_path}
    done = subprocess.run([checkout / "tools/docs"], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    first, second = done.stderr.splitlines()
    assert first == "setup: missing: Python 3.11 or later with venv. Install it and run this again:"
    assert "python3 python3-venv on Debian" in second


def test_demo_refuses_a_missing_file_before_it_sets_up(bare_path):
    environment = os.environ | {"PATH": bare_path}
    command = [ROOT / "tools" / "demo", "no_such_file.glb"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (1, "setup: there is no file no_such_file.glb\n")
