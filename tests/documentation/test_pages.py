"""What the README and the site's pages say: Python runs, commands parse and run, links and names are right."""

from __future__ import annotations

import json
import re
import runpy
import shlex
import tomllib
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from support.files import GltfWriter

import solari_vk as sv
from solari_vk import cli
from solari_vk.data.cli.annotations import ANNOTATIONS
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.shaders import slang
from solari_vk.lab.conformance.groups import GROUPS
from solari_vk.output import movie
from solari_vk.output.tone_mapping import TONEMAPS
from solari_vk.passes.first_hits import FIRST_HITS
from solari_vk.scene.builtin import SCENES
from solari_vk.scene.files import formats
from solari_vk.scene.files.formats import readable_suffixes
from solari_vk.scene.lens import PROJECTIONS
from solari_vk.scene.lights.light import Light
from solari_vk.settings import FIELDS, QUALITIES

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *sorted(DOCS.rglob("*.md"))]
# By tests/renderers/rt/test_examples.py, tests/data/cluster/test_guide.py, test_coming_from.py and test_learning.py.
ELSEWHERE = ("ray_tracing.md", "driver_faults.md", "guides/clusters.md", "guides/coming_from.md", "guides/learning.md")
RUN_ELSEWHERE = {DOCS / name for name in ELSEWHERE}
# Pictures as small as possible, and few frames: each pattern must be on some page.
SMALLER = {
    r"\((640, 360|320, 180|160, 90)\)": "(16, 9)",
    r"\b64, 64\)(?=, 16|$)": "8, 8)",
    r"range\((24|32)\)": "range(2)",
    r"samples=\d+": "samples=2",
    r"frames=16\b": "frames=2",
    r"\bworlds = 1024": "worlds = 2",
    r"worlds, 64, 64": "worlds, 8, 8",
    r"240, 320": "9, 16",
}

SCAN = """ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
3 0 1 2
"""


def text_of(page):
    return page.read_text(encoding="utf-8")


def blocks(page, language):
    return re.findall(rf"^```{language}\n(.*?)^```$", text_of(page), re.MULTILINE | re.DOTALL)


def name_of(page):
    return page.relative_to(ROOT).as_posix()


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The current folder, with the files that pages name."""
    writer = GltfWriter()
    node = writer.node(mesh=writer.mesh())
    moves = {"input": writer.accessor([0, 1]), "output": writer.accessor([[-1, 0, 0], [1, 0, 0]])}
    channel = {"sampler": 0, "target": {"node": node, "path": "translation"}}
    writer.add("animations", name="Run", samplers=[moves], channels=[channel])
    for name in ("model.glb", "character.glb"):
        writer.save(tmp_path / name)
    (tmp_path / "scan.ply").write_text(SCAN)
    (tmp_path / "downlight.ies").write_text(sv.LightProfile([0, 90], [0], [[800, 0]]).text())
    sv.save_image(tmp_path / "map.exr", np.ones((4, 8, 3)))
    (tmp_path / "path.json").write_text(blocks(DOCS / "guides/animation.md", "json")[0])
    monkeypatch.chdir(tmp_path)
    return tmp_path


# ---- Python -----------------------------------------------------------------------------------------


def run_page(page, folder):
    """Run the Python of a page from top to bottom, in small pictures; returns its names."""
    for path, content in re.findall(r"^<!-- file: (\S+) -->\n```\w+\n(.*?)^```$", text_of(page), re.M | re.S):
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(content)
    names = {"__name__": "__main__"}
    try:
        for program in blocks(page, "python"):
            for shown, run in SMALLER.items():
                program = re.sub(shown, run, program, flags=re.MULTILINE)
            exec(compile(program, name_of(page), "exec"), names)
    finally:
        for value in list(names.values()):
            if isinstance(value, Device):
                value.close()
    return names


WITH_PYTHON = [page for page in PAGES if blocks(page, "python") and page not in RUN_ELSEWHERE]


@pytest.mark.filterwarnings("error:the picture")
@pytest.mark.parametrize("page", WITH_PYTHON, ids=name_of)
def test_python_runs(lent_device, page, folder, capsys):
    if page.name == "slang.md" and slang.library_file() is None:
        pytest.skip(f"needs {slang.INSTALL}")
    names = run_page(page, folder)
    if page == DOCS / "index.md":
        assert names["radiance"].shape == (9, 16, 3)
        assert names["depth"].shape == names["ball"].shape == (9, 16)
        assert names["ball"].any()
        assert (folder / "out.png").stat().st_size > 0
    if page.name == "slang.md":
        assert capsys.readouterr().out == "True\n"
    if page.name == "passes.md":
        assert names["frame"].device is names["device"]
        assert capsys.readouterr().out.startswith("[")


def test_blocks_fit_the_page():
    """The site shows 88 columns."""
    named = {"gltf.md", "ray_tracing.md", "README.md", "CONTRIBUTING.md"}
    for page in PAGES:
        if page.parent.name in ("start", "guides") or page.name in named:
            shown = blocks(page, r"(?:python|glsl|slang|sh)")
            assert max((len(line) for block in shown for line in block.splitlines()), default=0) <= 88, page


def test_what_makes_programs_smaller_is_used():
    programs = "".join(program for page in WITH_PYTHON for program in blocks(page, "python"))
    assert [shown for shown in SMALLER if not re.search(shown, programs)] == []


# ---- commands ---------------------------------------------------------------------------------------


def lines_of(page):
    """The commands of a page's blocks and in its text, without comments."""
    inline = re.findall(r"(?<!`)`(solari-vk [^`]+)`", text_of(page))
    lines = "\n".join(blocks(page, "sh")).replace("\\\n", "").splitlines()
    return [line.split(" #")[0].strip() for line in lines] + inline


COMMANDS = sorted({line for page in PAGES for line in lines_of(page) if line.startswith("solari-vk ")})
RENDERS = [line for line in COMMANDS if line.startswith("solari-vk render ") and " -o " in line]


def parts_of(parser):
    """The commands of a parser, or the parts of a command, by name."""
    actions = [action for action in parser._actions if isinstance(action.choices, dict)]
    return actions[0].choices if actions else {}


def test_commands_parse():
    """Also commands that are only named, and options alone."""
    names = {"FILES": "a.glb", "FOLDER": "folder", "PAGE": "a.md", "FILE": "a.md"}  # what stands for the reader's own
    for line in COMMANDS:
        words = [names.get(word, word) for word in shlex.split(line)[1:]]
        rest = words_after_commands(words)
        if words[0] in ("render", "view") and rest and rest[0].startswith("--"):
            words = [words[0], "model.glb", *rest]
            if words[0] == "render":
                words += ["-o", "a.png"]
        if rest and "COMMAND" not in rest:
            parsed = parsed_or_failed(words, line)
            assert GROUPS.keys() >= set(getattr(parsed, "only", ())) or words[0] != "conformance", line


def words_after_commands(words):
    """The words of a command line without the names of the command and of commands below it."""
    parser, rest = cli._parser(), list(words)
    while rest and rest[0] in parts_of(parser):
        parser = parts_of(parser)[rest.pop(0)]
    return rest


def parsed_or_failed(words, line):
    try:
        return cli._parser().parse_args(["picture" if word == "name" else word for word in words])
    except SystemExit as ended:
        if ended.code != 0:  # as --help ends
            pytest.fail(line)
        return None


def test_options_are_there(capsys):
    for command in parts_of(cli._parser()).values():
        command.print_help()
    shown = capsys.readouterr().out
    for page in PAGES:
        if page.parent.name in ("start", "guides") or page.name == "README.md":
            text = re.sub(r"<!-- made from the code: advice.*?<!-- end -->", "", text_of(page), flags=re.DOTALL)
            for option in re.findall(r"(?<=`)--[\w-]+", text):
                assert option in shown, f"{name_of(page)}: {option}"


@pytest.mark.slow
@pytest.mark.parametrize("line", RENDERS)
def test_renders_run(lent_device, line, folder):
    words = shlex.split(re.sub("--seconds [0-9]+", "", re.sub("--workers [0-9]+", "--workers 1", line)))[1:]
    output = folder / words[words.index("-o") + 1]
    limits = ["--size", "16x9", *(["--frames", "2"] if "--animate" in words else ["--time-limit", "0.01"])]
    if output.suffix == ".mp4":
        movie.check_encoder(output)
    assert cli.main([*words, *limits]) == 0
    assert output.stat().st_size > 0


def test_tools_are_there():
    for page in PAGES:
        for path in re.findall(r"(?<![\w/])tools/[\w/.]*\w", text_of(page)):
            assert "NAME" in path or (ROOT / path).exists(), f"{name_of(page)}: {path}"


def test_files_that_contributors_edit_are_there():
    text = text_of(ROOT / "CONTRIBUTING.md")
    paths = re.findall(r"`((?:solari_vk|glsl|tests|tools|docs)/[\w/.]+)`", text)
    assert len(paths) > 20
    assert [path for path in paths if "NAME" not in path and not (ROOT / path).exists()] == []


# ---- links and names --------------------------------------------------------------------------------


def anchors(page):
    """The anchors of a page's headings, as GitHub makes them. The site's build checks its own."""
    headings = re.findall(r"^#+ (.*)$", re.sub(r"^```.*?^```$", "", text_of(page), flags=re.M | re.S), re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


def links(page):
    """The files of the project that a page links to, each with its anchor, as GitHub reads it."""
    for target in re.findall(r"\]\(([^)\s]+)\)", re.sub(r"`[^`\n]*`", "", text_of(page))):
        if "://" not in target:
            path, _, anchor = target.partition("#")
            yield (page.parent / path).resolve() if path else page, anchor


def test_what_is_made_from_the_code_is_that_of_today():
    """Or run `python tools/reference.py`."""
    filled = runpy.run_path(str(ROOT / "tools" / "reference.py"))["filled"]
    pages = [page for page in DOCS.rglob("*.md") if "<!-- end -->" in text_of(page)]
    assert len(pages) == 12
    for page in pages:
        assert filled(text_of(page)) == text_of(page), page


def test_links_lead_somewhere():
    """On GitHub. The site's build checks the site's links."""
    for page in PAGES:
        for found, anchor in links(page):
            assert found.is_file(), f"{name_of(page)}: {found}"
            assert not anchor or anchor in anchors(found), f"{name_of(page)}: {found}#{anchor}"


def test_every_page_is_reached_from_the_readme():
    found, waiting = set(), [ROOT / "README.md"]
    while waiting:
        page = waiting.pop()
        if page not in found:
            found.add(page)
            waiting += [path for path, _ in links(page) if path.suffix == ".md"]
    assert not set(PAGES) - found


def test_extras_and_the_version_are_those_of_the_package():
    extras = tomllib.loads(text_of(ROOT / "pyproject.toml"))["project"]["optional-dependencies"]
    for page in PAGES:
        for named in re.findall(r"solari-vk\[([\w,]+)\]", text_of(page)):
            assert set(named.split(",")) <= set(extras), f"{name_of(page)}: {named}"
    assert f"\n## {sv.__version__}" in text_of(ROOT / "CHANGELOG.md")
    assert f"\nversion: {sv.__version__}\n" in text_of(ROOT / "CITATION.cff")


def test_names_that_pages_give_are_there():
    text = text_of(DOCS / "start/first_picture.md")
    (scenes,) = re.findall(r"## Built-in scenes\n\n(.*?)\n\w+ no file", text, re.S)
    assert set(re.findall(r"`(\w+)`", scenes)) == set(SCENES)
    outputs = text_of(DOCS / "guides/outputs.md")
    for name in re.findall(r"^\| `(.*?) \|", outputs, re.M):
        for output in re.findall(r"\w+", name):
            assert output in {*sv.PathTracer.OUTPUTS, *sv.Renderer.OUTPUTS}, output
    for name in re.findall(r"^\| `(\w+)` \|", text_of(DOCS / "guides/denoising.md"), re.M):
        assert name in FIELDS, name
    variables = set(re.findall(r"^\| `(SOLARI_VK_\w+)`", text_of(DOCS / "reference/cli.md"), re.M))
    sources = "".join(text_of(path) for path in (ROOT / "solari_vk").rglob("*.py"))
    assert variables == set(re.findall(r"SOLARI_VK_[A-Z]+(?:_[A-Z]+)*", sources))
    assert json.loads(blocks(DOCS / "guides/animation.md", "json")[0])


def lists_in(text):
    """The words of each list in a text, such as `a`, "b" or c, or a|b."""
    word, between = r"[`\"'*]*[.\w]*\w[`\"'*]*", r"(?:\s*[,|/]\s*(?:or |and )?|\s+(?:or|and)\s+)"
    for found in re.findall(rf"{word}(?:{between}{word}){{2,}}", text):
        yield {each.strip("`\"'*") for each in re.split(between, found)}


def test_lists_of_choices_are_whole():
    """A list that names three choices of a kind names all of them, in help, docstrings, advice and pages."""
    suffixes = set(readable_suffixes())
    kinds = [[set(names)] for names in (TONEMAPS, PROJECTIONS, QUALITIES, ANNOTATIONS)]
    meshes = {suffix for suffix in suffixes if "up" in formats._READERS[suffix].options}
    # Files of objects, of meshes alone, and all.
    kinds.append([meshes | {".gltf", ".glb"}, meshes, suffixes])
    kinds.append([{suffix for suffix in suffixes if "variants" in formats._READERS[suffix].options}])  # of USD
    sources = [*(ROOT / "solari_vk").rglob("*.py"), *(ROOT / "solari_vk/base").glob("*.toml")]
    read = [path for path in [*PAGES, *sources] if path.name != "CHANGELOG.md" and path.parent.name != "measured"]
    lists = {path: list(lists_in(text_of(path))) for path in read}
    for wholes in kinds:
        named = [(path, words & wholes[0]) for path, found in lists.items() for words in found]
        partial = [(path, words) for path, words in named if len(words) >= 3 and words not in wholes]
        assert not partial
        # So there is a list that would be too short if one more were added to the code alone.
        assert any(len(words) >= 3 for _, words in named), wholes


def test_pages_name_all_that_there_is_of_a_kind():
    outputs = text_of(DOCS / "guides/outputs.md")
    assert [name for name in FIRST_HITS if f"`{name}`" not in outputs] == []
    cameras = text_of(DOCS / "guides/cameras.md")
    assert [name for name in PROJECTIONS if f'`"{name}"`' not in cameras] == []
    lights = text_of(DOCS / "guides/lights.md")
    public = {name: getattr(sv, name) for name in sv.__all__}
    kinds = [name for name, value in public.items() if isinstance(value, type) and issubclass(value, Light)]
    assert len(kinds) > 3
    assert [name for name in kinds if f"sv.{name}" not in lights] == []


def test_fields_of_materials_are_there():
    """The column "here" of the tables of docs/guides/materials.md."""
    found = set()
    for table in re.findall(r"(?:^\|.*\n)+", text_of(DOCS / "guides/materials.md"), re.MULTILINE):
        titles, _, *rows = ([cell.strip() for cell in line.split("|")] for line in table.splitlines())
        if "here" in titles:
            found |= {name for row in rows for name in re.findall(r"`(\w+)`", row[titles.index("here")])}
    assert len(found) > 20
    for name in found:
        assert hasattr(sv.Material(), name), name


def test_the_specifications_rows_name_what_is_there():
    """Counts by state are those of the rows; files and tests exist."""
    text = (DOCS / "explained/seeds.md").read_text(encoding="utf-8")
    table = cells_of_tables(text)
    rows = [row for row in table if len(row) != 3 and row[0] != "the text says" and set(row[0]) != {"-"}]
    assert {len(row) for row in rows} == {4}
    counted = Counter(row[1].split(":")[0] for row in rows)
    assert Counter({row[0]: int(row[1]) for row in table if len(row) == 3 and row[1].isdigit()}) == counted
    assert f"{len(rows)} rows" in text.replace("\n", " ")
    tests = {path.stem for path in (ROOT / "tests").rglob("test_*.py")}
    for name in {name for row in rows for name in re.findall(r"`([a-z_0-9/.]+)`", row[2] + row[3])}:
        if name.startswith("test_"):
            assert name in tests, name
        elif "." in name or "/" in name:
            assert any((ROOT / folder / name).exists() for folder in ("", "glsl", "solari_vk")), name


def cells_of_tables(text):
    """The cells of each row of a page's tables."""
    lines = [line.strip("|") for line in text.splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in line.split("|")] for line in lines]
