"""The command line: `python -m reproduction` reproduce, verdicts, readme, tidy."""

import argparse
import asyncio
import atexit
import csv
import json
import os
import re
import shutil
import signal
import sys
import threading
import time
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from textwrap import fill

from tqdm import tqdm

from mpt_helpers import __version__
from mpt_helpers.files import write_together, write_whole

from . import ledger
from .ledger import keys, published, shipped_verdicts, stored_verdicts
from .ledger.tables import Table
from .ledger.verdicts import CANNOT_BE_CHECKED, FAILS, FIELDS, HOLDS, OF_CLAIMS, WRONG
from .project import project

NOTEBOOKS, FIGURES, LEDGER = Path("notebooks"), Path("figures"), Path("reproduction") / "ledger"
BLOCK = re.compile(r"(<!-- verdicts: [^\n]* -->\n).*?(<!-- end of verdicts -->)", re.DOTALL)
CELL_TIMEOUT = 600  # seconds; the slowest cell takes some ten
LONGEST_SOCKET = 98  # bytes of a path; with the number that Jupyter adds, macOS takes 103 and Linux 107
STAGE = ".reproduce-"  # how the name of a folder begins in which notebooks run
LEFT_OVER = 24 * 3600  # seconds after which such a folder is of no run: the slowest run takes some minutes
# Where the results lie of a notebook that was edited while it ran: in a folder of its key.
RESULTS = Path("reproduced")


class CommandError(Exception):
    """A failure in words for the terminal."""


def chosen(some, known):
    """Return the given keys, or all known keys if none is given. Raises CommandError for an unknown one."""
    for key in some:
        if key not in known:
            raise CommandError(f"unknown notebook {key!r}; the known ones are {', '.join(known)}")
    return list(dict.fromkeys(some)) or known  # each once


def chosen_notebooks(root, some):
    """Return {key: path} of the given notebooks of the project, or of all if none is given."""
    paths = {path.stem: path for path in sorted(root.glob(f"{NOTEBOOKS}/*.ipynb"))}
    return {key: paths[key] for key in chosen(some, list(paths))}


def reproduce(some):
    """Execute notebooks in place; write their figures and, for a notebook of a paper, its verdicts into the package.

    As many notebooks run side by side as there are processors. A notebook that fails stops those still running; none of
    these changes any file. Raises CommandError for an unknown key, another project than that of the package that runs,
    a folder that cannot be written to, a notebook that fails (naming the cell and the error) and one that was edited
    while it ran (its results are kept in reproduced/, the others are written), ValueError for verdicts that do not
    cover the paper, ModuleNotFoundError without Jupyter.
    """
    root = project()
    paths = chosen_notebooks(root, some)
    if root.joinpath(LEDGER).is_dir() and not root.joinpath(LEDGER).samefile(ledger.paper.FOLDER):
        running = ledger.paper.FOLDER.parent
        raise CommandError(f"the package that runs is {running}, not that of {root}: run this in {root}")
    for folder in (FIGURES, NOTEBOOKS):
        path = root / folder
        if path.exists() and not (path.is_dir() and os.access(path, os.W_OK)):
            raise CommandError(f"{folder}: needs a folder that can be written to")
    sources = {key: path.read_bytes() for key, path in paths.items()}
    notebooks = {key: _parsed(key, source) for key, source in sources.items()}
    remove_left_over(root)
    with asyncio.Runner(loop_factory=_Loop) as runner:
        try:
            edited = runner.run(_reproduce_all(root, notebooks, sources))
        except ExceptionGroup as failures:
            raise failures.exceptions[0] from None  # the others are ends that it caused
    if edited:
        raise CommandError("\n".join(edited))


def _parsed(key, source):
    """Return the notebook that the bytes of a file hold. Raises CommandError where they hold none."""
    import nbformat  # here, as nbclient below, so that verdicts are shown without Jupyter

    try:
        return nbformat.reads(source.decode("utf-8"), as_version=4)
    except Exception as error:  # nbformat's own, or what a file of another form leads to
        raise CommandError(f"{key}: needs a notebook ({error!r:.200})") from None


def remove_left_over(root):
    """Remove the folders of runs that ended without doing so, as when the machine went down."""
    for folder in root.glob(f"{STAGE}*"):
        if time.time() - folder.stat().st_mtime > LEFT_OVER:
            shutil.rmtree(folder, ignore_errors=True)


class _Loop(asyncio.SelectorEventLoop):
    """Leaves an interrupt to asyncio, which cancels all notebooks; nbclient's own handler would end one of them."""

    def add_signal_handler(self, *_):
        raise RuntimeError  # nbclient goes on without a handler, as outside the main thread


@contextmanager
def _ends_cancel(task):
    """Let SIGTERM, and the end of the terminal, cancel a task as an interrupt does: it then leaves nothing behind."""
    loop = task.get_loop()
    ends = []
    if threading.current_thread() is threading.main_thread():  # which alone may set what a signal does
        known = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
        ends = [end for end in known if signal.getsignal(end) is signal.SIG_DFL]  # nohup ignores SIGHUP
    for end in ends:
        signal.signal(end, lambda *_: loop.call_soon_threadsafe(task.cancel))
    try:
        yield
    finally:
        for end in ends:
            signal.signal(end, signal.SIG_DFL)


async def _reproduce_all(root, notebooks, sources):
    """Reproduce notebooks, given by key with the bytes of their files; return what is to be said of edited ones.

    Those with the most cells, which take longest, start first.
    """
    cells = {key: sum(cell.cell_type == "code" for cell in each.cells) for key, each in notebooks.items()}
    processors = asyncio.Semaphore(os.cpu_count() or 1)
    line = "cell {n} of {total}, {elapsed} so far, some {remaining} left"
    hidden = not sys.stdout.isatty()
    shown = {"file": sys.stdout, "disable": hidden, "leave": False}
    tasks = []
    bars = tqdm(total=sum(cells.values()), bar_format=line, smoothing=0, **shown)
    with _ends_cancel(asyncio.current_task()), bars as bar:
        async with asyncio.TaskGroup() as group:
            for key in sorted(cells, key=cells.get, reverse=True):
                work = _reproduce(root, key, notebooks[key], sources[key], processors, bar)
                tasks.append(group.create_task(work))
    return [task.result() for task in tasks if task.result()]


async def _reproduce(root, key, notebook, source, processors, bar):
    """When a processor is free, execute a notebook in a copy of the project's notebooks, and write what it makes.

    Where its file is no longer `source`, somebody has edited it meanwhile: then the results are written elsewhere, and
    what is to be said of that is returned.
    """
    import nbformat

    async with processors:
        with staged(root) as stage:
            count = await _execute(key, notebook, stage / NOTEBOOKS, bar)
            executed = stage / NOTEBOOKS / f"{key}.ipynb"
            nbformat.write(tidied(notebook), executed)
            made = {FIGURES / path.name: path.read_bytes() for path in stage.joinpath(FIGURES).iterdir()}
            made[NOTEBOOKS / executed.name] = executed.read_bytes()
            if key in keys() and root.joinpath(LEDGER).is_dir():
                verdicts = published(key).complete(stored_verdicts(executed))
                made[LEDGER / f"{key}.json"] = f"{as_json(verdicts)}\n".encode()
    path = NOTEBOOKS / executed.name
    if not root.joinpath(path).is_file() or root.joinpath(path).read_bytes() != source:
        kept = RESULTS / key
        _write(root / kept, made)
        return f"{path} was edited while it ran and is left as it is: what this run made lies in {kept}"
    _write(root, made)
    with bar.external_write_mode():
        print(f"{key}: {count} cells executed", flush=True)


def _write(root, made):
    """Write files, {path from the root: bytes}, into folders that are made where they are missing."""
    for folder in {path.parent for path in made}:
        root.joinpath(folder).mkdir(parents=True, exist_ok=True)
    write_together({root / path: made[path] for path in sorted(made)})


@contextmanager
def staged(root):
    """Give a copy of the project's notebooks/ (with their data) and an empty figures/, in which notebooks run.

    Raises CommandError where the copy fails, as on a full disk.
    """
    with TemporaryDirectory(prefix=STAGE, dir=root) as place:
        stage = Path(place)
        stage.joinpath(FIGURES).mkdir()
        try:
            shutil.copytree(root / NOTEBOOKS, stage / NOTEBOOKS)
        except shutil.Error as error:  # holds (file, copy, reason) for each file that failed
            file, _, reason = error.args[0][0]
            raise CommandError(f"{file}: cannot be copied: {reason}") from None
        yield stage


def _kernel_manager(folder):
    """Return the manager of a kernel that talks through sockets in a folder; where it cannot, through TCP ports.

    Jupyter chooses free ports before the kernel opens them, and another program may take one in between. With ports one
    run in some twenty, four at a time, waited for ever, probably for that reason.
    """
    from jupyter_client import AsyncKernelManager

    file, socket = os.path.join(folder, "kernel.json"), os.path.join(folder, "ipc")
    if os.name != "posix" or len(os.fsencode(socket)) > LONGEST_SOCKET:
        return AsyncKernelManager(kernel_name="python3")
    return AsyncKernelManager(kernel_name="python3", transport="ipc", connection_file=file, ip=socket)


async def _execute(key, notebook, folder, bar):
    """Run a notebook's code cells in a folder, store their outputs in it, and return how many they are.

    Raises CommandError for a cell that fails.
    """
    from nbclient import NotebookClient
    from nbclient.exceptions import CellExecutionError

    started = ["none"]  # the ids of the cells so far
    sockets = TemporaryDirectory(prefix="mpt-")
    client = NotebookClient(
        notebook,
        km=_kernel_manager(sockets.name),
        timeout=CELL_TIMEOUT,
        kernel_name="python3",
        extra_arguments=["--IPKernelApp.log_level=50"],  # messages below level 50 do not concern the notebook
        shutdown_kernel="immediate",
        coalesce_streams=True,
        on_cell_start=lambda cell, cell_index: started.append(cell.id),
        on_cell_executed=lambda cell, cell_index, execute_reply: bar.update(),
    )
    try:
        # The kernel imports the package that runs here.
        variables = {"PYTHONPATH": os.pathsep.join(sys.path)} | settings_of_nobody(folder.parent)
        await client.async_execute(cwd=str(folder), env=os.environ | variables)
    except Exception as error:
        if asyncio.current_task().cancelling():  # this notebook is ended, and nbclient says that its kernel died
            raise asyncio.CancelledError from error
        what = f"{error.ename}: {error.evalue}" if isinstance(error, CellExecutionError) else error
        raise CommandError(f"{key}: cell {started[-1]} failed: {what}") from None
    finally:
        # nbclient stops neither a kernel that was still starting nor the channels to it.
        if client.kc is not None:
            client.kc.stop_channels()
        if client.km is not None:
            await client.km.shutdown_kernel(now=True)
        sockets.cleanup()
        atexit.unregister(client._cleanup_kernel)  # which would find no kernel
    return client.code_cells_executed


def settings_of_nobody(folder):
    """Return variables for a kernel, so that no result depends on the settings of whoever runs it.

    With them IPython and matplotlib find no settings but those of `folder`, which has none; IPython runs no code of the
    user's first and shows figures inline. matplotlib finds the list of fonts that it makes once for each user here: a
    kernel would tell in a cell's output that it makes one.
    """
    import matplotlib.font_manager

    style = folder / "matplotlibrc"
    style.touch()
    return {
        "IPYTHONDIR": str(folder / ".ipython"),
        "PYTHONSTARTUP": "",
        "MATPLOTLIBRC": str(style),
        "MPLBACKEND": "module://matplotlib_inline.backend_inline",
        "MPLCONFIGDIR": matplotlib.get_cachedir(),
    }


def tidied(notebook):
    """Return a notebook without what changes from run to run or from editor to editor.

    That is the version of Python, the name of the kernel as it is shown, and the times of the cells.
    """
    notebook["metadata"]["language_info"] = {"name": "python"}
    notebook["metadata"]["kernelspec"] = {"display_name": "Python 3", "language": "python", "name": "python3"}
    for cell in notebook["cells"]:
        cell["metadata"].pop("execution", None)
    return notebook


def tidy(some):
    """Rewrite notebooks so that after `jupyter execute --inplace` or JupyterLab only outputs differ."""
    import nbformat

    for key, path in chosen_notebooks(project(), some).items():
        text = nbformat.writes(tidied(_parsed(key, path.read_bytes())))
        write_whole(path, f"{text}\n".encode())


def as_json(verdicts):
    """Return Verdicts as JSON text."""
    return json.dumps(verdicts.records(), indent=1, ensure_ascii=False)


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


def show_verdicts(some, form):
    """Print the stored verdicts of some papers, or of all: as "json", "csv", text on "all" or on the causes only."""
    verdicts = shipped_verdicts(*chosen(some, keys()))
    if form == "json":
        print(as_json(verdicts))
    elif form == "csv":
        writer = csv.DictWriter(sys.stdout, FIELDS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(verdicts.records())
    else:
        print(as_text(verdicts, form == "all", shutil.get_terminal_size().columns))
    sys.stdout.flush()


def readme(verdicts):
    """Return the README's block on Verdicts: what was found in words, then what holds, a row for each paper."""
    tally = verdicts.tally()
    lost = tally.causes["copy"].total()
    unchecked = tally.claims[CANNOT_BE_CHECKED] + tally.values[CANNOT_BE_CHECKED]
    sentences = [
        f"**What we found: {tally.wrong_text()}.**",
        f"Of the {unchecked} cells that cannot be checked, {lost} are missing or illegible in our copy;",
        f"for {unchecked - lost} the paper leaves something out.",
    ]
    claims, values = [], []
    for paper in [*dict.fromkeys(each.paper for each in verdicts), "all"]:
        own = tally if paper == "all" else verdicts.of(paper).tally()
        name = paper if paper == "all" else f"[{paper}]({NOTEBOOKS}/{paper}.ipynb)"
        claims.append([name, own.claims.total(), *(own.claims[verdict] for verdict in OF_CLAIMS)])
        agree, disagree = (sum(own.values[each] for each in some) for some in (HOLDS, FAILS))
        causes = [f"{len(own.causes[kind])} ({own.causes[kind].total()})" for kind in WRONG]
        values.append([name, own.values.total(), agree, disagree, own.values[CANNOT_BE_CHECKED], *causes])
    of_values = ["numbers, formulas, figures", "agree", "do not", "cannot be checked"]
    tables = [
        Table(["paper", "claims", *OF_CLAIMS.values()], claims),
        Table(["paper", *of_values, *(f"{kind}s (cells)" for kind in WRONG)], values),
    ]
    return "\n\n".join([" ".join(sentences), *(table.markdown() for table in tables)])


def write_readme():
    """Write the block on the verdicts into the README; raises CommandError where it has no place for it."""
    path = project() / "README.md"
    block = readme(shipped_verdicts())
    text, places = BLOCK.subn(lambda old: f"{old[1]}\n{block}\n\n{old[2]}", path.read_text(encoding="utf-8"))
    if places != 1:
        raise CommandError(f"{path.name}: needs one place for the verdicts, got {places}")
    write_whole(path, text.encode())


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
    form = show.add_mutually_exclusive_group()
    form.add_argument("--all", action="store_const", dest="form", const="all", help="print every verdict")
    form.add_argument("--json", action="store_const", dest="form", const="json", help="print every verdict as JSON")
    form.add_argument("--csv", action="store_const", dest="form", const="csv", help="print every verdict as CSV")
    commands.add_parser("readme", help="write the counts of the verdicts into the README")
    options = parser.parse_args(arguments)
    if options.command == "verdicts" and not sys.stdout.isatty() and hasattr(sys.stdout, "reconfigure"):
        sys.stdout.reconfigure(encoding="utf-8")  # into files, also where the terminal has another encoding
    try:
        if options.command == "reproduce":
            reproduce(options.keys)
        elif options.command == "tidy":
            tidy(options.keys)
        elif options.command == "verdicts":
            show_verdicts(options.keys, options.form)
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
    except asyncio.CancelledError:
        print("error: terminated", file=sys.stderr)
        return 143


if __name__ == "__main__":
    sys.exit(main())
