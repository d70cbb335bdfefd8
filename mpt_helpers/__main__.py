"""The command line: `python -m mpt_helpers` reproduce, verdicts, readme, tidy."""

import argparse
import csv
import io
import json
import os
import re
import shutil
import sys
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from textwrap import fill

from tqdm import tqdm

from . import __version__
from .files import write_together, write_whole
from .ledger import keys, published, shipped_verdicts, stored_verdicts
from .ledger.tables import Table
from .ledger.verdicts import CANNOT_BE_CHECKED, FIELDS, HOLDS, WRONG

NOTEBOOKS, FIGURES, LEDGER = Path("notebooks"), Path("figures"), Path("mpt_helpers") / "ledger"
BLOCK = re.compile(r"(<!-- verdicts: [^\n]* -->\n).*?(<!-- end of verdicts -->)", re.DOTALL)
CELL_TIMEOUT = 600  # seconds; the slowest cell takes some ten


class CommandError(Exception):
    """A failure in words for the terminal."""


def project():
    """Return the project's folder: the working directory or, from within notebooks/, the one above."""
    here = Path.cwd()
    for folder in (here, here.parent):
        if any(folder.glob(f"{NOTEBOOKS}/*.ipynb")):
            return folder
    raise CommandError(f"no notebooks in {here / NOTEBOOKS}: run this in the project's folder")


def chosen(some, known):
    """Return some keys, or all that are known if there are none; raises CommandError for one that is not known."""
    for key in some:
        if key not in known:
            raise CommandError(f"unknown notebook {key!r}; the known ones are {', '.join(known)}")
    return some or known


def reproduce(some):
    """Execute notebooks in place; write their figures and, for a notebook of a paper, its verdicts into the package.

    A notebook that fails leaves all files as they were. Raises CommandError for an unknown key, a folder that cannot be
    written to, a notebook that fails (naming the cell and the error) and verdicts that do not cover the paper.
    """
    root = project()
    some = chosen(some, sorted(path.stem for path in root.glob(f"{NOTEBOOKS}/*.ipynb")))
    for folder in (FIGURES, NOTEBOOKS):
        path = root / folder
        if path.exists() and not (path.is_dir() and os.access(path, os.W_OK)):
            raise CommandError(f"{folder}: needs a folder that can be written to")
    for key in some:
        with staged(root) as stage:
            notebook = stage / NOTEBOOKS / f"{key}.ipynb"
            _execute(notebook)
            made = {FIGURES / path.name: path.read_bytes() for path in stage.joinpath(FIGURES).iterdir()}
            made[NOTEBOOKS / notebook.name] = notebook.read_bytes()
            if key in keys() and root.joinpath(LEDGER).is_dir():
                verdicts = published(key).complete(stored_verdicts(notebook))
                made[LEDGER / f"{key}.json"] = f"{as_json(verdicts)}\n".encode()
            root.joinpath(FIGURES).mkdir(exist_ok=True)
            write_together({root / path: made[path] for path in sorted(made)})


@contextmanager
def staged(root):
    """Give a copy of the project's notebooks/ (with their data) and an empty figures/, in which notebooks run."""
    with TemporaryDirectory(prefix=".reproduce-", dir=root) as place:
        stage = Path(place)
        stage.joinpath(FIGURES).mkdir()
        shutil.copytree(root / NOTEBOOKS, stage / NOTEBOOKS)
        yield stage


def _execute(path):
    # Imported here, so that the verdicts can be read without Jupyter.
    try:
        import nbformat
        from nbclient import NotebookClient
    except ModuleNotFoundError as error:
        raise CommandError("reproduce needs Jupyter: pip install 'mpt_helpers[notebooks]'") from error
    key = path.stem
    try:
        notebook = nbformat.read(path, as_version=4)
    except (ValueError, TypeError, LookupError, AttributeError, nbformat.ValidationError) as error:
        raise CommandError(f"{key}: needs a notebook ({error!r:.200})") from error
    ran = ["none"]
    total = sum(cell.cell_type == "code" for cell in notebook.cells)
    line = "{desc}: cell {n} of {total}, {elapsed} so far, some {remaining} left"
    terminal = sys.stdout.isatty()

    def on_cell_start(cell, cell_index):
        ran.append(cell.id)

    def on_cell_executed(cell, cell_index, execute_reply):
        bar.update()

    with tqdm(total=total, desc=key, bar_format=line, file=sys.stdout, disable=not terminal) as bar:
        client = NotebookClient(
            notebook,
            timeout=CELL_TIMEOUT,
            kernel_name="python3",
            extra_arguments=["--IPKernelApp.log_level=50"],  # what it says below that is not about the notebook
            resources={"metadata": {"path": str(path.parent)}},
            record_timing=False,
            coalesce_streams=True,
            on_cell_start=on_cell_start,
            on_cell_executed=on_cell_executed,
        )
        try:
            client.execute()
        except Exception as error:  # a cell's, a timeout's, a dead kernel's, or what nbclient makes of an interrupt
            if hasattr(client, "_async_cleanup_kernel_future"):  # nbclient caught a signal, and stopped the kernel
                raise KeyboardInterrupt from error
            what = getattr(error, "evalue", str(error)) or "the kernel is gone, as after an interrupt"
            name = f"{error.ename}: " if hasattr(error, "ename") else ""
            raise CommandError(f"{key}: cell {ran[-1]} failed: {name}{what}") from error
    if not terminal:
        print(f"{key}: {total} cells executed", flush=True)
    nbformat.write(tidied(notebook), path)


def tidied(notebook):
    """Return a notebook without what changes from run to run: the version of Python and the times of its cells."""
    notebook["metadata"]["language_info"] = {"name": "python"}
    for cell in notebook["cells"]:
        cell["metadata"].pop("execution", None)
    return notebook


def tidy(some):
    """Rewrite notebooks so that after `jupyter execute --inplace` or JupyterLab only outputs differ."""
    root = project()
    for key in chosen(some, sorted(path.stem for path in root.glob(f"{NOTEBOOKS}/*.ipynb"))):
        path = root / NOTEBOOKS / f"{key}.ipynb"
        notebook = tidied(json.loads(path.read_text(encoding="utf-8")))
        text = json.dumps(notebook, indent=1, ensure_ascii=False, sort_keys=True)
        write_whole(path, f"{text}\n".encode())


def as_json(verdicts):
    """Return Verdicts as JSON text."""
    return json.dumps(verdicts.records(), indent=1, ensure_ascii=False)


def as_csv(verdicts):
    """Return Verdicts as CSV text, with a header also where there are none."""
    text = io.StringIO()
    writer = csv.DictWriter(text, FIELDS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(verdicts.records())
    return text.getvalue().rstrip()


def as_text(verdicts, every, width):
    """Return Verdicts as text in lines of a width: each paper's counts and causes, then its rows if asked for all."""
    lines = []
    for paper in dict.fromkeys(each.paper for each in verdicts):
        own = verdicts.of(paper)
        tally = own.tally()
        lines.append(fill(f"{paper}: {tally.claims_text()}; {tally.values_text()}; {tally.causes_text()}.", width))
        for kind, cells in tally.causes.items():
            for place, count in cells.items():
                cause = own.causes[place]
                text = f"{kind} {cause.id} ({count}): {cause.sentence} {cause.meaning}"
                lines.append(fill(text, width, initial_indent="  ", subsequent_indent="    "))
        if every:
            for each in own:
                why = ", ".join(part for part in (each.basis, each.cause) if part)
                text = f"{each.id}: {each.where}: printed {each.printed}; computed {each.computed}"
                text += f"; {each.verdict} ({why}). {each.reason}"
                lines.append(fill(text, width, initial_indent="  ", subsequent_indent="    "))
    return "\n".join(lines or ["no verdicts are stored yet: run `make reproduce`"])


def readme(verdicts):
    """Return the README's block on Verdicts: what is wrong and what holds in words, then a row for each paper."""
    tally = verdicts.tally()
    others = "".join(f", {count} {words}" for words, count in tally.claims_bar() if words != "hold")
    words = f"**What is wrong: {tally.causes_text()}.** {tally.claims_text()}{others}. {tally.values_text()}."
    rows = []
    for paper in [*dict.fromkeys(each.paper for each in verdicts), "all"]:
        own = tally if paper == "all" else verdicts.of(paper).tally()
        row = [paper if paper == "all" else f"[{paper}]({NOTEBOOKS}/{paper}.ipynb)"]
        row += [f"{len(own.causes[kind])} ({own.causes[kind].total()})" for kind in WRONG]
        row += [f"{sum(counts[each] for each in HOLDS)} of {counts.total()}" for counts in (own.claims, own.values)]
        rows.append([*row, own.claims[CANNOT_BE_CHECKED] + own.values[CANNOT_BE_CHECKED]])
    header = ["paper", *(f"{kind}s (cells)" for kind in WRONG), "claims hold", "numbers, formulas, figures agree"]
    return f"{words}\n\n{Table([*header, 'cannot be checked'], rows).markdown()}"


def write_readme():
    """Write the block on the verdicts into the README; raises CommandError where it has no place for it."""
    path = project() / "README.md"
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise CommandError(f"{path.name}: {error.strerror}") from error
    block = readme(shipped_verdicts())
    text, places = BLOCK.subn(lambda old: f"{old[1]}\n{block}\n\n{old[2]}", text)
    if places != 1:
        raise CommandError(f"{path.name}: needs one place for the verdicts, got {places}")
    write_whole(path, text.encode())


def main(arguments=None):
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m mpt_helpers", description="Four papers, reproduced.")
    parser.add_argument("--version", action="version", version=f"mpt_helpers {__version__}")
    commands = parser.add_subparsers(dest="command", required=True)
    run = commands.add_parser("reproduce", help="execute the notebooks in place and write every figure")
    clean = commands.add_parser("tidy", help="after `jupyter execute --inplace`: leave a difference of outputs only")
    for command in (run, clean):
        command.add_argument("keys", metavar="KEY", nargs="*", help="a notebook's name without .ipynb (default: all)")
    show = commands.add_parser("verdicts", help="print what holds and what is wrong, without running anything")
    show.add_argument("keys", metavar="KEY", nargs="?", help="a notebook's name without .ipynb (default: all)")
    form = show.add_mutually_exclusive_group()
    form.add_argument("--all", action="store_true", help="print every verdict, not the causes only")
    form.add_argument("--json", action="store_true", help="print every verdict as JSON")
    form.add_argument("--csv", action="store_true", help="print every verdict as CSV")
    commands.add_parser("readme", help="write the counts of the verdicts into the README")
    options = parser.parse_args(arguments)
    try:
        if options.command == "reproduce":
            reproduce(options.keys)
        elif options.command == "tidy":
            tidy(options.keys)
        elif options.command == "readme":
            write_readme()
        else:
            verdicts = shipped_verdicts(*chosen([options.keys] if options.keys else [], keys()))
            if options.json:
                print(as_json(verdicts))
            elif options.csv:
                print(as_csv(verdicts))
            else:
                print(as_text(verdicts, options.all, shutil.get_terminal_size().columns))
            sys.stdout.flush()
        return 0
    except BrokenPipeError:  # as in `verdicts | head`: what is not yet written goes nowhere
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (CommandError, OSError, ValueError) as failure:  # OSError: a full disk; ValueError: the ledger's files
        print(f"error: {failure}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("error: interrupted", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
