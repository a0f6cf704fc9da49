"""Tables of a manual that are made from the code.

A command updates each table between its two marks.
"""

import re
from collections.abc import Mapping


def with_blocks(manual: str, what: str, blocks: Mapping[str, str]) -> str:
    """Return the manual with updated blocks.

    A block stands between ``<!-- what name -->`` and ``<!-- end -->``, and is replaced by its name.
    """
    marks = re.compile(rf"(<!-- {re.escape(what)} (\S+) -->\n).*?(?=<!-- end -->)", re.DOTALL)
    return marks.sub(lambda found: f"{found[1]}{blocks[found[2]]}", manual)
