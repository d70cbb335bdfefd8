"""`python -m mpt_helpers track FILE` cleans a recorded track; the papers' commands are `python -m reproduction`."""

import sys
from collections.abc import Sequence

MOVED = ("reproduce", "verdicts", "readme", "tidy")
USAGE = "python -m mpt_helpers track FILE.gpx cleans and smooths a recorded track; track --help says more"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code, 2 as of any command line that is not understood."""
    given = sys.argv[1:] if arguments is None else list(arguments)
    if given and given[0] == "track":
        from .tracks.__main__ import main as track

        return track(given[1:])
    if given and given[0] in MOVED:
        text = (
            f"`{given[0]}` belongs to the reproduction of the papers: in a checkout, python -m reproduction {given[0]}"
        )
    elif given and given[0] in ("-h", "--help"):
        print(USAGE)
        return 0
    else:
        text = f"{USAGE}; the papers are reproduced in a checkout, by python -m reproduction"
    print(text, file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main())
