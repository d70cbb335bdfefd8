"""What is shipped, and that GitHub and `.ci/run` call the commands of the Makefile and nothing else."""

import re
import subprocess
import tarfile
import zipfile

import pytest
import yaml
from conftest import ROOT
from tools import shipped

import mpt_helpers

MAKEFILE = (ROOT / "Makefile").read_text()
COMMANDS = re.search(r"(?m)^\.PHONY: (.*)", MAKEFILE)[1].split()


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """A wheel of this tree."""
    return zipfile.ZipFile(shipped.build(tmp_path_factory.mktemp("dist"))[0])


def test_the_wheel_has_the_package_and_nothing_else(wheel):
    names = {name for name in wheel.namelist() if not name.startswith(f"mpt_helpers-{mpt_helpers.__version__}.")}
    folder = ROOT / "mpt_helpers"
    kinds = (".py", ".typed")
    assert names == {str(path.relative_to(ROOT)) for path in folder.rglob("*") if path.suffix in kinds}


def test_the_source_archive_has_what_a_checkout_has(tmp_path):
    """So that `make reproduce` and `make test` work from it."""
    tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True)
    if tracked.returncode:
        pytest.skip("not a git checkout: what belongs to it is not known")
    with tarfile.open(shipped.build(tmp_path)[1]) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert set(tracked.stdout.split()) - names == set()


def test_the_version_stands_in_one_place_and_is_that_of_the_citation():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == mpt_helpers.__version__
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert changes.startswith(f"# Changelog\n\n## {mpt_helpers.__version__} ({citation['date-released']})\n")


def test_each_extra_is_used_somewhere():
    extras = shipped.metadata()["optional-dependencies"]
    assert set(shipped.USES) == set(extras) - {"test"}


@pytest.mark.parametrize("path", sorted(ROOT.glob(".github/workflows/*.yml")), ids=lambda path: path.name)
def test_a_workflow_runs_commands_of_the_makefile_and_nothing_else(path):
    jobs = yaml.safe_load(path.read_text())["jobs"]
    steps = [step for job in jobs.values() for step in job["steps"]]
    runs = [step["run"] for step in steps if "run" in step]
    assert [run for run in runs if not re.fullmatch("make [a-z-]+", run)] == []
    assert {run.removeprefix("make ") for run in runs} <= set(COMMANDS)


def test_every_command_of_the_makefile_is_there():
    for command in COMMANDS:
        assert re.search(rf"(?m)^{command}:", MAKEFILE), command
