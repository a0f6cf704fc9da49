"""The site: built without a warning and without a network, its pages from the project, its code and its data."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote

import pytest

from studies.scenario import scenes
from studies.study import NAMES

yaml = pytest.importorskip("yaml")
pytest.importorskip("material")
pytest.importorskip("mkdocstrings")
pytest.importorskip("nbconvert")
ROOT = Path(__file__).resolve().parents[2]
SETTINGS = ROOT / "studies" / "site" / "mkdocs.yml"
LOADED = re.compile(r'<(?:script|img|iframe|link)[^>]*? (?:src|href)="([^"]+)"')
OUTSIDE = re.compile(r"(?:https?:)?//")
PACKAGES = ("coupling", "meshes", "studies", "tests", "thread", "tissue")
FUNCTION = re.compile(r"`((?:\w+/)+\w+)\.py:([\w.]+)`")


def build(settings: Path, folder: Path) -> subprocess.CompletedProcess[str]:
    """Build a site into a folder, and return how the command ended."""
    command = [sys.executable, "-m", "mkdocs", "build", "-f", str(settings), "-d", str(folder)]
    return subprocess.run(
        command, check=False, env=os.environ | {"NO_MKDOCS_2_WARNING": "1"}, capture_output=True, text=True
    )


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The files of the site by their names: the text of a page, nothing of the others."""
    folder = tmp_path_factory.mktemp("site")
    done = build(SETTINGS, folder)
    assert done.returncode == 0, done.stderr
    files = {str(path.relative_to(folder)): path for path in folder.rglob("*") if path.is_file()}
    kept = (".html", ".css", ".json")
    return {name: path.read_text(encoding="utf-8") if path.suffix in kept else "" for name, path in files.items()}


def at(page: str, link: str) -> str:
    """The name of the file to which a link in a page leads."""
    return os.path.normpath(os.path.join(os.path.dirname(page), unquote(link.partition("#")[0].partition("?")[0])))


def test_what_a_page_loads_is_stored_with_it(built: dict[str, str]) -> None:
    """Independent check: every script, style and picture of each page is a file of the site, none of another host."""
    pages = [name for name in built if name.endswith(".html")]
    assert len(pages) > 400
    for page in pages:
        loaded = [link for link in LOADED.findall(built[page]) if not link.startswith("data:image/")]
        assert len(loaded) > 4 and not any(OUTSIDE.match(link) for link in loaded), page
        if page != "404.html":  # its links are absolute
            assert [link for link in loaded if at(page, link) not in built] == [], page
    for style in (text for name, text in built.items() if name.endswith(".css")):
        assert not re.search(r"@import|url\([\"']?(?:https?:)?//", style)


def test_every_page_is_in_the_navigation(built: dict[str, str]) -> None:
    """Independent check: the front page leads to every Markdown page of the project, and every module has its page."""
    led = {at("index.html", link) for link in re.findall(r'<a href="([^"]+)" class="md-nav__link', built["index.html"])}
    pages = [*ROOT.glob("*.md"), *(path for package in PACKAGES for path in (ROOT / package).rglob("*.md"))]
    names = {str(path.relative_to(ROOT)) for path in pages if path.parent.name != "results"}
    assert {re.sub(r"README\.md$", "index.html", name).replace(".md", ".html") for name in names} <= led
    assert {"GALLERY.html", "studies/site/python.ipynb.html", "code/suturefem.html"} <= led
    modules = [path.relative_to(ROOT) for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    described = [path for path in modules if path.parts[0] != "tests" and path.parts[:2] != ("studies", "api")]
    dotted = [".".join(path.with_suffix("").parts).removesuffix(".__init__") for path in described]
    assert [name for name in dotted if f'id="{name}"' not in built[f"code/{name}.html"]] == []


def test_formulas_are_drawn_by_the_browser(built: dict[str, str]) -> None:
    """Independent check: the formulas of the front page are MathML, and no page has one in TeX."""
    formulas = re.findall(r"\$\$.+?\$\$|\$[^$\n]+\$", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    assert 0 < len(formulas) == built["index.html"].count("<math")
    for name, text in built.items():
        assert not re.search(r'<(?:span|div) class="arithmatex"', text) and "\\begin{" not in text, name


def test_each_equation_leads_to_its_function(built: dict[str, str]) -> None:
    """Independent check: every `file.py:function` of the theory is a link to a mark that the page of its module has."""
    theory = (ROOT / "coupling/README.md").read_text(encoding="utf-8")
    links = re.findall(
        r'href="(\.\./code/[\w.]+\.html)#([\w.]+)"[^>]*><code>([^<]+)</code>', built["coupling/index.html"]
    )
    assert {f"`{text}`" for *_, text in links} == {found[0] for found in FUNCTION.finditer(theory)}
    assert [link for link in links if f'id="{link[1]}"' not in built[at("coupling/index.html", link[0])]] == []
    assert "coupling.kernels.border.Border.H_qy" in {mark for _, mark, _ in links}


def test_links_to_files_show_them(built: dict[str, str]) -> None:
    """Independent check: a scene and a test are pages with a listing, which the search leaves out."""
    for page, link, word in (
        ("studies/scenario/index.html", "scenes/cough.toml.html", "youngs_modulus"),
        ("tests/index.html", "bounds.py.html", "TWO_SOLVERS"),
    ):
        assert f'href="{link}"' in built[page] and word in built[at(page, link)]
    assert "cough.toml" not in built["search/search_index.json"]


def test_no_line_of_a_docstring_is_a_quotation(built: dict[str, str]) -> None:
    """Independent check: Markdown would draw a line that begins with a sign of inequality as a quotation."""
    assert [name for name, text in built.items() if name.startswith("code/") and "<blockquote>" in text] == []


def test_names_and_words_are_found(built: dict[str, str]) -> None:
    """Independent check: the search has a function and a word of the notebook, also without a server; no sources."""
    found = {entry["location"]: entry["text"] for entry in json.loads(built["search/search_index.json"])["docs"]}
    assert "Linearise" in found["code/coupling.kernels.border.html#coupling.kernels.border.linearise"]
    assert any("Howell" in text for place, text in found.items() if place.startswith("studies/site/python.ipynb.html"))
    assert "search/search_index.js" in built
    assert not any("Source code in" in text for text in found.values())


def test_the_gallery_has_every_scene_and_study(built: dict[str, str]) -> None:
    """Independent check: a picture of its own and the file of each scene, the findings and the figure of each study."""
    gallery = built["GALLERY.html"]
    for scene in scenes():
        assert f'src="{scene}.png"' in gallery and f'href="studies/scenario/scenes/{scene}.toml.html"' in gallery
    for study in NAMES:
        assert f'href="studies/index.html#{study.replace("_", "-")}"' in gallery
        drawn = (ROOT / "studies" / study / "results/figure.png").is_file()
        assert (f'src="studies/{study}/results/figure.png"' in gallery) == drawn
    assert gallery.count("<img") == len(scenes()) + len(list(ROOT.glob("studies/*/results/figure.png")))
    pictures = list((SETTINGS.parent / "gallery").glob("*.png"))
    assert len({path.read_bytes() for path in pictures}) == len(scenes())


@pytest.mark.parametrize("text", ["[a](lost.md)", "[a](#lost)"])
def test_a_link_that_leads_nowhere_ends_it(tmp_path: Path, text: str) -> None:
    """Independent check: a lost file and a lost heading in a page of a small site with the same settings are errors."""
    small = {"INHERIT": str(SETTINGS), "docs_dir": "pages", "nav": [{"Home": "index.md"}], "plugins": [], "hooks": []}
    (tmp_path / "mkdocs.yml").write_text(yaml.safe_dump(small), encoding="utf-8")
    (tmp_path / "pages").mkdir()
    for words, status in (("a", 0), (text, 1)):
        (tmp_path / "pages/index.md").write_text(words, encoding="utf-8")
        assert build(tmp_path / "mkdocs.yml", tmp_path / "site").returncode == status
