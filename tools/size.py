#!/usr/bin/env python3
"""Prints the size of a checkout: lines by folder, of core and wings, import circles, the longest files, tests.

Usage: python tools/size.py [ROOT]     ROOT is the folder of a checkout, by default the one of this file.
"""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from collections import Counter
from collections.abc import Container
from pathlib import Path

FOLDERS = ("solari_vk", "glsl", "tests", "tools", "docs")
SHADER_SUFFIXES = {".glsl", ".comp", ".vert", ".frag", ".rgen", ".rmiss", ".rchit", ".rahit", ".rint"}
SUFFIXES = {".py", ".sh", ".md", "", *SHADER_SUFFIXES}
WINGS = ("data", "studio", "lab")  # the rooms of the package that the core doesn't import
WIDEST = 120  # columns of a GLSL line


def import_graph(package: Path) -> dict[str, set[str]]:
    """The modules of a package, each with the package's modules that it imports, also inside functions, for type
    checkers only, and by import_module("..."). Raises ValueError for a relative import."""
    paths = {
        ".".join(path.relative_to(package.parent).with_suffix("").parts).removesuffix(".__init__"): path
        for path in package.rglob("*.py")
    }
    return {module: (imported_names(path, paths) & paths.keys()) - {module} for module, path in paths.items()}


def imported_names(path: Path, known: Container[str]) -> set[str]:
    """What a file imports. known: the modules of the package, of which `from package import name` may be one."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.level or node.module is None):
            raise ValueError(f"{path}:{node.lineno}: imports are absolute")
        names |= _names_of(node, known)
    return names


def _names_of(node: ast.AST, known: Container[str]) -> set[str]:
    """What a statement or call imports."""
    if isinstance(node, ast.Import):
        return {alias.name for alias in node.names}
    if isinstance(node, ast.ImportFrom):
        inner = [f"{node.module}.{alias.name}" for alias in node.names]
        return {name if name in known else str(node.module) for name in inner}
    if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
        return {arg.value for arg in node.args if isinstance(arg, ast.Constant)}
    return set()


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """The groups of nodes that reach each other, directly or through others; the largest group comes first."""
    # Graphs of hundreds of modules are small enough to follow from each node.
    reached = {}
    for start in graph:
        found: set[str] = set()
        waiting = [start]
        while waiting:
            for name in graph.get(waiting.pop(), set()) - found:
                found.add(name)
                waiting.append(name)
        reached[start] = found
    groups = {frozenset(b for b in reached[a] if a in reached[b]) for a in graph}
    return sorted((sorted(group) for group in groups if len(group) > 1), key=lambda group: (-len(group), group))


def line_counts(root: Path) -> dict[Path, int]:
    """The lines of each text file in FOLDERS, by its path from the root."""
    files = [path for name in FOLDERS for path in (root / name).rglob("*")]
    return {
        path.relative_to(root): len(path.read_text(encoding="utf-8").splitlines())
        for path in files
        if path.is_file() and path.suffix in SUFFIXES and "__pycache__" not in path.parts
    }


def wide_lines(root: Path) -> list[str]:
    """FILE:LINE of the GLSL lines that have more than WIDEST columns."""
    return [
        f"{path.relative_to(root)}:{number}"
        for folder in FOLDERS
        for path in sorted((root / folder).rglob("*"))
        if path.suffix in SHADER_SUFFIXES
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if len(line) > WIDEST
    ]


def collected_tests(root: Path) -> str:
    """What pytest says of the number of tests, slow ones included."""
    command = [sys.executable, "-m", "pytest", "--collect-only", "-q", "-m", "", "-p", "no:cacheprovider"]
    environment = os.environ | {"PYTHONPATH": str(root)}
    done = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True, check=False)
    lines = (done.stdout + done.stderr).strip().splitlines()
    return lines[-1].strip("= ") if lines else "pytest says nothing"


def main(root: Path) -> None:
    """Print the report."""
    # Pages aren't counted: they may be as long as a reader needs.
    counts = line_counts(root)
    by_folder = Counter[str]()
    for path, count in counts.items():
        if path.suffix == ".md":
            continue
        by_folder[path.parts[0]] += count
        if len(path.parts) > 2:
            by_folder["/".join(path.parts[:2])] += count
    for folder, count in sorted(by_folder.items()):
        print(f"{count:7,}  {'  ' if '/' in folder else ''}{folder}")
    wings = sum(by_folder[f"solari_vk/{name}"] for name in WINGS)
    print(f"{by_folder['solari_vk'] - wings:7,}  core: solari_vk without {', '.join(WINGS)}")
    print(f"{wings:7,}  wings")
    print(f"{sum(by_folder[name] for name in ('solari_vk', 'glsl', 'tests')):7,}  solari_vk + glsl + tests")
    found = circles(import_graph(root / "solari_vk"))
    print(f"import circles: {len(found)}, the longest of {max(map(len, found), default=0)} modules")
    for circle in found:
        print(f"  {' '.join(circle)}")
    print(f"GLSL lines over {WIDEST} columns: {len(wide_lines(root))}")
    print("longest files:")
    code = {path: count for path, count in counts.items() if path.suffix != ".md"}
    for path in sorted(code, key=code.__getitem__, reverse=True)[:8]:
        print(f"  {code[path]:5}  {path}")
    print(f"tests: {collected_tests(root)}")


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve() if len(sys.argv) > 1 else Path(__file__).resolve().parents[1])
