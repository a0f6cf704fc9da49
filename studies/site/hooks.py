"""Hooks of mkdocs: the pages, which stand all over the project, the files that they link to, and the code."""

import html
import posixpath
import re
from base64 import b64encode
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from nbconvert import MarkdownExporter

from studies.lists import study_list
from studies.scenario import scenes
from studies.scenario.reference import title_of
from studies.study import NAMES

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("studies/api", "meshes", "thread", "tissue", "coupling", "studies")
LINK = re.compile(r"\]\(([^)\s#:]+)")  # to a file of the project
LISTED = re.compile(r"(\]\([^)\s#:]+\.(?:cff|ipynb|py|toml|txt|yml))(?=[)#])")  # links to files shown as pages
FUNCTION = re.compile(r"`((?:\w+/)+\w+)\.py:([\w.]+)`")
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)
SOURCE = '<details class="mkdocstrings-source"'


def on_files(files: Files, config: MkDocsConfig) -> None:
    """Add the pages, and the files that they link to, under their paths in the project."""
    code = dict(packages())
    made = {f"code/{name}.md": described(name, code) for modules in code.values() for name in modules}
    made["GALLERY.md"] = "\n".join(gallery())
    listed = (name for entry in config.nav for name in entry.values())
    names = list(dict.fromkeys([*listed, *made, *config.extra["polyfills"]]))
    config.nav.append({"Code": [{package: titles(package, modules)} for package, modules in code.items()]})
    for name in names:  # which grows
        if not name.endswith(".md"):
            files.append(File.generated(config, name, abs_src_path=str(ROOT / name)))
            continue
        text = with_links(made[name]) if name in made else page(ROOT / name)
        files.append(File.generated(config, name, content=text))
        linked = (posixpath.normpath(posixpath.join(posixpath.dirname(name), link)) for link in LINK.findall(text))
        names += [new for new in dict.fromkeys(linked) if new not in names and exists(new)]


def packages() -> Iterator[tuple[str, list[str]]]:
    """Yield the name of each package, and its own with those of its modules."""
    for init in dict.fromkeys(path for top in PACKAGES for path in sorted((ROOT / top).rglob("__init__.py"))):
        package = ".".join(init.parent.relative_to(ROOT).parts).removeprefix("studies.api.")
        modules = sorted(path.stem for path in init.parent.glob("*.py") if path != init)
        yield package, [package, *(f"{package}.{module}" for module in modules)]


def titles(package: str, modules: list[str]) -> list[dict[str, str]]:
    """Return the entries of the navigation for a package and its modules."""
    return [{name.removeprefix(f"{package}."): f"code/{name}.md"} for name in modules]


def described(name: str, code: dict[str, list[str]]) -> str:
    """Return the page of a module, or of a package without the names that it imports from its modules."""
    return f"::: {name}\n" + "    options: {members: false}\n" * (len(code.get(name, ())) > 1)


def on_page_content(content: str, **_: Any) -> str:
    """Return the HTML of a page with MathML for its formulas, and its sources left out of the search."""
    return FORMULA.sub(mathml, content).replace(SOURCE, f"{SOURCE} data-search-exclude")


def mathml(found: re.Match[str]) -> str:
    """Return a TeX formula as MathML, which a browser draws by itself."""
    block = found[1] == "div"
    drawn = convert(html.unescape(found[2]), display="block" if block else "inline")
    return f'<div style="overflow-x: auto">{drawn}</div>' if block else str(drawn)


def exists(name: str) -> bool:
    """Return whether a name on the site is that of a file of the project, or of the page of one."""
    return (ROOT / name).is_file() or (ROOT / name.removesuffix(".md")).is_file()


def page(path: Path) -> str:
    """Return the text of a page: a Markdown file, or a notebook or listing whose name has `.md` appended."""
    if path.is_file():
        return with_links(path.read_text(encoding="utf-8"))
    source = path.with_suffix("")
    if source.suffix == ".ipynb":
        return with_links(notebook(source))
    listing = source.read_text(encoding="utf-8")
    return f"---\nsearch: {{exclude: true}}\n---\n# {source.name}\n\n````{source.suffix[1:]}\n{listing}````\n"


def notebook(path: Path) -> str:
    """Return a notebook as Markdown, with its figures in the page."""
    text, kept = MarkdownExporter().from_filename(str(path))
    for name, picture in kept["outputs"].items():
        text = text.replace(f"({name})", f"(data:image/png;base64,{b64encode(picture).decode()})")
    return str(text)


def with_links(text: str) -> str:
    """Return a page whose links lead to the pages of listings, and each `file.py:function` to its description."""
    as_pages = LISTED.sub(r"\1.md", text)
    return FUNCTION.sub(lambda found: f"[{found[0]}][{found[1].replace('/', '.')}.{found[2]}]", as_pages)


def gallery() -> Iterator[str]:
    """Yield the lines of the gallery: picture, title and file of each scene, then figure and question of each study."""
    yield '# Gallery\n\n## Scenes\n\n<div class="grid cards" markdown>\n'
    for scene in scenes():
        title = title_of(scene)
        yield f"- ![{title}]({scene}.png)\n\n    [{scene}](studies/scenario/scenes/{scene}.toml): {title}\n"
    yield '</div>\n\n## Studies\n\n<div class="grid cards" markdown>\n'
    for name in NAMES:
        figure, question = f"studies/{name}/results/figure.png", study_list(name)["question"]
        drawn = f"![{name}]({figure})\n\n    " if exists(figure) else ""
        yield f"- {drawn}[{name}](studies/README.md#{name.replace('_', '-')}): {question}\n"
    yield "</div>\n"
