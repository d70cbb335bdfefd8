"""What is shipped, and that GitHub and `.ci/run` call the commands of the Makefile and nothing else."""

import os
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile

import pytest
import yaml
from conftest import ROOT
from packaging.version import Version

import mpt_helpers
from tools import shipped

MAKEFILE = (ROOT / "Makefile").read_text()
COMMANDS = re.search(r"(?m)^\.PHONY: (.*)", MAKEFILE)[1].split()


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """The wheel and the source archive of this tree."""
    return shipped.build(tmp_path_factory.mktemp("dist"))


def test_the_smoke_test_reads_utf_8_where_that_is_not_the_encoding_of_the_locale(tmp_path):
    """As on Windows, where the README cannot be read by the locale's."""
    locale = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    code = f"""if True:
        import sys, types
        from pathlib import Path
        sys.path.insert(0, {str(ROOT / "tests")!r})
        from tools import shipped
        assert "mpt.fit" in shipped.README_CODE
        assert shipped.metadata()["name"] == "mpt_helpers"
        there = types.SimpleNamespace(here=Path.cwd(), run=lambda path: exec(path.read_bytes()))
        shipped.Environment.script(there, "assert len('\\u03c3\\u00b2') == 2")
    """
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=os.environ | locale, check=True)


def test_the_wheel_has_the_package_and_nothing_else(built):
    wheel = zipfile.ZipFile(built[0])
    names = {name for name in wheel.namelist() if not name.startswith(f"mpt_helpers-{mpt_helpers.__version__}.")}
    folder = ROOT / "mpt_helpers"
    kinds = (".py", ".typed")
    assert names == {str(path.relative_to(ROOT)) for path in folder.rglob("*") if path.suffix in kinds}


def test_the_source_archive_has_what_a_checkout_has(built):
    """So that `make reproduce` and `make test` work from it."""
    tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True)
    if tracked.returncode:
        pytest.skip("not a git checkout: what belongs to it is not known")
    with tarfile.open(built[1]) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert set(tracked.stdout.split()) - names == set()


def test_the_version_is_ahead_of_the_last_release_which_the_citation_names():
    """A version such as 0.5.0.dev0 stands behind the last release; at a release all three agree."""
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    changes = re.findall(r"(?m)^## (.*)$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"))
    assert changes[0] == "Unreleased"
    assert changes[1] == f"{citation['version']} - {citation['date-released']}"
    assert Version(mpt_helpers.__version__) >= Version(citation["version"])


def test_each_extra_is_used_somewhere():
    extras = shipped.metadata()["optional-dependencies"]
    assert set(shipped.USES) == set(extras) - {"test"}


WORKFLOWS = sorted(ROOT.glob(".github/workflows/*.yml"))
# Commands of a workflow that are none of the Makefile's: Windows has no make, and a tag must be the package's version.
OTHERS = {
    'python -m pip install "flit_core>=3.11"',
    "python tests/tools/shipped.py",
    'test "v$(sed -n \'s/^__version__ = "\\(.*\\)"/\\1/p\' mpt_helpers/__init__.py)" = "$GITHUB_REF_NAME"',
    'gh release create "$GITHUB_REF_NAME" dist/* --draft --title "$GITHUB_REF_NAME" --notes-file CHANGELOG.md',
}


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_a_workflow_runs_commands_of_the_makefile_and_few_others(path):
    jobs = yaml.safe_load(path.read_text())["jobs"]
    runs = {step["run"] for job in jobs.values() for step in job["steps"] if "run" in step} - OTHERS
    assert runs <= {f"make {command}" for command in COMMANDS}


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_a_workflow_ends_in_time_and_its_actions_are_pinned_by_hash(path):
    jobs = yaml.safe_load(path.read_text())["jobs"]
    assert [name for name, job in jobs.items() if "timeout-minutes" not in job] == []
    actions = [step["uses"] for job in jobs.values() for step in job["steps"] if "uses" in step]
    assert [action for action in actions if not re.fullmatch(r"[\w-]+/[\w-]+@[0-9a-f]{40}", action)] == []


@pytest.fixture
def made(tmp_path):
    """A function that runs `make` with the Makefile alone, and a Python that shows its arguments and ends with a code.

    It returns the exit code, the arguments of each call, and the last line that is not make's own.
    """
    if os.name != "posix" or not shutil.which("make"):
        pytest.skip("needs make and a shell")
    (tmp_path / "Makefile").write_text(MAKEFILE)
    for name in ("pyproject.toml", "environment.lock"):
        (tmp_path / name).touch()

    def make(command, fails=None, installed=True):
        """Fail (exit code 3) where the arguments of a call have the word `fails`."""
        python = tmp_path / "python"
        python.write_text(f'#!/bin/sh\necho "called: $*"\ncase "$*" in *"{fails or "nothing"}"*) exit 3;; esac\n')
        python.chmod(0o755)
        (tmp_path / ".venv").mkdir(exist_ok=True)
        if installed:
            (tmp_path / ".venv" / ".ok").touch()
        arguments = ["make", command, f"PY={python}", f"PYTHON={python}"]
        # Within `make test` this is a make of its own, which tells of no folder and no level.
        alone = {name: value for name, value in os.environ.items() if name not in ("MAKEFLAGS", "MFLAGS", "MAKELEVEL")}
        said = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        run = subprocess.run(arguments, cwd=tmp_path, env=alone, **said)
        lines = run.stdout.splitlines()
        calls = [line.removeprefix("called: ") for line in lines if line.startswith("called: ")]
        return run.returncode, calls, [line for line in lines if not line.startswith("make: ***")][-1]

    return make


def test_make_test_runs_the_style_the_tests_and_the_bytes_and_says_at_its_end_whether_all_is_well(made):
    code, calls, last = made("test")
    assert code == 0
    assert calls[:2] == ["-m ruff check .", "-m ruff format --check ."]
    assert calls[2].startswith("-m pytest ")
    # exact compares every byte; the sockets of its kernels are those of tests/conftest.py
    assert " -p tests.support.exact --nbval --nbval-current-env " in calls[2]
    assert calls[2].endswith(" -m not slow mpt_helpers reproduction docs/break_sensor.py tests notebooks")
    assert last.startswith("make test: all is well: ")
    for fails, count in (("check .", 1), ("format", 2), ("pytest", 3)):
        code, calls, last = made("test", fails)
        assert (code, len(calls)) == (2, count)  # of make, whatever the command's own is
        assert last == "make test: not all is well: see FAILED, or the error, above"


def test_make_reproduce_that_fails_says_so_at_its_end(made):
    assert made("reproduce")[:2] == (0, ["-m reproduction reproduce"])
    code, _, last = made("reproduce", "reproduction")
    assert (code, last) == (2, "make reproduce: not everything ran: see the error above")


def test_make_nbval_talks_through_files(made):
    _, (call,), _ = made("nbval")
    assert " -p tests.support.sockets " in call
    assert call.endswith(" notebooks")


def test_where_nothing_can_be_installed_make_says_what_to_do(made):
    code, calls, last = made("reproduce", "--require-hashes", installed=False)
    assert code == 2
    assert calls[-1].endswith("--require-hashes -r environment.lock")
    assert last.startswith("error: pip could not install environment.lock. ")
    for word in ("HTTPS_PROXY", "PIP_INDEX_URL", "make PYTHON=python3.13", "hashes"):
        assert word in last
    code, calls, last = made("reproduce", "import sys", installed=False)
    assert (code, len(calls)) == (2, 1)  # the version of Python is asked first
    assert "Python 3.11 or newer is needed" in last


def test_the_pythons_that_were_tried_are_the_same_everywhere():
    """In the README, where make cannot install, and in the environments of `make test-all`."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert "Python 3.11 to 3.13" in readme
    assert "a Python of 3.11 to 3.13, which were tried" in MAKEFILE
    assert shipped.metadata()["requires-python"] == ">=3.11"


def test_before_a_commit_the_ruff_of_the_environment_runs():
    repos = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"]
    (ruff,) = (each["rev"] for each in repos if each["repo"].endswith("/ruff-pre-commit"))
    assert f"ruff=={ruff.removeprefix('v')}\n" in (ROOT / "environment.txt").read_text(encoding="utf-8")


def test_every_command_of_the_makefile_is_there():
    for command in COMMANDS:
        assert re.search(rf"(?m)^{command}:", MAKEFILE), command
