"""The site: built without a warning and without a network, each equation leading to its function."""

import re
from pathlib import Path

import pytest

from studies.site import site

pytest.importorskip("mkdocs")
pytest.importorskip("latex2mathml")
OUTSIDE = re.compile(r'<(?:script|link|img|iframe)[^>]*(?:src|href)="(?:https?:)?//', re.IGNORECASE)


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    site.build(folder)
    return folder


def test_every_page_is_there_and_loads_nothing_from_outside(built: Path) -> None:
    """Independent check: a page for every room and package, no script, style or picture of another host."""
    pages = list(built.rglob("*.html"))
    assert len(pages) >= len(site.PAGES) + len(site.PACKAGES)
    for page in pages:
        assert not OUTSIDE.search(page.read_text(encoding="utf-8")), page
    assert (built / "studies/scenario/scenes/one_stitch.png").is_file()


def test_formulas_are_drawn_by_the_browser(built: Path) -> None:
    """Independent check: the block matrix of the front page is MathML, and no dollar of TeX is left over."""
    front = (built / "index.html").read_text(encoding="utf-8")
    assert front.count("<math") >= 4 and "\\begin{pmatrix}" not in front


def test_each_equation_leads_to_its_function(built: Path) -> None:
    """Independent check: every `file.py:function` of the theory is a link to a mark that the page of the code has."""
    theory = (built / "coupling/index.html").read_text(encoding="utf-8")
    links = re.findall(r'href="\.\./(code/\w+\.html)#([\w-]+)"', theory)
    named = site.FUNCTION.findall((site.ROOT / "coupling/README.md").read_text(encoding="utf-8"))
    assert len(links) >= len(named) > 50
    marks = {page: set(re.findall(r'id="([\w-]+)"', (built / page).read_text(encoding="utf-8"))) for page, _ in links}
    assert [link for link in links if link[1] not in marks[link[0]]] == []
    assert "coupling-kernels-border-border" in {mark for _, mark in links}


def test_a_link_that_leads_nowhere_ends_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: a lost file and a lost heading in a page are errors."""
    for text in ("[a](lost.md)", "[a](#lost)"):
        monkeypatch.setattr(site, "gather", lambda sources, text=text: site.write(sources / "README.md", text))
        monkeypatch.setattr(site, "navigation", lambda: [{"Home": "README.md"}])
        with pytest.raises(RuntimeError, match="the site is not built"):
            site.build(tmp_path / "site")


def test_what_a_docstring_says_is_no_markup() -> None:
    """Independent check: marks of code are kept, signs of Markdown and HTML are text."""
    assert site.described("a ``b_c`` d_e <f> [N] |x|") == r"a `b_c` d\_e &lt;f> \[N\] \|x\|"
