"""The table of a sweep: a row for each case.

It has a column for each varied key and for each quantity of the summary. It does not depend on
time, machine or order of the runs: the same cases give the same bytes.
"""

import io
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from studies.output.columns import headed, quantities
from studies.output.files import comma_separated, write_bytes, write_text
from studies.scenario import ScenarioError, as_toml
from studies.scenario.reference import unit_of

# A case: the values of its keys, and its result, with `exit_status`, `summary` and, if known, `cells`.
Case = tuple[Mapping[str, Any], Mapping[str, Any]]

NEAR, LIKE = 3, 0.6  # largest number of suggested names, and their least similarity: difflib's own bound


@dataclass(frozen=True)
class Column:
    """A column with its name, its unit, and a value or None per row.

    The unit is "-" for a number without unit, and empty for words.
    """

    name: str
    unit: str
    values: tuple[float | int | str | bool | None, ...]

    @property
    def heading(self) -> str:
        """The name with its unit: `solve.dt [s]`."""
        return headed(self.name, self.unit)

    @property
    def kind(self) -> type:
        """Type of its values: float, int, bool, or str if they differ."""
        kinds = {type(value) for value in self.values if value is not None}
        if kinds <= {int, float} and kinds:
            return float if float in kinds else int
        return kinds.pop() if len(kinds) == 1 else str

    @property
    def is_number(self) -> bool:
        """Whether its values are numbers or None."""
        return self.kind in (int, float) or all(value is None for value in self.values)

    @property
    def converted(self) -> list[Any]:
        """Its values, all converted to the column's type."""
        return [None if value is None else self.kind(value) for value in self.values]


@dataclass(frozen=True)
class SweepTable:
    """The columns of a sweep, all of the same length."""

    columns: tuple[Column, ...]

    def __repr__(self) -> str:
        failed = sum(status != 0 for status in self["exit_status"].values)
        return f"SweepTable({len(self)} cases, {failed} not completed, {len(self.columns)} columns)"

    def __len__(self) -> int:
        return len(self.columns[0].values)

    def __getitem__(self, name: str) -> Column:
        """Return a column by its name without its unit. Raises `KeyError`."""
        for column in self.columns:
            if name in (column.name, column.heading):
                return column
        raise KeyError(name)

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names of the columns, as a mapping does."""
        return iter(self.names)

    @property
    def names(self) -> list[str]:
        """The names of the columns, without units."""
        return [column.name for column in self.columns]

    @property
    def csv(self) -> str:
        """The table in CSV: numbers with all their digits, empty for None."""
        rows = zip(*(map(written, column.converted) for column in self.columns), strict=True)
        return comma_separated([[column.heading for column in self.columns], *map(list, rows)])

    @property
    def parquet(self) -> bytes:
        """The table in Parquet, with the unit of each column in its metadata.

        Raises `ImportError`.
        """
        import pyarrow
        import pyarrow.parquet

        types = {float: pyarrow.float64(), int: pyarrow.int64(), bool: pyarrow.bool_(), str: pyarrow.string()}
        fields = [pyarrow.field(c.heading, types[c.kind], metadata={"unit": c.unit}) for c in self.columns]
        arrays = [pyarrow.array(c.converted, types[c.kind]) for c in self.columns]
        data = io.BytesIO()
        pyarrow.parquet.write_table(pyarrow.Table.from_arrays(arrays, schema=pyarrow.schema(fields)), data)
        return data.getvalue()


def counted(cases: int) -> str:
    """Return a number of cases in words."""
    return "1 case" if cases == 1 else f"{cases} cases"


def asked_column(table: SweepTable, name: str, option: str, number: bool = True) -> Column:
    """Return the column named in an option; it must be numeric, unless `number` is False.

    Raises `ScenarioError` with similar names.
    """
    try:
        column = table[name]
    except KeyError:
        known = [column.name for column in table.columns if not number or column.is_number]
        near = get_close_matches(name, known, NEAR, LIKE)
        hint = f"the nearest are {', '.join(near)}" if near[1:] else f"the nearest is {near[0]}" if near else ""
        hint = hint or f"there are for example {', '.join(known[1:9])}"
        what = "number" if number else "column"
        raise ScenarioError(f"{option} {name} is refused: the table has no such {what}; {hint}") from None
    if number and not column.is_number:
        raise ScenarioError(f"{option} {name} is refused: it is a word or a list; give a number's name")
    return column


def drawn_columns(table: SweepTable, names: Sequence[str]) -> list[Column]:
    """Return the columns of a figure: two numeric ones, and a third of any kind.

    Without a third name it is the other of two varied keys whose combinations are run, or the last
    if the first column is no key. Raises `ScenarioError`.
    """
    columns = [asked_column(table, name, "--plot", number=place < 2) for place, name in enumerate(names)]
    keys = [key for key in table.columns[1 : table.names.index("exit_status")] if 1 < len(set(key.values)) < len(table)]
    others = [key for key in keys if key is not columns[0]]
    return columns + others[-1:] if len(columns) == len(keys) == 2 else columns


def written(value: object) -> object:
    """Return a value as the cell of a table in CSV: a flag in the words of TOML."""
    return as_toml(value) if isinstance(value, bool) else value


def table_of(cases: Sequence[Case]) -> SweepTable:
    """Return the table of cases."""
    every, results = [settings for settings, _ in cases], [result for _, result in cases]
    varied = dict.fromkeys(key for settings in every for key in settings)
    found = [quantities(result["summary"]) for result in results]
    units = {name: q.unit for row in found for name, q in row.items()}
    keys = [Column(key, unit_of(key), tuple(plain(settings.get(key)) for settings in every)) for key in varied]
    measured = [
        Column(name, unit, tuple(row[name].value if name in row else None for row in found))
        for name, unit in units.items()
    ]
    remarks = [result["summary"].get("remarks", []) for result in results]
    codes = ("; ".join(f"{remark['code']} ({remark['where']})" for remark in row) for row in remarks)
    unsupported = (sum(remark["severity"] == "unsupported" for remark in row) for row in remarks)
    ended = [
        Column("exit_status", "", tuple(result["exit_status"] for result in results)),
        Column("unsupported", "", tuple(unsupported)),
        Column("remarks", "", tuple(codes)),
    ]
    cells = Column("cells", "-", tuple(result.get("cells") for result in results))
    return SweepTable((Column("case", "", tuple(range(len(cases)))), *keys, *ended, *measured, cells))


def plain(value: Any) -> float | int | str | bool | None:
    """Return a number or a word unchanged, any other value in TOML."""
    return value if value is None or isinstance(value, float | int | str) else as_toml(value)


def write_tables(table: SweepTable, folder: Path) -> None:
    """Write ``table.csv``, and ``table.parquet`` if pyarrow is installed."""
    write_text(folder / "table.csv", table.csv)
    with suppress(ImportError):
        write_bytes(folder / "table.parquet", table.parquet)
