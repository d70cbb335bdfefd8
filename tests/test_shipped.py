"""What is shipped, and that GitHub and `.ci/run` call the commands of the Makefile and nothing else."""

import re
import zipfile

import pytest
import yaml
from conftest import ROOT
from tools import shipped

import mpt_helpers
from reproduction.ledger import keys

MAKEFILE = (ROOT / "Makefile").read_text()
COMMANDS = re.search(r"(?m)^\.PHONY: (.*)", MAKEFILE)[1].split()


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """A wheel of this tree."""
    return zipfile.ZipFile(shipped.build(tmp_path_factory.mktemp("dist"))[0])


def test_the_wheel_has_the_package_and_what_the_papers_print_and_nothing_else(wheel):
    names = {name for name in wheel.namelist() if not name.startswith(f"mpt_helpers-{mpt_helpers.__version__}.")}
    folder = ROOT / "mpt_helpers"
    kinds = (".py", ".toml", ".json", ".typed")
    assert names == {str(path.relative_to(ROOT)) for path in folder.rglob("*") if path.suffix in kinds}
    assert {f"reproduction/ledger/{key}.toml" for key in keys()} <= names


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
