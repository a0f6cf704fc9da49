"""The parser of the command line, made from the list of commands in `commands.toml`.

The arguments and the module of a command are loaded only for its call, so help and version are
fast.
"""

import argparse
import sys
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from studies.command.lines import print_lines
from studies.lists import list_of

TABLE = list_of(__file__, "commands.toml")
SHARED = TABLE.pop("shared")


def parser_for(arguments: Sequence[str]) -> argparse.ArgumentParser:
    """Return the parser of the command line, with the arguments of the named commands."""
    parser = argparse.ArgumentParser(prog="suture", description="A suture thread and the organ it pierces.")
    parser.add_argument("--version", action=Version, nargs=0, help="print the version, and the commit of a clone")
    commands = parser.add_subparsers(required=True, metavar="command")
    for name, command in TABLE.items():
        sub = commands.add_parser(name, help=command["text"], description=command["text"])
        sub.set_defaults(command=partial(carry_out, command))
        if name in arguments:
            add_arguments(sub, command)
    return parser


def add_arguments(parser: argparse.ArgumentParser, command: Mapping[str, Any]) -> None:
    """Add the arguments of a command, group by group."""
    own = {name: settings for name, settings in command.items() if isinstance(settings, dict)}
    places: dict[str, Options] = defaultdict(parser.add_mutually_exclusive_group, {"": parser})
    for group in command.get("order", ["own"]):
        for name, settings in (own if group == "own" else SHARED[group]).items():
            known = {key: in_python(key, value) for key, value in settings.items() if key != "either"}
            places[settings.get("either", "")].add_argument(name, **known)


def in_python(key: str, value: Any) -> Any:
    """Return a setting of an argument as an object of Python."""
    if key == "help" and "{scenes}" in value:
        from studies.scenario import scenes

        return value.format(scenes=", ".join(scenes()))
    if key == "metavar":
        return tuple(value) if isinstance(value, list) else value
    if isinstance(value, str) and value.startswith("@"):
        return named(value[1:])
    return KINDS.get(value, value) if key == "type" else value


def read(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """Return the parsed command line; end the process at a fault.

    None means the arguments of the process.
    """
    given = sys.argv[1:] if arguments is None else arguments
    parser = parser_for(given)
    asked = next((word for word in given if not word.startswith("-")), None)
    if asked is not None and asked not in TABLE:
        from studies.scenario.refusal import hint_at

        hint = hint_at(asked, TABLE, "the nearest is {}; ")
        parser.error(f"{asked} is refused: there is no such command; {hint}there are {', '.join(TABLE)}")
    options = parser.parse_args(given)
    options.words = list(given)
    return options


def named(place: str) -> Any:
    """Return the object of the code at ``module:name``."""
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)


def carry_out(command: Mapping[str, Any], options: argparse.Namespace) -> int:
    """Carry out a command by the functions of its list; return its exit status."""
    if "needs" in command:
        import_module(command["needs"])
    if "performs" in command:
        return int(named(command["performs"])(options))
    place, *names = command["prints"]
    print_lines(named(place)(*(getattr(options, name) for name in names)))
    return 0


class Version(argparse.Action):
    """Print the version."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        """Print the version and end."""
        from studies.output.provenance import CODE, ROOT, commit, installed_version

        at = commit(ROOT)
        print(f"{CODE} {installed_version(CODE) or '(not installed)'}{f' ({at})' if at else ''}")
        parser.exit()


Options = argparse.ArgumentParser | argparse._MutuallyExclusiveGroup


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text} is refused: give a whole number, 1 or more")
    return int(text)


KINDS: dict[str, Callable[..., Any]] = {"path": Path, "float": float, "count": _count}  # by `type` in the list
