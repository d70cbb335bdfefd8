"""`python -m mpt_helpers track FILE` cleans a recorded track; the papers' commands are `python -m reproduction`."""

import sys
from collections.abc import Sequence

USAGE = (
    "python -m mpt_helpers track FILE.gpx cleans and smooths a recorded track; track --help says more; "
    "the papers are reproduced in a checkout, by python -m reproduction"
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code; 2 if the command line is not understood."""
    given = sys.argv[1:] if arguments is None else list(arguments)
    if given[:1] == ["track"]:
        from .tracks.__main__ import main as track

        return track(given[1:])
    asked = given[:1] in (["-h"], ["--help"])
    print(USAGE, file=sys.stdout if asked else sys.stderr)
    return 0 if asked else 2


if __name__ == "__main__":
    sys.exit(main())
