"""Run the guides: `python docs/run_guide.py` writes what their blocks print into them, their pictures into docs/guide/.

A block of Python is followed by what it prints, in a block of text. A picture, or a link to one that stands elsewhere,
shows the figure `fig` of the block before it. The tests run the guide in the same way and compare every byte.
"""

import contextlib
import io
import re
import tempfile
import warnings
from pathlib import Path

import matplotlib

from reproduction import figures, plots

DOCS = Path(__file__).parent
PICTURES = DOCS / "guide"
PAGES = ("guide.md", "by_hand.md", "band.md", "small_processor.md")
BLOCK = r"^```python\n(?P<code>.*?)^```$(?:\n\n```text\n(?P<said>.*?)^```$)?"
PART = re.compile(rf"(?ms){BLOCK}|^!?\[[^\]]*\]\(guide/(?P<name>\w+)\.png\)")


def run(text, names=None):
    """Run the guide from docs/: yield each part, and what it prints or, for a picture below its block, its PNG."""
    names = {} if names is None else names
    with contextlib.chdir(DOCS), matplotlib.rc_context(), tempfile.TemporaryDirectory() as place:
        plots.use_style()
        for part in PART.finditer(text):
            if part["code"]:
                with contextlib.redirect_stdout(io.StringIO()) as printed, _printed_warnings():
                    exec(compile(part["code"], "a block of a guide", "exec"), names)
                yield part, printed.getvalue()
            elif "fig" in names:
                yield part, figures.save_figure(names.pop("fig"), part["name"], place).png


@contextlib.contextmanager
def _printed_warnings():
    """Print warnings for users as a terminal shows them, and let others be errors."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = lambda message, category, *_: print(f"{category.__name__}: {message}")
        yield


def rewritten(text):
    """Return the guide with what its blocks print, and its pictures by name."""
    pictures, parts, end = {}, [], 0
    for part, made in run(text):
        if part["name"]:
            pictures[part["name"]] = made
            continue
        said = f"\n\n```text\n{made}```" if made else ""
        parts += [text[end : part.start()], f"```python\n{part['code']}```{said}"]
        end = part.end()
    return "".join([*parts, text[end:]]), pictures


if __name__ == "__main__":
    PICTURES.mkdir(exist_ok=True)
    for page in PAGES:
        text, pictures = rewritten((DOCS / page).read_text(encoding="utf-8"))
        (DOCS / page).write_text(text, encoding="utf-8")
        for name, png in pictures.items():
            (PICTURES / f"{name}.png").write_bytes(png)
