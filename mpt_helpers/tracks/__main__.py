"""`python -m mpt_helpers track FILE`: a recorded track without its faults, smoothed, with a band that was tested."""

from __future__ import annotations

import argparse
import io
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from .. import tracks
from . import report, writers
from .files import require_free, write_together
from .readers import COLUMNS

DPI = 130
DESCRIPTION = (
    "Read a recorded track (GPX, or CSV with columns time and lat, lon or x, y), refuse its faults, smooth it, test "
    "how far ahead it can be predicted, and write FILE_smooth.gpx and FILE.png. Refused fixes lie on the smoothed line "
    "of the new file."
)


def main(argv: Sequence[str]) -> int:
    """Run the command with its arguments, and return its exit status."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # escape what a terminal cannot show, or a file name that is not text
            stream.reconfigure(errors="backslashreplace")
    options = _parser().parse_args(argv)
    try:
        _run(options)
    except KeyboardInterrupt:
        print("track: interrupted; nothing was written", file=sys.stderr)
        return 130
    except (ValueError, OSError, ImportError, MemoryError) as error:
        print(f"track: {_words(error, options.file)}", file=sys.stderr)
        return 1
    return 0


def _words(error, path):
    if isinstance(error, OSError) and error.filename:
        return f"{error.filename}: {error.strerror}"
    if isinstance(error, ImportError):
        return f"{error}: python -m pip install {error.name or 'mpt_helpers'}"
    return f"{path}: needs more memory than there is" if isinstance(error, MemoryError) else str(error)


def _parser():
    parser = argparse.ArgumentParser(prog="python -m mpt_helpers track", description=DESCRIPTION)
    parser.add_argument("file", type=Path, metavar="FILE", help="a GPX or CSV file, plain or gzipped (.gz)")
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="where to write (beside FILE)")
    parser.add_argument("--seconds", type=float, default=10.0, metavar="S", help="how far ahead to predict (10)")
    pause = "start a new part after this many seconds without a fix (60, or ten usual steps if that is longer)"
    parser.add_argument("--pause", type=float, metavar="S", help=pause)
    limit = "refuse a fix whose squared distance exceeds this many variances; 50 to 200 work alike (100)"
    parser.add_argument("--limit", type=float, default=100.0, metavar="NIS", help=limit)
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of the report")
    parser.add_argument("--overwrite", action="store_true", help="replace files that exist, but never FILE")
    names = parser.add_argument_group("columns of a CSV, where they have other names")
    for what in COLUMNS:
        names.add_argument(f"--{what}", metavar="NAME", dest=f"column_{what}")
    return parser


def _run(options):
    path, folder = options.file, options.out or options.file.parent
    if path.absolute().parts[1:2] in (("dev",), ("proc",)):
        raise ValueError(f"{path}: needs a file with a name of its own: save the recording to one first")
    if not folder.is_dir():
        raise ValueError(f"{folder}: needs a folder that exists, to write to")
    named = {what: getattr(options, f"column_{what}") for what in COLUMNS}
    named = {what: name for what, name in named.items() if name is not None}
    stem = Path(path.stem).stem if path.suffix.lower() == ".gz" else path.stem
    picture = folder / f"{stem}.png"
    if path.suffix != ".png":  # which is refused for what it holds
        require_free([picture], options.overwrite, path)  # before the work
    _show("finding faults, fitting, smoothing ...")
    try:
        c = tracks.track(path, columns=named, seconds=options.seconds, limit=options.limit, pause=options.pause)
        _show("drawing ...")
        png = io.BytesIO()
        c.plot().savefig(png, format="png", dpi=DPI, metadata={"Software": "mpt_helpers"})
    finally:
        _show("")
    if c.source.recording.metres is None:
        smooth, track = folder / f"{stem}_smooth.gpx", writers.gpx_bytes(c)
    else:
        smooth, track = folder / f"{stem}_smooth.csv", writers.csv_bytes(c)
    replaced = [each.name for each in (smooth, picture) if each.exists()]
    write_together({smooth: track, picture: png.getvalue()}, options.overwrite, path)
    files = [str(smooth), str(picture)]
    if options.json:
        found = report.summary(c) | {"files": files, "replaced": replaced}
        print(json.dumps(found, ensure_ascii=False, allow_nan=False))
        return
    print(c.report())
    print(f"written: {', '.join(files)}" + (f" (replaced: {', '.join(replaced)})" if replaced else ""))


def _show(stage):
    """Show what is being done on a terminal, in one line."""
    if sys.stderr.isatty():
        print(f"\r\033[K{stage}", end="", file=sys.stderr, flush=True)
