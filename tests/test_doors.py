"""What the pages say can be done: every listing of Python and TOML, every command and every link in a Markdown file.

The listings of Python in a page follow one another. A listing of TOML is a whole scenario, or, after the comment
`<!-- fragment -->`, a part that is put into the scene `two_piercings`. In commands `FILE.toml` and the tutorial's
`stitch.toml` stand for a scenario, `NAME` for a study and `…` for arguments left out; one word alone names a command.
"""

import argparse
import re
import shlex
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import pytest

from studies.command.command import main
from studies.scenario import SCENES, load, parse, schema
from studies.simulation import prepare
from studies.study import NAMES, arguments, study
from suturefem import run

ROOT = Path(__file__).resolve().parent.parent
FRONT, GUIDE = ROOT / "README.md", ROOT / "studies" / "scenario" / "GUIDE.md"
LISTING = re.compile(r"^(?:<!-- (?P<mark>.*?) -->\n)?```(?P<kind>\w*)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL)
INLINE = re.compile(r"`([^`\n]+)`")
LINK = re.compile(r"\]\(([^)\s]+)\)")
KEY = re.compile(r"((?:tissue|thread|piercing|solve|output)(?:\.\w+)+)(?: = .*)?")
LINES = 150  # of the front page
PLACEHOLDERS = {"FILE.toml": "two_piercings", "stitch.toml": "two_piercings", "NAME": NAMES[0]}  # of commands


@dataclass(frozen=True)
class Listing:
    """A listing in a page: what is written above it, its language, and its text."""

    page: Path
    line: int
    mark: str
    kind: str
    text: str

    def __str__(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line}"


def pages() -> list[Path]:
    """Every Markdown file of the project; hidden folders, `results` and `build` are not of it."""
    found = (path.relative_to(ROOT) for path in ROOT.rglob("*.md"))
    return sorted(
        ROOT / path
        for path in found
        if path.parts[0] not in ("build", "results") and not any(p[0] == "." for p in path.parts)
    )


def listings(page: Path, text: str) -> list[Listing]:
    """The listings of a page."""
    return [
        Listing(page, 1 + text.count("\n", 0, found.start("kind")), found["mark"] or "", found["kind"], found["text"])
        for found in LISTING.finditer(text)
    ]


def commands(text: str) -> Iterator[str]:
    """The `suture` commands of a page, in its listings of shell and in its sentences."""
    lines = [line for listing in listings(ROOT, text) if listing.kind == "sh" for line in listing.text.splitlines()]
    parts = [part.strip() for line in lines for part in line.split("&&")] + INLINE.findall(LISTING.sub("", text))
    for part in parts:
        if found := re.match(r"(?:\S*/)?suture (.+)", part):
            yield found[1]


def missing_links(page: Path, text: str) -> list[str]:
    """The relative links of a page that lead nowhere: no such file in the project, or no such heading in it."""
    plain = INLINE.sub("", LISTING.sub("", text))
    return [link for link in LINK.findall(plain) if not re.match(r"[a-z]+:", link) and not leads(page, link)]


def leads(page: Path, link: str) -> bool:
    """Whether a relative link leads to a file of the project, and to a heading of it where one is named."""
    name, _, heading = link.partition("#")
    target = (page.parent / name).resolve() if name else page
    if not target.is_relative_to(ROOT) or not target.exists():
        return False
    return not heading or heading in anchors(target.read_text(encoding="utf-8"))


def anchors(text: str) -> set[str]:
    """Names by which the headings of a page are linked."""
    headings = re.findall(r"^#+ (.+)$", LISTING.sub("", text), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def merged(whole: Mapping[str, Any], part: Mapping[str, Any]) -> dict[str, Any]:
    """Tables with those of a part put in: key by key, lists of tables by name, a table of another kind in place."""
    if "kind" in whole and part.get("kind", whole["kind"]) != whole["kind"]:
        return dict(part)
    out = dict(whole)
    for key, value in part.items():
        old = whole.get(key)
        if isinstance(value, dict) and isinstance(old, dict):
            out[key] = merged(old, value)
        elif isinstance(value, list) and value and isinstance(value[0], dict) and "name" in value[0]:
            named = {item["name"]: item for item in old or []}
            named |= {item["name"]: merged(named.get(item["name"], {}), item) for item in value}
            out[key] = list(named.values())
        else:
            out[key] = value
    return out


def keys(node: Mapping[str, Any], whole: Mapping[str, Any], name: str = "") -> set[str]:
    """Dotted names of all keys that a JSON schema knows below a node, without the numbers of lists."""
    if "$ref" in node:
        node = whole["$defs"][node["$ref"].rpartition("/")[2]]
    out = {name}
    for choice in [*node.get("anyOf", ()), *node.get("oneOf", ())]:
        out |= keys(choice, whole, name)
    if isinstance(node.get("items"), dict):
        out |= keys(node["items"], whole, name)
    for key, value in node.get("properties", {}).items():
        out |= keys(value, whole, f"{name}.{key}" if name else key)
    return out


PAGES = {str(page.relative_to(ROOT)): page.read_text(encoding="utf-8") for page in pages()}
LISTINGS = [listing for name, text in PAGES.items() for listing in listings(ROOT / name, text)]
COMMANDS = [(name, command) for name, text in PAGES.items() for command in dict.fromkeys(commands(text))]


def test_the_front_page_is_short_and_its_commands_are_one_line() -> None:
    """Independent check: a page that is read to its end, and the tests' command as `.ci/run` looks for it."""
    lines = PAGES["README.md"].splitlines()
    assert len(lines) <= LINES
    assert len([line for line in lines if re.match(r"python3 -m venv .*pytest", line)]) == 1
    assert len([line for line in lines if re.match(r"python3 -m venv .*suture run", line)]) == 1


@pytest.mark.parametrize("name", PAGES)
def test_links_lead_somewhere(name: str) -> None:
    """Independent check: every relative link is a file of the project, and every heading linked stands in it."""
    assert missing_links(ROOT / name, PAGES[name]) == []


@pytest.mark.parametrize("name", dict.fromkeys(str(x.page.relative_to(ROOT)) for x in LISTINGS if x.kind == "python"))
def test_python_runs(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: the listings of Python in a page run to their end one after the other, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"__name__": "__main__"}
    for listing in LISTINGS:
        if (listing.page, listing.kind) == (ROOT / name, "python"):
            exec(compile(listing.text, str(listing), "exec"), names)
    plt.close("all")  # README draws one, which the notebook of the same process would show as its own


@pytest.mark.parametrize("listing", [x for x in LISTINGS if x.kind == "toml"], ids=str)
def test_scenarios_can_be_run(listing: Listing, tmp_path: Path) -> None:
    """Independent check: a whole scenario passes `suture check`, a part of one within `two_piercings`."""
    assert listing.mark in ("", "fragment")
    if listing.mark:
        whole = tomllib.loads((SCENES / "two_piercings.toml").read_text(encoding="utf-8"))
        prepare(parse(merged(whole, tomllib.loads(listing.text))))
        return
    (tmp_path / "scenario.toml").write_text(listing.text, encoding="utf-8")
    assert main(["check", str(tmp_path / "scenario.toml")]) == 0


def test_the_front_page_s_scenario_is_the_scene_that_it_runs(tmp_path: Path) -> None:
    """Independent check: the listing is the file of the scene, and its run ends without a remark and a closed wound."""
    [scenario] = [x for x in LISTINGS if x.page == FRONT and x.kind == "toml"]
    [command] = [command for name, command in COMMANDS if name == "README.md" and command.startswith("run ")]
    scene = command.split()[1]
    assert scenario.text == (SCENES / f"{scene}.toml").read_text(encoding="utf-8")
    finished = run(load(scene), tmp_path / "run")
    assert finished.remarks == []
    assert finished.quantities["ties.knot.force"].value == pytest.approx(0.36, rel=1e-3)


@pytest.mark.parametrize(("name", "command"), COMMANDS)
def test_commands_are_understood(name: str, command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: `suture` takes the arguments, and its scenario, study and overrides are there."""
    words = [PLACEHOLDERS.get(word, word) for word in shlex.split(command)]
    if "…" in words or len(words) == 1:
        words = [words[0], "--help"]
    options = understood(words, monkeypatch)
    if words[0] in ("run", "check", "mesh") and options:
        load(options.file, options.set)
    if words[0] == "study" and options and options.name != "list":
        arguments(study(options.name), options.preset, options.set)


def understood(words: list[str], monkeypatch: pytest.MonkeyPatch) -> argparse.Namespace | None:
    """What `suture` makes of its arguments, without carrying it out; None where it only explains itself."""
    seen: list[argparse.Namespace] = []
    original = argparse.ArgumentParser.parse_args

    def read(self: argparse.ArgumentParser, args: Any = None, namespace: Any = None) -> argparse.Namespace:
        seen.append(original(self, args, namespace))
        seen[0].command = lambda options: 0
        return seen[0]

    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", read)
    try:
        assert main(words) == 0
    except SystemExit as end:
        assert end.code == 0, f"suture {shlex.join(words)} is not understood"
        return None
    return seen[0]


def test_the_guide_names_keys_that_there_are() -> None:
    """Independent check: every `table.key` in its sentences is one of the schema."""
    known = keys(schema(), schema())
    named = {found[1] for code in INLINE.findall(PAGES[str(GUIDE.relative_to(ROOT))]) if (found := KEY.fullmatch(code))}
    assert len(named) > 30
    assert named <= known, named - known


def test_the_checks_see_what_they_should(monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: a lost file, a lost heading, a listing that fails, a command and a key that are none."""
    text = "[a](lost.md) [b](README.md#lost) [c](README.md#licence) [d](https://x.y) `[e](f)`\n"
    assert missing_links(FRONT, text) == ["lost.md", "README.md#lost"]
    text += (
        "<!-- fragment -->\n```toml\na = 1\n```\n\n```sh\ncd x && .venv/bin/suture run y\n```\nsay `suture check z`\n"
    )
    assert [(x.line, x.mark, x.kind, x.text) for x in listings(FRONT, text)] == [
        (3, "fragment", "toml", "a = 1\n"),
        (7, "", "sh", "cd x && .venv/bin/suture run y\n"),
    ]
    assert list(commands(text)) == ["run y", "check z"]
    whole = {"m": {"kind": "a", "x": 1}, "p": [{"name": "u", "x": 1}, {"name": "v"}]}
    part = {"m": {"kind": "b"}, "p": [{"name": "u", "y": 2}]}
    assert merged(whole, part) == {"m": {"kind": "b"}, "p": [{"name": "u", "x": 1, "y": 2}, {"name": "v"}]}
    assert {"solve.dt", "piercing.from", "tissue.mesh.h_site"} <= keys(schema(), schema())
    with pytest.raises(AssertionError, match="not understood"):
        understood(["run", "two_piercings", "--outt", "DIR"], monkeypatch)


def test_the_quick_tests_are_files_of_tests() -> None:
    """Independent check: every file that the list names is there, once, and they come from every folder of tests."""
    files = (ROOT / "tests" / "quick.txt").read_text(encoding="utf-8").split()
    assert len(set(files)) == len(files) and all((ROOT / name).is_file() for name in files)
    folders = {path.parent for path in (ROOT / "tests").rglob("test_*.py")} - {ROOT / "tests" / "fuzz"}
    assert {(ROOT / name).parent for name in files} == folders


def test_the_recipes_name_what_there_is() -> None:
    """Independent check: every file that CONTRIBUTING.md names is there, and every name of code stands in the code."""
    code = INLINE.findall(LISTING.sub("", PAGES["CONTRIBUTING.md"]))
    files = {name for name in code if re.fullmatch(r"\.?\w+(/\w+)*/\w+(\.py)?", name) and "NAME" not in name}
    assert len(files) > 10
    assert [name for name in files if not (ROOT / name).exists()] == []
    modules = [path for folder in ("coupling", "meshes", "studies", "tests", "thread", "tissue")
               for path in (ROOT / folder).rglob("*.py") if path != Path(__file__)]  # fmt: skip
    text = "\n".join(path.read_text(encoding="utf-8") for path in modules)
    names = {name for name in code if re.fullmatch(r"[A-Za-z_]\w+(\.[a-z_]\w*)*", name)} - {"NAME", "OMP_NUM_THREADS"}
    assert len(names) > 30
    assert [name for name in names if not re.search(rf"\b{name.rpartition('.')[2]}\b", text)] == []
