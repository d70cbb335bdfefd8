"""`python -m mpt_helpers`: says where the commands are that reproduce the papers."""

import sys

MOVED = ("reproduce", "verdicts", "readme", "tidy")


def main(arguments=None):
    """Say what there is to run; returns the exit code, 2 as of any command line that is not understood."""
    given = sys.argv[1:] if arguments is None else arguments
    if given and given[0] in MOVED:
        text = (
            f"`{given[0]}` belongs to the reproduction of the papers: in a checkout, python -m reproduction {given[0]}"
        )
    else:
        text = "mpt_helpers is a package to import; the papers are reproduced in a checkout, by python -m reproduction"
    print(text, file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main())
