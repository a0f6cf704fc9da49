"""The page of a report: pieces of HTML, and the whole page.

The page includes its style, its script and plotly's script.
"""

import html
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from string import Template
from typing import Any

HERE = Path(__file__).parent


def plotly_script() -> str:
    """Return plotly's program as one text."""
    from plotly.offline import get_plotlyjs

    return str(get_plotlyjs())


def whole_page(title: str, body: Iterable[str], data: Mapping[str, Any]) -> str:
    """Return a page that needs no other file; its head forbids the loading of files."""
    parts = {name: (HERE / f"page.{name}").read_text(encoding="utf-8") for name in ("html", "css", "js")}
    numbers = json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    parts |= {"title": html.escape(title), "body": "\n".join(body), "data": numbers, "plotly": plotly_script()}
    return Template(parts["html"]).substitute(parts)


def escaped(value: object) -> str:
    """Return a value as text of a page."""
    return html.escape(str(value))


def number_text(value: object) -> str:
    """Return a number with four digits, or any other value unchanged; empty for None and NaN."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list | tuple):
        return ", ".join(number_text(item) for item in value)
    return str(value)


def figure(png: str, words: str) -> str:
    """Return a picture in base64, with an alternative text."""
    return f'<img class="figure" alt="{escaped(words)}" src="data:image/png;base64,{png}">'


def heading(text: str) -> str:
    """Return the heading of a section."""
    return f"<h2>{escaped(text)}</h2>"


def paragraph(text: str) -> str:
    """Return a paragraph of explanation."""
    return f'<p class="note">{escaped(text)}</p>'


def table(head: Sequence[str], rows: Iterable[Sequence[object]], words: int = 1) -> str:
    """Return a table whose first `words` columns are words and the others numbers."""

    def line(tag: str, cells: Sequence[object]) -> str:
        parts = [
            f"<{tag}{'' if place < words else chr(32) + 'class=n'}>{escaped(number_text(cell))}</{tag}>"
            for place, cell in enumerate(cells)
        ]
        return f"<tr>{''.join(parts)}</tr>"

    body = "".join(line("td", row) for row in rows)
    return f'<div class="scroll"><table><thead>{line("th", head)}</thead><tbody>{body}</tbody></table></div>'


def remark_list(remarks: Sequence[Mapping[str, str]], without: str) -> str:
    """Return the remarks as a list, or the sentence `without` if there is none."""
    if not remarks:
        return paragraph(without)
    words = ("severity", "message", "code", "where")
    item = '<li class="{0}"><b>{0}</b>{1} <code>{2}</code> {3}</li>'
    items = [item.format(*(escaped(one.get(word, "")) for word in words)) for one in remarks]
    return f'<ul class="remarks">{"".join(items)}</ul>'


def side_by_side(left: str, right: str) -> str:
    """Return two parts next to each other; on a narrow screen one is below the other."""
    return f'<div class="beside"><div>{left}</div><div>{right}</div></div>'


def folded(title: str, text: str) -> str:
    """Return text that is shown on a click."""
    return f"<details><summary>{escaped(title)}</summary><pre>{escaped(text)}</pre></details>"


def chart(name: str) -> str:
    """Return the place of a chart."""
    return f'<div class="chart" id="{escaped(name)}"></div>'


def selection(name: str, label: str, options: Iterable[str] = (), chosen: str = "") -> str:
    """Return a selection, with the given options or with options from the page's script."""
    marked = ((option, " selected" if option == chosen else "") for option in options)
    items = "".join(f"<option{mark}>{escaped(option)}</option>" for option, mark in marked)
    return f'<label>{escaped(label)} <select id="{escaped(name)}">{items}</select></label>'
