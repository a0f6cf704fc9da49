"""Where the command begins: an interrupt while the libraries are loading ends in a sentence too."""

import sys


def main() -> int:
    """Run a command; returns the exit status."""
    try:
        from studies.command.command import main as command

        return command()
    except KeyboardInterrupt:
        print("suture: interrupted", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
