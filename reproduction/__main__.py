"""The command line: `python -m reproduction` reproduce, verdicts, readme, tidy."""

import argparse
import csv
import os
import shutil
import subprocess
import sys
from functools import partial
from textwrap import fill

from mpt_helpers import __version__
from mpt_helpers.tracks.files import write_whole

from .execute import tidied
from .ledger import keys, shipped_verdicts
from .ledger.verdicts import FIELDS
from .project import FIGURES, LEDGER, NOTEBOOKS, CommandError, chosen, chosen_notebooks, project
from .readme import write_readme
from .runner import reproduce


def reproduce_and_say(some):
    """Reproduce notebooks and, where it is all of them, the README's counts; end with a line on what is changed."""
    written = reproduce(some)
    root = project()
    if not some and (root / "README.md").is_file():
        write_readme()
    print(outcome(root, written))


def outcome(root, written):
    """Return a line on what a run wrote, {path: whether its bytes changed}: as committed, or what is not.

    Where the project is no git checkout, and where there is no git, what stood there before is compared.
    """
    made = f"all {len(written)} files that they make"
    places = [NOTEBOOKS, FIGURES, LEDGER / "*.json", "README.md"]
    git = ["git", "-C", str(root), "status", "--porcelain", "--no-renames", "--", *map(str, places)]
    try:
        asked = subprocess.run(git, capture_output=True, text=True)
    except OSError:  # no git on the PATH: everything has run by now, and that must not be called an error
        asked = None
    if asked is not None and asked.returncode == 0:
        differ, same = [line[3:] for line in asked.stdout.splitlines()], "as committed"
    else:
        differ, same = [str(path) for path, changed in written.items() if changed], "as before"
    if differ:
        return f"the notebooks ran; not {same}: {', '.join(differ)}"
    return f"the notebooks ran, and {made} are {same}, byte for byte"


def tidy(some):
    """Rewrite notebooks so that after `jupyter execute --inplace` or JupyterLab only outputs differ."""
    import nbformat

    for key, path in chosen_notebooks(project(), some).items():
        try:
            notebook = nbformat.reads(path.read_text(encoding="utf-8"), as_version=4)
        except Exception as error:  # nbformat's own, or what a file of another form leads to
            raise CommandError(f"{key}: needs a notebook ({error!r:.200})") from None
        write_whole(path, f"{nbformat.writes(tidied(notebook))}\n".encode())


def as_text(verdicts, every, width):
    """Return Verdicts as text in lines of a width: all counts, then each paper's causes, and its rows if `every`."""
    wrapped = partial(fill, width=width, break_on_hyphens=False)
    by_paper = {paper: verdicts.of(paper) for paper in dict.fromkeys(each.paper for each in verdicts)}
    several = len(by_paper) > 1
    summaries = {"all papers": verdicts} | by_paper if several else by_paper
    lines = []
    for name, some in summaries.items():
        tally = some.tally()
        lines.append(wrapped(f"{name}: {tally.claims_text()}; {tally.values_text()}; {tally.causes_text()}."))
    for paper, own in by_paper.items():
        lines += ["", f"{paper}:"] if several else []
        rows = []
        for kind, cells in own.tally().causes.items():
            for place, count in cells.items():
                cause = own.causes[place]
                rows.append(f"{kind} {cause.id} ({count}): {cause.sentence} {cause.meaning}")
        for each in own if every else []:
            why = ", ".join(part for part in (each.basis, each.cause) if part)
            row = f"{each.id}: {each.where}: printed {each.printed}; computed {each.computed}"
            beyond = f" Beyond: {each.beyond}" if each.beyond else ""
            rows.append(f"{row}; {each.verdict} ({why}). {each.reason}{beyond}")
        lines += [wrapped(row, initial_indent="  ", subsequent_indent="    ") for row in rows]
    return "\n".join(lines or ["no verdicts are stored yet: run `make reproduce`"])


def show_verdicts(some, form, every):
    """Print the stored verdicts of some papers, or of all: every one as "json" or "csv", else as text if `every`."""
    verdicts = shipped_verdicts(*chosen(some, keys()))
    if form == "json":
        print(verdicts.as_json(), end="")
    elif form == "csv":
        writer = csv.DictWriter(sys.stdout, FIELDS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(verdicts.records())
    else:
        print(as_text(verdicts, every, shutil.get_terminal_size().columns))
    sys.stdout.flush()


def main(arguments=None):
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m reproduction", description="Four papers, reproduced.")
    parser.add_argument("--version", action="version", version=f"mpt_helpers {__version__}")
    commands = parser.add_subparsers(dest="command", required=True)
    run = commands.add_parser("reproduce", help="execute the notebooks in place and write every figure")
    clean = commands.add_parser("tidy", help="normalise notebooks so that only outputs differ in git")
    show = commands.add_parser("verdicts", help="print what holds and what is wrong, without running anything")
    for command in (run, clean, show):
        command.add_argument("keys", metavar="KEY", nargs="*", help="a notebook's name without .ipynb (default: all)")
    show.add_argument("--all", action="store_true", help="print every verdict, as the next two always do")
    form = show.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_const", dest="form", const="json", help="print every verdict as JSON")
    form.add_argument("--csv", action="store_const", dest="form", const="csv", help="print every verdict as CSV")
    commands.add_parser("readme", help="write the counts of the verdicts into the README")
    options = parser.parse_args(arguments)
    if options.command == "verdicts" and not sys.stdout.isatty() and hasattr(sys.stdout, "reconfigure"):
        sys.stdout.reconfigure(encoding="utf-8")  # into files, also where the terminal has another encoding
    try:
        if options.command == "reproduce":
            reproduce_and_say(options.keys)
        elif options.command == "tidy":
            tidy(options.keys)
        elif options.command == "verdicts":
            show_verdicts(options.keys, options.form, options.all)
        else:
            write_readme()
        return 0
    except BrokenPipeError:  # as in `verdicts | head`: what is not yet written goes nowhere
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0 if options.command == "verdicts" else 1
    except ModuleNotFoundError as error:
        if error.name not in ("nbformat", "nbclient"):
            raise
        print(f"error: {options.command} needs Jupyter: pip install 'mpt_helpers[notebooks]'", file=sys.stderr)
        return 1
    except (CommandError, OSError, ValueError) as failure:  # OSError: a full disk; ValueError: the ledger's files
        print(f"error: {failure}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("error: interrupted", file=sys.stderr)
        return 130
    except SystemExit as end:  # of a run that was terminated
        print("error: terminated", file=sys.stderr)
        return end.code


if __name__ == "__main__":
    sys.exit(main())
