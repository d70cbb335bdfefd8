"""The command line: `python -m mpt_helpers` reproduce [KEY ...], verdicts [KEY] [--json | --csv], and readme."""

import argparse
import csv
import io
import json
import os
import re
import shutil
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from .files import write_together, write_whole
from .published import Verdicts, counts_by_paper, stored_verdicts
from .tables import Table

NOTEBOOKS, FIGURES = Path("notebooks"), Path("figures")
README = Path("README.md")
BLOCK = re.compile(r"(<!-- verdicts: [^\n]* -->\n).*?(<!-- end of verdicts -->)", re.DOTALL)
MEASURED = Path("benchmarks") / "results.json"  # what notebooks read of the clock, so that none of them looks at it
CELL_TIMEOUT = 600  # seconds; the slowest cell takes some ten


class CommandError(Exception):
    """What went wrong, in words for the terminal."""


def reproduce(keys):
    """Execute notebooks in place, one after the other, and write their figures; nothing of one that fails is touched.

    Raises CommandError for an unknown key, for a folder that cannot be written to and for a notebook that fails, naming
    the notebook, the cell and the error.
    """
    keys = known(keys)
    for folder in (FIGURES, NOTEBOOKS):
        if folder.exists() and not (folder.is_dir() and os.access(folder, os.W_OK)):
            raise CommandError(f"{folder}: needs a folder that can be written to")
    for key in keys:
        # A cell reads ../figures: the notebook runs in a copy of its place, and what it made is moved over at the end.
        with TemporaryDirectory(prefix=".reproduce-", dir=".") as place:
            stage = Path(place)
            stage.joinpath(FIGURES).mkdir()
            shutil.copytree(NOTEBOOKS, stage / NOTEBOOKS)
            if MEASURED.exists():
                stage.joinpath(MEASURED).parent.mkdir()
                shutil.copy(MEASURED, stage / MEASURED)
            text = _execute(key, stage / NOTEBOOKS)
            FIGURES.mkdir(exist_ok=True)
            made = {FIGURES / each.name: each.read_bytes() for each in sorted(stage.joinpath(FIGURES).iterdir())}
            write_together(made | {NOTEBOOKS / f"{key}.ipynb": text.encode()})


def _execute(key, folder):
    # Imported here, so that the verdicts can be read without Jupyter.
    import nbformat
    from nbclient import NotebookClient

    try:
        notebook = nbformat.read(folder / f"{key}.ipynb", as_version=4)
    except (ValueError, TypeError, LookupError, AttributeError, nbformat.ValidationError) as error:
        raise CommandError(f"{key}: needs a notebook ({error!r:.200})") from error
    total = sum(cell.cell_type == "code" for cell in notebook.cells)
    ran = []

    def progress(cell, cell_index):
        if cell.cell_type == "code":
            ran.append(cell.id)
            print(f"{key}: cell {len(ran)} of {total}, {cell.id}", flush=True)

    client = NotebookClient(
        notebook,
        timeout=CELL_TIMEOUT,
        kernel_name="python3",
        extra_arguments=["--IPKernelApp.log_level=50"],  # what it says below that is not about the notebook
        resources={"metadata": {"path": str(folder)}},
        record_timing=False,
        coalesce_streams=True,
        on_cell_start=progress,
    )
    try:
        client.execute()
    except Exception as error:  # a cell's, a timeout's, a dead kernel's, or what nbclient makes of an interrupt
        errors = (
            (cell.id, f"{out.ename}: {out.evalue}")
            for cell in notebook.cells
            for out in cell.get("outputs", [])
            if "ename" in out
        )
        gone = str(error) or "the kernel is gone, as after an interrupt"
        where, what = next(errors, (ran[-1] if ran else "none", gone))
        if hasattr(client, "_async_cleanup_kernel_future"):  # nbclient caught a signal, and stopped the kernel
            raise KeyboardInterrupt from error
        raise CommandError(f"{key}: cell {where} failed: {what}") from error
    notebook.metadata["language_info"] = {"name": "python"}  # the rest of it names the version of Python
    return nbformat.writes(notebook) + "\n"


def verdicts(keys):
    """Return the stored Verdicts of these notebooks, of all if none is named.

    Raises CommandError for an unknown key and for a notebook without verdicts.
    """
    try:
        return Verdicts(each for key in known(keys) for each in stored_verdicts(NOTEBOOKS / f"{key}.ipynb"))
    except ValueError as error:
        raise CommandError(str(error)) from error


def as_json(verdicts):
    """Return Verdicts as JSON text."""
    return json.dumps(verdicts.records(), indent=1, ensure_ascii=False)


def as_csv(verdicts):
    """Return Verdicts as CSV text."""
    text = io.StringIO()
    writer = csv.DictWriter(text, verdicts.records()[0], lineterminator="\n")
    writer.writeheader()
    writer.writerows(verdicts.records())
    return text.getvalue()


def readme():
    """Return the README with the table of verdicts as the notebooks have it.

    Raises CommandError when there is no README with a place for the table.
    """
    rows = counts_by_paper(verdicts([]))
    linked = [[f"[{key}]({NOTEBOOKS.name}/{key}.ipynb)", *counts] for key, *counts in rows.rows[:-1]]
    table = Table(rows.header, [*linked, rows.rows[-1]]).markdown()
    try:
        text, places = BLOCK.subn(lambda old: f"{old[1]}\n{table}\n\n{old[2]}", README.read_text(encoding="utf-8"))
    except OSError as error:
        raise CommandError(f"{README}: {error.strerror}") from error
    if places != 1:
        raise CommandError(f"{README}: needs one place for the table of verdicts, got {places}")
    return text


def known(keys):
    """Return these keys of notebooks, or all if none; raises CommandError for an unknown key or another folder."""
    there = sorted(path.stem for path in NOTEBOOKS.glob("*.ipynb"))
    if not there:
        raise CommandError(f"no notebooks in {NOTEBOOKS.resolve()}: run this in the project's folder")
    for key in keys:
        if key not in there:
            raise CommandError(f"unknown notebook {key!r}; the known ones are {', '.join(there)}")
    return keys or there


def main(arguments=None):
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m mpt_helpers", description="Four papers, reproduced.")
    commands = parser.add_subparsers(dest="command", required=True)
    run = commands.add_parser("reproduce", help="execute the notebooks in place and write every figure")
    run.add_argument("keys", metavar="KEY", nargs="*", help="a notebook's name without .ipynb (default: all)")
    show = commands.add_parser("verdicts", help="print the verdicts of the notebooks, without running them")
    show.add_argument("keys", metavar="KEY", nargs="?", help="a notebook's name without .ipynb (default: all)")
    form = show.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_const", dest="form", const=as_json, help="print them as JSON")
    form.add_argument("--csv", action="store_const", dest="form", const=as_csv, help="print them as CSV")
    commands.add_parser("readme", help="write the table of verdicts into the README")
    options = parser.parse_args(arguments)
    try:
        if options.command == "reproduce":
            reproduce(options.keys)
            return 0
        if options.command == "readme":
            write_whole(README, readme().encode())
            return 0
        given = verdicts([options.keys] if options.keys else [])
        columns = ("paper", "id", "where", "kind", "printed", "computed", "verdict", "reason")
        table = Table(columns, [[getattr(each, column) for column in columns] for each in given])
        print(options.form(given).rstrip() if options.form else table)
        return 0
    except (CommandError, OSError) as failure:  # as of a full disk
        print(f"error: {failure}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("error: interrupted", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
