"""The site by mkdocs: the Markdown pages, pages generated from the code, and the linked files.

``python -m studies.site.site DIR`` builds the site into a folder; a warning is an error. Pages load
nothing from the network: formulas become MathML here, and the theme's files are stored with the
pages.
"""

import ast
import logging
import re
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from studies.lists import list_of
from studies.site.notebook import cells_of, markdown

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("meshes", "thread", "tissue", "coupling", "studies")
CODE = "code"  # folder of the pages made from the code
PAGES: dict[str, str] = list_of(__file__, "pages.toml")
CHECKED = ("not_found", "anchors", "absolute_links", "unrecognized_links")  # checks of every link
LINK = re.compile(r"\]\(([^)\s#]+)(?:#[^)\s]*)?\)")
NOTEBOOKS = re.compile(r"(\]\([^)\s]+)\.ipynb([)#])")
FUNCTION = re.compile(r"`((?:\w+/)+\w+\.py):([\w.]+)`")
LISTING = re.compile(r"(^```.*?^```$|`[^`\n]+`)", re.MULTILINE | re.DOTALL)
FORMULA = re.compile(r"\$\$(.+?)\$\$|\$([^$\n]+)\$", re.DOTALL)


def build(target: Path) -> None:
    """Build the site into a folder.

    Raises `RuntimeError` for a warning, for example about a broken link.
    """
    from mkdocs.commands.build import build as build_pages
    from mkdocs.config import load_config
    from mkdocs.exceptions import Abort

    with tempfile.TemporaryDirectory() as folder:
        sources = Path(folder) / "docs"
        gather(sources)
        settings = Path(folder) / "mkdocs.yml"
        settings.write_text("site_name: suturefem\n", encoding="utf-8")
        config = load_config(
            str(settings), docs_dir=str(sources), site_dir=str(target.resolve()), strict=True, use_directory_urls=False,
            plugins=[],  # the search plugin loads a worker, which is impossible for a page opened as a file
            theme={"name": "readthedocs", "highlightjs": False}, nav=navigation(),
            markdown_extensions=["tables", "fenced_code", "md_in_html", "toc"],
            validation={"links": dict.fromkeys(CHECKED, "warn")},
        )  # fmt: skip
        logging.getLogger("mkdocs").setLevel(logging.WARNING)
        try:
            build_pages(config)
        except Abort as error:
            raise RuntimeError(f"the site is not built: {error}") from None


def navigation() -> list[dict[str, Any]]:
    """Return the pages in reading order, with the pages of the code last."""
    code = [{package: f"{CODE}/{package}.md"} for package in PACKAGES]
    return [*({title: as_page(name)} for title, name in PAGES.items()), {"Code": code}]


def as_page(name: str) -> str:
    """Return the name of a page on the site; a notebook becomes Markdown."""
    return name.replace(".ipynb", ".md")


def gather(sources: Path) -> None:
    """Write the pages, and copy every linked file, at the same places as in the project."""
    for package in PACKAGES:
        write(sources / CODE / f"{package}.md", package_page(package))
    for name in PAGES.values():
        text = markdown(cells_of(ROOT / name)) if name.endswith(".ipynb") else (ROOT / name).read_text(encoding="utf-8")
        for linked in LINK.findall(text):
            copy(ROOT / name, linked, sources)
        up = "../" * name.count("/")
        write(sources / as_page(name), with_mathml(with_code_links(NOTEBOOKS.sub(r"\1.md\2", text), up)))


def write(path: Path, text: str) -> None:
    """Write a page."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


def copy(page: Path, link: str, sources: Path) -> None:
    """Copy a file that a page links to, unless the file is itself a page of the site."""
    found = (page.parent / link).resolve()
    if not found.is_file() or not found.is_relative_to(ROOT):
        return
    name = found.relative_to(ROOT)
    if str(name) not in PAGES.values():
        (sources / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(found, sources / name)


def with_code_links(text: str, up: str) -> str:
    """Return a page with a link for each `file.py:function` to the pages of the code.

    `up` is the path from the page to the top of the site.
    """
    return FUNCTION.sub(lambda found: f"[`{found[0][1:-1]}`]({up}{code_link(found[1], found[2])})", text)


def code_link(file: str, name: str) -> str:
    """Return the link to the description of a class or function, else of its file.

    A member has the link of its class.
    """
    package, module = Path(file).parts[0], module_of(Path(file))
    first = name.partition(".")[0]
    known = {each.name for each in public(ROOT / file)}
    return f"{CODE}/{package}.md#{anchor(f'{module}.{first}' if first in known else module)}"


def anchor(name: str) -> str:
    """Return the anchor of a dotted name."""
    return name.replace(".", "-").lower()


def with_mathml(text: str) -> str:
    """Return a page whose formulas outside listings are MathML, which a browser can draw."""
    parts = LISTING.split(text)
    return "".join(part if place % 2 else FORMULA.sub(mathml, part) for place, part in enumerate(parts))


def mathml(found: re.Match[str]) -> str:
    """Return a TeX formula as MathML."""
    from latex2mathml.converter import convert

    drawn = convert(found[1] or found[2], display="block" if found[1] else "inline")
    return f'<div style="overflow-x: auto">{drawn}</div>' if found[1] else drawn


def package_page(package: str) -> str:
    """Return the page of a package.

    It has the modules with their docstrings, and their public classes and functions.
    """
    modules = sorted((ROOT / package).rglob("*.py"))
    return f"# {package}\n\n" + "\n".join(line for path in modules for line in module_lines(path))


def module_lines(path: Path) -> Iterator[str]:
    """Yield the lines of a module with a docstring."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    words, module = ast.get_docstring(tree), module_of(path.relative_to(ROOT))
    if not words:
        return
    yield f'<h2 id="{anchor(module)}">{module}</h2>\n\n{described(words)}\n'
    for each in public(path):
        yield f'<h3 id="{anchor(f"{module}.{each.name}")}"><code>{signature(each)}</code></h3>\n'
        yield f"{described(ast.get_docstring(each) or '')}\n"


def module_of(path: Path) -> str:
    """Return the dotted name of a module; for an `__init__`, the name of its package."""
    return ".".join(path.with_suffix("").parts).removesuffix(".__init__")


def public(path: Path) -> list[ast.FunctionDef | ast.ClassDef]:
    """Return the public classes and functions of a module.

    Their names have no leading underscore.
    """
    body = ast.parse(path.read_text(encoding="utf-8")).body
    return [each for each in body if isinstance(each, ast.FunctionDef | ast.ClassDef) and each.name[0] != "_"]


def signature(each: ast.FunctionDef | ast.ClassDef) -> str:
    """Return the signature of a function, or the fields of a class, as text of a page."""
    if isinstance(each, ast.FunctionDef):
        text = f"{each.name}({ast.unparse(each.args)})" + (f" -> {ast.unparse(each.returns)}" if each.returns else "")
    else:
        given = [f"{part.target.id}: {ast.unparse(part.annotation)}" for part in each.body
                 if isinstance(part, ast.AnnAssign) and isinstance(part.target, ast.Name)]  # fmt: skip
        text = f"class {each.name}({', '.join(given)})"
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


def described(words: str) -> str:
    """Return a docstring as text of a page, in which only code marks are kept."""
    text = re.sub(r"``(.+?)``", r"`\1`", words)
    return "\n".join(
        "".join(part if k % 2 else escaped(part) for k, part in enumerate(re.split(r"(`[^`]+`)", line)))
        for line in text.splitlines()
    )


def escaped(text: str) -> str:
    """Return text with the marks of Markdown and HTML escaped."""
    return re.sub(r"([\\*_\[\]|#])", r"\\\1", text.replace("&", "&amp;").replace("<", "&lt;"))


if __name__ == "__main__":
    build(Path(sys.argv[1]))
