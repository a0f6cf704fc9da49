"""Tables of a manual that are made from the code: a command updates each table between its two marks."""

import re
from collections.abc import Mapping


def with_blocks(manual: str, what: str, blocks: Mapping[str, str]) -> str:
    """Return the manual with each block between ``<!-- what name -->`` and ``<!-- end -->`` replaced by its name."""
    marks = re.compile(rf"(<!-- {re.escape(what)} (\S+) -->\n).*?(?=<!-- end -->)", re.DOTALL)
    return marks.sub(lambda found: f"{found[1]}{blocks[found[2]]}", manual)
