"""The documentation's site: it is built without a warning, shows what the code has, and fetches nothing."""

from __future__ import annotations

import html
import inspect
import json
import os
import re
import subprocess
import sys
from contextlib import closing
from http.client import HTTPConnection
from ipaddress import ip_address
from pathlib import Path

import pytest
from mkdocs.config import load_config
from mkdocs.livereload import LiveReloadServer

import solari_vk as sv
from solari_vk import cli
from solari_vk.passes.debug_views import DEBUG_VIEWS
from solari_vk.settings import FIELDS

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The folder of the built site."""
    folder = tmp_path_factory.mktemp("site")
    build = [sys.executable, "-m", "mkdocs", "build", "-f", str(ROOT / "tools/site/mkdocs.yml"), "-d", str(folder)]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(build, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr  # mkdocs.yml is strict
    assert "WARNING" not in done.stderr
    return folder


def shown(page):
    """The text of a page, without tags."""
    return html.unescape(re.sub(r"<[^>]*>", "", page.read_text(encoding="utf-8")))


def test_every_page_is_there(site):
    pages = [path.relative_to(ROOT / "docs").with_suffix(".html") for path in (ROOT / "docs").rglob("*.md")]
    assert all((site / page).is_file() for page in [*pages, "contributing.html", "changelog.html"])


def test_search_finds_what_people_look_for(site):
    """By the words that the page's index is split into."""
    index = json.loads((site / "search/search_index.json").read_text(encoding="utf-8"))
    separator = re.compile(index["config"]["separator"])
    pages = {word: set() for word in ("look_at", "urdf", "depth")}
    for entry in index["docs"]:
        words = separator.split(f"{entry['title']} {entry['text']}".lower())
        for word in pages.keys() & set(words):
            pages[word].add(entry["location"].partition("#")[0])
    assert {"reference/scene.html", "guides/coming_from.html", "guides/scenes.html"} <= pages["look_at"]
    assert {"guides/scenes.html", "guides/robots.html"} <= pages["urdf"]
    assert {"guides/outputs.html", "guides/cameras.html", "start/first_script.html"} <= pages["depth"]


def test_pages_are_in_the_order_of_readers(site):
    """Other programs' calls first, measurements last; their index has all of them."""
    navigation = load_config(str(ROOT / "tools/site/mkdocs.yml")).nav
    start = next(part["Start"] for part in navigation if "Start" in part)
    assert start[0] == "guides/coming_from.md"
    assert start.index("start/first_picture.md") < start.index("start/first_script.md")
    assert "Measured" in navigation[-1]
    index = (ROOT / "docs/measured/index.md").read_text(encoding="utf-8")
    pages = [
        page for each in navigation[-1]["Measured"] for page in (each.values() if isinstance(each, dict) else [each])
    ]
    assert all(f"({os.path.relpath(page, 'measured')})" in index for page in pages if page != "measured/index.md")


def test_every_public_name_has_its_place(site):
    anchors = {
        anchor
        for page in (site / "reference").glob("*.html")
        for anchor in re.findall(r'id="(solari_vk\.[\w.]+)"', page.read_text(encoding="utf-8"))
    }
    for name in set(sv.__all__) - {"__version__"}:
        value = getattr(sv, name)
        home = value.__name__ if inspect.ismodule(value) else f"{value.__module__}.{name}"
        assert {f"solari_vk.{name}", home} & anchors, name
    assert {"solari_vk.Scene.add", "solari_vk.PathTracer.render", "solari_vk.Camera.look_at"} <= anchors
    assert {"solari_vk.rt.create_blas", "solari_vk.scene.shapes.sphere"} <= anchors


def test_every_option_setting_and_view_is_shown(site):
    text = shown(site / "reference/cli.html")
    parsers = [cli._parser()]
    while parsers:
        for action in parsers.pop()._actions:
            parsers += action.choices.values() if isinstance(action.choices, dict) else []
            assert all(option in text for option in action.option_strings if option != "-h"), action
    settings, views = shown(site / "reference/settings.html"), shown(site / "reference/views.html")
    assert all(name in settings and field.meaning.replace("`", "") in settings for name, field in FIELDS.items())
    assert all(name in views and meaning.replace("`", "") in views for name, meaning in DEBUG_VIEWS.items())


def test_formulas_are_mathml(site):
    page = (site / "explained/estimators.html").read_text(encoding="utf-8")
    assert len(re.findall(r'<math [^>]*display="block"', page)) >= 8
    assert "arithmatex" not in page
    assert not re.search(r"\$|\\[a-z]+\{", shown(site / "explained/estimators.html").partition("What is computed")[2])


def test_pages_fetch_nothing(site):
    for page in site.rglob("*.html"):
        fetched = re.findall(r'<(?:script|link|img|iframe)\b[^>]*?\b(?:src|href)="(https?:[^"]+)"', page.read_text())
        assert not fetched, f"{page.name}: {fetched}"
    for sheet in site.rglob("*.css"):
        assert not re.search(r"(?:url\(|@import )[\"']?https?:", sheet.read_text()), sheet


@pytest.fixture
def served(site):
    """A request to what `tools/docs serve` runs, here for the built site: get(target) gives (status, body)."""
    config = load_config(str(ROOT / "tools/site/mkdocs.yml"))
    assert ip_address(config.dev_addr.host).is_loopback
    (site.parent / "secret.html").write_text("secret")
    server = LiveReloadServer(lambda: None, config.dev_addr.host, 0, str(site))
    server.server_bind()
    server.server_activate()
    server.serve_thread.start()

    def get(target):
        with closing(HTTPConnection(*server.server_address, timeout=10)) as line:
            line.putrequest("GET", target, skip_host=True)
            line.endheaders()
            answer = line.getresponse()
            return answer.status, answer.read()

    yield get
    server.shutdown(wait=False)


def test_only_this_machine_is_served_and_only_the_site(served):
    assert served("/index.html")[0] == served("/start/../index.html")[0] == 200
    for way in (
        "/../secret.html",
        "/%2e%2e/secret.html",
        "/..%2fsecret.html",
        "/start/../../secret.html",
        "//secret.html",
        "/..\\secret.html",
        "//etc/passwd",
        f"/{ROOT}/README.md",
    ):
        assert served(way)[0] == 404, way


def test_no_link_leads_out_of_the_documentation():
    """MkDocs copies what links lead to."""
    assert not [path for path in (ROOT / "docs").rglob("*") if not path.resolve().is_relative_to(ROOT / "docs")]
