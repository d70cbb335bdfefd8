"""Run the project's notebooks side by side, and write what they make: whole, or not at all.

Each runs in a copy of notebooks/, in a process of its own (`execute`). What it makes is moved into place when it has
ended well, unless its file was edited meanwhile: then the edit stays, and the results lie in reproduced/.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

from tqdm import tqdm

from mpt_helpers.tracks.files import write_together

from . import ledger
from .execute import settings_of_nobody
from .ledger import keys, published, stored_verdicts
from .ledger.contents import contents, write_contents
from .project import FIGURES, LEDGER, NOTEBOOKS, CommandError, chosen_notebooks, project

STAGE = ".reproduce-"  # how the name of a folder begins in which a notebook runs
LEFT_OVER = 24 * 3600  # seconds after which such a folder is of no run: the slowest run takes some minutes
# Where the results lie of a notebook that was edited while it ran: in a folder of its key.
RESULTS = Path("reproduced")


def reproduce(some):
    """Execute notebooks in place; write their figures and, for a notebook of a paper, its verdicts.

    As many notebooks run side by side as there are processors. A notebook that fails stops those still running; none of
    these changes any file. Returns what was written, {path from the root: whether its bytes are others than before}.
    Raises CommandError for an unknown key, another project than that of the package that runs, a folder that cannot be
    written to, a notebook that fails (naming the cell and the error) and one that was edited while it ran (its results
    are kept in reproduced/, the others are written), ValueError for verdicts that do not cover the paper,
    ModuleNotFoundError without Jupyter.
    """
    for name in ("nbclient", "nbformat"):  # only the processes that run notebooks import them, which takes a second
        if find_spec(name) is None:
            raise ModuleNotFoundError(name=name)
    root = project()
    paths = chosen_notebooks(root, some)
    if root.joinpath(LEDGER).is_dir() and not root.joinpath(LEDGER).samefile(ledger.files.FOLDER):
        running = ledger.files.FOLDER.parents[1]
        raise CommandError(f"the reproduction that runs is that of {running}, not of {root}: run this in {root}")
    for folder in (FIGURES, NOTEBOOKS):
        path = root / folder
        if path.exists() and not (path.is_dir() and os.access(path, os.W_OK)):
            raise CommandError(f"{folder}: needs a folder that can be written to")
    sources = {key: path.read_bytes() for key, path in paths.items()}
    cells = {key: _code_cells(key, source) for key, source in sources.items()}
    remove_left_over(root)
    line = "cell {n} of {total}, {elapsed} so far, some {remaining} left"
    shown = {"bar_format": line, "smoothing": 0, "file": sys.stdout, "disable": not sys.stdout.isatty(), "leave": False}
    written, edited = {}, []
    with tqdm(total=sum(cells.values()), **shown) as bar, _Processes() as processes:

        def work(key):
            with staged(root) as stage:
                processes.execute(key, stage, bar)
                made = _made(root, key, stage)
            place, changed = _write(root, key, sources[key], made)
            if place != root:
                kept = place.relative_to(root)
                edited.append(
                    f"{NOTEBOOKS / key}.ipynb was edited while it ran and is left as it is: "
                    f"what this run made lies in {kept}"
                )
                return
            written.update(changed)
            with bar.external_write_mode():
                print(f"{key}: {cells[key]} cells executed", flush=True)

        processes.run(work, sorted(cells, key=cells.get, reverse=True))  # the longest first
    if edited:
        raise CommandError("\n".join(edited))
    return written


class _Processes:
    """The processes that run notebooks: when one notebook fails, or this process is ended, all are."""

    def __init__(self):
        self.running = []
        self.ended = False

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.end()

    def execute(self, key, stage, bar):
        """Execute the notebook of a key in a stage; raises CommandError where it fails."""
        # The kernel imports the packages that run here.
        variables = {"PYTHONPATH": os.pathsep.join(sys.path)} | settings_of_nobody(stage)
        command = [sys.executable, "-m", "reproduction.execute", str(stage / NOTEBOOKS / f"{key}.ipynb")]
        if self.ended:
            raise CommandError(f"{key}: not run")
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "encoding": "utf-8"}
        with subprocess.Popen(command, env=os.environ | variables, **pipes) as process:
            self.running.append(process)
            if self.ended:  # in between
                process.terminate()
            for _ in process.stdout:
                bar.update()
            said = process.stderr.read()
        if process.returncode:
            failures = [line for line in said.splitlines() if line.startswith("cell ")]
            raise CommandError(f"{key}: {failures[-1] if failures else said.strip() or 'was ended'}")

    def run(self, work, keys):
        """Call work(key) for all keys, as many at once as there are processors; raise the first failure."""
        with _ends_interrupt(), ThreadPoolExecutor(os.cpu_count() or 1) as pool:
            calls = [pool.submit(work, key) for key in keys]
            try:
                wait(calls, return_when=FIRST_EXCEPTION)
                failed = [call.exception() for call in calls if call.done() and call.exception()]
                if failed:
                    raise failed[0]
            finally:
                for call in calls:
                    call.cancel()
                self.end()

    def end(self):
        """End all processes that still run: nbclient ends their kernels."""
        self.ended = True
        for process in self.running:
            if process.poll() is None:
                process.terminate()


@contextmanager
def _ends_interrupt():
    """Let SIGTERM, and the end of the terminal, stop this process as an interrupt does, with their own exit code."""

    def stop(*_):
        raise SystemExit(143)

    ends = []
    if threading.current_thread() is threading.main_thread():  # which alone may set what a signal does
        known = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
        ends = [end for end in known if signal.getsignal(end) is signal.SIG_DFL]  # nohup ignores SIGHUP
    for end in ends:
        signal.signal(end, stop)
    try:
        yield
    finally:
        for end in ends:
            signal.signal(end, signal.SIG_DFL)


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


def remove_left_over(root):
    """Remove the folders of runs that ended without doing so, as when the machine went down."""
    for folder in root.glob(f"{STAGE}*"):
        if time.time() - folder.stat().st_mtime > LEFT_OVER:
            shutil.rmtree(folder, ignore_errors=True)


def _code_cells(key, source):
    """Return the number of code cells in the bytes of a notebook; raises CommandError for another file."""
    try:
        return sum(cell["cell_type"] == "code" for cell in json.loads(source.decode("utf-8"))["cells"])
    except (ValueError, LookupError, TypeError) as error:
        raise CommandError(f"{key}: needs a notebook ({error!r:.200})") from None


def _made(root, key, stage):
    """Return the files that a notebook has made, {path from the root: bytes}: figures, itself, its verdicts."""
    executed = stage / NOTEBOOKS / f"{key}.ipynb"
    made = {FIGURES / path.name: path.read_bytes() for path in stage.joinpath(FIGURES).iterdir()}
    if key in keys() and root.joinpath(LEDGER).is_dir():
        paper = published(key)
        verdicts = paper.complete(stored_verdicts(executed))
        made[LEDGER / f"{key}.json"] = verdicts.as_json().encode()
        if paper.rows:
            write_contents(executed, contents(paper.rows, verdicts))
    made[NOTEBOOKS / f"{key}.ipynb"] = executed.read_bytes()
    return made


def _write(root, key, source, made):
    """Write what a notebook made; where its file is no longer `source`, in reproduced/.

    Returns in which folder, and {path from there: whether its bytes are others than before}.
    """
    path = root / NOTEBOOKS / f"{key}.ipynb"
    place = root if path.is_file() and path.read_bytes() == source else root / RESULTS / key
    changed = {}
    for each in sorted(made):
        file = place / each
        file.parent.mkdir(parents=True, exist_ok=True)
        changed[each] = not file.is_file() or file.read_bytes() != made[each]
    write_together({place / each: made[each] for each in sorted(made)})
    return place, changed
