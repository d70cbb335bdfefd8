"""Pages followed to the letter: a fifth paper in a copy of the project; a motion, a filter and a gate.

Those that need the copy run in `make test-all`: only who adds something to the project meets them.
"""

import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys

import nbformat
import numpy as np
import pytest
from conftest import NOTEBOOKS, ROOT, cells_of
from oracles import plain_loop, van_loan
from scipy.linalg import expm

import mpt_helpers as mpt
from reproduction.__main__ import main
from reproduction.ledger import Paper, keys, published, read_paper, stored_verdicts
from reproduction.ledger.items import KINDS
from reproduction.ledger.verdicts import BASES, CAUSE_KINDS

PAGE = (ROOT / "reproduction" / "README.md").read_text(encoding="utf-8")
EXTENDING = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
KEY = re.search(r"The key is .*, here `(\w+)`", PAGE)[1]
KERNEL = json.loads(re.search(r"has the metadata `(\{.*?\})`", PAGE)[1])
FOLDED = json.loads(re.search(r"folded by the metadata `(\{.*?\})`", PAGE)[1])
# Not what Python has compiled: that it need not do again.
IGNORED = shutil.ignore_patterns(".*", "_build", "dist", "*.egg-info")
# What `make site` makes before Sphinx runs.
SITE = """\
import sys
sys.path.insert(0, "docs")
import pages
pages.main()"""
# What `make reproduce` does, for the new paper only: one process imports all that it needs.
MAKES = f"""\
from reproduction.__main__ import main
assert main(["reproduce", "{KEY}"]) == main(["readme"]) == 0"""


def blocks(kind):
    """Return the page's code blocks of one kind."""
    return re.findall(rf"```{kind}\n(.*?)```", PAGE, re.DOTALL)


MODULE = blocks("python")[0].rstrip("\n")  # the others are cells


def run(folder, *arguments):
    """Run Python in a copy of the project, with the package of this copy; return what it prints."""
    environment = os.environ | {"PYTHONPATH": str(folder)}
    done = subprocess.run([sys.executable, *arguments], cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    """A copy of the project to which the page has added a paper: its notebook is executed, its counts in the README."""
    copy = tmp_path_factory.mktemp("project") / "copy"
    shutil.copytree(ROOT, copy, ignore=IGNORED)
    ledger, words = blocks("toml")
    (copy / "reproduction" / "ledger" / f"{KEY}.toml").write_text(ledger, encoding="utf-8")
    (name,) = re.findall(rf"`(reproduction/\w+_{KEY[:4]}\.py)`", PAGE)
    (copy / name).write_text(f"{MODULE}\n", encoding="utf-8")
    path = copy / "docs" / "papers.toml"
    path.write_text(f"{path.read_text(encoding='utf-8')}\n{words}", encoding="utf-8")
    write_the_notebook(copy / "notebooks" / f"{KEY}.ipynb")
    run(copy, "-c", MAKES)
    return copy


def write_the_notebook(path):
    """Write the page's cells, not yet executed."""
    notebook = nbformat.v4.new_notebook(metadata=KERNEL)
    for kind, text in re.findall(r"```(markdown|python)\n(.*?)\n```", PAGE, re.DOTALL):
        if kind == "markdown":
            notebook.cells.append(nbformat.v4.new_markdown_cell(text))
        elif text != MODULE:
            metadata = FOLDED if text.startswith("# ") or "save_figure(fig" in text else {}
            notebook.cells.append(nbformat.v4.new_code_cell(text, metadata=metadata))
    nbformat.write(notebook, path)


@pytest.fixture
def said(copy, monkeypatch, capsys):
    """A function that returns the words of the command line on the copy's verdicts."""

    def said(*arguments):
        monkeypatch.setattr("reproduction.ledger.files.FOLDER", copy / "reproduction" / "ledger")
        assert main(["verdicts", *arguments]) == 0
        return capsys.readouterr().out

    return said


@pytest.mark.slow
def test_the_new_paper_has_its_verdicts(said):
    given = {each["id"]: each for each in json.loads(said(KEY, "--json"))}
    verdicts = {id: each["verdict"] for id, each in given.items()}
    values = {"table1.gain": "reproduced", "table1.variance": "differs"}
    assert verdicts == values | {"units": "reproduced", "figure1": "cannot be checked"}
    assert given["table1.variance"]["cause"] == "digits-exchanged"
    assert given["table1.variance"]["computed"] == "0.618034"
    assert {each["basis"] for each in given.values()} == {"exact", "identity", "reading"}


@pytest.mark.slow
def test_the_new_paper_is_counted_beside_the_others(said):
    others = keys()
    shown = said()
    assert re.findall(r"(?m)^(\w+): ", shown) == sorted([KEY, *others])
    assert "The filter is a little better than printed." in " ".join(shown.split())


@pytest.mark.slow
def test_the_front_of_its_notebook_has_its_contents(copy):
    front = "".join(cells_of(copy / "notebooks" / f"{KEY}.ipynb")[0]["source"])
    assert "| [Table 1](#Table-1) | the settled filter | ✗ 1 of 2 wrong: digits exchanged |" in front
    assert "| [Figure 1](#Figure-1) | the variance of the first steps | ? picture lost in our copy; redrawn on" in front


@pytest.mark.slow
def test_the_projects_tests_of_papers_and_pages_pass_with_the_new_paper(copy):
    files = [
        "tests/site/test_readme.py",
        *(f"tests/papers/test_{name}.py" for name in ("ledger", "notebooks", "articles")),
    ]
    others = " and ".join(f"not {key}" for key in (*keys(), "lessons"))  # what says something of them has run
    said = run(copy, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-k", others, *files)
    assert " passed" in said
    readme = (copy / "README.md").read_text(encoding="utf-8")
    assert re.search(rf"\| A\. Walker, \*[\w ]+\*, \d+: \[our notebook\]\(notebooks/{KEY}\.ipynb\)", readme)
    assert "| How well can a random walker be known? **" in readme


@pytest.mark.slow
def test_the_site_has_the_new_paper(copy):
    run(copy, "-c", SITE)
    source = copy / "docs" / "_build" / "source"
    home = (source / "index.md").read_text(encoding="utf-8")
    assert f'<a href="notebooks/{KEY}.html#table-1" aria-label="Table 1 of 1960">1</a>' in home
    assert "How well can a random walker be known?" in home
    assert "Are the digits 1 and 8 of the variance exchanged?" in (source / "ledger.md").read_text(encoding="utf-8")
    assert (source / "notebooks" / f"{KEY}.ipynb").is_file()


@pytest.mark.slow
def test_an_item_without_a_verdict_is_an_error_that_names_it(copy, monkeypatch):
    monkeypatch.setattr("reproduction.ledger.files.FOLDER", copy / "reproduction" / "ledger")
    verdicts = stored_verdicts(copy / "notebooks" / f"{KEY}.ipynb")
    with pytest.raises(ValueError, match=f"{KEY}.toml and its notebook: no verdict on units"):
        published(KEY).complete([each for each in verdicts if each.id != "units"])


def test_without_its_cause_a_failing_item_stops_the_run_in_the_words_of_the_page():
    """The ledger of the page as it is before the first run."""
    before = blocks("toml")[0].replace(', cause = "digits-exchanged"', "")
    gain = (5**0.5 - 1) / 2  # the settled gain, and the settled variance
    with pytest.raises(ValueError, match="needs a cause") as stopped:
        read_paper(KEY, before).table("table1", [gain, gain])
    _, _, message = str(stopped.value).partition("'table1.variance': ")
    assert f"`{message}`" in PAGE


def test_the_calls_of_the_page_are_those_of_a_paper():
    calls = set(re.findall(r"`paper\.(\w+)", PAGE))
    assert {"table", "equal", "claims", "lacking", "check", "claim", "cannot_check"} <= calls
    assert [call for call in calls if not callable(getattr(Paper, call))] == []


def test_the_page_says_of_cells_what_the_tests_hold_notebooks_to():
    cells = [cell for path in NOTEBOOKS for cell in cells_of(path)]
    folded = [cell["metadata"] for cell in cells if "hide-input" in cell["metadata"].get("tags", [])]
    assert [each for each in folded if each != FOLDED] == []


def test_the_page_names_every_kind_of_item_and_cause_and_every_basis():
    for kind in (*KINDS, *CAUSE_KINDS, *BASES):
        assert f"`{kind}`" in PAGE, kind


def test_the_layout_names_every_part():
    contributing = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    (layout,) = re.findall(r"### Layout\n\n((?:    .*\n)+)", contributing)
    for name in ("mpt_helpers/", "reproduction/", "ledger/", "notebooks/", "docs/", "benchmarks/", "tests/"):
        assert name in layout.split(), name
    for path in (ROOT / "mpt_helpers").glob("*.py"):
        if path.stem not in ("__init__", "__main__", "_checks", "_immutable"):
            assert path.stem in layout.replace(",", " ").split(), path.stem


def text_of(kind):
    """The name and the text of the module of a motion, a filter or a gate, as the page has it."""
    block = rf"Here is `(\w+)\.py`(?:(?!Here is `).)*?```python {kind}\n(.*?)```"
    (found,) = re.findall(block, EXTENDING, re.DOTALL)
    return found


@pytest.fixture
def added(tmp_path, monkeypatch):
    """A function that adds the module of a motion, a filter or a gate to the package, and returns it."""

    def added(kind):
        name, text = text_of(kind)
        path = tmp_path / f"{name}.py"
        path.write_text(text, encoding="utf-8")
        spec = importlib.util.spec_from_file_location(f"mpt_helpers.{name}", path)
        module = importlib.util.module_from_spec(spec)
        monkeypatch.setitem(sys.modules, spec.name, module)
        spec.loader.exec_module(module)
        return module

    return added


def test_a_motion_is_one_file(added):
    """With times and gaps of its own it is filtered as by a plain loop, smoothed, fitted, and given a band."""
    motion = added("motion").Forgetful
    rng = np.random.default_rng(5)
    t = np.cumsum(0.001 + rng.exponential(2.0, 300))
    drift = np.array([[0, 1], [0, -1 / 20]])
    for length in (1e-9, 0.02, 2.1, 2.2, 6.0, 40.0):  # from 2.107 s on, Q is no series
        (F, Q), (F_right, Q_right) = motion(20.0, 0.04)(length), van_loan(drift, [0, 0.04], length)
        np.testing.assert_allclose(F, F_right, rtol=1e-12, atol=1e-15)  # the oracle's zero is 1e-16
        np.testing.assert_allclose(Q, Q_right, rtol=1e-12)  # 0.1 less 0.1 leaves 0.1**3 / 3 with 13 digits

    def model(q, r):
        return mpt.LinearModel(transition=motion(20.0, q), dt=1.0, H=[[1, 0]], R=[[r]], P0=np.eye(2))

    true = model(0.04, 0.5)
    steps = [true.transition(dt) for dt in np.diff(t, prepend=t[0] - 1)]
    x, z, truth = np.zeros(2), np.empty((300, 1)), np.empty((300, 2))
    for k, (F, Q) in enumerate(steps):
        x = F @ x + np.linalg.cholesky(Q + 1e-15 * np.eye(2)) @ rng.standard_normal(2)
        truth[k], z[k] = x, x[0] + rng.normal(0, np.sqrt(0.5))
    z[rng.random(300) < 0.2] = np.nan
    kf = mpt.KalmanFilter(true, t=t)
    plain = plain_loop(steps, true.H, [true.R] * 300, true.x0, true.P0, z)
    np.testing.assert_allclose(kf.filter(z), plain.x, rtol=1e-9, atol=1e-9)
    smooth = kf.smooth(z)
    assert np.mean((truth - smooth.x)[:, 0] ** 2 < 4 * smooth.P[:, 0, 0]) > 0.85
    found = mpt.fit(lambda q, r: mpt.KalmanFilter(model(q, r), t=t), z, q=0.1, r=1.0)
    assert abs(np.log(found.values["r"] / 0.5)) < 3 * found.log_errors["r"]
    assert np.isfinite(mpt.metrics.following(mpt.metrics.ahead(kf, z, 3.0))).any()


def test_the_page_of_extensions_prints_what_it_says(tmp_path, monkeypatch, capsys):
    """The three files lie beside the script, as a user has them."""
    for kind in ("motion", "filter", "gate"):
        name, text = text_of(kind)
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    names = {}
    exec("".join(re.findall(r"```python use\n(.*?)```", EXTENDING, re.DOTALL)), names)
    assert capsys.readouterr().out == "".join(re.findall(r"```text\n(.*?)```", EXTENDING, re.DOTALL))
    assert names["plane"].n == 4
    assert names["counts"].all()  # no outlier was simulated
    np.testing.assert_array_equal(names["x_gated"], names["x"])
    assert not np.allclose(names["x_fading"], names["x"])


def test_another_motion_is_refused_in_the_words_of_the_page():
    def constant_within_a_step(dt):
        return np.array([[1, dt], [0, 1]]), np.array([[dt**4 / 4, dt**3 / 2], [dt**3 / 2, dt**2]])

    with pytest.raises(ValueError, match="transition: needs two steps") as refused:
        mpt.LinearModel(transition=constant_within_a_step, dt=1.0, H=[[1, 0]], R=[[0.5]])
    assert f"`{refused.value}`" in EXTENDING


def test_a_filter_is_one_file(added):
    """Tracks with gaps of their own are filtered as by a plain loop."""
    model = mpt.constant_velocity(1.0, 0.01, 0.1, P0=np.eye(2))
    rng = np.random.default_rng(6)
    z = np.cumsum(rng.standard_normal((200, 1, 3)), axis=0)
    z[rng.random(z.shape) < 0.2] = np.nan
    found = added("filter").FadingFilter(model, alpha=1.05).filter(z)
    steps = [(model.F, model.Q)] * 200
    for track in range(3):
        loop = plain_loop(steps, model.H, [model.R] * 200, model.x0, model.P0, z[..., track], alpha=1.05)
        np.testing.assert_allclose(found[..., track], loop.x, rtol=1e-9, atol=1e-9)


def test_a_gate_is_one_file(added):
    """It refuses the one outlier. That it is a plain loop, test_own_gate says."""
    kf = mpt.KalmanFilter(mpt.constant_velocity(1.0, 0.01, 0.1, P0=np.eye(2)), t=np.arange(40.0) ** 1.2)
    z = np.arange(40.0)[:, None] ** 1.2
    z[20] += 30
    np.testing.assert_array_equal(np.flatnonzero(~added("gate").impatient(kf, z)), [20])


def test_the_gate_of_the_page_comes_slowly_across_a_jump(added):
    assert "After a jump this gate lets in one fix in six until the line has come across" in EXTENDING
    kf = mpt.KalmanFilter(mpt.constant_velocity(1.0, 0.01, 0.1, P0=np.eye(2)))
    z = np.zeros((100, 1))
    z[50:] = 500
    refused = np.flatnonzero(~added("gate").impatient(kf, z))
    np.testing.assert_array_equal(refused[:10], [*range(50, 55), *range(56, 61)])
    assert refused[-1] < 80


@pytest.mark.parametrize(("dt", "exponential"), [(0.001, True), (10.0, True), (10.0, False), (1000.0, False)])
def test_the_Q_of_the_page_for_long_steps_is_one_for_long_steps_only(dt, exponential):
    """Van Loan's exponential, or the covariance that the state settles at: each is refused where the page says so."""
    assert "use P∞ - F P∞ Fᵀ there. Over short steps that loses digits." in EXTENDING
    rate, noise = np.sqrt(3) / 30, 4 * (np.sqrt(3) / 30) ** 3 * 100  # the Matérn 3/2 process of 30 s and 10 m
    drift, settled = np.array([[0, 1], [-(rate**2), -2 * rate]]), np.diag([100, 100 * rate**2])

    def model(dt, exponential):
        def transition(dt):
            F = expm(drift * dt)
            return van_loan(drift, [0, noise], dt) if exponential else (F, settled - F @ settled @ F.T)

        return mpt.LinearModel(transition=transition, dt=dt, H=[[1, 0]], R=[[0.5]])

    model(dt, exponential)
    if dt != 10:
        with pytest.raises(ValueError, match="transition: needs"):
            model(dt, not exponential)


@pytest.mark.slow
def test_the_three_files_are_as_the_project_wants_its_modules(copy):
    """Style, doctests and rooms of the copy, with nothing changed but the three files that are new."""
    files = []
    for kind in ("motion", "filter", "gate"):
        name, text = text_of(kind)
        files.append(f"mpt_helpers/{name}.py")
        (copy / files[-1]).write_text(
            text.replace("from mpt_helpers import", "from ._base import").replace("from mpt_helpers.", "from ."),
            encoding="utf-8",
        )
    shutil.copy(ROOT / "pyproject.toml", copy)
    run(copy, "-m", "ruff", "check", *files)
    run(copy, "-m", "ruff", "format", "--check", *files)
    tests = ["tests/core/test_package.py"]
    assert " passed" in run(copy, "-m", "pytest", "-q", "-p", "no:cacheprovider", *files, *tests)
